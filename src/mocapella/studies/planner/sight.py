"""Lines of sight from sensors to points of people, past boxes and pillars, as arrays.

The same geometry as the simulated room's compiled kernel (`mocapella.sources.simulate.occlusion`): a segment and a
box by slabs (Ericson, "Real-Time Collision Detection" (2005), section 5.3.3), and a segment and an upright cylinder.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.sources.simulate.occlusion import Obstacles

Float64 = NDArray[np.float64]
Bools = NDArray[np.bool_]


def blocked(eye: Float64, targets: Float64, things: Obstacles) -> Bools:
    """Return whether an obstacle is between a lens and each target (...,).

    Args:
        eye: (3,) position of the lens [m].
        targets: (..., 3) positions [m].
        things: the obstacles.
    """
    found = np.zeros(targets.shape[:-1], dtype=np.bool_)
    way = targets - eye
    for x, z, half_width, height, half_depth, cos, sin in things.boxes:
        dx, dz = eye[0] - x, eye[2] - z
        start = (dx * cos - dz * sin, eye[1], dx * sin + dz * cos)
        step = (way[..., 0] * cos - way[..., 2] * sin, way[..., 1], way[..., 0] * sin + way[..., 2] * cos)
        limits = ((-half_width, half_width), (0.0, height), (-half_depth, half_depth))
        first, last = np.zeros(found.shape), np.ones(found.shape)
        for at, by, (low, high) in zip(start, step, limits, strict=True):
            enters, leaves = _slab(at, by, low, high)
            first, last = np.maximum(first, enters), np.minimum(last, leaves)
        found |= first < last
    for x, z, radius, height in things.pillars:
        px, pz, dx, dz = eye[0] - x, eye[2] - z, way[..., 0], way[..., 2]
        a, b, c = dx**2 + dz**2, px * dx + pz * dz, px**2 + pz**2 - radius**2
        root = np.sqrt(np.maximum(b * b - a * c, 0.0))
        crosses = (a >= 1e-12) & (root > 0)
        a = np.where(crosses, a, 1.0)
        enters, leaves = _slab(eye[1], way[..., 1], 0.0, height)
        first = np.maximum(np.maximum(0.0, (-b - root) / a), enters)
        last = np.minimum(np.minimum(1.0, (-b + root) / a), leaves)
        found |= crosses & (first < last)
    return found


def _slab(start: float, step: Float64, low: float, high: float) -> tuple[Float64, Float64]:
    """Range of fractions of the way (...,) where a coordinate is between two bounds; (1, 0) if it never is."""
    flat = np.abs(step) < 1e-12
    safe = np.where(flat, 1.0, step)
    a, b = (low - start) / safe, (high - start) / safe
    within = low < start < high
    enters = np.where(flat, 0.0 if within else 1.0, np.minimum(a, b))
    leaves = np.where(flat, 1.0 if within else 0.0, np.maximum(a, b))
    return enters, leaves
