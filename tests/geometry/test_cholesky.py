"""Positive definite systems: what is solved is solved, and what is not positive definite is said so."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.geometry.cholesky_kernels import factorise, inverted, substitute

seeds, sizes = st.integers(0, 2**32 - 1), st.integers(1, 14)


def positive(rng: np.random.Generator, n: int) -> np.ndarray:
    B = rng.normal(size=(n, n))
    return np.asarray(B @ B.T + 0.1 * np.eye(n))


@pytest.mark.slow
@given(seeds, sizes, st.sampled_from([0.0, 1e-3, 2.0]))
def test_the_factor_is_that_of_the_raised_matrix_and_solves_it(seed: int, n: int, damping: float) -> None:
    rng = np.random.default_rng(seed)
    A, b = positive(rng, n), rng.normal(size=n)
    raised = A + damping * np.diag(np.diag(A))
    L, x = np.zeros((n, n)), b.copy()
    assert factorise(np.tril(A), damping, L)
    np.testing.assert_allclose(L @ L.T, raised, rtol=1e-9, atol=1e-9)
    substitute(L, x)
    np.testing.assert_allclose(raised @ x, b, atol=1e-7)


@given(seeds, sizes)
def test_what_is_not_positive_definite_has_none(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    A, k = positive(rng, n), rng.integers(n)
    A[k, k] = -A[k, k]
    assert not factorise(A, 0.0, np.zeros((n, n)))
    A[k, k] = np.nan
    assert not factorise(A, 0.0, np.zeros((n, n)))


@given(seeds, sizes, st.sampled_from([0.0, 1e-3, 2.0]))
def test_the_inverse_is_that_of_the_raised_matrix_and_symmetric(seed: int, n: int, damping: float) -> None:
    A = positive(np.random.default_rng(seed), n)
    out, untouched = np.empty((n, n)), np.full((n, n), 7.0)
    assert inverted(A, damping, out)
    np.testing.assert_allclose(out @ (A + damping * np.diag(np.diag(A))), np.eye(n), atol=1e-7)
    np.testing.assert_array_equal(out, out.T)
    assert not inverted(-A, damping, untouched)
    assert (untouched == 7.0).all()
