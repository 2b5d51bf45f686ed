"""A body of the method ``silhouettes``: its mesh, with edges, capsules and ball joints that all frames share.

They depend on the rest pose only. The posed vertices of the last pose are cached, since many steps of a frame use them.
"""

from __future__ import annotations

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.kinematics.ball_joints import LocalTree, ball_joints, local_tree
from mocapella.kinematics.silhouette_fit import figure
from mocapella.model.body_capsules import capsules_of
from mocapella.model.rigged_mesh import RiggedMesh, carried
from mocapella.model.twist_tree import TreePose, motions

Float64 = NDArray[np.float64]

SKIN_POINTS = 6
"""Number of vertices per part that represent its surface."""


class Standing(msgspec.Struct, frozen=True, eq=False):
    """A posed mesh: its vertices (n, 3) and landmarks (m, 3) in the world [m], by linear blend skinning."""

    pose: TreePose
    vertices: Float64
    landmarks: Float64


class SilhouetteBody:
    """One body's mesh, with values for rendering and collisions computed once, and a cache of its last pose.

    Args:
        mesh: the body's mesh.

    Attributes:
        mesh: the body's mesh.
        figure: the mesh with its edges, for rendering its outline.
        balls: its ball joints, which have three axes.
        solid: its limbs as capsules, which must not penetrate each other.
        skin: (k,) indices of vertices that are spread over its parts.
    """

    def __init__(self, mesh: RiggedMesh) -> None:
        self.mesh, self.figure = mesh, figure(mesh)
        self.balls, self.solid = ball_joints(mesh.tree), capsules_of(mesh)
        marks, count = mesh.landmarks.values(), len(mesh.landmarks)
        self._marks = (
            np.array([mark.point for mark in marks], np.float64).reshape(count, 3),
            np.array([[mark.part] for mark in marks], np.int32).reshape(count, 1),
            np.ones((count, 1)),
        )
        chosen = [
            some[np.unique(np.linspace(0, len(some) - 1, SKIN_POINTS).astype(int))]
            for some in (np.flatnonzero(self.figure.part == part) for part in range(len(mesh.tree.parents)))
            if len(some)
        ]
        self.skin = np.concatenate(chosen) if chosen else np.empty(0, np.int64)
        self._stood: Standing | None = None

    def standing(self, pose: TreePose) -> Standing:
        """Return the body in a pose. For the same pose object as in the last call, the same value is returned.

        Its arrays must therefore not be changed.
        """
        if self._stood is None or self._stood.pose is not pose:
            mesh, moved = self.mesh, motions(self.mesh.tree, pose)
            vertices = carried(mesh.vertices, mesh.bones, mesh.shares, moved)
            self._stood = Standing(pose, vertices, carried(*self._marks, moved))
        return self._stood

    def local(self, pose: TreePose) -> LocalTree:
        """Return the body's tree re-expressed about a pose, so that a fit that starts there meets no gimbal lock.

        The ball joints' angles are 0 at ``pose``. The tree's `into` and `back` convert poses to it and back.
        """
        return local_tree(self.mesh.tree, self.balls, pose)
