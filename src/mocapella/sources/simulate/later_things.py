"""Things that came after the empty room was filmed: a chair, a bag, a mask. They hide people and throw shadows.

    things = seated_things(mesh, motion)                  # a chair below, a bag beside, and a mask on the head
    vertices = [thing.vertices(at_s) for thing in things]

A thing is a set of boxes of one dark material. It stands in the room, or moves with a part of a person's body.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.rigid import rotation_about_y
from mocapella.model.rigged_mesh import RiggedMesh, landmarks_at, posed
from mocapella.model.twist_tree import TwistTree, motions
from mocapella.sources.simulate.body_motion import BodyMotion
from mocapella.sources.simulate.outfits import Clothes, Garment, plain_clothes

Float64 = NDArray[np.float64]

_DARK: Final = Garment("plain", (0.03, 0.028, 0.027))
_FUR: Final = Garment("plain", (0.2, 0.13, 0.07))
_SEAT_M: Final = 0.46
"""Width and depth of a chair's seat."""
_BEHIND_M: Final = 0.14
"""Distance of the seat's back edge behind the hips."""
_THICK_M: Final = 0.05
_BACK_M: Final = 0.42
"""Height of the chair's back above the seat."""
_BAG_M: Final = (0.16, 0.3, 0.34)
_CORNERS: Final = np.array([(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
_SIDES: Final = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
"""Corners of a box's faces −x +x −y +y −z +z, counter-clockwise as seen from outside."""


@dataclass(frozen=True, eq=False)
class LaterThing:
    """A rigid thing that is not in the empty room.

    Attributes:
        mesh: its surface, a mesh of one part; vertices in the world, or in the rest frame of the body that carries it.
        clothes: its material.
        carrier: mesh, motion and index of the part that carries it; None for a thing that stands in the room.
    """

    mesh: RiggedMesh
    clothes: Clothes
    carrier: tuple[RiggedMesh, BodyMotion, int] | None = None

    def vertices(self, at_s: float) -> Float64:
        """Return the vertices (n, 3) in the world at a time since the motion's beginning [m]."""
        if self.carrier is None:
            return self.mesh.vertices
        body, motion, part = self.carrier
        R, t = motions(body.tree, motion.pose(at_s))
        return np.asarray(self.mesh.vertices @ R[part].reshape(3, 3).T + t[part])


def boxes(name: str, placed: Sequence[tuple[Float64, Float64]], yaw: float = 0.0) -> RiggedMesh:
    """Return a mesh of boxes, each with vertices of its own at every face, so that its edges are sharp.

    Args:
        name: name of the mesh.
        placed: centre (3,) and half edges (3,) of each box [m].
        yaw: rotation of every box about the vertical through its own centre [rad].
    """
    points: list[Float64] = []
    faces: list[tuple[int, int, int]] = []
    for centre, half in placed:
        corners = (_CORNERS * half) @ rotation_about_y(yaw).T + centre
        for side in _SIDES:
            first = 4 * len(points)
            points.append(corners[list(side)])
            faces += [(first, first + 1, first + 2), (first, first + 2, first + 3)]
    vertices = np.concatenate(points)
    tree = TwistTree(
        np.array([-1], np.int64), np.empty(0, np.int64), np.empty((0, 6)), np.empty((0, 2)), vertices.mean(axis=0)
    )
    count = len(vertices)
    return RiggedMesh(
        name, tree, (name,), (), vertices, np.array(faces, np.int32), np.zeros((count, 1), np.int32),
        np.ones((count, 1)), {},
    )  # fmt: skip


def seated_things(mesh: RiggedMesh, motion: BodyMotion) -> tuple[LaterThing, ...]:
    """Return a chair below a person who sits at the motion's start, a bag beside the feet, and a mask on the head.

    Args:
        mesh: the person, with hips, knees, ankles and a head.
        motion: the person's motion; sits at its start.
    """
    pose = motion.pose(0.0)
    at = dict(zip(mesh.landmarks, landmarks_at(mesh, pose), strict=True))
    hips, knees, ankles = (0.5 * (at[f"left {name}"] + at[f"right {name}"]) for name in ("hip", "knee", "ankle"))
    ahead = (knees - hips) * [1.0, 0.0, 1.0]
    ahead /= np.linalg.norm(ahead)
    aside, up = np.cross([0.0, 1.0, 0.0], ahead), np.array([0.0, 1.0, 0.0])
    yaw = float(np.arctan2(ahead[0], ahead[2]))
    vertices = posed(mesh, pose)
    over_seat = np.abs((vertices - hips) @ ahead) < 0.5 * _BEHIND_M
    top = float(vertices[over_seat & (vertices[:, 1] > 0.5 * hips[1]), 1].min())
    trunk = (vertices[:, 1] > hips[1]) & (vertices[:, 1] < hips[1] + _BACK_M)
    behind = max(_BEHIND_M, -float(((vertices[trunk] - hips) @ ahead).min())) + 0.01
    floor = hips * [1.0, 0.0, 1.0]
    half, thick = 0.5 * _SEAT_M, 0.5 * _THICK_M
    seat = floor + (half - behind) * ahead + (top - thick) * up
    back = floor - (behind + thick) * ahead + (top + 0.5 * _BACK_M) * up
    parts = [(seat, np.array([half, thick, half])), (back, np.array([half, 0.5 * _BACK_M + _THICK_M, thick]))]
    for x in (-1.0, 1.0):
        for z in (-1.0, 1.0):
            foot = seat + (half - thick) * (x * aside + z * ahead)
            low = 0.5 * (top - _THICK_M)
            parts.append((foot * [1.0, 0.0, 1.0] + low * up, np.array([thick, low, thick])))
    bag_half = 0.5 * np.array(_BAG_M)
    beside = ankles * [1.0, 0.0, 1.0] - 0.42 * aside + bag_half[1] * up
    things = [(boxes("chair", parts, yaw), _DARK), (boxes("bag", [(beside, bag_half)], yaw + 0.3), _DARK)]
    found = [LaterThing(one, plain_clothes(one, cloth)) for one, cloth in things]
    return (*found, *_mask(mesh, motion))


def _mask(mesh: RiggedMesh, motion: BodyMotion) -> tuple[LaterThing, ...]:
    """Return a mask with a snout and ears that the person wears; none for a body without a head."""
    nose, head = mesh.landmarks.get("nose"), mesh.landmarks.get("head")
    if nose is None or head is None:
        return ()
    middle = 0.5 * (nose.point + head.point) * [0.0, 1.0, 0.5]
    snout = nose.point + np.array([0.0, -0.01, 0.06])
    ears = [head.point + np.array([side * 0.08, 0.05, 0.0]) for side in (-1.0, 1.0)]
    small = np.array([0.035, 0.06, 0.02])
    placed = [(middle, np.array([0.1, 0.14, 0.12])), (snout, np.array([0.06, 0.05, 0.08]))]
    one = boxes("mask", placed + [(ear, small) for ear in ears])
    return (LaterThing(one, plain_clothes(one, _FUR), (mesh, motion, nose.part)),)
