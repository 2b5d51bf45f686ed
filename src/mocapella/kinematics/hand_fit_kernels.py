"""Kernels that fit a hand to its markers, a prior and a prediction.

The fit minimises, over the palm's motion T and the n free angles z,

    Σ (p − x(T, z))ᵀ W (p − x(T, z))  +  (z − z₀)ᵀ Λ (z − z₀)  +  Σ (change since the prediction)² / variance

by the Levenberg–Marquardt method, with a steep penalty outside the limits; at the end the angles are clamped to them.
Residuals and derivatives are in the palm's frame. A digit's angles are flexion f and abduction a of its first joint,
flexions m and b of the second and third, and the thumb's opposition c. Importing this module imports numba.
"""

# ruff: noqa: PLR0912, PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.geometry.cholesky_kernels import factorise, inverted, substitute
from mocapella.geometry.turn_kernels import FIRST, orthonormal, turn_between, turned
from mocapella.kinematics.hand_kernels import (
    A0,
    AX,
    B_MAX,
    BASE,
    F0,
    FMIN,
    FRAME,
    FX,
    L1,
    M_MAX,
    limit,
)

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

_WEAK = 0.01  # share of the prior's information in the markers' own covariance
_LIMIT_SD = 0.01  # standard deviation outside the limits [rad], for the cone relative to its half axes


@njit(cache=True, error_model="numpy")
def digit_points(row: Float64, mirror: float, q: Float64, x: Float64, axes: Float64) -> None:
    """Compute a digit's joints and axes of rotation in the palm's frame, by forward kinematics.

    The axes of f and a go through the first joint, of m and c through the second, of b through the third.

    Args:
        row: (`DIGIT`,) the digit's parameters, see `hand_kernels`.
        mirror: -1 for a left hand, else 1.
        q: (5,) flexion f and abduction a of the first joint, flexions m and b of the next ones, opposition c [rad].
        x: (4, 3) written: joints and tip [m].
        axes: (5, 3) written: unit axis of each angle.
    """
    sf, cf, sa, ca = math.sin(q[0]), math.cos(q[0]), math.sin(q[1]), math.cos(q[1])
    sc, cc = math.sin(q[4]), math.cos(q[4])
    turn = mirror  # an axis is a pseudovector
    for k in range(3):
        X, Y, Z = row[FRAME + 3 * k], row[FRAME + 3 * k + 1], row[FRAME + 3 * k + 2]
        side = mirror if k == 0 else 1.0
        across, ahead = ca * X - sa * Z, sa * X + ca * Z
        up, along = cf * Y + sf * ahead, cf * ahead - sf * Y
        second, bone = cc * across - sc * along, sc * across + cc * along
        axes[0, k], axes[1, k], axes[4, k] = turn * side * across, turn * side * Y, turn * side * up
        axes[2, k] = axes[3, k] = turn * side * second
        x[0, k] = side * row[BASE + k]
        x[1, k] = x[0, k] + side * row[L1] * along
        x[2, k] = x[1, k] + side * row[L1 + 1] * (math.cos(q[2]) * bone - math.sin(q[2]) * up)
        x[3, k] = x[2, k] + side * row[L1 + 2] * (math.cos(q[2] + q[3]) * bone - math.sin(q[2] + q[3]) * up)


@njit(cache=True, error_model="numpy")
def digit_angles(z: Float64, columns: Int64, gains: Float64, digit: int, q: Float64) -> None:
    """Write a digit's angles f, a, m, b, c into q (5,), from the free angles z (n,) [rad].

    Args:
        z: (n,) free angles [rad].
        columns, gains: (5, 5) as in `fit`.
        digit: index of the digit, 0 for the thumb.
        q: (5,) written [rad].
    """
    for k in range(5):
        column = columns[digit, k]
        q[k] = gains[digit, k] * z[column] if column >= 0 else 0.0


