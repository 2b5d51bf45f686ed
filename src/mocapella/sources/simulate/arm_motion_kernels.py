"""Compiled kernels of `mocapella.sources.simulate.arm_motion`; importing this module imports numba.

Hands are tapered capsules; a Levenberg–Marquardt search removes the overlaps of fingers within the joint limits.
"""

# ruff: noqa: PLR0915, PLR0917 - compiled: loops are written out
from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.geometry.cholesky_kernels import factorise, substitute
from mocapella.sources.simulate.arm_mesh_kernels import arm_frames

Float64 = NDArray[np.float64]
Integers = NDArray[np.integer[Any]]

_PALM_SPANS = 4
_STEPS = 25
_TRIES = 6
PAIRS = 10 * 9 + 5 * 2 * _PALM_SPANS
"""Number of limb pairs checked: all limbs of different digits, and each digit's outer two with the palm's four."""


class HandGeometry(NamedTuple):
    """The fixed geometry of one hand.

    Attributes:
        digit_frames: (5, 3, 3) of `HandModel.frames`.
        which: (5, 5) indices of the digits' angles, see `mocapella.model.hand.DIGIT_ANGLES`.
        bases, lengths: (5, 3) of `HandShape` [m].
        cones, limits: (5, 5), (21, 2) joint limits of `HandModel` [rad].
        radii: (5, 4) radii of the digits at their joints and tip [m].
        palm_m: half the palm's thickness [m].
    """

    digit_frames: Float64
    which: Integers
    bases: Float64
    lengths: Float64
    cones: Float64
    limits: Float64
    radii: Float64
    palm_m: float


class LimbBuffers(NamedTuple):
    """Workspace that every evaluation of the residuals overwrites.

    Attributes:
        bones, points: (19, 3, 4), (24, 3) of `arm_frames`.
        limbs: (19, 8) of `limbs_of`.
    """

    bones: Float64
    points: Float64
    limbs: Float64


