"""Polygons on the floor: points inside, area, and whether an outline crosses itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]


def inside(corners: Float64, points: Float64) -> NDArray[np.bool_]:
    """Return whether points (..., 2) are inside a polygon (corners, 2), by the even-odd rule."""
    found = np.zeros(points.shape[:-1], dtype=np.bool_)
    x, z = points[..., 0], points[..., 1]
    for (x1, z1), (x2, z2) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if z1 != z2:
            found ^= ((z1 > z) != (z2 > z)) & (x < x1 + (z - z1) * (x2 - x1) / (z2 - z1))
    return found


def polygon_area(corners: Float64) -> float:
    """Return the area of a polygon (corners, 2) that does not cross itself [m²] (the shoelace formula)."""
    x, z = (corners - corners[0]).T
    return 0.5 * abs(float(np.sum(x * np.roll(z, -1) - np.roll(x, -1) * z)))


def crosses_itself(corners: Float64) -> bool:
    """Return whether two edges of a polygon (corners, 2) meet elsewhere than neighbours at their common corner."""
    count = len(corners)
    a, b = corners, np.roll(corners, -1, axis=0)
    if (np.abs(a - b).max(axis=1) < 1e-9).any():
        return True
    for i in range(count):
        for j in range(i + 1, count):
            neighbours = j == i + 1 or (i == 0 and j == count - 1)
            if neighbours:
                one, other = (i, j) if j == i + 1 else (j, i)
                if _folds_back(a[one], b[one], b[other]):
                    return True
            elif _meet(a[i], b[i], a[j], b[j]):
                return True
    return False


def _cross(o: Float64, p: Float64, q: Float64) -> float:
    return float((p[0] - o[0]) * (q[1] - o[1]) - (p[1] - o[1]) * (q[0] - o[0]))


def _folds_back(before: Float64, corner: Float64, after: Float64) -> bool:
    return abs(_cross(corner, before, after)) < 1e-9 and float((before - corner) @ (after - corner)) > 0


def _meet(p1: Float64, q1: Float64, p2: Float64, q2: Float64) -> bool:
    """Whether two segments have a common point (Ericson, "Real-Time Collision Detection" (2005), section 5.1.9.1)."""
    d1, d2, d3, d4 = _cross(p1, q1, p2), _cross(p1, q1, q2), _cross(p2, q2, p1), _cross(p2, q2, q1)
    if ((d1 > 0) != (d2 > 0)) and ((d3 > 0) != (d4 > 0)) and 0.0 not in (d1, d2, d3, d4):
        return True
    touches = ((d1, p1, q1, p2), (d2, p1, q1, q2), (d3, p2, q2, p1), (d4, p2, q2, q1))
    return any(
        d == 0 and bool((np.minimum(p, q) <= at).all() and (at <= np.maximum(p, q)).all()) for d, p, q, at in touches
    )