@njit(cache=True, error_model="numpy")
def _columns_of(
    digit: int, joint: int, x: Float64, axes: Float64, columns: Int64, gains: Float64, J: Float64, at: Int64,
) -> int:  # fmt: skip
    """Write the derivatives J (11, 3) of a digit's joint and their indices at (11,): six of the palm, then angles."""
    px, py, pz = x[joint, 0], x[joint, 1], x[joint, 2]
    for k in range(6):
        at[k] = k
        for c in range(3):
            J[k, c] = 0.0
    J[0, 0] = J[1, 1] = J[2, 2] = 1.0
    J[3, 1], J[3, 2] = -pz, py
    J[4, 0], J[4, 2] = pz, -px
    J[5, 0], J[5, 1] = -py, px
    n = 6
    if digit < 0:  # of the palm
        return n
    for k in range(5):
        column = columns[digit, k]
        origin = 0 if k < 2 else (2 if k == 3 else 1)
        if column < 0 or joint <= origin:
            continue
        dx, dy, dz = px - x[origin, 0], py - x[origin, 1], pz - x[origin, 2]
        wx, wy, wz = axes[k, 0], axes[k, 1], axes[k, 2]
        g = gains[digit, k]
        J[n, 0], J[n, 1], J[n, 2] = g * (wy * dz - wz * dy), g * (wz * dx - wx * dz), g * (wx * dy - wy * dx)
        at[n] = 6 + column
        n += 1
    return n


@njit(cache=True, error_model="numpy")
def _add(J: Float64, at: Int64, n: int, W: Float64, rx: float, ry: float, rz: float, H: Float64, g: Float64) -> float:
    """Add a point's JᵀWJ and JᵀWr to H and g; return rᵀWr."""
    for i in range(n):
        vx = J[i, 0] * W[0] + J[i, 1] * W[3] + J[i, 2] * W[6]
        vy = J[i, 0] * W[1] + J[i, 1] * W[4] + J[i, 2] * W[7]
        vz = J[i, 0] * W[2] + J[i, 1] * W[5] + J[i, 2] * W[8]
        g[at[i]] += vx * rx + vy * ry + vz * rz
        for k in range(n):
            H[at[i], at[k]] += vx * J[k, 0] + vy * J[k, 1] + vz * J[k, 2]
    cost = rx * (W[0] * rx + W[1] * ry + W[2] * rz) + ry * (W[3] * rx + W[4] * ry + W[5] * rz)
    return float(cost + rz * (W[6] * rx + W[7] * ry + W[8] * rz))


@njit(cache=True, error_model="numpy")
def _place(point: int, base: int) -> tuple[int, int]:
    """Return the digit of a measured point, −1 for one of the base, and its index among the digit's joints and tip."""
    if point < 5:
        return point, 3
    if point < 5 + base:
        return -1, 3
    return (point - 5 - base) // 2, 1 + (point - 5 - base) % 2


@njit(cache=True, error_model="numpy")
def _measured(
    digits: Float64, mirror: float, layout: Float64, points: Float64, information: Float64, columns: Int64,
    gains: Float64, R: Float64, t: Float64, z: Float64, H: Float64, g: Float64,
) -> float:  # fmt: skip
    """Add the markers' terms to H and g; return the sum of their squared weighted residuals."""
    q, x, axes, J = np.empty(5), np.empty((4, 3)), np.empty((5, 3)), np.empty((11, 3))
    W, at = np.empty(9), np.empty(11, dtype=np.int64)
    cost = 0.0
    for i in range(len(points)):
        if information[i, 0, 0] == 0.0:
            continue
        digit, joint = _place(i, len(layout))
        if digit >= 0:
            digit_angles(z, columns, gains, digit, q)
            digit_points(digits[digit], mirror, q, x, axes)
        else:
            x[3, 0], x[3, 1], x[3, 2] = mirror * layout[i - 5, 0], layout[i - 5, 1], layout[i - 5, 2]
        n = _columns_of(digit, joint, x, axes, columns, gains, J, at)
        dx, dy, dz = points[i, 0] - t[0], points[i, 1] - t[1], points[i, 2] - t[2]
        rx = R[0] * dx + R[3] * dy + R[6] * dz - x[joint, 0]
        ry = R[1] * dx + R[4] * dy + R[7] * dz - x[joint, 1]
        rz = R[2] * dx + R[5] * dy + R[8] * dz - x[joint, 2]
        for a in range(3):
            for b in range(3):
                value = 0.0
                for c in range(3):
                    for d in range(3):
                        value += R[3 * c + a] * information[i, c, d] * R[3 * d + b]
                W[3 * a + b] = value
        cost += _add(J, at, n, W, rx, ry, rz, H, g)
    return cost


