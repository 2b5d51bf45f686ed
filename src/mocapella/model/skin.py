"""Skins: surfaces of triangles that the joints of a rigid skeleton move, for files of animated skeletons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.bone_rotations import posed, shortest
from mocapella.geometry.segment_axes import unit
from mocapella.model.rest_pose import RigidSkeleton

Float64 = NDArray[np.float64]
Int32 = NDArray[np.int32]

_RADIUS: Final = 0.16
_RADII_M: Final = (0.004, 0.045)
"""Radius of a capsule around a bone, relative to the bone's length, and its limits [m]."""
_ROUND: Final = 12
_RINGS: Final = 4


@dataclass(frozen=True, eq=False)
class SkinnedSurface:
    """A surface, and how the joints of a skeleton move it.

    Attributes:
        vertices: (n, 3) at rest, in the frame of the skeleton's `rest_positions` [m].
        faces: (m, 3) indices of each triangle's vertices, counter-clockwise as seen from outside.
        joints: (n, 4) indices of the joints that move each vertex.
        shares: (n, 4) their weights, which add up to 1.
    """

    vertices: Float64
    faces: Int32
    joints: Int32
    shares: Float64

    @property
    def normals(self) -> Float64:
        """(n, 3) unit normals of the vertices at rest: the means of their triangles', by area."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        out = np.zeros_like(self.vertices)
        for k in range(3):
            np.add.at(out, self.faces[:, k], np.cross(b - a, c - a))
        return np.nan_to_num(unit(out), nan=0.0) + np.where(np.isnan(unit(out)), [0.0, 1.0, 0.0], 0.0)


def joined(surfaces: Sequence[SkinnedSurface]) -> SkinnedSurface:
    """Return several surfaces of one skeleton, at least one, as one."""
    starts = np.cumsum([0, *(len(one.vertices) for one in surfaces)])
    return SkinnedSurface(
        np.concatenate([one.vertices for one in surfaces]),
        np.concatenate([one.faces + start for one, start in zip(surfaces, starts[:-1], strict=True)]).astype(np.int32),
        np.concatenate([one.joints for one in surfaces]),
        np.concatenate([one.shares for one in surfaces]),
    )


def rest_positions(skeleton: RigidSkeleton) -> Float64:
    """Return the positions (joints, 3) of a skeleton's joints at rest, the root's at 0 [m]."""
    return posed(skeleton.parents, skeleton.offsets, np.zeros(3), np.tile(np.eye(3), (len(skeleton.parents), 1, 1)))


def capsules(skeleton: RigidSkeleton) -> SkinnedSurface:
    """Return a capsule around each bone of a skeleton, moved by the joint at which the bone begins."""
    places = rest_positions(skeleton)
    vertices, faces, joints = [np.zeros((0, 3))], [np.zeros((0, 3), np.int32)], [np.zeros(0, np.int32)]
    count = 0
    for joint in range(1, len(places)):
        parent = int(skeleton.parents[joint])
        start, along = places[parent], skeleton.offsets[joint]
        length = float(np.linalg.norm(along))
        if length > 1e-6:
            points, triangles = _capsule(length, float(np.clip(_RADIUS * length, *_RADII_M)))
            turn = shortest(np.array([0.0, 0.0, 1.0]), along / length)
            vertices.append(start + points @ turn.T)
            faces.append((triangles + count).astype(np.int32))
            joints.append(np.full(len(points), parent, np.int32))
            count += len(points)
    moved = np.concatenate(joints)
    return SkinnedSurface(
        np.concatenate(vertices), np.concatenate(faces), np.column_stack([moved, *[np.zeros_like(moved)] * 3]),
        np.tile([1.0, 0.0, 0.0, 0.0], (len(moved), 1)),
    )  # fmt: skip


def _capsule(length: float, radius: float) -> tuple[Float64, Int32]:
    """Return the vertices and triangles of a capsule along z, from 0 to its length."""
    angles = np.linspace(-np.pi / 2, np.pi / 2, 2 * _RINGS)[1:-1]
    z = np.where(angles < 0, 0.0, length) + radius * np.sin(angles)
    turns = np.linspace(0.0, 2 * np.pi, _ROUND, endpoint=False)
    rings = [np.column_stack([radius * np.cos(angle) * np.cos(turns), radius * np.cos(angle) * np.sin(turns),
                              np.full(_ROUND, height)]) for angle, height in zip(angles, z, strict=True)]  # fmt: skip
    points = np.concatenate([[[0.0, 0.0, -radius]], *rings, [[0.0, 0.0, length + radius]]])
    k, after = np.arange(_ROUND), np.roll(np.arange(_ROUND), -1)
    last = len(points) - 1
    faces = [np.column_stack([np.zeros(_ROUND, int), 1 + after, 1 + k])]
    for ring in range(len(rings) - 1):
        a, b = 1 + _ROUND * ring, 1 + _ROUND * (ring + 1)
        faces += [np.column_stack([a + k, a + after, b + k]), np.column_stack([a + after, b + after, b + k])]
    top = 1 + _ROUND * (len(rings) - 1)
    faces.append(np.column_stack([top + k, top + after, np.full(_ROUND, last)]))
    return points, np.concatenate(faces).astype(np.int32)