@njit(cache=True, error_model="numpy")
def limbs_apart(limbs: Float64, i: int, j: int) -> float:
    """Return the distance between the rows i and j of ``limbs`` (n, 8) of `limbs_of` [m]; negative if they overlap.

    This is the distance of the axes' nearest points (C. Ericson, *Real-time collision detection*, 2005, section
    5.1.9), minus the radii there.
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
    return float(math.sqrt(total) - mine - limbs[j, 6] - t * (limbs[j, 7] - limbs[j, 6]))


@njit(cache=True)
def limbs_of(points: Float64, radii: Float64, palm_m: float, limbs: Float64) -> None:
    """Compute the hand's limbs: three of each digit, then four of the palm.

    Neighbouring digits merge at their bases, so a digit's first limb begins at 45 % of its bone. Its last limb
    ends before the tip.

    Args:
        points: (24, 3) of `arm_frames` [m].
        radii, palm_m: (5, 4) radii of the digits, and half the palm's thickness [m].
        limbs: (19, 8) written: two ends (3 + 3) and the radii there [m].
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
def overlaps(limbs: Float64, out: Float64) -> None:
    """Write the overlap of each pair of ``limbs`` (19, 8) into ``out`` (`PAIRS`,) [m]; negative if they are apart.

    Limbs that touch at rest are excluded: the thumb's first limb is paired only with the fingers' outer limbs.
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
def limit(angles: Float64, hand: HandGeometry) -> None:
    """Clamp angles (21,) [rad] to the joint limits and, of each digit's base, to its elliptic cone, in place."""
    which, cones, limits = hand.which, hand.cones, hand.limits
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
    hand: HandGeometry, angles: Float64, wished: Float64, touch: Float64, allowed_m: float, buffers: LimbBuffers,
    out: Float64,
) -> float:  # fmt: skip
    """Write the residuals (overlaps, gaps of touching digits, departures from the wish); return the worst overlap."""
    points, limbs, radii = buffers.points, buffers.limbs, hand.radii
    arm_frames(
        hand.digit_frames, hand.which, hand.bases, hand.lengths, 0.3, 0.25, np.zeros(4), angles, buffers.bones, points
    )
    limbs_of(points, radii, hand.palm_m, limbs)
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
        else:  # the nearest of two fingers' outer limbs
            for k in range(4):
                apart = min(apart, limbs_apart(limbs, 3 * a + 1 + k % 2, 3 * b + 1 + k // 2))
        out[n] = touch[i, 2] * apart / 5e-4
        n += 1
    for i in range(len(angles)):
        out[n] = (angles[i] - wished[i]) / 0.15
        n += 1
    return worst


@njit(cache=True)
def squared(r: Float64) -> float:
    """Return the sum of squares of r (n,)."""
    total = 0.0
    for i in range(len(r)):
        total += r[i] * r[i]
    return total


@njit(cache=True)
def _copy(source: Float64, target: Float64) -> None:
    for k in range(len(source)):
        target[k] = source[k]


@njit(cache=True)
def _normal_equations(J: Float64, r: Float64, H: Float64, g: Float64) -> None:
    """Write the gradient g = J r (n,) and the lower half of H = J Jᵀ (n, n) for J (n, m), r (m,)."""
    n, m = J.shape
    for i in range(n):
        g[i] = 0.0
        for k in range(m):
            g[i] += J[i, k] * r[k]
        for j in range(i + 1):
            total = 0.0
            for k in range(m):
                total += J[i, k] * J[j, k]
            H[i, j] = total


@njit(cache=True)
def untangle(
    hand: HandGeometry, wished: Float64, start: Float64, touch: Float64, allowed_m: float, angles: Float64
) -> float:
    """Write the angles (21,) nearest to ``wished`` at which no digit penetrates another; return the worst overlap [m].

    It is negative if all limbs are apart.

    Levenberg–Marquardt on squared overlaps, gaps between touching tips, and departures from the wished angles, within
    the joint limits.

    Args:
        hand: the hand's geometry.
        wished: (21,) wished angles [rad].
        start: (21,) angles at which the search begins [rad].
        touch: (n, 3) indices of two digits that must touch, and a weight, as in `arm_motion.untangled`.
        allowed_m: smaller overlaps are accepted [m].
        angles: (21,) written [rad].
    """
    n, m = len(wished), PAIRS + len(touch) + len(wished)
    buffers = LimbBuffers(np.empty((19, 3, 4)), np.empty((24, 3)), np.empty((19, 8)))
    r, s, J, trial = np.empty(m), np.empty(m), np.empty((n, m)), np.empty(n)
    H, M, g = np.empty((n, n)), np.empty((n, n)), np.empty(n)
    pulled = 0.0
    for i in range(len(touch)):
        pulled += touch[i, 2]
    cost, before, damping, e = -1.0, -1.0, 1e-3, 1e-5
    there = worst = 0.0
    _copy(wished, angles)
    limit(angles, hand)
    # Step -1 tests the wished angles, step 0 the start. Each later step evaluates n derivatives, then trial points.
    step, column, tries = -1, n, 0
    _copy(angles, trial)
    while True:
        there = float(_residuals(hand, trial, wished, touch, allowed_m, buffers, s))
        if column < n:  # a derivative
            for k in range(m):
                J[column, k] = (s[k] - r[k]) / e
            trial[column] = angles[column]
            column += 1
            if column < n:
                trial[column] += e
                continue
            _normal_equations(J, r, H, g)
            tries = 0
        else:  # a trial point
            now = squared(s)
            if step < 0:
                if there <= allowed_m and pulled == 0.0:
                    return there
                step = 0
                _copy(start, trial)
                limit(trial, hand)
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
        factorise(H, damping, M)  # always positive definite: each angle has a residual of its own
        _copy(g, trial)
        substitute(M, trial)
        for i in range(n):
            trial[i] = angles[i] - trial[i]
        limit(trial, hand)
