"""Kernels of one digit's inverse kinematics: closed form, and search for the nearest posture within the limits.

A digit is solved in the frame of its first joint, where its tip at flexion f, abduction a, flexion m of the second and
b of the third joint is (u·sin a, −w, u·cos a) with

    u = l₁·cos f + l₂·cos(f + m) + l₃·cos(f + m + b),   w likewise with sines:

a plane chain in a plane that turns about y. Importing this module imports numba. `mocapella.kinematics.hand_solvers`
makes the rows of numbers.
"""

# ruff: noqa: PLR0912, PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.geometry.cholesky_kernels import factorise, substitute

Int64 = NDArray[np.int64]
Float64 = NDArray[np.float64]

Bool = NDArray[np.bool_]

# Indices in a digit's row of numbers.
L1, L2, L3 = 0, 1, 2
BASE = 3  # (3,) in the palm's frame
FRAME = 6  # (9,) R_palm_digit, row by row
F0, A0, FX, AX, FMIN = 15, 16, 17, 18, 19  # centre and half axes of the cone, least flexion [rad]
PHI_MIN, PHI_MAX = 20, 21  # of the direction in the cone
M_MAX, B_MAX = 22, 23  # [rad]; least is 0
RATIO, COUPLED = 24, 25  # of the third flexion to the second; whether it is held to it
POLY = 26  # (8,) squared distance of the tip as a polynomial of cos(m/3)
NATURAL = 34  # (4,) f, a, m, b at rest [rad]
DIGIT = 38

_TOLERANCE = 1e-9
_B_STEPS = 24
_NEWTON = 40
STARTS = 5
_DIRECTIONS = 8