@njit(cache=True, error_model="numpy")
def _expected(
    prior_mean: Float64, prior: Float64, predicted_R: Float64, predicted_t: Float64, predicted_z: Float64,
    certainty: Float64, R: Float64, t: Float64, z: Float64, H: Float64, g: Float64,
) -> float:  # fmt: skip
    """Add prior and prediction to H and g; return their cost."""
    n, cost = len(z), 0.0
    for i in range(n):
        v = 0.0
        for k in range(n):
            v += prior[i, k] * (z[k] - prior_mean[k])
            H[6 + i, 6 + k] += prior[i, k]
        g[6 + i] -= v
        cost += v * (z[i] - prior_mean[i])
    d = np.zeros(6 + n)
    if certainty[0, 0] > 0.0 or certainty[3, 3] > 0.0:
        d[3], d[4], d[5] = turn_between(predicted_R, FIRST, R)
        dx, dy, dz = t[0] - predicted_t[0], t[1] - predicted_t[1], t[2] - predicted_t[2]
        for k in range(3):
            d[k] = R[k] * dx + R[3 + k] * dy + R[6 + k] * dz
    for i in range(n):
        d[6 + i] = z[i] - predicted_z[i]
    for i in range(6 + n):
        v = 0.0
        for k in range(6 + n):
            v += certainty[i, k] * d[k]
            H[i, k] += certainty[i, k]
        g[i] -= v
        cost += v * d[i]
    return cost


@njit(cache=True, error_model="numpy")
def _penalty(
    digits: Float64, columns: Int64, gains: Float64, z: Float64, c_max: float, H: Float64, g: Float64,
) -> float:  # fmt: skip
    """Add the penalty outside the limits to H and g; return its cost."""
    cost, w, q = 0.0, 1.0 / _LIMIT_SD**2, np.empty(5)
    for i in range(5):
        row = digits[i]
        digit_angles(z, columns, gains, i, q)
        f, a = q[0] - row[F0], q[1] - row[A0]
        fc, ac = columns[i, 0], columns[i, 1]
        s = (f / row[FX]) ** 2 + ((a / row[AX]) ** 2 if row[AX] > 0.0 else 0.0)
        if s > 1.0:
            s = math.sqrt(s)
            df, da = f / (row[FX] ** 2 * s), a / (row[AX] ** 2 * s) if row[AX] > 0.0 else 0.0
            cost += w * (s - 1.0) ** 2
            g[6 + fc] -= w * (s - 1.0) * df
            H[6 + fc, 6 + fc] += w * df * df
            if ac >= 0:
                g[6 + ac] -= w * (s - 1.0) * da
                H[6 + ac, 6 + ac] += w * da * da
                H[6 + fc, 6 + ac] += w * df * da
                H[6 + ac, 6 + fc] += w * df * da
        for k in range(5):
            column = columns[i, k]
            if k == 1 or column < 0:
                continue
            low = row[FMIN] if k == 0 else (-c_max if k == 4 else 0.0)
            high = math.inf if k == 0 else (row[M_MAX] if k == 2 else (row[B_MAX] if k == 3 else c_max))
            over = max(q[k] - high, 0.0) + min(q[k] - low, 0.0)
            if over != 0.0:
                cost += w * over * over
                g[6 + column] -= w * over * gains[i, k]
                H[6 + column, 6 + column] += w * gains[i, k] ** 2
    return cost


@njit(cache=True, error_model="numpy")
def within(digits: Float64, columns: Int64, gains: Float64, z: Float64, c_max: float) -> None:
    """Clamp free angles to the limits of their digits, in place.

    Args:
        digits: (5, `DIGIT`) of `hand_kernels`.
        columns, gains: (5, 5) index and factor of the free angle that each of a digit's angles follows.
        z: (n,) free angles [rad], changed.
        c_max: limit of the thumb's opposition c [rad].
    """
    q, out = np.empty(5), np.empty(4)
    for i in range(5):
        digit_angles(z, columns, gains, i, q)
        limit(digits[i], q[0], q[1], q[2], q[3], out)
        for k in range(5):
            column = columns[i, k]
            if column >= 0 and gains[i, k] == 1.0:
                z[column] = out[k] if k < 4 else min(max(q[4], -c_max), c_max)


@njit(cache=True, error_model="numpy")
def _copy(one: Float64, other: Float64) -> None:
    """Copy a vector into another; a slice takes numba longer to compile."""
    for k in range(len(one)):
        other[k] = one[k]


