from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import expm

from mocapella.geometry.alignment import cross_matrix
from mocapella.geometry.rigid import inverse
from mocapella.geometry.twists import adjoint, exp_twist, log_motion

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
