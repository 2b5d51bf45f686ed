"""Limbs that are in each other are pushed apart, within the fit.

    solid = capsules_of(mesh)
    given = [*given, apart(solid, landmarks, motions)]

Of two capsules that overlap the nearest points of their axes are to lie so far from the middle between them as their
radii say: two planes (`mocapella.kinematics.twist_fit`) across the line between them. Limbs that only touch are free.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.kinematics.twist_fit import InPlanes
from mocapella.model.body_capsules import body_capsules
from mocapella.model.rigged_mesh import RiggedMesh

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

TOUCHING_M = 0.008
"""Limbs that touch press their flesh so much [m]."""
SD_M = 0.002
"""How much limbs may be in each other, against outlines that want it [m]."""


class Capsules(msgspec.Struct, frozen=True, eq=False):
    """A mesh's limbs, as capsules.

    Attributes:
        part: (c,) which part moves each.
        ends: (c, 2) landmarks, as numbers of the mesh's.
        radii: (c,) [m].
        pairs: (p, 2) which can meet.
    """

    part: Int64
    ends: Int64
    radii: Float64
    pairs: Int64


def capsules_of(mesh: RiggedMesh) -> Capsules:
    """Of a body; none of what is no body."""
    limbs = body_capsules(mesh)
    parts = np.array([mark.part for mark in mesh.landmarks.values()], np.int64)
    # The second landmark is next to the joint that moves the next part, but for the trunk's.
    moved = np.maximum(parts[limbs.ends[:, 0]], 0) if len(limbs.ends) else np.empty(0, np.int64)
    for k, name in enumerate(limbs.names):
        if name in mesh.part_names:
            moved[k] = mesh.part_names.index(name)
        elif name == "trunk" and "torso" in mesh.part_names:
            moved[k] = mesh.part_names.index("torso")
    return Capsules(moved, limbs.ends, limbs.radii, limbs.pairs)


def apart(solid: Capsules, landmarks: Float64, motions: tuple[Float64, Float64], sd_m: float = SD_M) -> InPlanes:
    """The planes that keep limbs out of each other; none where they are.

    Args:
        solid: see there.
        landmarks: (n, 3) of the mesh where it is [m].
        motions: R (parts, 9) and t (parts, 3) of the tree that is fitted.
        sd_m: how much they may be in each other [m].
    """
    R, t = motions
    room = 2 * len(solid.pairs)
    part, rest = np.empty(room, np.int64), np.empty((room, 3))
    planes, weights = np.empty((room, 4)), np.empty(room)
    ends = np.ascontiguousarray(landmarks[solid.ends]) if room else np.empty((0, 2, 3))
    n = _kernels().apart(
        ends, solid.radii, solid.pairs, solid.part, R, t, TOUCHING_M, 1.0 / sd_m**2, part, rest, planes, weights
    )
    return InPlanes(part[:n], rest[:n], planes[:n], weights[:n])


def depth_m(solid: Capsules, pairs: Int64, landmarks: Float64) -> float:
    """How deep the limbs of some pairs are in each other, all together [m]."""
    return (
        float(_kernels().depth(np.ascontiguousarray(landmarks[solid.ends]), solid.radii, pairs)) if len(pairs) else 0.0
    )


@cache
def _kernels() -> Any:
    """Compiled; numba is imported when it is first needed."""
    from mocapella.kinematics import contact_kernels

    return contact_kernels