@njit(cache=True, error_model="numpy")
def fit(
    digits: Float64, mirror: float, layout: Float64, points: Float64, information: Float64, columns: Int64,
    gains: Float64, c_max: float, prior_mean: Float64, prior: Float64, predicted_R: Float64, predicted_t: Float64,
    predicted_z: Float64, certainty: Float64, R: Float64, t: Float64, z: Float64, iterations: int,
) -> float:  # fmt: skip
    """Fit a hand to its markers; return the cost.

    Args:
        digits: (5, `DIGIT`) of `hand_kernels`.
        mirror: -1 for a left hand, else 1.
        layout: (k, 3) the base's markers in the palm's frame of a right hand [m].
        points: (5 + k, 3) measured tips, then the base's markers, world [m]; or (15 + k, 3) with each digit's second
            and third joint after them.
        information: (…, 3, 3) inverse covariances [1/m²]; 0 where a marker is not used.
        columns, gains: (5, 5) index and factor of the free angle that each of a digit's angles f, a, m, b, c follows;
            -1: held at 0.
        c_max: limit of c [rad].
        prior_mean, prior: (n,), (n, n) mean and inverse covariance of the free angles.
        predicted_R, predicted_t, predicted_z: (9,), (3,), (n,) predicted values of R, t and z.
        certainty: (6 + n, 6 + n) inverse covariance of the palm's twist and of the free angles about the prediction.
        R, t, z: (9,), (3,), (n,) motion from the palm's frame to the world (rotation by rows, translation [m]) and free
            angles [rad]; the start, overwritten with the result.
        iterations: largest number of iterations.
    """
    n = 6 + len(z)
    H, g, M, d = np.empty((n, n)), np.empty(n), np.empty((n, n)), np.empty(n)
    new_R, new_t, new_z = np.empty(9), np.empty(3), np.empty(n - 6)
    _copy(R, new_R)
    _copy(t, new_t)
    _copy(z, new_z)
    damping, cost, most = 1e-6, math.inf, 1.0
    for turn in range(iterations + 1):
        spare, spare_g = np.zeros((n, n)), np.zeros(n)
        there = _measured(
            digits, mirror, layout, points, information, columns, gains, new_R, new_t, new_z, spare, spare_g
        )
        there += _expected(
            prior_mean, prior, predicted_R, predicted_t, predicted_z, certainty, new_R, new_t, new_z, spare, spare_g
        )
        there += _penalty(digits, columns, gains, new_z, c_max, spare, spare_g)
        if there < cost:
            gained, cost = cost - there, there
            _copy(new_R, R)
            _copy(new_t, t)
            _copy(new_z, z)
            H, g = spare, spare_g
            for i in range(6):
                H[i, i] += 1e-9
            if turn > 0:
                damping = max(0.1 * damping, 1e-9)
                if gained < 1e-6 * (1.0 + cost):
                    break
        else:
            damping = max(10.0 * damping, 1e-6)
            if damping > 1e6 or most < 1e-9:
                break
        while damping < 1e6 and not factorise(H, damping, M):
            damping = max(10.0 * damping, 1e-6)
        for i in range(n):
            d[i] = g[i]
        substitute(M, d)
        most = 0.0
        for i in range(3, n):
            most = max(most, abs(d[i]))
        if most > 0.5:
            for i in range(n):
                d[i] *= 0.5 / most
        turned(R, FIRST, d[3], d[4], d[5], new_R)
        orthonormal(new_R)
        for k in range(3):
            new_t[k] = t[k] + R[3 * k] * d[0] + R[3 * k + 1] * d[1] + R[3 * k + 2] * d[2]
        for k in range(n - 6):
            new_z[k] = z[k] + d[6 + k]
    within(digits, columns, gains, z, c_max)
    return cost


