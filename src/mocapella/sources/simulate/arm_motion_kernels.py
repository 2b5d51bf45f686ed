"""The loops of `mocapella.sources.simulate.arm_motion`, compiled; importing this module imports numba."""

# ruff: noqa: PLR0912, PLR0915, PLR0917 - compiled: arrays come by position, and loops are written out
from __future__ import annotations

import math

import numpy as np

from mocapella.compiled import njit
from mocapella.geometry.cholesky_kernels import factorise, substitute
from mocapella.sources.simulate.arm_mesh_kernels import arm_frames

_PALM_SPANS = 4
_STEPS = 25
_TRIES = 6
PAIRS = 10 * 9 + 5 * 2 * _PALM_SPANS
"""Pairs of limbs: three limbs of each digit with those of each other, the outer two of each with the palm's four."""


@njit(cache=True, error_model="numpy")
def limbs_apart(limbs, i, j):
    """Distance between two of the limbs (n, 8), see `limbs_of` [m]; negative where they overlap.

    That of the axes' nearest points (C. Ericson, *Real-time collision detection*, 2005, section 5.1.9), less the radii
    there.
    """
    uu, vv, uv, uw, vw = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        u, v, w = limbs[i, 3 + k] - limbs[i, k], limbs[j, 3 + k] - limbs[j, k], limbs[i, k] - limbs[j, k]
        uu, vv, uv, uw, vw = uu + u * u, vv + v * v, uv + u * v, uw + u * w, vw + v * w
    across = uu * vv - uv * uv
    s = min(max((uv * vw - uw * vv) / across, 0.0), 1.0) if across > 1e-6 * uu * vv else 0.5
    t = (uv * s + vw) / vv
    if t < 0.0:
        t, s = 0.0, min(max(-uw / uu, 0.0), 1.0)
    elif t > 1.0:
        t, s = 1.0, min(max((uv - uw) / uu, 0.0), 1.0)
    total = 0.0
    for k in range(3):
        x = limbs[i, k] + s * (limbs[i, 3 + k] - limbs[i, k]) - limbs[j, k] - t * (limbs[j, 3 + k] - limbs[j, k])
        total += x * x
    mine = limbs[i, 6] + s * (limbs[i, 7] - limbs[i, 6])
    return math.sqrt(total) - mine - limbs[j, 6] - t * (limbs[j, 7] - limbs[j, 6])


@njit(cache=True)
def limbs_of(points, radii, palm_m, limbs):
    """Write the limbs (19, 8), ends and radii there [m]: three of each digit, then the palm's four.

    Neighbouring digits share flesh at their bases, so the first limbs begin at 45 % of their bone. The last limb's end
    is before the tip.

    Args:
        points: (24, 3) of `arm_frames`; radii: (5, 4) of the digits at joints and tip; palm_m: half the palm's
            thickness.
    """
    for d in range(5):
        for bone in range(3):
            i, p = 3 * d + bone, 1 + 4 * d + bone
            length = 0.0
            for k in range(3):
                length += (points[p + 1, k] - points[p, k]) ** 2
            begin, end = 0.45 if bone == 0 else 0.0, 1.0 - (0.4 * radii[d, 3] / math.sqrt(length) if bone == 2 else 0.0)
            for k in range(3):
                along = points[p + 1, k] - points[p, k]
                limbs[i, k], limbs[i, 3 + k] = points[p, k] + begin * along, points[p, k] + end * along
            limbs[i, 6], limbs[i, 7] = radii[d, bone], radii[d, bone + 1]
    for e in range(_PALM_SPANS):
        for k in range(3):
            along = points[5 + 4 * e, k] - points[0, k]
            limbs[15 + e, k], limbs[15 + e, 3 + k] = points[0, k] + 0.2 * along, points[0, k] + 0.9 * along
        limbs[15 + e, 6] = limbs[15 + e, 7] = palm_m


@njit(cache=True)
def overlaps(limbs, out):
    """Write how far fingers are inside each other and inside the palm (`PAIRS`,) [m]; negative where they are apart.

    What belongs together at rest is no pair: the thumb's first limb meets only the fingers' outer limbs.
    """
    n = 0
    for d in range(5):
        for e in range(d + 1, 5):
            for i in range(3):
                for j in range(3):
                    out[n] = -limbs_apart(limbs, 3 * d + i, 3 * e + j) if d or i or j else -1.0
                    n += 1
    for d in range(5):
        for i in range(1, 3):
            for e in range(_PALM_SPANS):
                out[n] = -limbs_apart(limbs, 3 * d + i, 15 + e)
                n += 1


@njit(cache=True)
def limit(angles, which, cones, limits):
    """Bring angles (21,) within the limits, in place, as `HandModel.limited` does."""
    for i in range(len(angles)):
        angles[i] = min(max(angles[i], limits[i, 0]), limits[i, 1])
    for d in range(5):
        f0, a0, F, A = cones[d, 0], cones[d, 1], cones[d, 2], cones[d, 3]
        f, a = angles[which[d, 0]] - f0, angles[which[d, 1]] - a0
        s = math.hypot(f / F, a / A if A > 0.0 else 0.0)
        if s > 1.0:
            angles[which[d, 0]], angles[which[d, 1]] = f0 + f / s, a0 + a / s


