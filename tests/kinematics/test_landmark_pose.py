"""A mesh's pose of named points in space, from no start."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.rigged_meshes import BOX_FACES, CORNERS, any_motion, any_pose

from mocapella.errors import SettingsError
from mocapella.geometry.rigid import apply
from mocapella.kinematics.landmark_pose import pose_of
from mocapella.model.body_meshes import body_mesh, legs_mesh
from mocapella.model.hand import hand_model
from mocapella.model.hand_mesh import hand_mesh
from mocapella.model.rigged_mesh import RiggedMesh, landmarks_at, rigid_mesh
from mocapella.model.twist_tree import TreePose

seeds = st.integers(0, 2**32 - 1)
few = settings(max_examples=25, deadline=None)
KEYPOINTS = ("nose", *(f"{side} {joint}" for joint in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
                       for side in ("left", "right")))  # fmt: skip


def joints(mesh: RiggedMesh, at: TreePose) -> dict[str, np.ndarray]:
    return dict(zip(mesh.landmarks, landmarks_at(mesh, at), strict=True))


MESHES = {
    "a man": body_mesh("male"),
    "a girl": body_mesh("female", 1.3),
    "legs": legs_mesh("female"),
    "a hand": hand_mesh(hand_model("full").shape("left")),
}


@pytest.mark.slow
@few
@given(st.sampled_from(sorted(MESHES)), seeds)
def test_landmarks_of_any_pose_within_limits_are_found_again(which: str, seed: int) -> None:
    mesh = MESHES[which]
    true = any_pose(np.random.default_rng(seed), mesh)
    found = pose_of(mesh, joints(mesh, true))
    assert ((found.angles >= mesh.tree.limits[:, 0]) & (found.angles <= mesh.tree.limits[:, 1])).all()
    np.testing.assert_allclose(landmarks_at(mesh, found), landmarks_at(mesh, true), atol=0.002)


@pytest.mark.slow
@settings(few, max_examples=10)
@given(seeds)
def test_thirteen_keypoints_that_are_some_centimetres_off_are_enough_to_begin_with(seed: int) -> None:
    mesh, rng = MESHES["a man"], np.random.default_rng(seed)
    true = any_pose(rng, mesh, 0.9)
    exact = joints(mesh, true)
    seen = {name: exact[name] + 0.02 * rng.normal(size=3) for name in KEYPOINTS}
    found = joints(mesh, pose_of(mesh, seen))
    away = [np.linalg.norm(found[name] - exact[name]) for name in KEYPOINTS]
    assert np.median(away) < 0.04
    assert max(away) < 0.15


def test_a_t_pose_gives_its_pose() -> None:
    mesh = MESHES["a girl"]
    angles = np.zeros(20)
    for side in ("left", "right"):
        angles[mesh.joint_names.index(f"{side} shoulder raise sidewards")] = np.radians(45)
    exact = joints(mesh, TreePose(any_motion(np.random.default_rng(0)), angles))
    found = pose_of(mesh, {name: exact[name] for name in KEYPOINTS})
    raised = [k for k, name in enumerate(mesh.joint_names) if "raise" in name or "flexion" in name]
    np.testing.assert_allclose(found.angles[raised], angles[raised], atol=0.02)
    turns = [k for k, name in enumerate(mesh.joint_names) if name.endswith("shoulder turn outwards")]
    np.testing.assert_allclose(found.angles[turns], 0, atol=0.02, err_msg="what nothing says is as at rest")


@pytest.mark.slow
@few
@given(seeds)
def test_joints_that_are_not_seen_do_not_count(seed: int) -> None:
    mesh, rng = MESHES["a man"], np.random.default_rng(seed)
    true = any_pose(rng, mesh, 0.8)
    exact = joints(mesh, true)
    hidden = rng.choice([name for name in exact if "wrist" in name or "ankle" in name or "head" in name], 3)
    seen = {name: np.full(3, np.nan) if name in hidden else point for name, point in exact.items()}
    left_out = {name: point for name, point in exact.items() if name not in hidden}
    one, other = pose_of(mesh, seen), pose_of(mesh, left_out)
    np.testing.assert_array_equal(one.angles, other.angles)
    found = joints(mesh, one)
    for name in left_out:
        np.testing.assert_allclose(found[name], exact[name], atol=0.002)


def test_a_rigid_object_is_only_aligned() -> None:
    mesh = rigid_mesh("box", CORNERS, BOX_FACES, {str(k): corner for k, corner in enumerate(CORNERS)})
    T = any_motion(np.random.default_rng(0))
    found = pose_of(mesh, {str(k): corner for k, corner in enumerate(apply(T, CORNERS))})
    np.testing.assert_allclose(found.T_world_model, T, atol=1e-9)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (("left hip", "left knie"), r"male has no landmark 'left knie'; known: .*did you mean left knee\?"),
        (
            ("left hip", "right hip"),
            r"joints that are seen are \['left hip', 'right hip'\]; they must be three or more",
        ),
        (("left hip", "right hip", "pelvis"), "that are not on a line"),
        ((), r"joints that are seen are \[\]"),
    ],
)
def test_too_little_and_unknown_names_are_said(names: tuple[str, ...], said: str) -> None:
    mesh = MESHES["a man"]
    exact = joints(mesh, any_pose(np.random.default_rng(0), mesh))
    with pytest.raises(SettingsError, match=said):
        pose_of(mesh, {name: exact.get(name, np.zeros(3)) for name in names})


def test_points_of_another_shape_are_said() -> None:
    with pytest.raises(SettingsError, match="left hip"):
        pose_of(MESHES["a man"], {"left hip": np.zeros((2, 3))})
