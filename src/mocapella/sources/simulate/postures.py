"""Postures and exercises in place: how a standing body sinks, leans and holds its arms. The values are ours."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

from mocapella.errors import SettingsError, one_of

RISE_S: Final = 0.8
"""Duration of the transition from standing into a posture, and of the return [s]."""
Direction = tuple[float, float, float]
"""Components of a direction ahead of the chest, out to the arm's side, and up; of any length."""


class ArmDirections(NamedTuple):
    """Directions of an arm's bones.

    Attributes:
        upper, fore: directions of the upper arm, and of forearm and hand.
        thumb: direction of the thumb, besides along the forearm.
        sides: the arms that have this pose.
        waves: whether the forearm waves about ``fore``, up and out.
    """

    upper: Direction
    fore: Direction
    thumb: Direction = (0.0, 0.0, 1.0)
    sides: tuple[str, ...] = ("Left", "Right")
    waves: bool = False


_RIGHT: Final = ("Right",)
ARM_POSES: Final[Mapping[str, ArmDirections]] = {
    "reach": ArmDirections((0.97, 0.1, -0.2), (0.98, 0.0, -0.1)),
    "lap": ArmDirections((0.45, 0.15, -0.88), (0.88, -0.1, -0.45)),
    "across": ArmDirections((0.85, -0.42, -0.3), (0.95, -0.1, 0.0), sides=_RIGHT),
    "wave": ArmDirections((0.3, 0.85, 0.1), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), sides=_RIGHT, waves=True),
    "behind": ArmDirections((-0.45, 0.25, -0.86), (-0.3, -0.9, -0.25), (-1.0, 0.0, 0.0)),
    "pocket": ArmDirections((-0.5, 0.2, -0.84), (-0.05, -0.35, -0.93), (-1.0, 0.0, 0.0), sides=_RIGHT),
    "hips": ArmDirections((-0.2, 0.75, -0.63), (0.3, -0.75, -0.6), (-1.0, 0.0, 0.0)),
    "crossed": ArmDirections((0.35, 0.1, -0.93), (0.5, -0.86, 0.1)),
    "phone": ArmDirections((0.3, 0.45, -0.84), (0.1, -0.3, 0.95), (1.0, 0.0, 0.0), sides=_RIGHT),
    "up": ArmDirections((0.05, 0.3, 0.95), (0.0, 0.05, 1.0), (1.0, 0.0, 0.0)),
    "out": ArmDirections((0.0, 1.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)),
    "point": ArmDirections((0.95, 0.2, 0.1), (0.97, 0.1, 0.15), sides=_RIGHT),
    "head": ArmDirections((0.1, 0.75, 0.65), (0.0, -0.75, 0.65), (-1.0, 0.0, 0.0)),
}


@dataclass(frozen=True)
class BodyPosture:
    """A posture or an exercise in place, as deviation from standing.

    Attributes:
        period_s: duration from one assumption of the posture to the next; 0 holds it [s].
        sink: downward displacement of the pelvis, as a fraction of the legs' length.
        back: backward displacement of the pelvis, as a fraction of stature; negative: ahead.
        lean: forward lean of the trunk; negative: back [rad].
        arms: pose of the arms, a key of `ARM_POSES`; None lets them hang.
    """

    period_s: float = 0.0
    sink: float = 0.0
    back: float = 0.0
    lean: float = 0.0
    arms: str | None = None


STANDING: Final = BodyPosture()
POSTURES: Final[Mapping[str, BodyPosture]] = {
    "squat": BodyPosture(period_s=2.4, sink=0.45, back=0.13, lean=0.6, arms="reach"),
    "sit": BodyPosture(sink=0.5, back=0.24, lean=0.1, arms="lap"),
    "bend": BodyPosture(period_s=4.0, back=0.06, lean=1.1),
    "wave": BodyPosture(arms="wave"),
    "arm-across": BodyPosture(arms="across"),
    "hands-behind": BodyPosture(arms="behind"),
    "back-pocket": BodyPosture(arms="pocket"),
    "hands-on-hips": BodyPosture(arms="hips"),
    "arms-crossed": BodyPosture(arms="crossed"),
    "phone": BodyPosture(lean=0.05, arms="phone"),
    "arms-up": BodyPosture(arms="up"),
    "arms-out": BodyPosture(arms="out"),
    "point": BodyPosture(arms="point"),
    "hands-on-head": BodyPosture(arms="head"),
    "crouch": BodyPosture(sink=0.68, back=0.05, lean=0.6, arms="lap"),
    "lean-back": BodyPosture(sink=0.5, back=0.24, lean=-0.4, arms="lap"),
    "sit-crossed": BodyPosture(sink=0.5, back=0.24, arms="crossed"),
    "kneel": BodyPosture(sink=0.48, back=-0.24),
    "crawl": BodyPosture(sink=0.48, back=-0.24, lean=1.4),
    "bow": BodyPosture(back=0.08, lean=1.4),
    "lie-back": BodyPosture(sink=0.93, back=0.47, lean=-1.5),
    "lie-front": BodyPosture(sink=0.93, back=-0.47, lean=1.5),
}
WAVE_PERIOD_S: Final = 1.1
"""Period of a waving forearm [s]."""
WAVE: Final = math.radians(35)
"""Amplitude of a waving forearm [rad]."""


def posture(name: str) -> BodyPosture:
    """Look up a posture of `POSTURES` by name.

    Raises:
        SettingsError: unknown posture; lists the known ones.
    """
    if name not in POSTURES:
        raise SettingsError(f"unknown posture {name!r}; known: {one_of(name, POSTURES)}")
    return POSTURES[name]
