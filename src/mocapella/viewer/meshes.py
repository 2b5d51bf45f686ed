"""The two meshes of all strokes, as surfaces of revolution about +y."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

BONE_SIDES, BALL_RINGS, BALL_SIDES = 6, 7, 9
"""As few as a bone and a joint still look round with: a browser without a GPU spends most of its time on triangles."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles: ``vertices`` (n, 3) float32 and ``faces`` (m, 3) uint32, seen from outside counter-clockwise."""

    vertices: NDArray[np.float32]
    faces: NDArray[np.uint32]


def revolve(heights: NDArray[np.float64], radii: NDArray[np.float64], sides: int) -> Mesh:
    """Return the closed surface of a profile that is rotated about +y, without triangles of no area.

    Args:
        heights: (rings,), rising.
        radii: (rings,), the first and the last 0.
        sides: corners of a ring.
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
    """Return a bone from the origin to (0, 1, 0), at most 1 wide: thicker at the origin, rounded at both ends."""
    heights = np.array([0.0, 0.05, 1.0 - 0.05, 1.0])
    radii = np.array([0.0, 1.0, 0.8, 0.0])
    return revolve(heights, radii, BONE_SIDES)


def ball_mesh() -> Mesh:
    """Return a polyhedron with the volume of a ball of radius 1 about the origin."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, BALL_RINGS)
    mesh = revolve(np.sin(angle), np.cos(angle).round(9), BALL_SIDES)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    volume = float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6
    return Mesh(mesh.vertices * np.float32((4 / 3 * np.pi / volume) ** (1 / 3)), mesh.faces)
