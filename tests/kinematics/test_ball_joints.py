"""Ball joints told by turns about the pose they are in: the same body, and no pose that is singular."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.geometry.twists import revolute
from mocapella.kinematics.ball_joints import ball_joints, local_tree
from mocapella.kinematics.twist_fit import FitSettings, OnPoints, Prior, fit, normal_equations
from mocapella.model.body_meshes import body_mesh
from mocapella.model.rigged_mesh import RiggedMesh, landmarks_at
from mocapella.model.twist_tree import TreePose, part_motions, twist_tree

MESH = body_mesh("male", 1.8, detail=0.8)
BALLS = ball_joints(MESH.tree)
SHOULDERS = [MESH.joint_names.index(f"{side} shoulder swing forwards") for side in ("left", "right")]
seeds = st.integers(0, 2**32 - 1)


def pose_within(rng: np.random.Generator, share: float = 1.0) -> TreePose:
    """Anywhere in that share of the limits about their middle."""
    low, high = MESH.tree.limits.T
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    T = np.eye(4)
    T[:3, 3] = rng.normal(size=3)
    return TreePose(T, middle + share * half * rng.uniform(-1, 1, len(low)))


def moved(tree_at: TreePose, mesh: RiggedMesh, local, pose: TreePose) -> np.ndarray:
    """(parts, 4, 4) by which everything moves from the pose of the local tree to another one of it."""
    return part_motions(local.tree, pose) @ np.linalg.inv(part_motions(local.tree, tree_at))


def test_the_shoulders_of_a_body_are_ball_joints_that_can_be_singular_and_its_hips_are_not() -> None:
    assert [MESH.part_names[part] for part in BALLS.parts] == ["left upper arm", "right upper arm"]
    assert BALLS.first.tolist() == SHOULDERS
    for k, side in enumerate(("left", "right")):
        np.testing.assert_allclose(BALLS.centres[k], MESH.landmarks[f"{side} shoulder"].point, atol=1e-9)


@pytest.mark.parametrize(
    ("twists", "limits"),
    [
        ([revolute(a, (0, 1, 0)) for a in np.eye(3)], [[-1, 1]] * 3),  # never near a right angle
        ([revolute(a, o) for a, o in zip(np.eye(3), [(0, 1, 0), (0, 1, 0), (0.1, 1, 0)], strict=True)], [[-2, 2]] * 3),
        ([revolute(a, (0, 1, 0)) for a in ((1, 0, 0), (0.6, 0.8, 0), (0, 0, 1))], [[-2, 2]] * 3),
        ([revolute(a, (0, 1, 0)) for a in np.eye(3)[:2]], [[-2, 2]] * 2),
    ],
)
def test_turns_that_are_no_such_ball_joint_are_left_as_they_are(twists, limits) -> None:
    tree = twist_tree([-1, 0], [1] * len(twists), twists, limits)
    assert len(ball_joints(tree).parts) == 0
    pose = TreePose(np.eye(4), np.full(len(twists), 0.3))
    local = local_tree(tree, ball_joints(tree), pose)
    np.testing.assert_array_equal(local.tree.twists, tree.twists)
    np.testing.assert_array_equal(local.back(local.at).angles, pose.angles)


@given(seeds)
def test_a_local_tree_moves_as_the_body_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pose = pose_within(rng)
    local = local_tree(MESH.tree, BALLS, pose)
    there = pose_within(rng)
    step = moved(local.at, MESH, local, local.into(there))
    landmarks, wanted = landmarks_at(MESH, pose), landmarks_at(MESH, there)
    for landmark, at, to in zip(MESH.landmarks.values(), landmarks, wanted, strict=True):
        T = step[landmark.part]
        np.testing.assert_allclose(T[:3, :3] @ at + T[:3, 3], to, atol=1e-9)


@given(seeds)
def test_a_pose_within_the_limits_comes_back_as_the_same_pose_of_the_body(seed: int) -> None:
    rng = np.random.default_rng(seed)
    local, there = local_tree(MESH.tree, BALLS, pose_within(rng)), pose_within(rng)
    again = local.back(local.into(there))
    np.testing.assert_allclose(landmarks_at(MESH, again), landmarks_at(MESH, there), atol=1e-9)
    others = np.setdiff1d(np.arange(len(there.angles)), [j + k for j in SHOULDERS for k in range(3)])
    np.testing.assert_array_equal(again.angles[others], there.angles[others])


@given(seeds)
def test_what_comes_back_is_within_the_limits_wherever_it_was(seed: int) -> None:
    rng = np.random.default_rng(seed)
    local = local_tree(MESH.tree, BALLS, pose_within(rng))
    angles = local.at.angles.copy()
    for j in SHOULDERS:
        angles[j : j + 3] = rng.normal(0, 1.5, 3)
    back = local.back(TreePose(local.at.T_world_model, angles)).angles
    assert (back >= MESH.tree.limits[:, 0]).all()
    assert (back <= MESH.tree.limits[:, 1]).all()


@given(seeds)
def test_where_a_body_is_all_its_ball_joints_are_at_rest(seed: int) -> None:
    pose = pose_within(np.random.default_rng(seed))
    local = local_tree(MESH.tree, BALLS, pose)
    for j in SHOULDERS:
        np.testing.assert_array_equal(local.at.angles[j : j + 3], 0.0)
        np.testing.assert_allclose(local.into(pose).angles[j : j + 3], 0.0, atol=1e-9)


@pytest.mark.parametrize("raised_deg", [90.0, 89.99, 90.01])
def test_an_arm_turns_every_way_where_its_three_joints_are_singular(raised_deg: float) -> None:
    angles = np.zeros(len(MESH.joint_names))
    for j in SHOULDERS:
        angles[j : j + 3] = 0.0, np.radians(raised_deg), 0.0
    pose = TreePose(np.eye(4), np.clip(angles, *MESH.tree.limits.T))
    local = local_tree(MESH.tree, BALLS, pose)

    def least_of_turns(tree, at) -> float:
        T = part_motions(tree, at)
        parts = np.repeat(np.arange(len(tree.parents)), 4)
        points = np.tile(np.concatenate([np.zeros((1, 3)), np.eye(3)]), (len(tree.parents), 1))
        targets = np.einsum("pij,pj->pi", T[parts, :3, :3], points) + T[parts, :3, 3]
        H = normal_equations(tree, at, [OnPoints(parts, points, targets, np.ones(len(parts)))]).H
        j = 6 + SHOULDERS[0]
        return float(np.linalg.eigvalsh(H[j : j + 3, j : j + 3])[0])

    assert least_of_turns(MESH.tree, pose) < 1e-3
    assert least_of_turns(local.tree, local.at) > 0.1


def test_an_arm_at_its_singular_pose_is_fitted_in_the_local_tree() -> None:
    j = SHOULDERS[0]
    start, there = np.zeros(len(MESH.joint_names)), np.zeros(len(MESH.joint_names))
    start[j + 1] = np.pi / 2
    there[j : j + 3] = np.radians([80.0, 70.0, -60.0])  # a way off that the second axis does not lead along
    wanted = landmarks_at(MESH, TreePose(np.eye(4), there))
    pose = TreePose(np.eye(4), start)
    for _ in range(3):
        local = local_tree(MESH.tree, BALLS, pose)
        at, T = landmarks_at(MESH, pose), part_motions(local.tree, local.at)
        parts = np.array([landmark.part for landmark in MESH.landmarks.values()])
        points = np.einsum("pji,pj->pi", T[parts, :3, :3], at - T[parts, :3, 3])
        given_points = OnPoints(parts, points, wanted, np.ones(len(parts)))
        weak = Prior(local.at, 0.0, 0.0, np.full(len(start), 1e-6))
        pose = local.back(fit(local.tree, local.at, [given_points], [weak], FitSettings(most_steps=30)).pose)
    np.testing.assert_allclose(landmarks_at(MESH, pose), wanted, atol=1e-5)


@given(seeds)
def test_what_is_usual_of_an_arm_is_its_turn_alone(seed: int) -> None:
    pose = pose_within(np.random.default_rng(seed))
    local = local_tree(MESH.tree, BALLS, pose)
    weights = np.full(len(pose.angles), 3.0)
    usual = local.into_usual(Prior(TreePose(np.eye(4), np.zeros(len(weights))), 0.0, 0.0, weights))
    for j in SHOULDERS:
        np.testing.assert_array_equal(usual.angles_per_rad[j : j + 2], 0.0)
        assert usual.angles_per_rad[j + 2] == pytest.approx(3.0 * abs(np.cos(pose.angles[j + 1])))
        turned = local.at.angles.copy()
        turned[j : j + 3] = usual.pose.angles[j : j + 3]
        back = local.back(TreePose(pose.T_world_model, turned)).angles
        np.testing.assert_allclose(back[j : j + 3], [*pose.angles[j : j + 2], 0.0], atol=1e-7)
