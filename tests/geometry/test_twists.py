from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from mocapella.geometry.alignment import cross_matrix
from mocapella.geometry.rigid import apply, inverse, rigid
from mocapella.geometry.twists import adjoint, exp_twist, log_motion, revolute

twists = arrays(np.float64, 6, elements=st.floats(-1.5, 1.5))
scales = st.sampled_from([1.0, 1e-3, 1e-5, 1e-9, 0.0])


@given(twists, scales)
@settings(deadline=None)
def test_the_exponential_is_that_of_the_matrix(twist: np.ndarray, scale: float) -> None:
    twist = twist * scale
    generator = np.zeros((4, 4))
    generator[:3, :3], generator[:3, 3] = cross_matrix(twist[3:]), twist[:3]
    np.testing.assert_allclose(exp_twist(twist), expm(generator), atol=1e-12)


@given(twists, scales)
@settings(deadline=None)
def test_the_logarithm_undoes_the_exponential_also_near_zero(twist: np.ndarray, scale: float) -> None:
    twist = twist * scale
    np.testing.assert_allclose(log_motion(exp_twist(twist)), twist, atol=1e-9)


@given(twists, twists)
@settings(deadline=None)
def test_the_adjoint_tells_a_motion_in_another_frame(x: np.ndarray, y: np.ndarray) -> None:
    T = exp_twist(y)
    np.testing.assert_allclose(exp_twist(adjoint(T) @ x), T @ exp_twist(x) @ inverse(T), atol=1e-9)


def test_batches_are_what_each_alone_is() -> None:
    x = np.random.default_rng(0).normal(size=(3, 2, 6)) * 0.5
    T = exp_twist(x)
    assert T.shape == (3, 2, 4, 4)
    np.testing.assert_allclose(log_motion(T), x, atol=1e-12)
    np.testing.assert_allclose(T[1, 1], exp_twist(x[1, 1]), atol=1e-15)


@given(arrays(np.float64, 6, elements=st.floats(-1.5, 1.5)), st.sampled_from([1e-2, 1e-5, 1e-8, 1e-12]))
@settings(deadline=None)
def test_the_logarithm_undoes_the_exponential_also_near_half_a_turn(twist: np.ndarray, less: float) -> None:
    axis = twist[3:] + np.array([0.0, 0.0, 2.0])
    twist = np.r_[twist[:3], (np.pi - less) * axis / np.linalg.norm(axis)]
    np.testing.assert_allclose(log_motion(exp_twist(twist)), twist, atol=1e-9)


@given(arrays(np.float64, (2, 3), elements=st.floats(-1.5, 1.5)))
@settings(deadline=None)
def test_of_half_a_turn_the_logarithm_is_one_of_the_two_that_there_are(vectors: np.ndarray) -> None:
    axis = vectors[0] + [0.0, 0.0, 2.0]
    T = exp_twist(np.r_[vectors[1], np.pi * axis / np.linalg.norm(axis)])
    twist = log_motion(T)
    assert np.linalg.norm(twist[3:]) == pytest.approx(np.pi, abs=1e-12)
    np.testing.assert_allclose(exp_twist(twist), T, atol=1e-12)


@pytest.mark.parametrize("translation", [[0.0, 0.0, 0.0], [0.3, -2.0, 1.0]])
def test_a_motion_that_does_not_turn_is_its_translation(translation: list[float]) -> None:
    T = rigid(np.eye(3), translation)
    np.testing.assert_array_equal(log_motion(T), [*translation, 0, 0, 0])
    np.testing.assert_array_equal(exp_twist(log_motion(T)), T)


@given(arrays(np.float64, (2, 3), elements=st.floats(-1.5, 1.5)), st.floats(-4, 4), st.floats(0.1, 9))
@settings(deadline=None)
def test_a_joint_turns_about_its_axis_and_leaves_it_where_it_is(
    vectors: np.ndarray, angle: float, length: float
) -> None:
    axis, point = vectors[0] + [0.0, 0.0, 2.0], vectors[1]
    twist = revolute(length * axis, point)
    T = exp_twist(angle * twist)
    on_it = point + np.array([[0.0], [1.0], [-2.0]]) * axis
    np.testing.assert_allclose(apply(T, on_it), on_it, atol=1e-12)
    about = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis))
    np.testing.assert_allclose(T[:3, :3], about.as_matrix(), atol=1e-12)
    assert twist[:3] @ twist[3:] == pytest.approx(0, abs=1e-12)  # zero pitch
    np.testing.assert_allclose(revolute(axis, on_it), np.tile(twist, (3, 1)), atol=1e-12)


def test_an_axis_without_length_is_no_joint() -> None:
    assert np.isnan(revolute(np.zeros(3), np.ones(3))).all()
