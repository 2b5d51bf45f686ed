"""Small linear algebra of `mocapella.calibration.sensor_graph`, compiled; importing this module imports numba.

LAPACK starts threads for matrices as small as these, which takes longer than the work on a machine that is busy. Sums
are written out: numba compiles them sooner than expressions of arrays.
"""

from __future__ import annotations

import numpy as np

from mocapella.compiled import njit


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
                L[i, i] = np.nan  # and with it all that follows
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


@njit(cache=True)
def refine(world, a, b, T_a_b, weights, most_steps, smallest_step):  # noqa: PLR0917
    """Gauss–Newton over all pairs; see `sensor_graph`. Improves ``world`` in place but for its first.

    Args:
        world: (sensors, 4, 4) T_root_sensor.
        a, b: (pairs,) which sensors; T_a_b: (pairs, 4, 4); weights: (pairs, 6, 6) inverse covariances.
        most_steps, smallest_step: when to end.

    Returns:
        (6·(sensors − 1), 6·(sensors − 1)) covariance.
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
def _inverse(T):
    out = np.eye(4)
    for i in range(3):
        for k in range(3):
            out[i, k] = T[k, i]
            out[i, 3] -= T[k, i] * T[k, 3]
    return out


@njit(cache=True)
def _product(A, B):
    out = np.zeros((A.shape[0], B.shape[1]))
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            for k in range(B.shape[1]):
                out[i, k] += A[i, j] * B[j, k]
    return out


@njit(cache=True)
def _transposed(A):
    out = np.empty((A.shape[1], A.shape[0]))
    for i in range(A.shape[0]):
        for k in range(A.shape[1]):
            out[k, i] = A[i, k]
    return out


@njit(cache=True)
def _cross(x, y, z):
    out = np.zeros((3, 3))
    out[0, 1], out[0, 2], out[1, 2] = -z, y, -x
    out[1, 0], out[2, 0], out[2, 1] = z, -y, x
    return out


@njit(cache=True)
def _adjoint(T):
    out, across = np.zeros((6, 6)), _cross(T[0, 3], T[1, 3], T[2, 3])
    for i in range(3):
        for k in range(3):
            out[i, k] = out[3 + i, 3 + k] = T[i, k]
            for j in range(3):
                out[i, 3 + k] += across[i, j] * T[j, k]
    return out


@njit(cache=True)
def _exp(twist):
    """As `twists.exp_twist`."""
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
def _log(T):
    """As `twists.log_motion`: by the longest column of 4 q qᵀ of the unit quaternion q."""
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
