"""Triangulate the surface of a smooth union of tapered limbs to make body, hand and arm meshes.

Limbs are rows of nine numbers: ends a and b [m], the radii there [m], and the index of the limb's group; rows are
sorted by group. The blending distance within a group differs from that between groups, so fingers stay apart and the
bones of a palm merge.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]


def polygonise(
    limbs: Float64, within: Float64, between: float, nodes: Float64, *, mirrored: bool = False
) -> tuple[Float64, Int64]:
    """Triangulate the closed surface of a smooth union of limbs, tapered capsules.

    Args:
        limbs: (k, 9) for each its ends a (3) and b (3) [m], the radii there (2) [m], and the index of its group (1);
            sorted by group.
        within: (groups,) blending distance between limbs of a group [m].
        between: blending distance between groups [m].
        nodes: (a, b, c, 3) nodes of a grid, which may be warped and extends beyond the limbs on all sides [m].
        mirrored: make the surface symmetric in x, triangles included. Nodes are given for x > 0 only, and so may be
            limbs; only limbs that reach x = 0 must be symmetric. A layer of cells joins the two halves.

    Returns:
        Vertices (n, 3) [m], and triangles (m, 3) as indices of these, anticlockwise as seen from outside.

    Raises:
        AssertionError: the surface touches itself at this resolution of the grid.
    """
    k = _kernels()
    values = np.empty(nodes.shape[:3])
    k.sample(limbs, within, between, nodes, values)
    if not k.separate(values):
        raise AssertionError("the surface touches itself")
    if mirrored:  # a layer of cells in whose middle x is 0: no triangle reaches over it
        values = np.concatenate([values[:1], values])
        nodes = np.concatenate([nodes[:1] * [-1.0, 1.0, 1.0], nodes])
    crossed = int(sum((np.diff(values < 0, axis=axis)).sum() for axis in range(3)))
    vertices, triangles = np.empty((4 * crossed, 3)), np.empty((2 * crossed, 3), np.int64)
    n, m = k.surface_net(values, nodes, vertices, triangles)
    vertices, triangles = vertices[:n].copy(), triangles[:m].copy()
    middle = np.flatnonzero(np.abs(vertices[:, 0]) < 1e-9) if mirrored else np.empty(0, np.int64)
    k.settle(limbs, within, between, vertices, 0.3 * float(np.linalg.norm(nodes[1, 1, -1] - nodes[0, 0, -1])))
    if not mirrored:
        return vertices, triangles
    vertices[middle, 0] = 0.0
    image = np.full(n, -1)
    image[middle] = middle
    sides = np.flatnonzero(image < 0)
    image[sides] = n + np.arange(len(sides))
    both = np.concatenate([vertices, vertices[sides] * [-1.0, 1.0, 1.0]])
    return both, np.concatenate([triangles, image[triangles][:, ::-1]])


def group_distances(limbs: Float64, within: Float64, points: Float64) -> Float64:
    """Return the signed distance of each point from each group of limbs alone [m]; negative inside.

    Args:
        limbs, within: (k, 9) and (groups,) blending distances [m], as in `polygonise`.
        points: (n, 3), in the frame of the limbs' ends [m].

    Returns:
        (n, groups) [m].
    """
    out = np.empty((len(points), len(within)))
    _kernels().group_distances(limbs, within, points, out)
    return out


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.geometry import limb_surface_kernels

    return limb_surface_kernels
