from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mocapella.fusion.tracked_mean import tracked_mean
from mocapella.geometry.rigid import apply, rigid, rotation_about_y

VIEWS, JOINTS = 3, 4
joint_states = arrays(np.uint8, (VIEWS, JOINTS), elements=st.integers(0, 2))
joint_positions = arrays(np.float64, (VIEWS, JOINTS, 3), elements=st.floats(-10, 10))


def blanked(positions: np.ndarray, states: np.ndarray) -> np.ndarray:
    return np.where((states == 0)[..., None], np.nan, positions)


def test_each_joint_is_the_mean_of_the_views_that_see_it_best() -> None:
    positions = np.array([[[1, 1, 1]] * 4, [[3, 3, 3]] * 4, [[8, 8, 8]] * 4], dtype=float)
    states = np.array([[2, 2, 1, 0], [2, 0, 1, 0], [1, 1, 0, 0]], dtype=np.uint8)
    fused = tracked_mean(blanked(positions, states), states)
    np.testing.assert_array_equal(fused.positions[:, 0], [2, 1, 2, np.nan])
    np.testing.assert_array_equal(fused.states, [2, 2, 1, 0])


@given(joint_positions, joint_states)
def test_the_order_of_the_views_does_not_matter(positions: np.ndarray, states: np.ndarray) -> None:
    positions = blanked(positions, states)
    one, other = tracked_mean(positions, states), tracked_mean(positions[::-1], states[::-1])
    np.testing.assert_allclose(one.positions, other.positions, atol=1e-12)
    np.testing.assert_array_equal(one.states, other.states)


@given(joint_positions, joint_states)
def test_views_that_agree_give_what_they_agree_on(positions: np.ndarray, states: np.ndarray) -> None:
    agreed = np.broadcast_to(positions[0], positions.shape)
    fused = tracked_mean(blanked(agreed, states), states)
    seen = states.any(axis=0)
    np.testing.assert_allclose(fused.positions[seen], positions[0][seen], atol=1e-12)
    assert np.isnan(fused.positions[~seen]).all()


@given(joint_positions, joint_states, st.floats(-3, 3))
def test_moving_all_views_moves_the_mean_along(positions: np.ndarray, states: np.ndarray, angle: float) -> None:
    positions = blanked(positions, states)
    T = rigid(rotation_about_y(angle), [1, 2, 3])
    moved = tracked_mean(apply(T, positions), states).positions
    np.testing.assert_allclose(moved, apply(T, tracked_mean(positions, states).positions), atol=1e-10)


@given(joint_positions, joint_states)
def test_a_view_that_is_not_there_changes_nothing(positions: np.ndarray, states: np.ndarray) -> None:
    positions = blanked(positions, states)
    padded = np.concatenate([positions, np.full((1, JOINTS, 3), np.nan)])
    padded_states = np.concatenate([states, np.zeros((1, JOINTS), dtype=np.uint8)])
    np.testing.assert_array_equal(
        tracked_mean(padded, padded_states).positions, tracked_mean(positions, states).positions
    )


def test_leading_axes_are_batches() -> None:
    rng = np.random.default_rng(0)
    positions, states = rng.normal(size=(5, 2, VIEWS, JOINTS, 3)), rng.integers(0, 3, (5, 2, VIEWS, JOINTS), np.uint8)
    one = tracked_mean(positions[3, 1], states[3, 1])
    np.testing.assert_array_equal(tracked_mean(positions, states).positions[3, 1], one.positions)
