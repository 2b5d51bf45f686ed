"""Limbs that are in each other are pushed apart, and those that are not are left alone."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from support.rigged_meshes import any_pose, worm
from support.silhouette_room import bent

from mocapella.geometry.rigid import apply
from mocapella.geometry.twists import exp_twist
from mocapella.kinematics.ball_joints import ball_joints, local_tree
from mocapella.kinematics.contact import SD_M, apart, depth_m
from mocapella.kinematics.contact_kernels import between
from mocapella.kinematics.twist_fit import FitSettings, InPlanes, Prior, fit, normal_equations
from mocapella.model.body_capsules import Capsules, capsules_of, depths_m, segment_distance
from mocapella.model.body_meshes import body_mesh
from mocapella.model.rigged_mesh import landmarks_at, rest
from mocapella.model.twist_tree import TreePose, part_motions

Float64 = NDArray[np.float64]
MESH = body_mesh("female", detail=0.8)
SOLID, BALLS = capsules_of(MESH), ball_joints(MESH.tree)
seeds = st.integers(0, 2**32 - 1)
few = settings(max_examples=20, deadline=None)


def motions(pose: TreePose) -> tuple[Float64, Float64]:
    T = part_motions(MESH.tree, pose)
    return np.ascontiguousarray(T[:, :3, :3]).reshape(-1, 9), np.ascontiguousarray(T[:, :3, 3])


def parting(pose: TreePose, solid: Capsules = SOLID, sd_m: float = SD_M) -> InPlanes:
    return apart(solid, landmarks_at(MESH, pose), motions(pose), sd_m, touching_m=0.0)


def residuals(planes: InPlanes, pose: TreePose) -> Float64:
    """(n,) how far each point is before its plane [m]."""
    x = apply(part_motions(MESH.tree, pose)[planes.part], planes.points[:, None])[:, 0]
    return np.asarray((planes.planes[:, :3] * x).sum(axis=1) - planes.planes[:, 3])


def fitted(pose: TreePose, rounds: int = 12) -> TreePose:
    """By the planes alone, step by step, each of which is to be small."""
    for _ in range(rounds):
        local = local_tree(MESH.tree, BALLS, pose)
        T = part_motions(local.tree, local.at)
        at = np.ascontiguousarray(T[:, :3, :3]).reshape(-1, 9), np.ascontiguousarray(T[:, :3, 3])
        stay = Prior(pose, 100.0, 100.0, np.full(len(MESH.joint_names), 2.0))
        given = [apart(SOLID, landmarks_at(MESH, pose), at, 0.004, touching_m=0.0)]
        pose = local.back(fit(local.tree, local.at, given, [local.into_prior(stay)], FitSettings(most_steps=3)).pose)
    return pose


@given(st.lists(st.floats(-2, 2), min_size=12, max_size=12))
def test_the_nearest_points_of_segments_are_so_far_apart_as_these(numbers: list[float]) -> None:
    one, other = np.array(numbers).reshape(2, 2, 3)
    nearest = np.empty((2, 3))
    far = between(one, other, nearest)
    assert far == pytest.approx(float(segment_distance(*one, *other)), abs=1e-7)
    assert np.linalg.norm(nearest[0] - nearest[1]) == pytest.approx(far, abs=1e-12)
    for point, (a, b) in zip(nearest, (one, other), strict=True):
        assert float(segment_distance(point, point, a, b)) == pytest.approx(0, abs=1e-9)


@given(seeds)
def test_the_planes_ask_each_limb_for_half_of_the_depth(seed: int) -> None:
    pose = any_pose(np.random.default_rng(seed), MESH)
    planes, deep = parting(pose), depths_m(SOLID, landmarks_at(MESH, pose))
    of_pair = np.flatnonzero(deep > 0)
    assume(len(of_pair))
    assert len(planes.part) == 2 * len(of_pair)
    np.testing.assert_allclose(residuals(planes, pose), -0.5 * np.repeat(deep[of_pair], 2), atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(planes.planes[:, :3], axis=1), 1, atol=1e-12)
    np.testing.assert_allclose(planes.planes[::2, :3], -planes.planes[1::2, :3], atol=1e-12)
    np.testing.assert_array_equal(planes.part, SOLID.part[SOLID.pairs[of_pair]].ravel())
    np.testing.assert_allclose(planes.weights, 1 / SD_M**2)


@given(seeds)
def test_limbs_that_are_brought_into_their_planes_only_touch(seed: int) -> None:
    """As if each were alone: both are moved along the line between them, and are as far apart as they are thick."""
    pose = any_pose(np.random.default_rng(seed), MESH)
    marks, planes = landmarks_at(MESH, pose), parting(pose)
    left = -residuals(planes, pose)
    for k, (i, j) in enumerate(SOLID.pairs[depths_m(SOLID, marks) > 0]):
        one, other = (marks[SOLID.ends[c]] + left[n] * planes.planes[n, :3] for c, n in ((i, 2 * k), (j, 2 * k + 1)))
        far = float(segment_distance(*one, *other))
        assert far == pytest.approx(SOLID.radii[i] + SOLID.radii[j], abs=1e-7)


@given(seeds)
def test_moving_the_world_moves_the_planes_and_changes_nothing_else(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pose, G = any_pose(rng, MESH), exp_twist(2 * rng.normal(size=6))
    there = TreePose(G @ pose.T_world_model, pose.angles)
    here, moved = parting(pose), parting(there)
    np.testing.assert_array_equal(moved.part, here.part)
    np.testing.assert_allclose(moved.points, here.points, atol=1e-7)
    normals = here.planes[:, :3] @ G[:3, :3].T
    np.testing.assert_allclose(moved.planes[:, :3], normals, atol=1e-6)
    np.testing.assert_allclose(moved.planes[:, 3], here.planes[:, 3] + normals @ G[:3, 3], atol=1e-6)


def test_limbs_that_are_apart_have_no_planes_and_stay() -> None:
    for pose in (rest(MESH), bent(MESH, {"left elbow flexion": 60, "right hip flexion": 40})):
        assert depths_m(SOLID, landmarks_at(MESH, pose)).max() == 0
        assert len(parting(pose).part) == 0
        np.testing.assert_allclose(fitted(pose, 2).angles, pose.angles, atol=1e-12)


DEEP = {
    "a hand in the trunk": {"left shoulder raise sidewards": -62, "left shoulder swing forwards": 10},
    "a leg in the other": {"left hip abduction": -12, "right hip abduction": -12},
    "a forearm in the belly": {
        "left shoulder raise sidewards": -40,
        "left shoulder turn outwards": -60,
        "left elbow flexion": 100,
    },
}


@pytest.mark.parametrize("degrees", DEEP.values(), ids=DEEP)
def test_limbs_that_were_deep_in_each_other_are_not_after_a_fit(degrees: dict[str, float]) -> None:
    pose = bent(MESH, degrees)
    deep = depths_m(SOLID, landmarks_at(MESH, pose))
    assert deep.max() > 0.02
    found = fitted(pose)
    assert depths_m(SOLID, landmarks_at(MESH, found)).max() < 0.1 * deep.max()
    turned = np.degrees(np.abs(found.angles - pose.angles))
    assert 1 < turned.max() < 40


@few
@given(seeds)
def test_a_fit_of_the_planes_makes_any_body_less_deep(seed: int) -> None:
    pose = any_pose(np.random.default_rng(seed), MESH, 0.7)
    before = depths_m(SOLID, landmarks_at(MESH, pose)).sum()
    assume(before > 0.02)
    assert depths_m(SOLID, landmarks_at(MESH, fitted(pose))).sum() < 0.5 * before


@few
@given(seeds)
def test_what_the_planes_cost_in_a_fit_is_half_of_each_depth_squared_and_twice(seed: int) -> None:
    """Points are at rest in the tree that is fitted."""
    pose = any_pose(np.random.default_rng(seed), MESH)
    planes, deep = parting(pose, sd_m=1.0), depths_m(SOLID, landmarks_at(MESH, pose))
    assume(deep.max() > 0.02)
    assert normal_equations(MESH.tree, pose, [planes]).cost == pytest.approx(2 * np.square(0.5 * deep).sum(), rel=1e-9)


def test_axes_that_meet_say_nothing_of_where_to_go() -> None:
    solid = capsules_of(MESH)
    names = list(MESH.landmarks)
    marks = landmarks_at(MESH, rest(MESH)).copy()
    for name in ("elbow", "wrist"):
        marks[names.index(f"right {name}")] = marks[names.index(f"left {name}")]
    forearms = [solid.names.index(f"{side} forearm") for side in ("left", "right")]
    only = Capsules(solid.names, solid.part, solid.ends, solid.radii, np.array([forearms]))
    assert len(apart(only, marks, motions(rest(MESH))).part) == 0
    marks[names.index("right elbow"), 2] += 0.02
    marks[names.index("right wrist"), 2] += 0.02
    assert len(apart(only, marks, motions(rest(MESH))).part) == 2


@given(seeds)
def test_how_deep_some_are_is_the_sum_of_theirs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    marks = landmarks_at(MESH, any_pose(rng, MESH))
    some = np.flatnonzero(rng.random(len(SOLID.pairs)) < 0.7)
    assert depth_m(SOLID, SOLID.pairs[some], marks) == pytest.approx(depths_m(SOLID, marks)[some].sum(), abs=1e-9)


def test_what_is_no_body_has_no_planes() -> None:
    mesh = worm()
    solid = capsules_of(mesh)
    T = part_motions(mesh.tree, rest(mesh))
    at = np.ascontiguousarray(T[:, :3, :3]).reshape(-1, 9), np.ascontiguousarray(T[:, :3, 3])
    planes = apart(solid, landmarks_at(mesh, rest(mesh)), at)
    assert (planes.part.shape, planes.points.shape, planes.planes.shape) == ((0,), (0, 3), (0, 4))
    assert depth_m(solid, solid.pairs, landmarks_at(mesh, rest(mesh))) == 0


@given(seeds)
def test_limbs_that_only_touch_are_left_alone(seed: int) -> None:
    """Their flesh is pressed a little: nothing pushes before they are deeper in each other than that."""
    pose = any_pose(np.random.default_rng(seed), MESH)
    deep = depths_m(SOLID, landmarks_at(MESH, pose))
    planes = apart(SOLID, landmarks_at(MESH, pose), motions(pose), touching_m=0.05)
    assert len(planes.part) == 2 * np.count_nonzero(deep > 0.05)
    if len(planes.part):
        assert np.sort(-residuals(planes, pose))[::2] == pytest.approx(np.sort(0.5 * (deep[deep > 0.05] - 0.05)))
