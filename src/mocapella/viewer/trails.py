"""Trails: the recent paths of people, as fading lines."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.model.scene import Person, Scene
from mocapella.viewer.palette import FLOOR, person_colour
from mocapella.viewer.room import RoomView

Float64 = NDArray[np.float64]

EVERY_S = 0.09
"""Interval between samples of the positions: at 30 frames per second, every third frame [s]."""
LONGEST_S = 60.0
_PARTS = ("root", "head", "hand_left", "hand_right", "foot_left", "foot_right")
_FASTEST_M_S = 8.0
"""A faster change of position is a jump, where the line has a gap [m/s]."""
_LONGEST_GAP_S = 1.0
_OVER_FLOOR_M = 0.012


class TrailOf(StrEnum):
    """Body parts that can leave trails; ``FLOOR`` is the root's projection onto the floor."""

    NOTHING = "off"
    FLOOR = "on the floor"
    HEAD = "head"
    HANDS = "hands"
    FEET = "feet"


@dataclass(frozen=True)
class TrailChoice:
    """A user's choice: the body parts that leave trails, and the duration of the trails [s]."""

    of: TrailOf = TrailOf.NOTHING
    seconds: float = 10.0


_TRACED = {
    TrailOf.NOTHING: (),
    TrailOf.FLOOR: ("root",),
    TrailOf.HEAD: ("head",),
    TrailOf.HANDS: ("hand_left", "hand_right"),
    TrailOf.FEET: ("foot_left", "foot_right"),
}


@dataclass
class _Steps:
    """Samples of one person: times [s], and positions (parts, 3) in the world [m]."""

    at_s: deque[float] = field(default_factory=lambda: deque(maxlen=round(LONGEST_S / EVERY_S)))
    places: deque[Float64] = field(default_factory=lambda: deque(maxlen=round(LONGEST_S / EVERY_S)))


class Trails:
    """Records the world positions of all people's head, hands, feet and root, every `EVERY_S`, for `LONGEST_S`.

    Attributes:
        number: number of samples so far; while it is unchanged, so are the trails.
    """

    def __init__(self) -> None:
        self.number = 0
        self._world = 0
        self._now_s = -np.inf
        self._people: dict[int, _Steps] = {}
        self._who: dict[int, Person] = {}

    def learn(self, scene: Scene, world: int) -> None:
        """Take a sample of the people's positions if `EVERY_S` has passed since the last one.

        Args:
            scene: the newest scene. Nothing is sampled while its time is before the last sample's; more than
                `LONGEST_S` before drops all samples.
            world: number of the world frame (`Perspectives.world`); a change drops all earlier samples.
        """
        at_s = scene.at_ns / NS_PER_S
        if world != self._world or at_s < self._now_s - LONGEST_S:
            self._people, self._world, self._now_s = {}, world, -np.inf
        if at_s < self._now_s + EVERY_S:
            return
        self._now_s = at_s
        self.number += 1
        parts = [scene.topology.parts.get(part, scene.topology.parts["root"]) for part in _PARTS]
        self._who = {person.id: person for person in scene.people}
        for person in scene.people:
            steps = self._people.setdefault(person.id, _Steps())
            steps.at_s.append(at_s)
            steps.places.append(person.positions[parts])
        self._people = {who: steps for who, steps in self._people.items() if steps.at_s[-1] > at_s - LONGEST_S}

    def lines(
        self, of: TrailOf, seconds: float, T_stage: Callable[[Person], Float64 | None], until_s: float = np.inf
    ) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Return the trails of the present people as line segments that fade with age.

        A trail has gaps where a position is unknown, where samples are missing for 1 s, and at jumps.

        Args:
            of: the body parts that leave trails.
            seconds: duration of the trails, above 0 [s].
            T_stage: function of a person that returns the transform (4, 4) from the world to the stage [m]; None for a
                person without one, who gets no trail.
            until_s: end of the trails, on the scenes' common clock [s]; infinite for the newest sample.

        Returns:
            End points (n, 2, 3) on the stage [m], and their colours (n, 2, 3), red, green and blue, 0 to 255.
        """
        now_s = min(self._now_s, until_s)
        points, colours = [np.zeros((0, 2, 3))], [np.zeros((0, 2, 3))]
        for part in _TRACED[of]:
            for who, steps in self._people.items():
                T = T_stage(self._who[who]) if who in self._who else None
                if T is None:
                    continue
                at_s = np.array(steps.at_s)
                path = np.array([place[_PARTS.index(part)] for place in steps.places]) @ T[:3, :3].T + T[:3, 3]
                if of is TrailOf.FLOOR:
                    path[:, 1] = np.where(np.isfinite(path[:, 1]), _OVER_FLOOR_M, np.nan)
                between_s = np.diff(at_s)
                joined = np.linalg.norm(np.diff(path, axis=0), axis=-1) < _FASTEST_M_S * between_s  # not where NaN
                joined &= (between_s < _LONGEST_GAP_S) & (at_s[:-1] >= now_s - seconds) & (at_s[1:] <= now_s)
                points.append(np.stack([path[:-1], path[1:]], axis=1)[joined])
                fresh = np.clip(1 - (now_s - at_s) / seconds, 0, 1)[:, None]
                shade = FLOOR + fresh * (np.array(person_colour(who)) - FLOOR)
                colours.append(np.stack([shade[:-1], shade[1:]], axis=1)[joined])
        return np.concatenate(points).astype(np.float32), np.concatenate(colours).round().astype(np.uint8)


def trail_lines(
    trails: Trails, shown: TrailChoice, room: RoomView, until_s: float = np.inf
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Return people's recent paths on the ROOM stage as line segments that fade with age.

    Args:
        trails: recorded positions.
        shown: the user's choice of body parts and duration.
        room: viewpoint of the drawing.
        until_s: end of the trails, on the scenes' common clock [s]; infinite for the newest sample.
    """

    def to_stage(person: Person) -> Float64 | None:
        T = room.T_perspective_world(person)
        return None if T is None else room.T_stage_perspective @ T

    return trails.lines(shown.of, shown.seconds, to_stage, until_s)
