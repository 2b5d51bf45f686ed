"""Silhouettes of one body meet in space, whatever it does and wherever it is; others do not."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.silhouette_pictures import pose_at, ring, silhouettes_of, somebody

from mocapella.calibration.visual_cones import MEET_FROM, Meeting, _overlap, disagreements, meetings
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


def fan(low_deg, high_deg, turned_deg=0.0):
    """Rays about z, whose angles are in this interval, and which also go along it."""
    angles = np.radians(np.linspace(low_deg, high_deg, 41) + turned_deg)
    return np.stack([np.cos(angles), np.sin(angles), np.linspace(-0.5, 0.7, 41)], axis=-1)


@pytest.mark.parametrize("turned_deg", [0.0, 90.0, 175.0, -179.0, 300.0])
def test_an_overlap_is_the_common_part_of_two_intervals_wherever_zero_is(turned_deg):
    for other, expected in (((0, 20), 1 / 3), ((-5, 5), 1 / 2), ((-10, 10), 1.0), ((11, 30), 0.0), ((-12, -9), 1 / 22)):
        a, b = fan(-10, 10, turned_deg), fan(*other, turned_deg)
        for length in (0.2, -3.0):
            assert _overlap(a, b, np.array([0, 0, length])) == pytest.approx(expected, abs=1e-9)
            assert _overlap(b, a, np.array([0, 0, length])) == pytest.approx(expected, abs=1e-9)


def test_rays_nearly_all_around_have_no_interval_and_so_no_overlap():
    baseline, narrow = np.array([0.0, 0.0, 1.0]), fan(-10, 10)
    assert _overlap(fan(-75, 75), narrow, baseline) == pytest.approx(20 / 150)
    for wide in (fan(-85, 85), fan(-170, 170)):
        assert np.isnan(_overlap(wide, narrow, baseline))
        assert np.isnan(_overlap(narrow, wide, baseline))


def test_an_overlap_of_just_the_least_is_no_contradiction():
    good, bad = 0.6, float(np.nextafter(0.6, 0))
    assert disagreements([Meeting(("a", "b"), good)], 0.6) == []
    (said,) = disagreements([Meeting(("a", "b"), bad), Meeting(("a", "c"), good), Meeting(("b", "c"), 0.9)], 0.6)
    assert "are the videos of these cameras, in this order" in said
    (said,) = disagreements([Meeting(("a", "b"), bad), Meeting(("a", "c"), bad), Meeting(("b", "c"), good)], 0.6)
    assert "a and b (60%), a and c (60%)" in said
    assert "a stands elsewhere" in said


@pytest.mark.parametrize(("shape", "says"), [((5, 6), True), ((4, 7), False)])
def test_a_silhouette_has_thirty_samples_at_least_and_none_on_its_outline(shape, says):
    phi = np.zeros((20, 20), np.float32)
    phi[5 : 5 + shape[0], 5 : 5 + shape[1]] = 1.0
    small = Silhouette((100, 100), 1, phi)
    (found,) = meetings({"c1": small, "c2": silhouettes_of(MESH, RIG, pose_at(MESH))["c2"]}, RIG)
    assert np.isfinite(found.overlap) == says