@njit(cache=True)
def to_digit(row: Float64, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Transform a point (x, y, z) from the palm's frame to a digit's frame [m]; row is (`DIGIT`,) its parameters.

    The digit's frame has its origin at the first joint, z along the straight bone, and −y towards flexion.
    """
    x, y, z = x - row[BASE], y - row[BASE + 1], z - row[BASE + 2]
    return (
        row[FRAME] * x + row[FRAME + 3] * y + row[FRAME + 6] * z,
        row[FRAME + 1] * x + row[FRAME + 4] * y + row[FRAME + 7] * z,
        row[FRAME + 2] * x + row[FRAME + 5] * y + row[FRAME + 8] * z,
    )


@njit(cache=True)
def tip(row: Float64, f: float, a: float, m: float, b: float) -> tuple[float, float, float]:
    """Compute a digit's tip in the digit's frame [m], by forward kinematics.

    Args:
        row: (`DIGIT`,) the digit's parameters.
        f, a: flexion and abduction of the first joint [rad].
        m, b: flexion of the second and third joint [rad].
    """
    u = row[L1] * math.cos(f) + row[L2] * math.cos(f + m) + row[L3] * math.cos(f + m + b)
    w = row[L1] * math.sin(f) + row[L2] * math.sin(f + m) + row[L3] * math.sin(f + m + b)
    return u * math.sin(a), -w, u * math.cos(a)


@njit(cache=True)
def missed(row: Float64, x: float, y: float, z: float, f: float, a: float, m: float, b: float) -> float:
    """Return the error of the inverse kinematics: the distance of a digit's tip from its target, at given angles [m].

    Args:
        row: (`DIGIT`,) the digit's parameters.
        x, y, z: the point in the digit's frame [m].
        f, a: flexion and abduction of the first joint [rad].
        m, b: flexion of the second and third joint [rad].
    """
    tx, ty, tz = tip(row, f, a, m, b)
    return math.sqrt((tx - x) ** 2 + (ty - y) ** 2 + (tz - z) ** 2)


@njit(cache=True)
def in_cone(row: Float64, f: float, a: float) -> bool:
    """Return whether flexion and abduction are within the elliptic cone of a digit's limits, to a rounding error.

    Args:
        row: (`DIGIT`,) the digit's parameters.
        f, a: flexion and abduction of the first joint [rad].
    """
    if f < row[FMIN] - _TOLERANCE:
        return False
    s = ((f - row[F0]) / row[FX]) ** 2
    if row[AX] > 0.0:
        s += ((a - row[A0]) / row[AX]) ** 2
    elif abs(a - row[A0]) > 1e-7:
        return False
    return bool(s <= 1.0 + _TOLERANCE)


@njit(cache=True)
def limit(row: Float64, f: float, a: float, m: float, b: float, out: Float64) -> None:
    """Clamp a digit's angles to its limits.

    Args:
        row: (`DIGIT`,) the digit's parameters.
        f, a: flexion and abduction of the first joint [rad].
        m, b: flexion of the second and third joint [rad].
        out: (4,) written: the clamped angles, in the same order.
    """
    f, a = max(f, row[FMIN]), a - row[A0]
    f -= row[F0]
    if row[AX] > 0.0:
        s = math.sqrt((f / row[FX]) ** 2 + (a / row[AX]) ** 2)
    else:
        s, a = abs(f) / row[FX], 0.0
    s = max(s, 1.0)
    out[0], out[1] = row[F0] + f / s, row[A0] + a / s
    out[2] = min(max(m, 0.0), row[M_MAX])
    out[3] = row[RATIO] * out[2] if row[COUPLED] > 0.0 else min(max(b, 0.0), row[B_MAX])


@njit(cache=True)
def wrapped(angle: float) -> float:
    """Wrap an angle to ±π [rad]."""
    if angle > math.pi:
        return angle - 2.0 * math.pi
    if angle < -math.pi:
        return angle + 2.0 * math.pi
    return angle


@njit(cache=True)
def _second_flexion(row: Float64, squared: float) -> float:
    """Return the flexion of the second joint at which a coupled digit's tip has a squared distance; NaN if none.

    The squared distance is a polynomial of c = cos(m/3), convex and rising between the limits: Newton's method from
    the chord overshoots once and then falls onto the root.
    """
    low, high, c_min = 0.0, 0.0, math.cos(row[M_MAX] / 3.0)
    for k in range(7, -1, -1):
        low, high = low * c_min + row[POLY + k], high + row[POLY + k]
    slack = 1e-9 * high
    if not (low - slack <= squared <= high + slack):
        return math.nan
    c = c_min + (1.0 - c_min) * (squared - low) / (high - low)
    for _ in range(12):
        value, slope = row[POLY + 7], 0.0
        for k in range(6, -1, -1):
            slope = slope * c + value
            value = value * c + row[POLY + k]
        step = (value - squared) / slope
        c -= step
        if abs(step) < 1e-14:
            break
    return 3.0 * math.acos(min(max(c, c_min), 1.0))


@njit(cache=True)
def closed_form(row: Float64, x: float, y: float, z: float, out: Float64) -> bool:
    """Compute the angles within the limits that put the tip at a point, if there are any.

    A digit that cannot abduct reaches for the point's projection on its plane. The digit bends in the plane through y
    and the point, and the third joint follows the second. If this violates a limit and the third joint is free, that
    joint takes the flexion nearest to the coupled one that keeps the limits.

    Args:
        row: (`DIGIT`,) the digit's parameters.
        x, y, z: the point in the digit's frame [m].
        out: (4,) written: flexion f and abduction a of the first joint, flexions m and b of the others [rad].

    Returns:
        Whether such angles exist.
    """
    r, w = math.hypot(x, z), -y
    if row[AX] == 0.0:  # projection on the digit's plane
        r = x * math.sin(row[A0]) + z * math.cos(row[A0])
    squared = r * r + w * w
    followed = _second_flexion(row, squared)
    for side in range(2):
        u, a = (r, math.atan2(x, z)) if side == 0 else (-r, math.atan2(-x, -z))
        if row[AX] == 0.0:
            if side == 1:
                break
            a = row[A0]
        elif abs(a - row[A0]) > row[AX] * (1.0 + _TOLERANCE):
            continue
        direction = math.atan2(w, u)
        if not math.isnan(followed):
            m, b = followed, row[RATIO] * followed
            ahead = row[L1] + row[L2] * math.cos(m) + row[L3] * math.cos(m + b)
            down = row[L2] * math.sin(m) + row[L3] * math.sin(m + b)
            f = wrapped(direction - math.atan2(down, ahead))
            if in_cone(row, f, a):
                out[0], out[1], out[2], out[3] = f, a, m, b
                return True
        if row[COUPLED] > 0.0:
            continue
        best = math.inf
        for k in range(_B_STEPS + 1):
            b = row[B_MAX] * k / _B_STEPS
            far = math.sqrt(row[L2] ** 2 + row[L3] ** 2 + 2.0 * row[L2] * row[L3] * math.cos(b))
            cosine = (squared - row[L1] ** 2 - far * far) / (2.0 * row[L1] * far)
            if not -1.0 <= cosine <= 1.0:
                continue
            bend = math.acos(cosine)
            m = bend - math.atan2(row[L3] * math.sin(b), row[L2] + row[L3] * math.cos(b))
            if not 0.0 <= m <= row[M_MAX] or abs(b - row[RATIO] * m) >= best:
                continue
            f = wrapped(direction - math.atan2(far * math.sin(bend), row[L1] + far * cosine))
            if in_cone(row, f, a):
                best = abs(b - row[RATIO] * m)
                out[0], out[1], out[2], out[3] = f, a, m, b
        if best < math.inf:
            return True
    return False


@njit(cache=True)
def _energy(row: Float64, x: float, y: float, z: float, v: Float64) -> float:
    """Return half the squared distance of the tip from a point, at v = (s, φ, m, b) of `_derivatives`."""
    f = row[F0] + row[FX] * v[0] * math.sin(v[1])
    a = row[A0] + row[AX] * v[0] * math.cos(v[1])
    b = row[RATIO] * v[2] if row[COUPLED] > 0.0 else v[3]
    tx, ty, tz = tip(row, f, a, v[2], b)
    return float(0.5 * ((tx - x) ** 2 + (ty - y) ** 2 + (tz - z) ** 2))


@njit(cache=True)
def _derivatives(row: Float64, x: float, y: float, z: float, v: Float64, g: Float64, H: Float64) -> None:
    """Write gradient (4,) and Hessian (4, 4) of `_energy`.

    The cone is f = f₀ + F·s·sin φ, a = a₀ + A·s·cos φ with s ≤ 1, so that all limits are bounds of single variables.
    """
    sine, cosine, s = math.sin(v[1]), math.cos(v[1]), v[0]
    F, A = row[FX], row[AX]
    f, a, m = row[F0] + F * s * sine, row[A0] + A * s * cosine, v[2]
    coupled = row[COUPLED] > 0.0
    ratio = row[RATIO]
    b = ratio * m if coupled else v[3]
    u3, w3 = row[L3] * math.cos(f + m + b), row[L3] * math.sin(f + m + b)
    u2, w2 = u3 + row[L2] * math.cos(f + m), w3 + row[L2] * math.sin(f + m)
    u1, w1 = u2 + row[L1] * math.cos(f), w2 + row[L1] * math.sin(f)
    q, turned = x * math.sin(a) + z * math.cos(a), x * math.cos(a) - z * math.sin(a)
    du, dw = u1 - q, w1 + y
    # By f, m and b: the first derivatives of (u, w) are (−w, u) of what the joint moves, the second −(u, w) of what
    # the outer of both joints moves.
    gf, gm, gb = -du * w1 + dw * u1, -du * w2 + dw * u2, -du * w3 + dw * u3
    ff = w1 * w1 + u1 * u1 - du * u1 - dw * w1
    fm = w1 * w2 + u1 * u2 - du * u2 - dw * w2
    fb = w1 * w3 + u1 * u3 - du * u3 - dw * w3
    mm = w2 * w2 + u2 * u2 - du * u2 - dw * w2
    mb = w2 * w3 + u2 * u3 - du * u3 - dw * w3
    bb = w3 * w3 + u3 * u3 - du * u3 - dw * w3
    ga, aa = -u1 * turned, u1 * q
    af, am, ab = w1 * turned, w2 * turned, w3 * turned
    if coupled:
        mm += 2.0 * ratio * mb + ratio * ratio * bb
        gm, fm, am = gm + ratio * gb, fm + ratio * fb, am + ratio * ab
    fs, fp, as_, ap = F * sine, F * s * cosine, A * cosine, -A * s * sine
    g[0], g[1], g[2], g[3] = gf * fs + ga * as_, gf * fp + ga * ap, gm, gb
    H[0, 0] = ff * fs * fs + 2.0 * af * fs * as_ + aa * as_ * as_
    H[1, 1] = ff * fp * fp + 2.0 * af * fp * ap + aa * ap * ap - gf * F * s * sine - ga * A * s * cosine
    H[0, 1] = ff * fs * fp + af * (fs * ap + fp * as_) + aa * as_ * ap + gf * F * cosine - ga * A * sine
    H[0, 2], H[1, 2], H[2, 2] = fm * fs + am * as_, fm * fp + am * ap, mm
    H[0, 3], H[1, 3], H[2, 3], H[3, 3] = fb * fs + ab * as_, fb * fp + ab * ap, mb, bb
    for i in range(4):
        for k in range(i):
            H[i, k] = H[k, i]


@njit(cache=True)
def descend(
    row: Float64, x: float, y: float, z: float, v: Float64, low: Float64, high: Float64, work: Float64, most: int,
    enough: float,
) -> tuple[float, int]:  # fmt: skip
    """Descend to a local minimum within bounds, by Newton steps with exact second derivatives, damped where they rise.

    Args:
        row: (`DIGIT`,) the digit's parameters.
        x, y, z: target of the tip, in the digit's frame [m].
        v: (4,) s, φ, m, b of `_derivatives`; the start, overwritten with the result.
        low, high: (4,) bounds of v.
        work: (11 or more, 4) workspace.
        most: largest number of steps.
        enough: energy at which the descent stops [m²].

    Returns:
        Half the squared distance of the tip from the target [m²], and the number of steps.
    """
    g, H, M, d, t = work[0], work[1:5], work[5:9], work[9], work[10]
    n = 3 if row[COUPLED] > 0.0 else 4
    value, damping = _energy(row, x, y, z, v), 1e-9
    steps = 0
    while steps < most and value > enough:
        _derivatives(row, x, y, z, v, g, H)
        slope, t[3] = 0.0, 0.0
        for i in range(n):
            free = not ((v[i] <= low[i] and g[i] > 0.0) or (v[i] >= high[i] and g[i] < 0.0))
            t[i] = 1.0 if free else 0.0
            slope += t[i] * abs(g[i])
        if slope < 1e-13:
            break
        fell = False
        for _ in range(12):
            for i in range(4):  # a row that is not free is that of the identity
                d[i] = -g[i] * t[i] if i < n else 0.0
                for k in range(i):
                    M[i, k] = H[i, k] * t[i] * t[k] if i < n else 0.0
                M[i, i] = H[i, i] + damping * (abs(H[i, i]) + 1e-5) + 1e-15 if t[i] > 0.0 else 1.0
            if factorise(M, 0.0, M):
                substitute(M, d)
                for i in range(n):
                    d[i] = min(max(v[i] + d[i], low[i]), high[i])
                there = _energy(row, x, y, z, d)
                if there < value:
                    fell = True
                    break
            damping = max(10.0 * damping, 1e-3)
        if not fell:
            break
        steps += 1
        gained, value = value - there, there
        damping *= 0.1
        for i in range(n):
            v[i] = d[i]
        if gained < 1e-12 * value + 1e-18:
            break
    return float(value), steps


@njit(cache=True)
def bounds(row: Float64, low: Float64, high: Float64) -> None:
    """Write the bounds (4,) of s, φ, m and b of `descend`: the cone is a disc of directions, or half of one."""
    low[0], low[1], low[2], low[3] = 0.0, row[PHI_MIN], 0.0, 0.0
    high[0], high[1], high[2], high[3] = 1.0, row[PHI_MAX], row[M_MAX], row[B_MAX]
    if row[FMIN] < row[F0]:
        low[0] = -1.0


@njit(cache=True)
def limited_search(row: Float64, x: float, y: float, z: float, out: Float64, work: Float64) -> None:
    """Compute the angles within the limits whose tip is nearest to a point.

    Newton's method starts from the best points of a coarse grid, one for each direction in the cone of the first joint
    (or, for a digit that cannot abduct, for each flexion of the second joint).

    Args:
        row: (`DIGIT`,) the digit's parameters.
        x, y, z: the point in the digit's frame [m].
        out: (4,) written: flexion f and abduction a of the first joint, flexions m and b of the others [rad].
        work: (25, 4) workspace.
    """
    low, high, v, best, starts, values = work[11], work[12], work[13], work[14], work[15:23], work[23:25].reshape(8)
    bounds(row, low, high)
    for k in range(_DIRECTIONS):
        values[k] = math.inf
    bends = 3 if row[COUPLED] == 0.0 else 1
    whole = row[FMIN] < row[F0]
    directions = 1 if row[AX] == 0.0 else (_DIRECTIONS if whole else 5)
    for k in range(4):
        m = row[M_MAX] * (0.05 + 0.3 * k)
        for j in range(bends):
            b = row[B_MAX] * (0.1 + 0.4 * j) if bends > 1 else row[RATIO] * m
            ahead = row[L1] + row[L2] * math.cos(m) + row[L3] * math.cos(m + b)
            down = row[L2] * math.sin(m) + row[L3] * math.sin(m + b)
            for i in range(directions):
                phi = 0.25 * math.pi * i - (math.pi if whole else 0.0) if directions > 1 else 0.5 * math.pi
                sine, cosine = math.sin(phi), math.cos(phi)
                for n in range(3):
                    s = 0.15 + 0.425 * n
                    f, a = row[F0] + row[FX] * s * sine, row[A0] + row[AX] * s * cosine
                    u, w = ahead * math.cos(f) - down * math.sin(f), ahead * math.sin(f) + down * math.cos(f)
                    value = (u * math.sin(a) - x) ** 2 + (w + y) ** 2 + (u * math.cos(a) - z) ** 2
                    c = i if directions > 1 else k
                    if value < values[c]:
                        values[c] = value
                        starts[c, 0], starts[c, 1], starts[c, 2], starts[c, 3] = s, phi, m, b
    least = math.inf
    for _ in range(STARTS):
        nearest = 0
        for i in range(1, _DIRECTIONS):
            if values[i] < values[nearest]:
                nearest = i
        values[nearest] = math.inf
        for c in range(4):
            v[c] = starts[nearest, c]
        for _ in range(2):
            value, _steps = descend(row, x, y, z, v, low, high, work, _NEWTON, 0.0)
            if value < least:
                least = value
                for c in range(4):
                    best[c] = v[c]
            if whole or v[0] > 1e-6:
                break
            v[0], v[1] = 0.05, math.pi - v[1]  # at the apex φ has no gradient
    f = row[F0] + row[FX] * best[0] * math.sin(best[1])
    a = row[A0] + row[AX] * best[0] * math.cos(best[1])
    limit(row, f, a, best[2], best[3], out)


@njit(cache=True)
def hand_closed_form(digits: Float64, targets: Float64, angles: Float64, errors: Float64, reached: Bool) -> None:
    """Solve the angles of five digits for targets of their tips.

    Args:
        digits: (5, `DIGIT`) the digits' parameters.
        targets: (5, 3) in the palm's frame of a right hand [m]; a digit without a finite target keeps its angles,
            within limits.
        angles: (5, 4) flexion f and abduction a of each digit's first joint, flexions m and b of the others [rad], in
            and out.
        errors: (5,) written: remaining distances of the tips [m]; NaN without a target.
        reached: (5,) written: whether the closed form solved the digit within its limits; False without a target.
    """
    work = np.empty((25, 4))
    for i in range(5):
        row, out = digits[i], angles[i]
        x, y, z = to_digit(row, targets[i, 0], targets[i, 1], targets[i, 2])
        reached[i] = False
        if not (abs(x) < 1e3 and abs(y) < 1e3 and abs(z) < 1e3):
            errors[i] = math.nan
            for k in range(4):
                if not abs(out[k]) < 1e3:
                    out[k] = row[NATURAL + k]
            limit(row, out[0], out[1], out[2], out[3], out)
            continue
        if closed_form(row, x, y, z, out):
            reached[i] = True
            limit(row, out[0], out[1], out[2], out[3], out)
        else:
            limited_search(row, x, y, z, out, work)
        errors[i] = missed(row, x, y, z, out[0], out[1], out[2], out[3])