@njit(cache=True, error_model="numpy")
def describe(
    digits: Float64, mirror: float, layout: Float64, points: Float64, information: Float64, columns: Int64,
    gains: Float64, prior: Float64, share: float, certainty: Float64, R: Float64, t: Float64, z: Float64, x: Float64,
    sd: Float64, alone: Float64, covariance: Float64, residuals: Float64,
) -> bool:  # fmt: skip
    """Compute a fitted hand's landmarks and their uncertainty: posterior, and from this frame's markers alone.

    The posterior covariance is the inverse of the normal matrix. Alone means: with a hundredth of the prior's
    information, and without the prediction; it tells which landmarks are measured rather than inferred.

    Args:
        digits, mirror, layout, points, information, columns, gains, prior, certainty, R, t, z: the fitted hand and its
            measurements, as in `fit`; not changed.
        share: share of the prior's information that the fit used.
        x: (21, 3) written: landmarks in the world [m].
        sd: (21,) written: standard deviation of a coordinate, from all information [m].
        alone: (21,) written: standard deviation of a coordinate, from the markers alone [m].
        covariance: (6 + n, 6 + n) written: of the palm's twist and of the free angles, from all information.
        residuals: (…,) written: distances of the measured markers from the fitted ones [m]; NaN where not finite.

    Returns:
        Whether the covariance exists.
    """
    n = 6 + len(z)
    Hm, H, g = np.zeros((n, n)), np.zeros((n, n)), np.zeros(n)
    q, joints, axes, J = np.empty(5), np.empty((4, 3)), np.empty((5, 3)), np.empty((11, 3))
    at = np.empty(11, dtype=np.int64)
    _measured(digits, mirror, layout, points, information, columns, gains, R, t, z, Hm, g)
    P = np.empty((2, n, n))
    for case in range(2):  # the markers alone, and all information
        weight = _WEAK if case == 0 else share
        for i in range(n):
            for k in range(n):
                H[i, k] = Hm[i, k] + (weight * prior[i - 6, k - 6] if i >= 6 and k >= 6 else 0.0)
                if case == 1:
                    H[i, k] += certainty[i, k]
            H[i, i] += 1e-6
        if not inverted(H, 1e-12, P[case]):
            return False
    for i in range(n):
        for k in range(n):
            covariance[i, k] = P[1, i, k]
    for landmark in range(21):
        digit, joint = (landmark - 1) // 4, (landmark - 1) % 4 if landmark > 0 else 0
        if landmark == 0:
            joints[0, 0] = joints[0, 1] = joints[0, 2] = 0.0
        elif joint == 0:
            digit_angles(z, columns, gains, digit, q)
            digit_points(digits[digit], mirror, q, joints, axes)
        count = _columns_of(digit, joint, joints, axes, columns, gains, J, at)
        all_of, of_markers = 0.0, 0.0
        for c in range(3):
            x[landmark, c] = t[c]
            for k in range(3):
                x[landmark, c] += R[3 * c + k] * joints[joint, k]
            for i in range(count):
                for k in range(count):
                    product = J[i, c] * J[k, c]
                    all_of += product * P[1, at[i], at[k]]
                    of_markers += product * P[0, at[i], at[k]]
        sd[landmark] = math.sqrt(all_of / 3.0)
        alone[landmark] = math.sqrt(of_markers / 3.0)
    for i in range(len(points)):
        digit, joint = _place(i, len(layout))
        if digit >= 0:
            k = 4 * digit + 1 + joint
            px, py, pz = x[k, 0], x[k, 1], x[k, 2]
        else:
            lx, ly, lz = mirror * layout[i - 5, 0], layout[i - 5, 1], layout[i - 5, 2]
            px = t[0] + R[0] * lx + R[1] * ly + R[2] * lz
            py = t[1] + R[3] * lx + R[4] * ly + R[5] * lz
            pz = t[2] + R[6] * lx + R[7] * ly + R[8] * lz
        residuals[i] = math.sqrt((points[i, 0] - px) ** 2 + (points[i, 1] - py) ** 2 + (points[i, 2] - pz) ** 2)
    return True


@njit(cache=True, error_model="numpy")
def misfits(
    digits: Float64, mirror: float, layout: Float64, points: Float64, information: Float64, columns: Int64,
    gains: Float64, R: Float64, t: Float64, z: Float64, squared: Float64,
) -> None:  # fmt: skip
    """Write the squared Mahalanobis distances of the markers from a hand, for the rejection of outliers.

    Args:
        digits, mirror, layout, points, information, columns, gains, R, t, z: the hand and its measurements, as in
            `fit`; not changed.
        squared: (…,) written [χ²].
    """
    n = 6 + len(z)
    H, g, alone = np.zeros((n, n)), np.zeros(n), np.zeros_like(information)
    for i in range(len(points)):
        for a in range(3):
            for b in range(3):
                alone[i, a, b] = information[i, a, b]
        squared[i] = _measured(digits, mirror, layout, points, alone, columns, gains, R, t, z, H, g)
        alone[i, 0, 0] = 0.0
