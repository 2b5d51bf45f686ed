"""Rotations of bones: forward kinematics gives the measured joints, and what is not observed is zero."""

from __future__ import annotations

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mocapella.geometry.bone_rotations import joint_rotations, local_rotations, posed, shortest

seeds = st.integers(0, 2**32 - 1)
PARENTS = np.array([-1, 0, 0, 0, 1, 4, 2, 6, 6])
"""A root with three bones, two limbs, one of which ends in two bones."""


def skeleton(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Offsets, and random rotations of the joints in the world (joints, 3, 3)."""
    rng = np.random.default_rng(seed)
    offsets = rng.normal(size=(len(PARENTS), 3))
    return offsets, Rotation.random(len(PARENTS), random_state=rng).as_matrix()


@settings(deadline=None)
@given(seeds)
def test_joints_of_a_rigid_skeleton_come_back_exactly(seed: int) -> None:
    offsets, R = skeleton(seed)
    positions = posed(PARENTS, offsets, np.array([1.0, 2.0, 3.0]), R)
    found = joint_rotations(PARENTS, offsets, positions)
    np.testing.assert_allclose(found @ np.swapaxes(found, -1, -2), np.tile(np.eye(3), (len(PARENTS), 1, 1)), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(found), 1.0)
    np.testing.assert_allclose(posed(PARENTS, offsets, positions[0], found), positions, atol=1e-7)
    np.testing.assert_allclose(found[0], R[0], atol=1e-7)  # three bones determine it


@settings(deadline=None)
@given(seeds)
def test_batches_are_frames_one_by_one(seed: int) -> None:
    offsets, _ = skeleton(seed)
    frames = np.stack([posed(PARENTS, offsets, np.zeros(3), skeleton(seed + k)[1]) for k in range(3)])
    together = joint_rotations(PARENTS, offsets, frames)
    for k in range(3):
        np.testing.assert_allclose(together[k], joint_rotations(PARENTS, offsets, frames[k]), atol=1e-9)


@settings(deadline=None)
@given(seeds)
def test_moving_the_whole_skeleton_moves_the_root_alone(seed: int) -> None:
    offsets, R = skeleton(seed)
    positions = posed(PARENTS, offsets, np.zeros(3), R)
    turn = Rotation.random(random_state=seed).as_matrix()
    one, other = (
        local_rotations(PARENTS, joint_rotations(PARENTS, offsets, points))
        for points in (positions, positions @ turn.T)
    )
    np.testing.assert_allclose(other[0], turn @ one[0], atol=1e-7)
    np.testing.assert_allclose(other[1:], one[1:], atol=1e-6)


@settings(deadline=None)
@given(seeds)
def test_a_bone_does_not_twist_about_itself(seed: int) -> None:
    """From its parent, it takes the shortest rotation: the axis is across the bone."""
    rng = np.random.default_rng(seed)
    parents, offsets = np.array([-1, 0, 1]), rng.normal(size=(3, 3))
    positions = np.cumsum(rng.normal(size=(3, 3)), axis=0)
    local = local_rotations(parents, joint_rotations(parents, offsets, positions))
    axis = Rotation.from_matrix(local[1]).as_rotvec()
    assert abs(axis @ offsets[2]) < 1e-6 * np.linalg.norm(offsets[2])


@settings(deadline=None)
@example([0.0, 0.0, 1.0], [0.0, 0.0, -1.0])
@example([0.0, 1.0, 0.0], [0.0, 1.0, 0.0])
@given(*[st.lists(st.floats(-1, 1), min_size=3, max_size=3).filter(lambda v: np.linalg.norm(v) > 0.1)] * 2)
def test_the_shortest_rotation_reaches_the_direction(start: list[float], end: list[float]) -> None:
    a, b = (np.array(v) / np.linalg.norm(v) for v in (start, end))
    R = shortest(a, b)
    np.testing.assert_allclose(R @ a, b, atol=1e-6)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-6)
    assert np.linalg.det(R) > 0


def test_a_short_bone_steers_little() -> None:
    """Millimetres of noise at a bone of a millimetre are no direction."""
    parents = np.array([-1, 0, 0, 0])
    offsets = np.array([[0.0, 0, 0], [0, 0.3, 0], [0.2, 0, 0], [0.001, 0, 0.001]])
    positions = offsets + np.array([[0.0, 0, 0], [0, 0, 0], [0, 0, 0], [-0.002, 0.001, 0]])
    R = joint_rotations(parents, offsets, positions)
    np.testing.assert_allclose(posed(parents, offsets, np.zeros(3), R)[1:3], offsets[1:3], atol=1e-4)


def test_a_bone_without_a_length_turns_nothing() -> None:
    parents, offsets = np.array([-1, 0]), np.zeros((2, 3))
    np.testing.assert_array_equal(joint_rotations(parents, offsets, np.zeros((2, 3))), np.tile(np.eye(3), (2, 1, 1)))
