"""Swing and twist: a rotation is taken apart and put together, and unknown directions stay unknown."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mocapella.geometry.segment_axes import unit
from mocapella.geometry.swing_twist import (
    across,
    faded,
    of_two_directions,
    quaternions,
    swung,
    twist_angle,
    twisted,
)

seeds = st.integers(0, 2**32 - 1)
X, Y = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])


def rotations(seed: int, count: int = 5) -> np.ndarray:
    return Rotation.random(count, random_state=seed).as_matrix()


@settings(deadline=None)
@given(seeds)
def test_two_directions_give_the_rotation_back(seed: int) -> None:
    R = rotations(seed)
    np.testing.assert_allclose(of_two_directions(2.0 * R @ X, R @ (0.3 * X + Y), X, Y), R, atol=1e-9)


@settings(deadline=None)
@given(seeds)
def test_the_first_direction_is_reached_exactly(seed: int) -> None:
    first, second = np.random.default_rng(seed).normal(size=(2, 5, 3))
    R = of_two_directions(first, second, X, Y)
    np.testing.assert_allclose(R @ X, unit(first), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(R), 1.0)
    assert (np.sum(across(R @ Y, unit(first)) * second, axis=1) > 0).all()


@pytest.mark.parametrize(("first", "second"), [(X, 2 * X), (0 * X, Y), (np.nan * X, Y)])
def test_what_determines_no_rotation_is_unknown(first: np.ndarray, second: np.ndarray) -> None:
    assert np.isnan(of_two_directions(first, second, X, Y)).all()


@settings(deadline=None)
@given(seeds)
def test_swing_and_twist_give_the_rotation_back(seed: int) -> None:
    before, R = rotations(seed), rotations(seed + 1)
    axis = R @ X
    swing = swung(before, X, axis)
    np.testing.assert_allclose(swing @ X, axis, atol=1e-6)
    angle = twist_angle(swing, axis, Y, R @ (Y + 0.7 * X))
    np.testing.assert_allclose(twisted(swing, axis, angle), R, atol=1e-6)


def test_a_side_along_the_limb_tells_no_twist() -> None:
    assert np.isnan(twist_angle(np.eye(3), X, Y, 3 * X))
    assert np.isnan(twist_angle(np.eye(3), X, Y, np.nan * X))


@settings(deadline=None)
@given(st.floats(-3.1, 3.1), st.floats(0.0, 1.0))
def test_a_fading_angle_is_between_zero_and_itself(angle: float, weight: float) -> None:
    found = float(faded(np.array(angle), np.array(weight)))
    assert abs(found) <= abs(angle) + 1e-9
    assert found * angle >= 0
    assert faded(np.array(angle), np.array(0.0)) == 0.0
    np.testing.assert_allclose(faded(np.array(angle), np.array(1.0)), angle, atol=1e-9)


def test_quaternions_of_full_turns_are_continuous() -> None:
    angle = np.linspace(0.0, 6 * np.pi, 200)
    R = Rotation.from_rotvec(np.outer(angle, [0.0, 0.6, 0.8])).as_matrix()
    q = quaternions(R[:, None])[:, 0]
    np.testing.assert_allclose(q[:, 3], np.cos(angle / 2), atol=1e-9)
    assert q[0, 3] > 0


def test_no_frames_have_no_quaternions() -> None:
    assert quaternions(np.empty((0, 2, 3, 3))).shape == (0, 2, 4)
