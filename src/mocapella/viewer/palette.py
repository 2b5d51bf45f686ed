"""Colours that are distinct on a dark background, as far as possible also for colour-blind people."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

_PAINT_GAMMA = 2.2


class Rgb(NamedTuple):
    """A colour: red, green and blue, 0 to 255."""

    red: int
    green: int
    blue: int

    @property
    def css(self) -> str:
        """The colour as ``#rrggbb``, for style sheets."""
        return f"#{self.red:02x}{self.green:02x}{self.blue:02x}"

    @property
    def paint(self) -> Rgb:
        """Darker colour for surfaces, which look like this colour under the lights of the 3D scene."""
        return Rgb(*(round(255 * (channel / 255) ** _PAINT_GAMMA) for channel in self))

    @property
    def faint(self) -> Rgb:
        """Dimmed surface colour, for lines and bones in the background."""
        return Rgb(*(round(0.35 * channel) for channel in self.paint))


FUSED = Rgb(255, 255, 255)
"""Colour of the fused skeleton."""
FILLED = Rgb(40, 235, 110)
"""Colour of a joint of the fused skeleton that another sensor measures, but not the perspective's sensor."""
INFERRED = Rgb(128, 140, 164)
"""Colour of a joint of the fused skeleton that no sensor measures."""
OBSTACLE = Rgb(186, 194, 214)
EYE = Rgb(24, 40, 84)
FLOOR = Rgb(20, 27, 40)
CLOTH = Rgb(90, 130, 255), Rgb(225, 232, 255)
"""Colours of a cloth's checks."""
GREEN, AMBER, BLUE, RED, GREY = (
    Rgb(61, 220, 151),
    Rgb(255, 184, 77),
    Rgb(94, 176, 255),
    Rgb(255, 107, 107),
    Rgb(138, 151, 171),
)
"""Colours of states: good; waiting or in doubt; in progress; faulty; off."""

PEOPLE = (
    Rgb(46, 196, 255),
    Rgb(255, 92, 168),
    Rgb(255, 226, 64),
    Rgb(176, 132, 255),
    Rgb(255, 159, 28),
    Rgb(154, 230, 72),
)
SENSORS = (
    Rgb(64, 150, 255),
    Rgb(0, 212, 170),
    Rgb(226, 116, 255),
    Rgb(176, 226, 70),
    Rgb(255, 130, 200),
    Rgb(240, 232, 190),
)
"""Colours of sensors, without amber and red, which mark sensors with a problem."""


def person_colour(person: int) -> Rgb:
    """Return a person's colour by the person's id; after six ids, colours repeat."""
    return PEOPLE[person % len(PEOPLE)]


class SensorColours:
    """Assigns colours to sensors in the order of their names, so that the same room always has the same colours."""

    def __init__(self) -> None:
        self._sensors: tuple[str, ...] = ()

    def learn(self, sensors: Collection[str]) -> None:
        """Add sensors by name. A new sensor changes the colours of the sensors whose names sort after its own."""
        if not set(self._sensors).issuperset(sensors):
            self._sensors = tuple(sorted({*self._sensors, *sensors}))

    def of(self, sensor: str) -> Rgb:
        """Return a sensor's colour; an unknown sensor is added. After six sensors, colours repeat."""
        self.learn((sensor,))
        return SENSORS[self._sensors.index(sensor) % len(SENSORS)]

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of all sensors so far, sorted."""
        return self._sensors
