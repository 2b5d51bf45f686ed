"""Joints of tracked people as starts of bodies."""

from __future__ import annotations

import numpy as np
import pytest

from mocapella.library.keypoint_tracking import UP
from mocapella.model.body_meshes import body_mesh
from mocapella.model.observations import JointState
from mocapella.model.openpose_names import LANDMARKS
from mocapella.model.rigged_mesh import landmarks_at
from mocapella.model.topology import topology
from mocapella.model.trajectories import Trajectories
from mocapella.tracker.silhouette_start import LATER_EVERY_S, RIG_FROM_Y_UP, people_joints, start_pose

HALPE = topology("halpe_26").joints
RATE_HZ = 30.0


def people(frames: int = 30, *, second_comes: int = 0) -> Trajectories:
    """Two standing people, the second from a frame on; the nose of the first is only inferred."""
    mesh = body_mesh("male", 1.8)
    at = {name: mark.point for name, mark in mesh.landmarks.items()}
    one = np.array([at.get(LANDMARKS.get(name, ""), np.full(3, np.nan)) for name in HALPE])
    positions = np.stack([np.stack([one, one + np.array([1.0, 0.0, 0.0])])] * frames).astype(np.float32)
    positions[:second_comes, 1] = np.nan
    states = np.where(np.isfinite(positions).all(axis=-1), JointState.TRACKED, JointState.NOT_TRACKED).astype(np.uint8)
    states[:, 0, HALPE.index("Nose")] = JointState.INFERRED
    return Trajectories(
        "people", np.arange(frames) / RATE_HZ, np.zeros(frames, np.int64), ("person_0", "person_1"), HALPE, positions,
        states, np.zeros(states.shape, np.float32),
    )  # fmt: skip


def test_each_person_has_a_start_and_later_joints_that_are_measured() -> None:
    found = people_joints(people(), 0.0)
    assert list(found) == ["person_0", "person_1"]
    first = found["person_0"]
    assert {"nose", "left hip", "right shoulder", "left toe"} <= first.start.keys()
    assert "nose" not in first.later[0].joints
    times = [one.at_s for one in first.later]
    assert times[0] >= LATER_EVERY_S - 1e-9
    assert np.diff(times).min() >= LATER_EVERY_S - 1e-9
    mesh = body_mesh("male", 1.8)
    pose = start_pose(mesh, found["person_1"].start)
    at = dict(zip(mesh.landmarks, landmarks_at(mesh, pose), strict=True))
    away = [np.linalg.norm(at[name] - place) for name, place in found["person_1"].start.items()]
    assert np.median(away) < 0.01


def test_someone_who_comes_later_has_no_start_but_later_joints() -> None:
    found = people_joints(people(60, second_comes=40), 0.0)
    assert found["person_1"].start == {}
    assert found["person_1"].later[0].at_s == pytest.approx(40 / RATE_HZ)
    soon = people_joints(people(60, second_comes=5), 0.0)
    assert soon["person_1"].start


def test_times_count_from_the_first_frame_that_is_tracked() -> None:
    found = people_joints(people(60), 1.0)
    assert found["person_0"].start
    assert all(0 < one.at_s <= 1.0 for one in found["person_0"].later)


@pytest.mark.parametrize("up", ["y", "z", "-y"])
def test_joints_are_in_the_rigs_own_world(up: str) -> None:
    assert np.allclose(RIG_FROM_Y_UP[up] @ UP[up], np.eye(3))
    found = people_joints(people(), 0.0, up)["person_0"].start
    above = found["left shoulder"] - found["left hip"]
    axis = {"y": (0, 1, 0), "z": (0, 0, 1), "-y": (0, -1, 0)}[up]
    assert above @ axis > 0.3
