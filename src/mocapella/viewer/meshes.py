"""The two meshes of all strokes, a bone and a ball, as surfaces of revolution about +y."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

BONE_SIDES, BALL_RINGS, BALL_SIDES = 6, 7, 9
"""Numbers of sides and rings of the meshes: few, because a browser without a GPU is slow with many triangles."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh.

    Attributes:
        vertices: (n, 3) float32 positions [m].
        faces: (m, 3) uint32 vertex indices of each triangle, counter-clockwise as seen from outside.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.uint32]


def revolve(heights: NDArray[np.float64], radii: NDArray[np.float64], sides: int) -> Mesh:
    """Return the closed surface of a profile that is rotated about +y, without degenerate triangles.

    Args:
        heights: (rings,) y of each ring, ascending.
        radii: (rings,) radius of each ring, in the same unit; the first and the last are 0.
        sides: number of corners of a ring.
    """
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    circle = np.stack([np.cos(angle), np.zeros(sides), np.sin(angle)], axis=-1)
    rings = radii[:, None, None] * circle
    rings[..., 1] = heights[:, None]
    k = np.arange(sides)
    after = (k + 1) % sides
    faces = []
    for ring in range(len(heights) - 1):
        low, high = ring * sides, (ring + 1) * sides
        if radii[ring + 1] > 0:
            faces.append(np.stack([low + k, high + k, high + after], axis=-1))
        if radii[ring] > 0:
            faces.append(np.stack([low + k, high + after, low + after], axis=-1))
    return Mesh(rings.reshape(-1, 3).astype(np.float32), np.concatenate(faces).astype(np.uint32))


def bone_mesh() -> Mesh:
    """Return a bone from the origin to (0, 1, 0) of radius 1, thinner towards its end, with tapered ends."""
    heights = np.array([0.0, 0.05, 1.0 - 0.05, 1.0])
    radii = np.array([0.0, 1.0, 0.8, 0.0])
    return revolve(heights, radii, BONE_SIDES)


def ball_mesh() -> Mesh:
    """Return a polyhedron around the origin that approximates a ball of radius 1, with the same volume."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, BALL_RINGS)
    mesh = revolve(np.sin(angle), np.cos(angle).round(9), BALL_SIDES)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    volume = float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6
    return Mesh(mesh.vertices * np.float32((4 / 3 * np.pi / volume) ** (1 / 3)), mesh.faces)
