"""The surface of a smooth union of tapered limbs, as triangles: how bodies, hands and arms are made.

Limbs are rows of nine numbers: ends a and b [m], the radii there [m], and the group that a limb belongs to, by which
they are sorted. Limbs of a group flow into each other by one measure, groups into groups by another, so that fingers
stay apart and the bones of a palm do not.
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
    """The surface: vertices (n, 3) and triangles (m, 3), closed, anticlockwise as seen from outside.

    Args:
        limbs: (n, 9), sorted by group.
        within: (groups,) how far the limbs of a group flow into each other [m].
        between: and groups [m].
        nodes: (a, b, c, 3) a grid, warped at will, that goes beyond the limbs on all sides.
        mirrored: the surface is its own mirror image in x, triangles too. The limbs must be; the nodes are those
            of x > 0 only, and what lies between them and x = 0 is one cell with its mirror image.
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
    vertices, triangles = np.empty((4 * crossed + 8, 3)), np.empty((2 * crossed + 8, 3), np.int64)
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
    """How far points (n, 3) are from each group (n, groups) [m]; negative inside."""
    out = np.empty((len(points), len(within)))
    _kernels().group_distances(limbs, within, points, out)
    return out


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.geometry import limb_surface_kernels

    return limb_surface_kernels
