"""Small linear algebra of `mocapella.calibration.sensor_graph`, compiled; importing this module imports numba.

LAPACK starts threads for matrices as small as these, which takes longer than the work on a machine that is busy.
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
            weighted = np.ascontiguousarray(to_a.T) @ weights[e]
            W = weighted @ to_a
            force = weighted @ _log(T_a_root @ world[b[e]] @ _inverse(T_a_b[e]))
            i, k = 6 * a[e], 6 * b[e]
            A[i : i + 6, i : i + 6] += W
            A[k : k + 6, k : k + 6] += W
            A[i : i + 6, k : k + 6] -= W
            A[k : k + 6, i : i + 6] -= W
            g[i : i + 6] += force
            g[k : k + 6] -= force
        C = inverse_of_positive(np.ascontiguousarray(A[6:, 6:]))
        step = C @ g[6:]
        for i in range(1, n):
            world[i] = _exp(step[6 * i - 6 : 6 * i]) @ world[i]
        if np.abs(step).max() < smallest_step:
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
def _cross(x):
    return np.array([[0.0, -x[2], x[1]], [x[2], 0.0, -x[0]], [-x[1], x[0], 0.0]])


@njit(cache=True)
def _adjoint(T):
    out, R = np.zeros((6, 6)), np.ascontiguousarray(T[:3, :3])
    out[:3, :3] = R
    out[3:, 3:] = R
    out[:3, 3:] = _cross(T[:3, 3]) @ R
    return out


@njit(cache=True)
def _exp(twist):
    """As `twists.exp_twist`."""
    angle = np.sqrt((twist[3:] ** 2).sum())
    K = _cross(twist[3:])
    KK = K @ K
    a, b, c = 1 - angle**2 / 6, 0.5 - angle**2 / 24, 1 / 6 - angle**2 / 120
    if angle >= 1e-4:
        a, b, c = np.sin(angle) / angle, (1 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    out = np.eye(4)
    out[:3, :3] += a * K + b * KK
    out[:3, 3] = twist[:3] + (b * K + c * KK) @ np.ascontiguousarray(twist[:3])
    return out


@njit(cache=True)
def _log(T):
    """As `twists.log_motion`: by the longest column of 4 q qᵀ of the unit quaternion q."""
    R = T[:3, :3]
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    best, most = -1, trace
    for i in range(3):
        if R[i, i] > most:
            best, most = i, R[i, i]
    q = np.empty(4)
    if best < 0:
        q[0] = 1 + trace
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            q[1 + i] = R[k, j] - R[j, k]
    else:
        i, j, k = best, (best + 1) % 3, (best + 2) % 3
        q[0] = R[k, j] - R[j, k]
        q[1 + i] = 1 + 2 * R[i, i] - trace
        q[1 + j] = R[i, j] + R[j, i]
        q[1 + k] = R[i, k] + R[k, i]
    if q[0] < 0:
        q = -q
    sine = np.sqrt((q[1:] ** 2).sum())
    angle = 2 * np.arctan2(sine, q[0])
    phi = q[1:] * (angle / sine if sine > 1e-12 * q[0] else 2 / q[0])
    K = _cross(phi)
    c = 1 / 12 + angle**2 / 720
    if angle >= 1e-3:
        c = (1 - 0.5 * angle * np.cos(0.5 * angle) / np.sin(0.5 * angle)) / angle**2
    out = np.empty(6)
    out[:3] = (np.eye(3) - 0.5 * K + c * (K @ K)) @ np.ascontiguousarray(T[:3, 3])
    out[3:] = phi
    return out
