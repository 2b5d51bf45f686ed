"""Compiled kernels of `occlusion`.

Distance of two segments: C. Ericson, "Real-Time Collision Detection" (2005), section 5.1.9; a segment and a box:
section 5.3.3 (slabs).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Float64 = NDArray[np.float64]


@njit(cache=True)
def hidden(  # noqa: PLR0917
    eye: Float64, joints: Float64, radii: Float64, parents: NDArray[np.int64], within: NDArray[np.bool_],
    boxes: Float64, pillars: Float64,
) -> NDArray[np.bool_]:  # fmt: skip
    """Return whether each joint is occluded (people, 25), see `occlusion.hidden`.

    Args:
        eye, joints, radii: (3,), (people, 25, 3), (people, 25) as in `occlusion.hidden` [m].
        parents, within: (25,), (25, 25) of `BodyTemplate`.
        boxes, pillars: (n, 7), (n, 4) of `Obstacles`.
    """
    people, count = joints.shape[0], joints.shape[1]
    result = np.zeros((people, count), dtype=np.bool_)
    nothing = np.zeros(count, dtype=np.bool_)
    for person in range(people):
        for joint in range(count):
            target = joints[person, joint]
            blocked = _behind_box(eye, target, boxes) or _behind_pillar(eye, target, pillars)
            for other in range(people):
                if not blocked:
                    own = within[joint] if other == person else nothing
                    blocked = _behind_body(eye, target, joints[other], radii[other], parents, own)
            result[person, joint] = blocked
    return result


@njit(cache=True)
def _behind_body(  # noqa: PLR0917
    eye: Float64, target: Float64, joints: Float64, radii: Float64, parents: NDArray[np.int64],
    excluded: NDArray[np.bool_],
) -> bool:  # fmt: skip
    for bone in range(len(parents)):
        if parents[bone] == bone or excluded[bone]:
            continue
        start = joints[parents[bone]]
        if _segments_squared(eye, target, start, joints[bone]) < radii[bone] ** 2:
            return True
    return False


@njit(cache=True)
def _segments_squared(p1: Float64, q1: Float64, p2: Float64, q2: Float64) -> float:
    """Squared distance of the segments p1–q1 and p2–q2, both of positive length."""
    a = b = c = e = f = 0.0
    for i in range(3):
        d1, d2, r = q1[i] - p1[i], q2[i] - p2[i], p1[i] - p2[i]
        a += d1 * d1
        e += d2 * d2
        b += d1 * d2
        c += d1 * r
        f += d2 * r
    a, e = max(a, 1e-18), max(e, 1e-18)
    s = min(1.0, max(0.0, (b * f - c * e) / max(a * e - b * b, 1e-18)))
    t = (b * s + f) / e
    if t < 0.0:
        t, s = 0.0, min(1.0, max(0.0, -c / a))
    elif t > 1.0:
        t, s = 1.0, min(1.0, max(0.0, (b - c) / a))
    squared = 0.0
    for i in range(3):
        gap = p1[i] + s * (q1[i] - p1[i]) - p2[i] - t * (q2[i] - p2[i])
        squared += gap * gap
    return squared


@njit(cache=True)
def _behind_box(eye: Float64, target: Float64, boxes: Float64) -> bool:
    for k in range(len(boxes)):
        x, z, half_width, height, half_depth, cos, sin = boxes[k]
        first, last = 0.0, 1.0
        for axis in range(3):
            if axis == 0:
                start = (eye[0] - x) * cos - (eye[2] - z) * sin
                end = (target[0] - x) * cos - (target[2] - z) * sin
                low, high = -half_width, half_width
            elif axis == 1:
                start, end, low, high = eye[1], target[1], 0.0, height
            else:
                start = (eye[0] - x) * sin + (eye[2] - z) * cos
                end = (target[0] - x) * sin + (target[2] - z) * cos
                low, high = -half_depth, half_depth
            enters, leaves = _slab(start, end, low, high)
            first, last = max(first, enters), min(last, leaves)
        if first < last:
            return True
    return False


@njit(cache=True)
def _slab(start: float, end: float, low: float, high: float) -> tuple[float, float]:
    """Range of fractions of the way in which a coordinate is between two bounds; (1, 0) if it never is."""
    if abs(end - start) < 1e-12:
        return (0.0, 1.0) if low < start < high else (1.0, 0.0)
    a, b = (low - start) / (end - start), (high - start) / (end - start)
    return min(a, b), max(a, b)


@njit(cache=True)
def _behind_pillar(eye: Float64, target: Float64, pillars: Float64) -> bool:
    for k in range(len(pillars)):
        x, z, radius, height = pillars[k]
        px, pz, dx, dz = eye[0] - x, eye[2] - z, target[0] - eye[0], target[2] - eye[2]
        a, b, c = dx * dx + dz * dz, px * dx + pz * dz, px * px + pz * pz - radius * radius
        inside = b * b - a * c
        if a < 1e-12 or inside <= 0.0:
            continue
        enters, leaves = _slab(eye[1], target[1], 0.0, height)
        first = max(0.0, (-b - np.sqrt(inside)) / a, enters)
        if first < min(1.0, (-b + np.sqrt(inside)) / a, leaves):
            return True
    return False
