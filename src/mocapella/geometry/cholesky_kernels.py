"""Kernels that solve positive definite systems by Cholesky factorisation; importing them imports numba.

G. Golub, C. Van Loan, *Matrix Computations*, 4.2. The loops need no linear-algebra library.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Float64 = NDArray[np.float64]


@njit(cache=True, error_model="numpy")
def factorise(A: Float64, damping: float, L: Float64) -> bool:
    """Factorise a symmetric matrix A, with its diagonal multiplied by 1 + damping, into L Lᵀ.

    Args:
        A: (n, n) symmetric; only its lower triangle is read.
        damping: relative increase of the diagonal (Levenberg and Marquardt).
        L: (n, n); its lower triangle is written.

    Returns:
        Whether the matrix is positive definite; if not, L is incomplete.
    """
    for i in range(len(A)):
        for k in range(i + 1):
            e = A[i, k] * (1.0 + damping) if i == k else A[i, k]
            for j in range(k):
                e -= L[i, j] * L[k, j]
            if i == k:
                if not e > 0.0:
                    return False
                L[i, i] = math.sqrt(e)
            else:
                L[i, k] = e / L[k, k]
    return True


@njit(cache=True, error_model="numpy")
def substitute(L: Float64, b: Float64) -> None:
    """Solve L Lᵀ x = b by forward and back substitution: replace b (n,) by x; L (n, n) is of `factorise`."""
    n = len(b)
    for i in range(n):
        for k in range(i):
            b[i] -= L[i, k] * b[k]
        b[i] /= L[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            b[i] -= L[k, i] * b[k]
        b[i] /= L[i, i]


@njit(cache=True, error_model="numpy")
def inverted(A: Float64, damping: float, out: Float64) -> bool:
    """Write the inverse of a symmetric matrix A, with its diagonal multiplied by 1 + damping; symmetric to the bit.

    The rows of the inverse of L are made in turn, and their products added; the innermost loops have no sums, so that
    they are vectorised.

    Args:
        A: (n, n) symmetric.
        damping: as in `factorise`.
        out: (n, n) written.

    Returns:
        Whether the matrix is positive definite; if not, nothing is written.
    """
    n = len(A)
    L, row = np.empty((n, n)), np.empty(n)
    if not factorise(A, damping, L):
        return False
    for i in range(n):
        for k in range(n):
            out[i, k] = 0.0
    for i in range(n):  # row i of L becomes that of its inverse
        for k in range(i):
            row[k] = 0.0
        for k in range(i):
            f = L[i, k]
            for j in range(k + 1):
                row[j] -= f * L[k, j]
        scale = 1.0 / L[i, i]
        for j in range(i):
            L[i, j] = scale * row[j]
        L[i, i] = scale
        for k in range(i + 1):
            f = L[i, k]
            for j in range(k + 1):
                out[k, j] += f * L[i, j]
    for i in range(n):
        for k in range(i):
            out[k, i] = out[i, k]
    return True
