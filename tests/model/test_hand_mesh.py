"""A hand as a mesh: its landmarks are those of the hand's model in any pose, and left is the image of right."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from support.rigged_meshes import any_motion, is_closed, volume

from mocapella.errors import SettingsError
from mocapella.kinematics.hand_chain import hand_chain, landmarks
from mocapella.model.hand import ANGLES, LANDMARKS, HandPose, hand_model
from mocapella.model.hand_flesh import REST_ANGLES
from mocapella.model.hand_mesh import HAND_PARTS, _grid, hand_mesh, hand_mesh_angles
from mocapella.model.rigged_mesh import landmarks_at, posed, rest
from mocapella.model.twist_tree import TreePose

sides = st.sampled_from(["left", "right"])
few = settings(max_examples=20, deadline=None)


def test_the_grid_of_a_hand_goes_beyond_its_flesh_by_three_of_its_steps_and_is_finest_across() -> None:
    limbs = np.array([[0.0, 0.1, 0.0, 1.0, 0.5, -0.2, 0.3, 0.2, 0], [0.2, 0.2, 1.0, 0.1, 0.1, 0.1, 0.1, 0.1, 1]])
    nodes = _grid(limbs, 0.1)
    low, high = np.array([-0.3, -0.2, -0.5]), np.array([1.3, 0.8, 1.1])
    first, last, steps = nodes[0, 0, 0], nodes[-1, -1, -1], nodes[1, 1, 1] - nodes[0, 0, 0]
    assert steps[0] == pytest.approx(0.1)
    assert steps[0] < steps[1] < steps[2] <= 2 * steps[0] + 1e-12, "along the fingers there is less detail"
    np.testing.assert_allclose(first, low - 3 * steps)
    assert (last >= high + 2 * steps - 1e-9).all()
    assert (last <= high + 3 * steps + 1e-9).all()
    assert np.prod(nodes.shape[:3]) == np.prod(np.round((last - first) / steps) + 1)


@pytest.mark.slow
@few
@given(sides, st.floats(0.15, 0.22), st.integers(0, 2**32 - 1))
def test_landmarks_are_those_of_the_hands_model_in_any_pose(side: str, length: float, seed: int) -> None:
    rng, model = np.random.default_rng(seed), hand_model("full")
    shape = model.shape(side, hand_length_m=length)  # type: ignore[arg-type]
    mesh = hand_mesh(shape)
    pose = HandPose(rng.uniform(*model.limits.T), any_motion(rng))
    there = landmarks_at(mesh, TreePose(pose.T_world_palm, hand_mesh_angles(mesh, pose.angles)))
    np.testing.assert_allclose(there, landmarks(hand_chain(model, shape), pose), atol=1e-12)
    assert tuple(mesh.landmarks) == LANDMARKS


@settings(few, max_examples=8)
@given(sides, st.floats(0.12, 0.24), st.floats(0.7, 1.3), st.sampled_from([0.9, 1.0, 1.5]))
@example("left", 0.234, 0.875, 1.0)  # had a hole between two knuckles
def test_a_hand_is_a_closed_surface_of_one_piece(side: str, length: float, thickness: float, detail: float) -> None:
    shape = hand_model("full").shape(side, hand_length_m=length)  # type: ignore[arg-type]
    mesh = hand_mesh(shape, thickness, detail)
    assert is_closed(mesh)
    assert len(mesh.vertices) - len(mesh.faces) // 2 == 2, "fingers are apart"
    assert volume(mesh) > 0
    assert mesh.vertices[:, 2].max() == pytest.approx(length, abs=0.06 * length), "the middle finger's tip"


def test_a_hand_is_a_tree_of_27_degrees_of_freedom() -> None:
    mesh = hand_mesh(hand_model("full").shape("right"))
    assert mesh.tree.dofs == 27
    assert mesh.part_names == HAND_PARTS
    assert sorted(mesh.joint_names) == sorted(ANGLES)
    assert 1000 <= len(mesh.vertices) <= 3000
    assert set(mesh.bones[:, 0].tolist()) == set(range(16))
    model_limits = hand_model("full").limits[[ANGLES.index(name) for name in mesh.joint_names]]
    rest_angles = REST_ANGLES[[ANGLES.index(name) for name in mesh.joint_names]]
    np.testing.assert_allclose(mesh.tree.limits + rest_angles[:, None], model_limits)
    np.testing.assert_allclose(hand_mesh_angles(mesh, REST_ANGLES), 0)


def test_the_left_hand_is_the_mirror_image_of_the_right_in_any_pose() -> None:
    right, left = (hand_mesh(hand_model("full").shape(side)) for side in ("right", "left"))
    rng = np.random.default_rng(0)
    for _ in range(5):
        at = TreePose(np.eye(4), rng.uniform(*right.tree.limits.T))
        np.testing.assert_allclose(posed(left, at), posed(right, at) * [-1, 1, 1], atol=1e-12)
    assert volume(left) == pytest.approx(volume(right))
    np.testing.assert_allclose(posed(left, rest(left)), left.vertices, atol=1e-15)


def test_settings_out_of_range_are_refused() -> None:
    shape = hand_model("full").shape("right")
    with pytest.raises(SettingsError, match=r"thickness is 2.0; it must be 0.7 to 1.3"):
        hand_mesh(shape, thickness=2.0)
    with pytest.raises(SettingsError, match=r"detail is 0.1; it must be 0.9 to 3.0"):
        hand_mesh(shape, detail=0.1)
