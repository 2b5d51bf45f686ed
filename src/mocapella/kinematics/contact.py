"""Constraints that push interpenetrating limbs apart during a fit.

    solid = capsules_of(mesh)
    given = [*given, apart(solid, landmarks, motions)]

For two overlapping capsules, two planes (`mocapella.kinematics.twist_fit`) pull the nearest points of their axes apart
along the line between them, by half of the excess overlap each. A small overlap, as in contact, has no cost.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocapella.kinematics.twist_fit import InPlanes
from mocapella.model.body_capsules import Capsules

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

TOUCHING_M = 0.006
"""Overlap allowed for limbs in contact, because flesh gives way [m]."""
SD_M = 0.001
"""Standard deviation of an overlap, which weighs these constraints against the outlines' [m]."""


def apart(
    solid: Capsules,
    landmarks: Float64,
    motions: tuple[Float64, Float64],
    sd_m: float = SD_M,
    touching_m: float = TOUCHING_M,
) -> InPlanes:
    """Return the planes that push overlapping limbs apart; empty if none overlaps. Limbs whose axes cross get none.

    Args:
        solid: the limbs as capsules.
        landmarks: (n, 3) landmarks of the mesh in the present pose, world [m].
        motions: the parts' motions from rest in that pose: R (parts, 9), row by row, and t (parts, 3) [m].
        sd_m: standard deviation of an overlap, which sets the planes' weight [m].
        touching_m: allowed overlap of limbs in contact [m].
    """
    R, t = motions
    room = 2 * len(solid.pairs)
    part, rest = np.empty(room, np.int64), np.empty((room, 3))
    planes, weights = np.empty((room, 4)), np.empty(room)
    ends = np.ascontiguousarray(landmarks[solid.ends]) if room else np.empty((0, 2, 3))
    n = _kernels().apart(
        ends, solid.radii, solid.pairs, solid.part, R, t, touching_m, 1.0 / sd_m**2, part, rest, planes, weights
    )
    return InPlanes(part[:n], rest[:n], planes[:n], weights[:n])


def depth_m(solid: Capsules, pairs: Int64, landmarks: Float64) -> float:
    """Return the sum of the overlaps of pairs of limbs [m]; 0 if none overlaps.

    Args:
        solid: the limbs as capsules.
        pairs: (q, 2) indices of its limbs.
        landmarks: (n, 3) landmarks of the mesh in the present pose, world [m].
    """
    return float(_kernels().depth(np.ascontiguousarray(landmarks[solid.ends]), solid.radii, pairs))


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.kinematics import contact_kernels

    return contact_kernels
