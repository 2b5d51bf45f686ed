"""Kernels of `mocapella.geometry.alignment`: rigid alignment of paired points by their moments.

M (`alignment.MOMENTS`,) are the moments of the pairs, sums over the points; `alignment` lists them. Importing this
module imports numba.
"""

# ruff: noqa: PLR0917 - kernels take arrays by position
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]


@njit(cache=True, error_model="numpy")
def accumulate(M: Float64, p: Float64, q: Float64, v: Float64, w: Float64, order: Int64) -> None:
    """Add pairs of points to their moments, in place. A pair with a weight of 0 or less is left out; NaN is not.

    Args:
        M: (`alignment.MOMENTS`,) the moments, updated.
        p: (n, 3) points in the target frame [m].
        q, v: (m, 3) points in the other frame [m], and their velocities [m/s].
        w: (n,) weights.
        order: (n,) index of the row of q and v that is paired with each row of p.
    """
    for j in range(len(w)):
        u, o = w[j], order[j]
        if u <= 0.0:
            continue
        M[0] += u
        at = 37
        for i in range(3):
            up, uq, uv = u * p[j, i], u * q[o, i], u * v[o, i]
            M[1 + i] += up
            M[4 + i] += uq
            M[16 + i] += uv
            for k in range(3):
                M[7 + 3 * i + k] += up * q[o, k]
                M[19 + 3 * i + k] += up * v[o, k]
                M[28 + 3 * i + k] += uq * v[o, k]
            for k in range(i, 3):
                M[at] += uq * q[o, k]
                M[at + 6] += uv * v[o, k]
                at += 1
            M[49] += up * p[j, i]


@njit(cache=True, error_model="numpy")
def diagonalise(N: Float64, V: Float64) -> None:
    """Diagonalise a symmetric matrix by cyclic Jacobi rotations (Golub and Van Loan, 8.5).

    Args:
        N: (n, n) the matrix, overwritten with the diagonal one, whose values are in no order.
        V: (n, n) written: the eigenvectors, one a column.
    """
    n = len(N)
    for i in range(n):
        for k in range(n):
            V[i, k] = 1.0 if i == k else 0.0
    for _ in range(30):
        off, on = 0.0, 0.0
        for i in range(n):
            on += N[i, i] * N[i, i]
            for j in range(i + 1, n):
                off += N[i, j] * N[i, j]
        if not off > 1e-34 * on:  # True for NaN
            break
        for a in range(n - 1):
            for b in range(a + 1, n):
                if N[a, b] == 0.0:
                    continue
                theta = (N[b, b] - N[a, a]) / (2 * N[a, b])
                t = 1.0 / (abs(theta) + math.sqrt(theta * theta + 1.0))
                if theta < 0.0:
                    t = -t
                c = 1.0 / math.sqrt(t * t + 1.0)
                s = t * c
                for k in range(n):
                    x, y = N[k, a], N[k, b]
                    N[k, a], N[k, b] = c * x - s * y, s * x + c * y
                for k in range(n):
                    x, y = N[a, k], N[b, k]
                    N[a, k], N[b, k] = c * x - s * y, s * x + c * y
                    x, y = V[k, a], V[k, b]
                    V[k, a], V[k, b] = c * x - s * y, s * x + c * y


@njit(cache=True, nogil=True, error_model="numpy")
def rotation_of(S: Float64, R: Float64) -> None:
    """Write the rotation that best turns vectors to others, by the quaternion of Horn (1987).

    Args:
        S: (3, 3) sum over the pairs of weight · vector · other vectorᵀ.
        R: (3, 3) or larger; its first rows and columns are written.
    """
    N, V = np.empty((4, 4)), np.empty((4, 4))
    N[0, 0] = S[0, 0] + S[1, 1] + S[2, 2]
    N[0, 1] = S[1, 2] - S[2, 1]
    N[0, 2] = S[2, 0] - S[0, 2]
    N[0, 3] = S[0, 1] - S[1, 0]
    N[1, 1] = S[0, 0] - S[1, 1] - S[2, 2]
    N[1, 2] = S[0, 1] + S[1, 0]
    N[1, 3] = S[2, 0] + S[0, 2]
    N[2, 2] = -S[0, 0] + S[1, 1] - S[2, 2]
    N[2, 3] = S[1, 2] + S[2, 1]
    N[3, 3] = -S[0, 0] - S[1, 1] + S[2, 2]
    for i in range(4):
        for k in range(i):
            N[i, k] = N[k, i]
    diagonalise(N, V)
    best = 0
    for i in range(1, 4):
        if N[i, i] > N[best, best]:
            best = i
    w, x = V[0, best], V[1, best]
    y, z = V[2, best], V[3, best]
    R[0, 0], R[0, 1], R[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    R[1, 0], R[1, 1], R[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    R[2, 0], R[2, 1], R[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


@njit(cache=True, error_model="numpy")
def align(M: Float64, offset: float, T: Float64) -> None:
    """Write the rigid motion ``T_p_q`` that best aligns the points of the moments M (least squares, Horn).

    Args:
        M: (`alignment.MOMENTS`,), with a sum of weights above 0.
        offset: clock offset of q [s].
        T: (4, 4) written.
    """
    W = M[0]
    mp, mq, S = np.empty(3), np.empty(3), np.empty((3, 3))
    for i in range(3):
        mp[i], mq[i] = M[1 + i] / W, (M[4 + i] + offset * M[16 + i]) / W
    for i in range(3):
        for k in range(3):
            S[k, i] = M[7 + 3 * i + k] + offset * M[19 + 3 * i + k] - W * mp[i] * mq[k]
    rotation_of(S, T)
    for i in range(3):
        T[i, 3] = mp[i] - T[i, 0] * mq[0] - T[i, 1] * mq[1] - T[i, 2] * mq[2]
    T[3, 0] = T[3, 1] = T[3, 2] = 0.0
    T[3, 3] = 1.0


@njit(cache=True, error_model="numpy")
def residuals(
    T: Float64, offset: float, p: Float64, q: Float64, v: Float64, order: Int64, w: Float64, r: Float64
) -> float:
    """Write the distances |p − T (q + offset·v)[order]| into r; return the mean of those with a weight above 0 [m].

    Args:
        T: (4, 4) ``T_p_q``.
        offset: clock offset of q [s].
        p, q, v, order, w: (n, 3) [m], (m, 3) [m], (m, 3) [m/s], (n,) and (n,), as in `accumulate`.
        r: (n,) written [m]; 0 where the weight is 0 or less.

    Returns:
        The mean distance [m]; 0 if no weight is above 0.
    """
    total, count = 0.0, 0
    for j in range(len(r)):
        r[j] = 0.0
        if w[j] <= 0.0:
            continue
        o, d = order[j], 0.0
        x, y, z = q[o, 0] + offset * v[o, 0], q[o, 1] + offset * v[o, 1], q[o, 2] + offset * v[o, 2]
        for i in range(3):
            e = p[j, i] - (T[i, 0] * x + T[i, 1] * y + T[i, 2] * z + T[i, 3])
            d += e * e
        r[j] = math.sqrt(d)
        total += r[j]
        count += 1
    return total / count if count else 0.0
