"""Things about seated people: chair, bag, mask, and harder ones of `SURROUNDINGS`. They hide people and throw shadows.

    things = seated_things(mesh, motion)                  # a chair below, a bag beside, and a mask on the head
    vertices = [thing.vertices(at_s) for thing in things]

A thing is a set of boxes of one dark material. It stands in the room, or moves with a part of a person's body. Most
things came after the empty room was filmed, before the person was; some come during the motion.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError, one_of
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
_STOOL_M: Final = 0.34
"""Width and depth of a stool's seat, and of its foot."""
_BACK_M: Final = 0.42
"""Height of the chair's back above the seat."""
_BAG_M: Final = (0.16, 0.3, 0.34)
_CORNERS: Final = np.array([(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
SURROUNDINGS: Final = ("chair", "table", "screen", "dark", "later", "skirt", "desk", "armchair", "stool")
"""What is about a seated person, beside the chair: nothing; a table whose cloth hides the legs; a screen about them;
nothing in a room as dark as the trousers; things that come during the motion; a skirt; a table without a cloth before
the legs; arm rests; nothing, and the chair is a stool on one column, without a back."""
_SIDES: Final = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
"""Corners of a box's faces −x +x −y +y −z +z, counter-clockwise as seen from outside."""


@dataclass(frozen=True, eq=False)
class LaterThing:
    """A rigid thing that is not in the empty room.

    Attributes:
        mesh: its surface, a mesh of one part; vertices in the world, or in the rest frame of the body that carries it.
        clothes: its material.
        carrier: mesh, motion and index of the part that carries it; None for a thing that stands in the room.
        comes_s: time since the motion's beginning when it comes [s]; before, it has no size.
        lasts_s: duration for which it is moved from ``begin_m`` to its place; 0 if it is there at once [s].
        begin_m: (3,) displacement from its place at which it comes, world [m].
    """

    mesh: RiggedMesh
    clothes: Clothes
    carrier: tuple[RiggedMesh, BodyMotion, int] | None = None
    comes_s: float = -np.inf
    lasts_s: float = 0.0
    begin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def vertices(self, at_s: float) -> Float64:
        """Return the vertices (n, 3) in the world at a time since the motion's beginning [m]."""
        if self.carrier is None:
            if at_s < self.comes_s:
                return np.broadcast_to(self.mesh.vertices.mean(axis=0), self.mesh.vertices.shape)
            left = 0.0 if self.lasts_s == 0 else max(1.0 - (at_s - self.comes_s) / self.lasts_s, 0.0)
            return np.asarray(self.mesh.vertices + left**2 * np.array(self.begin_m))
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


def seated_things(mesh: RiggedMesh, motion: BodyMotion, surroundings: str = "chair") -> tuple[LaterThing, ...]:
    """Return a chair below a person who sits at the motion's start, a bag beside the feet, a mask, and more.

    Args:
        mesh: the person, with hips, knees, ankles and a head.
        motion: the person's motion; sits at its start.
        surroundings: one of `SURROUNDINGS`.

    Raises:
        SettingsError: unknown surroundings; names the known ones.
    """
    if surroundings not in SURROUNDINGS:
        raise SettingsError(f"unknown surroundings {surroundings!r}; known: {one_of(surroundings, SURROUNDINGS)}")
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
    low = 0.5 * (top - _THICK_M)
    for x in (-1.0, 1.0):
        for z in (-1.0, 1.0):
            foot = seat + (half - thick) * (x * aside + z * ahead)
            parts.append((foot * [1.0, 0.0, 1.0] + low * up, np.array([thick, low, thick])))
    if surroundings == "stool":
        parts = _stool(floor, top - _THICK_M, up)
    bag_half = 0.5 * np.array(_BAG_M)
    beside = ankles * [1.0, 0.0, 1.0] - 0.42 * aside + bag_half[1] * up
    things = [(boxes("chair", parts, yaw), _DARK), (boxes("bag", [(beside, bag_half)], yaw + 0.3), _DARK)]
    found = [LaterThing(one, plain_clothes(one, cloth)) for one, cloth in things]
    seat_of = _Seat(np.stack([aside, up, ahead]), yaw, hips, knees, ankles, float(knees[1] + 0.12), half)
    return (*found, *_mask(mesh, motion), *_MORE[surroundings](seat_of))


def _stool(under: Float64, seat_m: float, up: Float64) -> list[tuple[Float64, Float64]]:
    """Return the boxes of a stool: a small seat, a column and a flat foot.

    Args:
        under: (3,) place on the floor below its middle, world [m].
        seat_m: height of the seat's lower side [m].
        up: (3,) unit vector upwards.
    """
    half, thick = 0.5 * _STOOL_M, 0.5 * _THICK_M
    return [
        (under + (seat_m + thick) * up, np.array([half, thick, half])),
        (under + 0.5 * seat_m * up, np.array([2 * thick, 0.5 * seat_m, 2 * thick])),
        (under + thick * up, np.array([half, thick, half])),
    ]


@dataclass(frozen=True, eq=False)
class _Seat:
    """Where a person sits.

    Attributes:
        axes: (3, 3) unit vectors to the left, up and ahead of the person.
        yaw: rotation of these axes about the vertical [rad].
        hips, knees, ankles: (3,) middle of both sides, world [m].
        lap_m: height above the thighs [m].
        half_m: half of the chair's width [m].
    """

    axes: Float64
    yaw: float
    hips: Float64
    knees: Float64
    ankles: Float64
    lap_m: float
    half_m: float

    def box(self, aside: tuple[float, float], up: tuple[float, float], ahead: tuple[float, float]) -> LaterThing:
        """Return a dark box between limits to the left of the hips, above the floor and ahead of the hips [m]."""
        ends = np.array([aside, up, ahead])
        centre = self.hips * [1.0, 0.0, 1.0] + ends.mean(axis=1) @ self.axes
        one = boxes("box", [(centre, 0.5 * (ends[:, 1] - ends[:, 0]))], self.yaw)
        return LaterThing(one, plain_clothes(one, _DARK))

    @property
    def knees_m(self) -> float:
        """Distance of the knees ahead of the hips [m]."""
        return float((self.knees - self.hips) @ self.axes[2])

    @property
    def toes_m(self) -> float:
        """Distance of the toes ahead of the hips [m]."""
        return float((self.ankles - self.hips) @ self.axes[2]) + 0.22


def _table(at: _Seat) -> tuple[LaterThing, ...]:
    """A table before the person, whose cloth hangs to the floor."""
    return (at.box((-0.5, 0.5), (0.0, at.lap_m + 0.04), (0.2, max(at.knees_m, at.toes_m) + 0.25)),)


def _screen(at: _Seat) -> tuple[LaterThing, ...]:
    """Four low panels about the legs and the chair."""
    high, wide, near, far, thick = 0.62, 0.55, -0.5, max(at.knees_m, at.toes_m) + 0.2, 0.03
    return (
        at.box((-wide, wide), (0.0, high), (far, far + thick)),
        at.box((-wide, wide), (0.0, high), (near - thick, near)),
        at.box((-wide - thick, -wide), (0.0, high), (near, far)),
        at.box((wide, wide + thick), (0.0, high), (near, far)),
    )


def _later(at: _Seat) -> tuple[LaterThing, ...]:
    """A box that is pushed to the person's left from the side, and one that is put down before the feet."""
    pushed = at.box((0.34, 0.8), (0.0, 0.6), (-0.1, 0.4))
    put = at.box((-0.3, 0.1), (0.0, 0.3), (at.toes_m + 0.06, at.toes_m + 0.3))
    x, y, z = (1.2 * at.axes[0]).tolist()
    return (
        replace(pushed, comes_s=0.2, lasts_s=0.5, begin_m=(x, y, z)),
        replace(put, comes_s=0.6, lasts_s=0.3, begin_m=(0.0, 0.5, 0.0)),
    )


def _skirt(at: _Seat) -> tuple[LaterThing, ...]:
    """A skirt that covers both thighs, and hangs before the shanks."""
    wide, knees = 0.24, at.knees_m
    low = 0.35 * float(at.knees[1])
    return (
        at.box((-wide, wide), (at.knees[1] - 0.1, at.lap_m - 0.01), (0.0, knees + 0.1)),
        at.box((-wide, wide), (low, at.lap_m - 0.01), (knees - 0.1, knees + 0.12)),
    )


def _desk(at: _Seat) -> tuple[LaterThing, ...]:
    """A table before the person, whose top and legs cross the person's legs in the images."""
    near, far, wide, leg, top = 0.22, at.knees_m + 0.35, 0.5, 0.05, at.lap_m + 0.04
    legs = [at.box((x, x + leg), (0.0, top), (z, z + leg)) for x in (-wide, wide - leg) for z in (near, far - leg)]
    return (at.box((-wide, wide), (top, top + 0.03), (near, far)), *legs)


def _armchair(at: _Seat) -> tuple[LaterThing, ...]:
    """Two arm rests on posts, beside the thighs and the forearms."""
    seat, rest, wide = at.lap_m - 0.15, at.lap_m + 0.1, 0.05
    found: list[LaterThing] = []
    for inner in (at.half_m, -at.half_m - wide):
        across = (inner, inner + wide)
        found.append(at.box(across, (rest, rest + 0.04), (-0.1, 0.28)))
        found += [at.box(across, (seat - 0.1, rest), (z, z + 0.05)) for z in (-0.1, 0.23)]
    return tuple(found)


_MORE: Final[dict[str, Callable[[_Seat], tuple[LaterThing, ...]]]] = {
    "chair": lambda _: (), "table": _table, "screen": _screen, "dark": lambda _: (), "later": _later, "skirt": _skirt,
    "desk": _desk, "armchair": _armchair, "stool": lambda _: (),
}  # fmt: skip


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