@njit(cache=True)
def _residuals(
    angles, wished, digit_frames, which, bases, lengths, radii, palm_m, touch, allowed_m, bones, points, limbs, out
):
    """Write what is squared: overlaps, distances of what shall touch, departures from what is wished; worst overlap."""
    arm_frames(digit_frames, which, bases, lengths, 0.3, 0.25, np.zeros(4), angles, bones, points)
    limbs_of(points, radii, palm_m, limbs)
    overlaps(limbs, out)
    worst = -1.0
    for i in range(PAIRS):
        worst = max(worst, out[i])
        out[i] = max(out[i] - allowed_m, 0.0) / 2e-4
    n = PAIRS
    for i in range(len(touch)):
        a, b = int(touch[i, 0]), int(touch[i, 1])
        apart = 1.0
        if a == 0:  # the thumb's tip and another's
            total = 0.0
            for k in range(3):
                total += (points[4 + 4 * a, k] - points[4 + 4 * b, k]) ** 2
            apart = math.sqrt(total) - radii[a, 3] - radii[b, 3]
        else:  # two fingers' outer two limbs, wherever they are nearest
            for k in range(4):
                apart = min(apart, limbs_apart(limbs, 3 * a + 1 + k % 2, 3 * b + 1 + k // 2))
        out[n] = touch[i, 2] * apart / 5e-4
        n += 1
    for i in range(len(angles)):
        out[n] = (angles[i] - wished[i]) / 0.15
        n += 1
    return worst


@njit(cache=True)
def squared(r):
    """The sum of squares."""
    total = 0.0
    for i in range(len(r)):
        total += r[i] * r[i]
    return total


@njit(cache=True)
def _copy(one, other):
    for k in range(len(one)):
        other[k] = one[k]


@njit(cache=True)
def untangle(
    wished, start, digit_frames, which, bases, lengths, cones, limits, radii, palm_m, touch, allowed_m, angles
):  # fmt: skip
    """Write the angles (21,) nearest to those wished at which no finger is in another or in the palm; worst overlap.

    Levenberg and Marquardt's method on squared overlaps, tips that shall touch, and departures from what is wished,
    within the hand's limits.

    Args:
        start: (21,) where the search begins.
        radii: (5, 4); palm_m: see `limbs_of`.
        touch: (n, 3) two digits that shall touch, the thumb first and with its tip, and how much, 0 to 1.
        allowed_m: overlaps that small are left.
    """
    n, m = len(wished), PAIRS + len(touch) + len(wished)
    bones, points, limbs = np.empty((19, 3, 4)), np.empty((24, 3)), np.empty((19, 8))
    r, s, J, trial = np.empty(m), np.empty(m), np.empty((n, m)), np.empty(n)
    H, M, g = np.empty((n, n)), np.empty((n, n)), np.empty(n)
    pulled = 0.0
    for i in range(len(touch)):
        pulled += touch[i, 2]
    cost, before, damping, e, worst = -1.0, -1.0, 1e-3, 1e-5, 0.0
    _copy(wished, angles)
    limit(angles, which, cones, limits)
    # Step -1 looks whether all is well as wished, step 0 at the start; one after the other each derivative and step.
    step, column, tries = -1, n, 0
    _copy(angles, trial)
    while True:
        there = _residuals(
            trial, wished, digit_frames, which, bases, lengths, radii, palm_m, touch, allowed_m, bones, points, limbs, s
        )
        if column < n:  # a derivative
            for k in range(m):
                J[column, k] = (s[k] - r[k]) / e
            trial[column] = angles[column]
            column += 1
            if column < n:
                trial[column] += e
                continue
            for i in range(n):
                g[i] = 0.0
                for k in range(m):
                    g[i] += J[i, k] * r[k]
                for j in range(i + 1):
                    total = 0.0
                    for k in range(m):
                        total += J[i, k] * J[j, k]
                    H[i, j] = total
            tries = 0
        else:  # a point
            now = squared(s)
            if step < 0:
                if there <= allowed_m and pulled == 0.0:
                    return there
                step = 0
                _copy(start, trial)
                limit(trial, which, cones, limits)
                continue
            if step == 0 or now < cost:
                gained, before = cost - now, cost
                _copy(trial, angles)
                _copy(s, r)
                cost, worst = now, there
                damping = max(damping * 0.2, 1e-6)
                if step == _STEPS or (step > 0 and gained < 1e-3 * before + 1e-9):
                    return worst
                step += 1
                column = 0
                _copy(angles, trial)
                trial[0] += e
                continue
            damping *= 8.0
            tries += 1
            if tries == _TRIES:
                return worst
        factorise(H, damping, M)  # each angle is wished for, too: there is always one
        _copy(g, trial)
        substitute(M, trial)
        for i in range(n):
            trial[i] = angles[i] - trial[i]
        limit(trial, which, cones, limits)
