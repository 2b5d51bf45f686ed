"""The loops of `mocapella.sources.simulate.arm_motion`, compiled; importing this module imports numba."""

# ruff: noqa: E501, PLR0912, PLR0917 - compiled: arrays come by position, and loops are written out
from __future__ import annotations

import math

import numpy as np

from mocapella.compiled import njit
from mocapella.sources.simulate.arm_mesh_kernels import arm_frames

_PALM_SPANS = 4
PAIRS = 10 * 9 + 5 * 2 * _PALM_SPANS
"""Pairs of limbs: three limbs of each digit with those of each other, the outer two of each with the palm's four."""


@njit(cache=True)
def limbs_apart(a, b, ra0, ra1, c, d, rc0, rc1):
    """Distance between two tapered limbs from a to b and from c to d [m]; negative where they overlap.

    That of the axes' nearest points (C. Ericson, *Real-time collision detection*, 2005, section 5.1.9), less the radii
    there.
    """
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = d[0] - c[0], d[1] - c[1], d[2] - c[2]
    wx, wy, wz = a[0] - c[0], a[1] - c[1], a[2] - c[2]
    uu, vv, uv = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, ux * vx + uy * vy + uz * vz
    uw, vw = ux * wx + uy * wy + uz * wz, vx * wx + vy * wy + vz * wz
    across = uu * vv - uv * uv
    s = min(max((uv * vw - uw * vv) / across, 0.0), 1.0) if across > 1e-6 * uu * vv else 0.5
    t = (uv * s + vw) / vv
    if t < 0.0:
        t, s = 0.0, min(max(-uw / uu, 0.0), 1.0)
    elif t > 1.0:
        t, s = 1.0, min(max((uv - uw) / uu, 0.0), 1.0)
    x, y, z = wx + s * ux - t * vx, wy + s * uy - t * vy, wz + s * uz - t * vz
    return math.sqrt(x * x + y * y + z * z) - ra0 - s * (ra1 - ra0) - rc0 - t * (rc1 - rc0)


