"""Kernels of the nearest points of two limbs and of the planes that separate them. Importing this imports numba.

Limbs are capsules. A penalty on their penetration depth separates them, as two point-to-plane constraints for each
pair.
"""

# ruff: noqa: PLR0917 - kernels take arrays by position
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

_NEAR_M = 1e-6
"""Distance of axes below which they have no direction of separation [m]."""


@njit(cache=True)
def between(one: Float64, other: Float64, nearest: Float64) -> float:
    """Return the distance of two segments [m], and write their nearest points.

    C. Ericson, *Real-Time Collision Detection* (2005), section 5.1.9.

    Args:
        one, other: (2, 3) end points of each [m].
        nearest: (2, 3) written: the point on ``one``, then on ``other`` [m].
    """
    uu = uv = vv = uw = vw = 0.0
    for d in range(3):
        u, v, w = one[1, d] - one[0, d], other[1, d] - other[0, d], one[0, d] - other[0, d]
        uu += u * u
        uv += u * v
        vv += v * v
        uw += u * w
        vw += v * w
    det = uu * vv - uv * uv
    s = min(max((uv * vw - vv * uw) / det, 0.0), 1.0) if det > 1e-12 * uu * vv else 0.0
    t = min(max((uv * s + vw) / vv, 0.0), 1.0) if vv > 0.0 else 0.0
    s = min(max((uv * t - uw) / uu, 0.0), 1.0) if uu > 0.0 else 0.0
    far = 0.0
    for d in range(3):
        nearest[0, d] = one[0, d] + s * (one[1, d] - one[0, d])
        nearest[1, d] = other[0, d] + t * (other[1, d] - other[0, d])
        far += (nearest[0, d] - nearest[1, d]) ** 2
    return math.sqrt(far)


@njit(cache=True, forceinline=True)
def _beyond(one: Float64, other: Float64, reach: float) -> bool:
    """Return whether two segments (2, 3) are certainly farther apart than ``reach``, from their centres [m]."""
    middles = u = v = 0.0
    for d in range(3):
        middles += (one[0, d] + one[1, d] - other[0, d] - other[1, d]) ** 2
        u += (one[1, d] - one[0, d]) ** 2
        v += (other[1, d] - other[0, d]) ** 2
    return middles > (2.0 * reach + math.sqrt(u) + math.sqrt(v)) ** 2


@njit(cache=True)
def depth(ends: Float64, radii: Float64, pairs: Int64) -> float:
    """Return the sum of the penetration depths of pairs of capsules [m].

    Args:
        ends: (c, 2, 3) end points of the capsules' axes [m].
        radii: (c,) [m].
        pairs: (q, 2) indices of two capsules.
    """
    total, nearest = 0.0, np.empty((2, 3))
    for q in range(len(pairs)):
        i, j = pairs[q, 0], pairs[q, 1]
        reach = radii[i] + radii[j]
        if not _beyond(ends[i], ends[j], reach):
            total += max(reach - between(ends[i], ends[j], nearest), 0.0)
    return total


@njit(cache=True)
def apart(
    ends: Float64, radii: Float64, pairs: Int64, part: Int64, R: Float64, t: Float64, touching: float,
    weight: float, parts: Int64, rest: Float64, planes: Float64, weights: Float64,
) -> int:  # fmt: skip
    """Write two planes for each pair of limbs that overlap by more than ``touching``; return the number of planes.

    Args:
        ends: (c, 2, 3) end points of the capsules' axes in the present pose, world [m].
        radii, pairs, part: (c,), (q, 2), (c,) of `Capsules`.
        R, t: (parts, 9), (parts, 3) the parts' motions from rest: rotations row by row, translations [m].
        touching: allowed penetration [m].
        weight: weight of each plane [1/m²].
        parts, rest, planes, weights: (2 q,) part, (2 q, 3) point at rest [m], (2 q, 4) unit normal and offset in the
            world [m], and (2 q,) weight of each plane [1/m²], written.
    """
    k, nearest = 0, np.empty((2, 3))
    for q in range(len(pairs)):
        i, j = pairs[q, 0], pairs[q, 1]
        far = between(ends[i], ends[j], nearest)
        deep = radii[i] + radii[j] - far - touching
        if not deep > 0.0 or far < _NEAR_M:
            continue
        for side in range(2):
            p, sign = part[i if side == 0 else j], 1.0 if side == 0 else -1.0
            A, o, wanted = R[p], t[p], 0.0
            for d in range(3):
                n = sign * (nearest[0, d] - nearest[1, d]) / far
                planes[k, d] = n
                wanted += n * nearest[side, d]
            planes[k, 3] = wanted + 0.5 * deep
            a, b, c = nearest[side, 0] - o[0], nearest[side, 1] - o[1], nearest[side, 2] - o[2]
            for d in range(3):
                rest[k, d] = A[d] * a + A[3 + d] * b + A[6 + d] * c
            parts[k], weights[k] = p, weight
            k += 1
    return k
