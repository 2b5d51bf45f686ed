"""Small linear algebra of `mocapella.calibration.sensor_graph`, compiled; importing this module imports numba.

LAPACK starts threads for matrices as small as these, which takes longer than the work on a machine that is busy.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def inverse_of_positive(A):
    """Of a symmetric positive definite (n, n) matrix, by its Cholesky factor (Golub and Van Loan, 4.2); NaN if it is
    none.
    """
    n = len(A)
    L = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            s = A[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i > j:
                L[i, j] = s / L[j, j]
            elif s > 0.0:
                L[i, i] = np.sqrt(s)
            else:
                return np.full((n, n), np.nan)
    # Columns of L⁻¹, kept as rows, so that the products below run along memory.
    X = np.zeros((n, n))
    for c in range(n):
        X[c, c] = 1.0 / L[c, c]
        for i in range(c + 1, n):
            s = 0.0
            for k in range(c, i):
                s -= L[i, k] * X[c, k]
            X[c, i] = s / L[i, i]
    out = np.empty((n, n))
    for i in range(n):
        for j in range(i + 1):
            s = 0.0
            for k in range(i, n):
                s += X[i, k] * X[j, k]
            out[i, j] = out[j, i] = s
    return out
