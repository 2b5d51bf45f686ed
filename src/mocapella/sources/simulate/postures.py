"""Exercises in place: how a standing body sinks, leans and moves its arms. The values are ours."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from mocapella.errors import SettingsError, one_of

RISE_S: Final = 0.8
"""Duration of the transition from standing into a posture, and of the return [s]."""


@dataclass(frozen=True)
class BodyPosture:
    """An exercise in place, as deviation from standing.

    Attributes:
        period_s: period in which the posture is assumed and left again; 0 holds it [s].
        sink: distance by which the pelvis sinks, as a fraction of the legs' length.
        back: distance by which the pelvis goes back, as a fraction of stature.
        lean: angle by which the trunk leans forward [rad].
        reach: weight of both arms stretched forward, 0 to 1.
        lap: weight of both hands on the thighs, 0 to 1.
        across: weight of the right arm in front of the chest, 0 to 1.
        wave: weight of the right hand waving beside the head, 0 to 1.
    """

    period_s: float = 0.0
    sink: float = 0.0
    back: float = 0.0
    lean: float = 0.0
    reach: float = 0.0
    lap: float = 0.0
    across: float = 0.0
    wave: float = 0.0


STANDING: Final = BodyPosture()
POSTURES: Final[Mapping[str, BodyPosture]] = {
    "squat": BodyPosture(period_s=2.4, sink=0.45, back=0.13, lean=0.6, reach=1.0),
    "sit": BodyPosture(sink=0.5, back=0.24, lean=0.1, lap=1.0),
    "bend": BodyPosture(period_s=4.0, back=0.06, lean=1.1),
    "wave": BodyPosture(wave=1.0),
    "arm-across": BodyPosture(across=1.0),
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
