"""Limbs that are in each other are pushed apart, within the fit.

    solid = capsules_of(mesh)
    given = [*given, apart(solid, landmarks, motions)]

Of two capsules that overlap the nearest points of their axes are to lie so far from the middle between them as their
radii say: two planes (`mocapella.kinematics.twist_fit`) across the line between them. Limbs that only touch are free.
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
"""Limbs that touch press their flesh so much [m]."""
SD_M = 0.001
"""How much limbs may be in each other, against outlines that want it [m]."""


def apart(
    solid: Capsules,
    landmarks: Float64,
    motions: tuple[Float64, Float64],
    sd_m: float = SD_M,
    touching_m: float = TOUCHING_M,
) -> InPlanes:
    """The planes that keep limbs out of each other; none where they are.

    Args:
        solid: see its class.
        landmarks: (n, 3) of the mesh where it is [m].
        motions: R (parts, 9) and t (parts, 3) of the tree that is fitted.
        sd_m: how much they may be in each other [m].
        touching_m: how deep they are where they only touch [m].
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
    """How deep the limbs of some pairs are in each other, all together [m].

    Args:
        solid: see its class.
        pairs: (q, 2) of its limbs.
        landmarks: (n, 3) of the mesh where it is [m].
    """
    return float(_kernels().depth(np.ascontiguousarray(landmarks[solid.ends]), solid.radii, pairs))


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.kinematics import contact_kernels

    return contact_kernels
