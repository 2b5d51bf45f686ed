"""Rigged meshes: surfaces moved by joints, such as a person, a pair of legs, a hand, a tool or an animal.

A rigid object is a mesh of one part without joints.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.model.twist_tree import TreePose, TwistTree, part_motions, twist_tree
from mocapella.settings import check

Float64 = NDArray[np.float64]
Int32 = NDArray[np.int32]
Int64 = NDArray[np.int64]


class Landmark(msgspec.Struct, frozen=True, eq=False):
    """A named point of a body, such as a knee.

    Attributes:
        part: index of the part that moves it.
        point: (3,) its position at rest, in the mesh's rest frame [m].
    """

    part: int
    point: Float64


class RiggedMesh(msgspec.Struct, frozen=True, eq=False):
    """A surface of triangles, and the tree of parts that moves it.

    Attributes:
        name: name of the mesh.
        tree: parts and joints, in the mesh's rest frame.
        part_names: one for each part of the tree, all different.
        joint_names: one for each angle of the tree, all different.
        vertices: (n, 3) at rest [m].
        faces: (m, 3) indices of each triangle's vertices, counter-clockwise as seen from outside.
        bones: (n, most) indices of the parts that move each vertex, by descending weight; ``most`` is any number.
        shares: (n, most) skinning weights of these parts, descending; they add up to 1, and all after a 0 are 0.
        landmarks: named points of the mesh.

    Raises:
        SettingsError: arrays that do not fit this description; names the vertex, face, part or landmark.
    """

    name: str
    tree: TwistTree
    part_names: tuple[str, ...]
    joint_names: tuple[str, ...]
    vertices: Float64
    faces: Int32
    bones: Int32
    shares: Float64
    landmarks: Mapping[str, Landmark]

    def __post_init__(self) -> None:
        n, parts, most = len(self.vertices), len(self.tree.parents), self.bones.shape[-1]
        shapes = (self.vertices.shape, self.faces.shape[1:], self.bones.shape, self.shares.shape)
        wanted = ((n, 3), (3,), (n, most), (n, most))
        check(shapes == wanted and most > 0, f"{self.name}: shapes of vertices, faces, bones and shares", shapes,
              f"{wanted}, with a part for each vertex at least")  # fmt: skip
        check(bool(np.isfinite(self.vertices).all()), f"{self.name}: vertices", "not finite", "finite")
        counts = (len(self.part_names), len(self.joint_names))
        wanted_names = (parts, len(self.tree.joint_parts))
        check(
            counts == wanted_names,
            f"{self.name}: names of parts and joints",
            counts,
            f"as many as there are {wanted_names}",
        )
        for what, names in (("parts", self.part_names), ("joints", self.joint_names)):
            twice = sorted({name for name in names if names.count(name) > 1})
            check(not twice, f"{self.name}: names of {what} that are there twice", twice, "each of one only")
        for what, index, end in (("faces", self.faces, n), ("bones", self.bones, parts)):
            wrong = np.argwhere((index < 0) | (index >= end))
            check(len(wrong) == 0, f"{self.name}: {what}{wrong[:1].tolist()}", index[tuple(wrong[:1].T)].tolist(),
                  f"0 to {end - 1}")  # fmt: skip
        total = self.shares.sum(axis=1)
        good = (
            (np.abs(total - 1.0) < 1e-6)
            & (self.shares >= 0).all(axis=1)
            & (np.diff(self.shares, axis=1) <= 0).all(axis=1)
        )
        bad = np.flatnonzero(~good)
        check(len(bad) == 0, f"{self.name}: shares of vertex {bad[:1].tolist()}", self.shares[bad[:1]].tolist(),
              "falling, 0 or more, and 1 together")  # fmt: skip
        for name, landmark in self.landmarks.items():
            where = f"{self.name}: landmark {name}: "
            check(0 <= landmark.part < parts, f"{where}part", landmark.part, f"0 to {parts - 1}")
            good = landmark.point.shape == (3,) and bool(np.isfinite(landmark.point).all())
            check(good, f"{where}point", landmark.point.tolist(), "three finite numbers")


def rigid_mesh(name: str, vertices: Any, faces: Any, landmarks: Mapping[str, Any] | None = None) -> RiggedMesh:
    """Return a mesh of one part without joints; its tree's root is the mean of its vertices. Arrays are copied.

    Args:
        name: name of the object and of its only part.
        vertices: (n, 3) in the object's frame [m].
        faces: (m, 3) indices of each triangle's vertices, counter-clockwise as seen from outside.
        landmarks: points (3,) in the object's frame [m] by name; None for none.

    Raises:
        SettingsError: no vertices, or arrays that do not fit `RiggedMesh`.
    """
    vertices = np.array(vertices, dtype=np.float64)
    check(vertices.ndim == 2 and len(vertices) > 0, f"{name}: shape of vertices", vertices.shape, "(1 or more, 3)")
    return RiggedMesh(
        name=name,
        tree=twist_tree([-1], root=vertices.mean(axis=0)),
        part_names=(name,),
        joint_names=(),
        vertices=vertices,
        faces=np.array(faces, dtype=np.int32),
        bones=np.zeros((len(vertices), 1), dtype=np.int32),
        shares=np.ones((len(vertices), 1)),
        landmarks={key: Landmark(0, np.array(point, dtype=np.float64)) for key, point in (landmarks or {}).items()},
    )


def posed(mesh: RiggedMesh, pose: TreePose) -> Float64:
    """Return the vertices (..., n, 3) in the world [m], by linear blend skinning; poses may have leading batch axes.

    The mesh is not changed, and joint limits are not applied.
    """
    T = part_motions(mesh.tree, pose)
    batch, parts = T.shape[:-3], T.shape[-3]
    R = np.ascontiguousarray(T[..., :3, :3]).reshape(-1, parts, 9)
    t = np.ascontiguousarray(T[..., :3, 3]).reshape(-1, parts, 3)
    out = np.empty((len(R), *mesh.vertices.shape))
    for k in range(len(R)):
        _kernels().skin(mesh.vertices, mesh.bones, mesh.shares, R[k], t[k], out[k])
    return out.reshape(*batch, *mesh.vertices.shape)


def carried(points: Float64, bones: Int32, shares: Float64, motions: tuple[Float64, Float64]) -> Float64:
    """Move points (n, 3) from rest into one pose, by linear blend skinning; return world positions (n, 3) [m].

    Args:
        points: (n, 3) at rest, such as the vertices of a mesh [m].
        bones, shares: (n, most) as in `RiggedMesh`.
        motions: R (parts, 9) and t (parts, 3) of `twist_tree.motions`.
    """
    out = np.empty(points.shape)
    _kernels().skin(points, bones, shares, *motions, out)
    return out


def at_rest(points: Float64, part: Int64, motions: tuple[Float64, Float64]) -> Float64:
    """Return the rest positions (n, 3) [m] of points that are moved by one part each; for these it inverts `carried`.

    Args:
        points: (n, 3) in the world, such as vertices of a posed mesh [m].
        part: (n,) index of the part that moves each point.
        motions: R (parts, 9) and t (parts, 3) of `twist_tree.motions`.
    """
    out = np.empty(points.shape)
    _kernels().at_rest(points, part, *motions, out)
    return out


def farthest_apart_m(these: Float64, those: Float64) -> float:
    """Return the greatest distance between corresponding points, (n, 3) each [m], as of vertices in two poses.

    Without points it is 0.
    """
    return float(_kernels().farthest_apart(these, those))


def landmarks_at(mesh: RiggedMesh, pose: TreePose) -> Float64:
    """Return the landmarks (..., landmarks, 3) in the world [m], in the order of ``mesh.landmarks``."""
    if not mesh.landmarks:
        return np.empty((*np.shape(pose.angles)[:-1], 0, 3))
    T = part_motions(mesh.tree, pose)[..., [landmark.part for landmark in mesh.landmarks.values()], :, :]
    points = np.array([landmark.point for landmark in mesh.landmarks.values()])
    return np.asarray((T[..., :3, :3] @ points[..., None])[..., 0] + T[..., :3, 3])


def rest(mesh: RiggedMesh) -> TreePose:
    """Return the rest pose: the identity for the root, all angles 0."""
    return TreePose(np.eye(4), np.zeros(len(mesh.joint_names)))


def smooth(x: Float64, start: float, end: float) -> Float64:
    """Return a smooth step (...,) of x (...,), from 0 where x is below ``start`` to 1 where it is above ``end``."""
    u = np.clip((x - start) / (end - start), 0.0, 1.0)
    return np.asarray(u * u * (3.0 - 2.0 * u))


def strongest(weights: Float64, most: int = 4) -> tuple[Int32, Float64]:
    """Convert dense skinning weights (n, parts), 0 or more, to ``bones`` and ``shares`` (n, most) of `RiggedMesh`.

    The ``most`` largest weights of a vertex are kept; weights below a thousandth of its largest are dropped, and the
    rest is scaled to add up to 1. Every vertex must have a weight above 0.
    """
    order = np.argsort(-weights, axis=1, kind="stable")[:, :most]
    kept = np.take_along_axis(weights, order, axis=1)
    kept = np.where(kept < 1e-3 * kept[:, :1], 0.0, kept)
    return order.astype(np.int32), kept / kept.sum(axis=1)[:, None]


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.geometry import skinning_kernels

    return skinning_kernels