@njit(cache=True)
def overlaps(points, radii, palm_m, ends, out):
    """Write how far fingers are inside each other and inside the palm [m]; negative where they are apart.

    Neighbouring digits share flesh at their bases, so the first limbs begin there at 45 % of their bone; and what
    belongs together at rest is no pair: the thumb's first limb meets only the fingers' outer limbs.

    Args:
        points: (24, 3) of `arm_frames`; radii: (5, 4) of the digits at joints and tip; palm_m: half the palm's
            thickness.
        ends: (16, 6) scratch.
        out: (`PAIRS`,).
    """
    for d in range(5):
        for bone in range(3):
            i = 3 * d + bone
            p, q = points[1 + 4 * d + bone], points[2 + 4 * d + bone]
            for k in range(3):
                ends[i, k], ends[i, 3 + k] = p[k], q[k]
                if bone == 0:
                    ends[i, k] += 0.45 * (q[k] - p[k])
            if bone == 2:  # the last limb's end is before the tip
                length = math.sqrt((q[0] - p[0]) ** 2 + (q[1] - p[1]) ** 2 + (q[2] - p[2]) ** 2)
                for k in range(3):
                    ends[i, 3 + k] -= 0.4 * radii[d, 3] * (q[k] - p[k]) / length
    n = 0
    for d in range(5):
        for e in range(d + 1, 5):
            for i in range(3):
                for j in range(3):
                    a, b = ends[3 * d + i], ends[3 * e + j]
                    if d == 0 and i == 0 and j == 0:
                        out[n] = -1.0
                    else:
                        out[n] = -limbs_apart(
                            a[:3], a[3:], radii[d, i], radii[d, i + 1], b[:3], b[3:], radii[e, j], radii[e, j + 1]
                        )
                    n += 1
    span = ends[15]
    for d in range(5):
        for i in range(1, 3):
            for e in range(_PALM_SPANS):
                a, wrist, base = ends[3 * d + i], points[0], points[5 + 4 * e]
                for k in range(3):
                    span[k] = 0.8 * wrist[k] + 0.2 * base[k]
                    span[3 + k] = 0.1 * wrist[k] + 0.9 * base[k]
                out[n] = -limbs_apart(a[:3], a[3:], radii[d, i], radii[d, i + 1], span[:3], span[3:], palm_m, palm_m)
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
    angles,
    wished,
    digit_frames,
    which,
    bases,
    lengths,
    radii,
    palm_m,
    touch,
    allowed_m,
    bones,
    points,
    ends,
    o,
    joints,
    out,
):
    arm_frames(digit_frames, which, bases, lengths, 0.3, 0.25, joints, angles, bones, points)
    overlaps(points, radii, palm_m, ends, o)
    for i in range(len(o)):
        out[i] = max(o[i] - allowed_m, 0.0) / 2e-4
    n = len(o)
    for i in range(len(touch)):
        a, b = int(touch[i, 0]), int(touch[i, 1])
        if a == 0:  # the thumb's tip and another's
            p, q = points[4 + 4 * a], points[4 + 4 * b]
            apart = math.sqrt((p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2)
            apart -= radii[a, 3] + radii[b, 3]
        else:  # two fingers' outer two limbs, wherever they are nearest
            apart = 1.0
            for k in range(1, 3):
                for m in range(1, 3):
                    p, q = ends[3 * a + k], ends[3 * b + m]
                    apart = min(
                        apart,
                        limbs_apart(
                            p[:3], p[3:], radii[a, k], radii[a, k + 1], q[:3], q[3:], radii[b, m], radii[b, m + 1]
                        ),
                    )
        out[n] = touch[i, 2] * apart / 5e-4
        n += 1
    for i in range(len(angles)):
        out[n] = (angles[i] - wished[i]) / 0.15
        n += 1


@njit(cache=True)
def squared(r):
    """The sum of squares."""
    total = 0.0
    for i in range(len(r)):
        total += r[i] * r[i]
    return total


@njit(cache=True)
def solve(H, more, g, M, x):
    """Write the solution of (H, its diagonal times ``more``) x = g by Cholesky's factor M; H's lower half counts."""
    n = len(g)
    for i in range(n):
        x[i] = g[i]
        for k in range(i + 1):
            total = H[i, k] * more if i == k else H[i, k]
            for j in range(k):
                total -= M[i, j] * M[k, j]
            M[i, k] = math.sqrt(total) if i == k else total / M[k, k]
        for j in range(i):
            x[i] -= M[i, j] * x[j]
        x[i] /= M[i, i]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            x[i] -= M[j, i] * x[j]
        x[i] /= M[i, i]


@njit(cache=True)
def untangle(
    wished, start, digit_frames, which, bases, lengths, cones, limits, radii, palm_m, touch, allowed_m, angles
):  # fmt: skip
    """Write the angles (21,) nearest to those wished at which no finger is in another or in the palm; worst overlap.

    Levenberg and Marquardt's method on squared overlaps, tips that shall touch, and departures from what is wished,
    within the hand's limits.

    Args:
        start: (21,) where the search begins.
        radii: (5, 4); palm_m: see `overlaps`.
        touch: (n, 3) two digits that shall touch, the thumb first and with its tip, and how much, 0 to 1.
        allowed_m: overlaps that small are left.
    """
    n, m = len(wished), PAIRS + len(touch) + len(wished)
    bones, points, ends, o = np.empty((19, 3, 4)), np.empty((24, 3)), np.empty((16, 6)), np.empty(PAIRS)
    joints, r, s = np.zeros(4), np.empty(m), np.empty(m)
    J, trial = np.empty((n, m)), np.empty(n)
    angles[:] = wished
    limit(angles, which, cones, limits)
    _residuals(
        angles,
        wished,
        digit_frames,
        which,
        bases,
        lengths,
        radii,
        palm_m,
        touch,
        allowed_m,
        bones,
        points,
        ends,
        o,
        joints,
        r,
    )
    pulled = False
    for i in range(len(touch)):
        pulled = pulled or touch[i, 2] > 0.0
    if o.max() <= allowed_m and not pulled:
        return o.max()
    angles[:] = start
    limit(angles, which, cones, limits)
    _residuals(
        angles,
        wished,
        digit_frames,
        which,
        bases,
        lengths,
        radii,
        palm_m,
        touch,
        allowed_m,
        bones,
        points,
        ends,
        o,
        joints,
        r,
    )
    cost, damping, e = squared(r), 1e-3, 1e-5
    H, M, g = np.empty((n, n)), np.empty((n, n)), np.empty(n)
    for _ in range(25):
        for i in range(n):
            trial[:] = angles
            trial[i] += e
            _residuals(
                trial, wished, digit_frames, which, bases, lengths, radii, palm_m, touch, allowed_m, bones, points, ends, o,
                joints, s,
            )  # fmt: skip
            for k in range(m):
                J[i, k] = (s[k] - r[k]) / e
        for i in range(n):
            g[i] = 0.0
            for k in range(m):
                g[i] += J[i, k] * r[k]
            for j in range(i + 1):
                total = 0.0
                for k in range(m):
                    total += J[i, k] * J[j, k]
                H[i, j] = total
        better = False
        for _ in range(6):
            solve(H, 1.0 + damping, g, M, trial)
            for i in range(n):
                trial[i] = angles[i] - trial[i]
            limit(trial, which, cones, limits)
            _residuals(
                trial, wished, digit_frames, which, bases, lengths, radii, palm_m, touch, allowed_m, bones, points, ends, o,
                joints, s,
            )  # fmt: skip
            there = squared(s)
            if there < cost:
                better = True
                break
            damping *= 8.0
        if not better:
            break
        gained = cost - there
        angles[:], r[:], cost = trial, s, there
        damping = max(damping * 0.2, 1e-6)
        if gained < 1e-3 * cost + 1e-9:
            break
    arm_frames(digit_frames, which, bases, lengths, 0.3, 0.25, joints, angles, bones, points)
    overlaps(points, radii, palm_m, ends, o)
    return o.max()
