"""Silhouettes of one body meet in space, whatever it does and wherever it is; others do not."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.silhouette_pictures import pose_at, ring, silhouettes_of, somebody

from mocapella.calibration.visual_cones import MEET_FROM, disagreements, meetings
from mocapella.model.camera import CameraRig
from mocapella.model.silhouettes import Silhouette
from mocapella.model.twist_tree import TreePose

MESH = somebody()
RIG = ring(3, size_px=(320, 240), far_m=5.0)


@settings(max_examples=15)
@given(aside=st.floats(-0.3, 0.3), turn=st.floats(-3.0, 3.0), bend=st.floats(0.0, 1.5), seed=st.integers(0, 9))
def test_silhouettes_of_one_body_meet(aside, turn, bend, seed):
    rng = np.random.default_rng(seed)
    pose = pose_at(MESH, aside, bend)
    T = pose.T_world_model.copy()
    T[:3, :3] = [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
    angles = np.clip(pose.angles + rng.normal(0, 0.2, len(pose.angles)), *MESH.tree.limits.T)
    found = meetings(silhouettes_of(MESH, RIG, TreePose(T, angles)), RIG)
    assert len(found) == 3
    assert all(one.overlap > 0.9 for one in found)
    assert disagreements(found) == []


def test_a_camera_that_is_turned_is_named():
    placed = RIG.cameras["c2"]
    angle = np.radians(12)
    R = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    T = placed.T_camera_world.copy()
    T[:3] = R @ T[:3]
    wrong = CameraRig({**RIG.cameras, "c2": msgspec.structs.replace(placed, T_camera_world=T)})
    found = meetings(silhouettes_of(MESH, RIG, pose_at(MESH)), wrong)
    (said,) = disagreements(found)
    assert "c2 stands elsewhere" in said
    assert [one.overlap < MEET_FROM for one in found if "c2" in one.cameras] == [True, True]
    assert [one.overlap > 0.9 for one in found if "c2" not in one.cameras] == [True]


def test_two_cameras_alone_are_both_named():
    two = CameraRig({name: RIG.cameras[name] for name in ("c1", "c2")})
    seen = silhouettes_of(MESH, two, pose_at(MESH))
    x, y = seen["c1"].origin_px
    (said,) = disagreements(meetings({**seen, "c1": msgspec.structs.replace(seen["c1"], origin_px=(x, y - 45))}, two))
    assert "c1 and c2" in said
    assert "in this order" in said


@pytest.mark.parametrize("what", ["cut off", "tiny", "one place"])
def test_what_says_nothing_says_nothing(what):
    seen, rig = silhouettes_of(MESH, RIG, pose_at(MESH)), RIG
    if what == "cut off":
        seen["c1"] = msgspec.structs.replace(seen["c1"], origin_px=(-40, seen["c1"].origin_px[1]))
    elif what == "tiny":
        seen["c1"] = msgspec.structs.replace(seen["c1"], phi=np.full((4, 4), -1.0, np.float32))
    else:
        rig = CameraRig({**RIG.cameras, "c1": RIG.cameras["c2"], "c3": RIG.cameras["c2"]})
    found = [one.overlap for one in meetings(seen, rig) if "c1" in one.cameras]
    assert np.isnan(found).all()
    assert disagreements(meetings(seen, rig)) == []


@pytest.mark.parametrize("step_px", [1, 2])
@pytest.mark.parametrize("side", ["left", "right", "top", "bottom"])
def test_a_silhouette_within_two_samples_of_any_edge_of_the_image_says_nothing(side, step_px):
    (width, height), reach = RIG.cameras["c1"].camera.size_px, 9 * step_px
    for room_px, says in ((2 * step_px, True), (2 * step_px - 1, False), (0, False)):
        x, y = {
            "left": (room_px, 100), "right": (width - 1 - room_px - reach, 100),
            "top": (100, room_px), "bottom": (100, height - 1 - room_px - reach),
        }[side]  # fmt: skip
        square = Silhouette((x, y), step_px, np.ones((10, 10), np.float32))
        (found,) = meetings({"c1": square, "c2": silhouettes_of(MESH, RIG, pose_at(MESH))["c2"]}, RIG)
        assert np.isfinite(found.overlap) == says


def test_silhouettes_at_a_coarser_step_meet_as_well():
    fine = silhouettes_of(MESH, RIG, pose_at(MESH))
    coarse = {
        name: msgspec.structs.replace(one, step_px=2 * one.step_px, phi=np.ascontiguousarray(one.phi[::2, ::2]))
        for name, one in fine.items()
    }
    assert [one.overlap > 0.9 for one in meetings(coarse, RIG)] == [True] * 3
