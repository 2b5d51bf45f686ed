"""Limbs as capsules, to measure how deeply a body's limbs penetrate each other.

A capsule is the set of points nearer than a radius to the segment between two landmarks; three quarters of a limb's
surface lie outside its capsule.
"""

from __future__ import annotations

from itertools import combinations
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.model.rigged_mesh import RiggedMesh

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

_LIMBS: Final[dict[str, tuple[str, str]]] = {
    "trunk": ("waist", "neck"),
    "head": ("neck", "head"),
    **{f"{side} {name}": (f"{side} {a}", f"{side} {b}") for side in ("left", "right")
       for name, a, b in (
           ("upper arm", "shoulder", "elbow"), ("forearm", "elbow", "wrist"), ("hand", "wrist", "hand"),
           ("thigh", "hip", "knee"), ("shank", "knee", "ankle"), ("foot", "heel", "toe"))},
}  # fmt: skip
"""The landmarks at both ends of each limb; the second one, at the distal end, moves with it."""
_TOUCHING: Final = {
    frozenset({"left thigh", "right thigh"}),
    *(frozenset({one, f"{side} {other}"}) for side in ("left", "right")
      for one, other in (("trunk", "upper arm"), ("head", "upper arm"), ("trunk", "thigh"), (f"{side} shank", "foot"))),
}  # fmt: skip
"""Pairs of limbs whose capsules always overlap; like pairs that share a landmark, they are not tested."""


class Capsules(msgspec.Struct, frozen=True, eq=False):
    """A body's limbs as capsules.

    Attributes:
        names: (c,) name of each limb.
        part: (c,) index of the mesh's part that moves each limb.
        ends: (c, 2) indices of the mesh's landmarks at both ends.
        radii: (c,) radius of each capsule [m].
        pairs: (p, 2) indices of limbs that can collide, the lower index first.
    """

    names: tuple[str, ...]
    part: Int64
    ends: Int64
    radii: Float64
    pairs: Int64


def capsules_of(mesh: RiggedMesh) -> Capsules:
    """Return a capsule for each limb between two landmarks that the mesh has, with the names of `body_mesh`.

    Without such landmarks, there are no capsules. Radii are fitted to the mesh at rest.
    """
    marks = list(mesh.landmarks)
    there = {name: both for name, both in _LIMBS.items() if mesh.landmarks.keys() >= set(both)}
    pairs = [
        (i, j)
        for (i, one), (j, other) in combinations(enumerate(there), 2)
        if frozenset({one, other}) not in _TOUCHING and not set(there[one]) & set(there[other])
    ]
    ends = np.array([[marks.index(name) for name in both] for both in there.values()], np.int64).reshape(-1, 2)
    part = np.array([mesh.landmarks[far].part for _, far in there.values()], np.int64)
    return Capsules(tuple(there), part, ends, _radii(mesh, ends), np.array(pairs, np.int64).reshape(-1, 2))


def depths_m(capsules: Capsules, landmarks: Float64) -> Float64:
    """Return how deeply the capsules of each pair of limbs, ``capsules.pairs``, overlap.

    Args:
        capsules: the mesh's capsules.
        landmarks: (..., n, 3) all landmarks of the posed mesh, in its order [m].

    Returns:
        (..., p) sum of the radii minus the distance of the axes, 0 if apart [m].
    """
    one, other = (landmarks[..., capsules.ends[capsules.pairs[:, k]], :] for k in (0, 1))
    between = segment_distance(one[..., 0, :], one[..., 1, :], other[..., 0, :], other[..., 1, :])
    return np.asarray(np.maximum(capsules.radii[capsules.pairs].sum(axis=1) - between, 0.0))


def _radii(mesh: RiggedMesh, ends: Int64) -> Float64:
    """Return (c,) the lower quartile of the distances of each axis' nearest vertices; 0 without any."""
    points, x = np.array([mark.point for mark in mesh.landmarks.values()]).reshape(-1, 3), mesh.vertices
    if not len(ends):
        return np.empty(0)
    distances = np.array([segment_distance(x, x, *np.broadcast_arrays(*points[both], x)[:2]) for both in ends])
    nearest = distances == distances.min(axis=0)  # vertices in the middle belong to both sides, for symmetry
    return np.array([np.percentile(d[n], 25) if n.any() else 0.0 for d, n in zip(distances, nearest, strict=True)])


def segment_distance(a: Any, b: Any, c: Any, d: Any) -> Float64:
    """Return the least distances (...,) between segments from a to b and from c to d, all (..., 3).

    They have the unit of the points. A segment may have the length 0.

    C. Ericson, *Real-Time Collision Detection* (2005), section 5.1.9.
    """
    u, v, w = b - a, d - c, a - c
    uu, uv, vv, uw, vw = (np.sum(p * q, axis=-1) for p, q in ((u, u), (u, v), (v, v), (u, w), (v, w)))
    with np.errstate(divide="ignore", invalid="ignore"):
        s = np.clip(np.nan_to_num((uv * vw - vv * uw) / (uu * vv - uv * uv), posinf=0.0, neginf=0.0), 0.0, 1.0)
        t = np.clip(np.nan_to_num((uv * s + vw) / vv), 0.0, 1.0)
        s = np.clip(np.nan_to_num((uv * t - uw) / uu), 0.0, 1.0)
    return np.asarray(np.linalg.norm(w + s[..., None] * u - t[..., None] * v, axis=-1))
