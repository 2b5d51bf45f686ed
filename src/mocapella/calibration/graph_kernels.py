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
def inverses_of_positive(A: Float64) -> Float64:
    """Invert each of several matrices (…, n, n) of one leading axis by `inverse_of_positive`."""
    out = np.empty_like(A)
    for e in range(len(A)):
        out[e] = inverse_of_positive(A[e])
    return out


@njit(cache=True)
def refine(  # noqa: PLR0917
    world: Float64, ends: Int64, T_a_b: Float64, weights: Float64, smallest_step: float, last: bool, covariance: Float64
) -> bool:
    """Refine the sensors' poses, except the first, by one step of Gauss–Newton over all pairs.

    Args:
        world: (sensors, 4, 4) T_root_sensor, updated; all but the first NaN if the pairs do not determine them.
        ends: (pairs, 2) indices of each pair's sensors, a and b.
        T_a_b: (pairs, 4, 4) measured relative poses.
        weights: (pairs, 6, 6) inverse covariances of a small motion in a's frame (translation [m], rotation [rad]).
        smallest_step: a step whose components are all below this is the last [m, rad].
        last: whether the step is the last in any case.
        covariance: (sensors, 6, 6) written after the last step: of small motions of the poses in the root's frame; NaN
            if the pairs do not determine them.

    Returns:
        Whether the step was the last.
    """
    A, x = _equations(world, ends, T_a_b, weights)
    if not _factorise(A):
        world[1:] = np.nan
        covariance[1:] = np.nan
        return True
    _solve(A, x)
    largest = 0.0
    for i in range(1, len(world)):
        step = x[6 * i - 6 : 6 * i]
        for r in range(6):
            largest = max(largest, abs(step[r]))
        world[i] = _product(_exp(step), world[i])
    if not last and not largest < smallest_step:
        return False
    _write_blocks_of_inverse(A, covariance[1:])
    return True


@njit(cache=True)
def _equations(world: Float64, ends: Int64, T_a_b: Float64, weights: Float64) -> tuple[Float64, Float64]:
    """Return the normal equations' matrix (6·(sensors − 1), …), upper triangle, and right side, without the root."""
    n = 6 * len(world) - 6
    A, g = np.zeros((n, n)), np.zeros(n)
    for e in range(len(ends)):
        a, b = ends[e]
        T_a_root = _inverse(world[a])
        to_a = _adjoint(T_a_root)
        weighted = _product(_transposed(to_a), weights[e])
        W = _product(weighted, to_a)
        off = _log(_product(_product(T_a_root, world[b]), _inverse(T_a_b[e])))
        i, k = 6 * a - 6, 6 * b - 6
        for r in range(6):
            force = 0.0
            for c in range(6):
                force += weighted[r, c] * off[c]
                if a > 0:
                    A[i + r, i + c] += W[r, c]
                if b > 0:
                    A[k + r, k + c] += W[r, c]
                if a > 0 and b > 0:
                    if i < k:
                        A[i + r, k + c] -= W[r, c]
                    else:
                        A[k + r, i + c] -= W[r, c]
            if a > 0:
                g[i + r] += force
            if b > 0:
                g[k + r] -= force
    return A, g


@njit(cache=True, error_model="numpy")
def _factorise(A: Float64) -> bool:
    """Replace the upper triangle of a matrix by its Cholesky factor U, A = Uᵀ U; False if it is not positive definite.

    The rows are updated along memory, so the compiler vectorises the inner loop; zeros of sparse graphs are skipped.
    """
    n = len(A)
    for k in range(n):
        if not A[k, k] > 0.0:
            return False
        row = A[k, k:]
        pivot = np.sqrt(row[0])
        for j in range(len(row)):
            row[j] /= pivot
        for i in range(k + 1, n):
            f = A[k, i]
            if f != 0.0:
                ahead, below = A[k, i:], A[i, i:]
                for j in range(len(below)):
                    below[j] -= f * ahead[j]
    return True


@njit(cache=True, error_model="numpy")
def _solve(U: Float64, x: Float64) -> None:
    """Solve Uᵀ U y = x by substitution: replace x (n,) by y; U (n, n) is of `_factorise`."""
    n = len(x)
    for k in range(n):
        x[k] /= U[k, k]
        for j in range(k + 1, n):
            x[j] -= U[k, j] * x[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            x[k] -= U[k, j] * x[j]
        x[k] /= U[k, k]


@njit(cache=True, error_model="numpy")
def _write_blocks_of_inverse(U: Float64, blocks: Float64) -> None:
    """Write the diagonal blocks (n/6, 6, 6) of the inverse of Uᵀ U."""
    n = len(U)
    X = np.zeros((n, n))  # the inverse of Uᵀ, by rows
    blocks[:] = 0.0
    for i in range(n):
        X[i, i] = 1.0
        for k in range(i):
            f = U[k, i]
            if f != 0.0:
                above, row = X[k, : k + 1], X[i, : k + 1]
                for j in range(len(row)):
                    row[j] -= f * above[j]
        row = X[i, : i + 1]
        for j in range(len(row)):
            row[j] /= U[i, i]
        for s in range(i // 6 + 1):
            part, block = X[i, 6 * s : 6 * s + 6], blocks[s]
            for r in range(6):
                for c in range(6):
                    block[r, c] += part[r] * part[c]


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
