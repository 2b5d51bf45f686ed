"""Compiled linear algebra of `mocapella.calibration.sensor_graph`; importing this module imports numba.

Pose graph optimisation: Gauss–Newton on the sensors' poses from the relative poses of pairs, weighted by their inverse
covariances.

LAPACK starts threads even for small matrices, which costs more than it saves on a busy machine. Sums are written out
because numba compiles loops faster than expressions of arrays.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.geometry.cholesky_kernels import factorise

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
_UNDAMPED = np.float64(0.0)


@njit(cache=True)
def inverse_of_positive(A: Float64) -> Float64:
    """Invert a symmetric positive definite matrix (n, n) by its Cholesky factor; all NaN if it is not one.

    G. Golub, C. Van Loan, *Matrix Computations*, 4.2.
    """
    n = len(A)
    L, out = np.zeros((n, n)), np.empty((n, n))
    if not factorise(A, _UNDAMPED, L):
        for i in range(n):
            for j in range(n):
                out[i, j] = np.nan
        return out
    # Columns of L⁻¹, kept as rows, so that the products below run along memory.
    X = np.zeros((n, n))
    for c in range(n):
        X[c, c] = 1.0 / L[c, c]
        for i in range(c + 1, n):
            s = 0.0
            for k in range(c, i):
                s -= L[i, k] * X[c, k]
            X[c, i] = s / L[i, i]
    for i in range(n):
        for j in range(i + 1):
            s = 0.0
            for k in range(i, n):
                s += X[i, k] * X[j, k]
            out[i, j] = out[j, i] = s
    return out


@njit(cache=True)
def refine(  # noqa: PLR0917
    world: Float64,
    a: Int64,
    b: Int64,
    T_a_b: Float64,
    weights: Float64,
    most_steps: int,
    smallest_step: float,
) -> Float64:
    """Refine the sensors' poses, except the first: pose graph optimisation by Gauss–Newton over all pairs.

    Args:
        world: (sensors, 4, 4) T_root_sensor, updated in place.
        a, b: (pairs,) indices of each pair's sensors.
        T_a_b: (pairs, 4, 4) measured relative poses.
        weights: (pairs, 6, 6) inverse covariances of a small motion in a's frame (translation [m], rotation [rad]).
        most_steps: largest number of steps.
        smallest_step: a step whose components are all below this is the last [m, rad].

    Returns:
        Covariance (6·(sensors − 1), 6·(sensors − 1)) of small motions of the poses in the root's frame; NaN if the
        pairs do not determine them.
    """
    n = len(world)
    C = np.zeros((6 * n - 6, 6 * n - 6))
    for _ in range(most_steps):
        A, g = np.zeros((6 * n, 6 * n)), np.zeros(6 * n)
        for e in range(len(a)):
            T_a_root = _inverse(world[a[e]])
            to_a = _adjoint(T_a_root)
            weighted = _product(_transposed(to_a), weights[e])
            W = _product(weighted, to_a)
            off = _log(_product(_product(T_a_root, world[b[e]]), _inverse(T_a_b[e])))
            i, k = 6 * a[e], 6 * b[e]
            for r in range(6):
                force = 0.0
                for c in range(6):
                    force += weighted[r, c] * off[c]
                    A[i + r, i + c] += W[r, c]
                    A[k + r, k + c] += W[r, c]
                    A[i + r, k + c] -= W[r, c]
                    A[k + r, i + c] -= W[r, c]
                g[i + r] += force
                g[k + r] -= force
        free = np.empty_like(C)
        for r in range(len(C)):
            for c in range(len(C)):
                free[r, c] = A[6 + r, 6 + c]
        C = inverse_of_positive(free)
        largest, step = 0.0, np.empty(6)
        for i in range(1, n):
            for r in range(6):
                step[r] = 0.0
                for c in range(len(C)):
                    step[r] += C[6 * i - 6 + r, c] * g[6 + c]
                largest = max(largest, abs(step[r]))
            moved = _product(_exp(step), world[i])
            for r in range(4):
                for c in range(4):
                    world[i, r, c] = moved[r, c]
        if largest < smallest_step:
            break
    return C


@njit(cache=True)
def _inverse(T: Float64) -> Float64:
    out = np.eye(4)
    for i in range(3):
        for k in range(3):
            out[i, k] = T[k, i]
            out[i, 3] -= T[k, i] * T[k, 3]
    return out


@njit(cache=True)
def _product(A: Float64, B: Float64) -> Float64:
    out = np.zeros((A.shape[0], B.shape[1]))
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            for k in range(B.shape[1]):
                out[i, k] += A[i, j] * B[j, k]
    return out


@njit(cache=True)
def _transposed(A: Float64) -> Float64:
    out = np.empty((A.shape[1], A.shape[0]))
    for i in range(A.shape[0]):
        for k in range(A.shape[1]):
            out[k, i] = A[i, k]
    return out


@njit(cache=True)
def _cross(x: float, y: float, z: float) -> Float64:
    out = np.zeros((3, 3))
    out[0, 1], out[0, 2], out[1, 2] = -z, y, -x
    out[1, 0], out[2, 0], out[2, 1] = z, -y, x
    return out


@njit(cache=True)
def _adjoint(T: Float64) -> Float64:
    out, across = np.zeros((6, 6)), _cross(T[0, 3], T[1, 3], T[2, 3])
    for i in range(3):
        for k in range(3):
            out[i, k] = out[3 + i, 3 + k] = T[i, k]
            for j in range(3):
                out[i, 3 + k] += across[i, j] * T[j, k]
    return out


@njit(cache=True)
def _exp(twist: Float64) -> Float64:
    """Return the exponential of a twist (6,), as `twists.exp_twist`."""
    square = twist[3] ** 2 + twist[4] ** 2 + twist[5] ** 2
    angle = np.sqrt(square)
    K = _cross(twist[3], twist[4], twist[5])
    KK = _product(K, K)
    a, b, c = 1 - square / 6, 0.5 - square / 24, 1 / 6 - square / 120
    if angle >= 1e-4:
        a, b, c = np.sin(angle) / angle, (1 - np.cos(angle)) / square, (angle - np.sin(angle)) / (angle * square)
    out = np.eye(4)
    for i in range(3):
        out[i, 3] = twist[i]
        for k in range(3):
            out[i, k] += a * K[i, k] + b * KK[i, k]
            out[i, 3] += (b * K[i, k] + c * KK[i, k]) * twist[k]
    return out


@njit(cache=True)
def _log(T: Float64) -> Float64:
    """Return the logarithm of a motion (4, 4), as `twists.log_motion`.

    By the longest column of 4 q qᵀ of the unit quaternion q."""
    trace = T[0, 0] + T[1, 1] + T[2, 2]
    best, most = -1, trace
    for i in range(3):
        if T[i, i] > most:
            best, most = i, T[i, i]
    q = np.empty(4)
    if best < 0:
        q[0] = 1 + trace
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            q[1 + i] = T[k, j] - T[j, k]
    else:
        i, j, k = best, (best + 1) % 3, (best + 2) % 3
        q[0] = T[k, j] - T[j, k]
        q[1 + i] = 1 + 2 * T[i, i] - trace
        q[1 + j] = T[i, j] + T[j, i]
        q[1 + k] = T[i, k] + T[k, i]
    if q[0] < 0:
        for i in range(4):
            q[i] = -q[i]
    sine = np.sqrt(q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
    angle = 2 * np.arctan2(sine, q[0])
    f = angle / sine if sine > 1e-12 * q[0] else 2 / q[0]
    K = _cross(f * q[1], f * q[2], f * q[3])
    KK = _product(K, K)
    c = 1 / 12 + angle**2 / 720
    if angle >= 1e-3:
        c = (1 - 0.5 * angle * np.cos(0.5 * angle) / np.sin(0.5 * angle)) / angle**2
    out = np.empty(6)
    for i in range(3):
        out[i], out[3 + i] = T[i, 3], f * q[1 + i]
        for k in range(3):
            out[i] += (c * KK[i, k] - 0.5 * K[i, k]) * T[k, 3]
    return out
