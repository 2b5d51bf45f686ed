from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_x, rotation_about_y

angles = st.floats(-10, 10)
translations = arrays(np.float64, 3, elements=st.floats(-100, 100))
Rotation = Callable[[float], np.ndarray]
points = arrays(np.float64, (4, 3), elements=st.floats(-100, 100))


about_an_axis = pytest.mark.parametrize("about", [rotation_about_x, rotation_about_y])


@about_an_axis
@given(angles, angles)
def test_rotations_about_an_axis_compose_by_adding_their_angles(about: Rotation, a: float, b: float) -> None:
    np.testing.assert_allclose(about(a) @ about(b), about(a + b), atol=1e-12)


@about_an_axis
@given(angles)
def test_a_rotation_keeps_lengths_and_handedness(about: Rotation, a: float) -> None:
    R = about(a)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(R), 1.0)


def test_a_quarter_turn_about_y_takes_z_to_x_and_x_to_minus_z() -> None:
    R = rotation_about_y(np.pi / 2)
    np.testing.assert_allclose(R @ [0, 0, 1], [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(R @ [1, 5, 0], [0, 5, -1], atol=1e-15)


def test_a_quarter_turn_about_x_takes_y_to_z_and_z_to_minus_y() -> None:
    R = rotation_about_x(np.pi / 2)
    np.testing.assert_allclose(R @ [5, 1, 0], [5, 0, 1], atol=1e-15)
    np.testing.assert_allclose(R @ [0, 0, 1], [0, -1, 0], atol=1e-15)
    assert rotation_about_x(np.zeros((2, 3))).shape == (2, 3, 3, 3)


@given(angles, translations, points)
def test_inverse_undoes_a_motion_and_is_the_inverse_matrix(a: float, t: np.ndarray, p: np.ndarray) -> None:
    T = rigid(rotation_about_y(a), t)
    np.testing.assert_allclose(apply(inverse(T), apply(T, p)), p, atol=1e-10)
    np.testing.assert_allclose(inverse(T) @ T, np.eye(4), atol=1e-10)


@given(angles, angles, translations, translations, points)
def test_motions_compose_as_their_matrices(a: float, b: float, t: np.ndarray, u: np.ndarray, p: np.ndarray) -> None:
    T_c_b, T_b_a = rigid(rotation_about_y(a), t), rigid(rotation_about_y(b), u)
    np.testing.assert_allclose(apply(T_c_b @ T_b_a, p), apply(T_c_b, apply(T_b_a, p)), atol=1e-9)


def test_leading_axes_are_batches() -> None:
    rng = np.random.default_rng(0)
    a, t, p = rng.normal(size=(2, 5)), rng.normal(size=(2, 5, 3)), rng.normal(size=(2, 5, 7, 3))
    T = rigid(rotation_about_y(a), t)
    assert T.shape == (2, 5, 4, 4)
    np.testing.assert_allclose(apply(T, p)[1, 3], apply(T[1, 3], p[1, 3]), atol=1e-15)
    np.testing.assert_allclose(inverse(T)[1, 3], inverse(T[1, 3]), atol=1e-15)
    np.testing.assert_allclose(apply(T[1, 3], p)[0, 2], apply(T[1, 3], p[0, 2]), atol=1e-15)


def test_a_missing_point_stays_missing_and_leaves_its_neighbours_alone() -> None:
    p = np.array([[1.0, 2.0, 3.0], [np.nan, np.nan, np.nan], [4.0, 5.0, 6.0]])
    moved = apply(rigid(rotation_about_y(0.3), [1, 2, 3]), p)
    np.testing.assert_array_equal(np.isnan(moved).all(axis=-1), [False, True, False])
    assert np.isfinite(moved[[0, 2]]).all()
