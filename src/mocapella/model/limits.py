"""Limits of values and quantities: one table for the decoders, the settings, the trackers and the server."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Range:
    """Valid values of a number, both ends included.

    Attributes:
        low, high: the smallest and the largest value.
        unit: unit of the values, such as ``rad``; empty for a number without one.
    """

    low: float
    high: float
    unit: str = ""

    def __contains__(self, value: object) -> bool:
        """Whether a number is valid; NaN is not."""
        return isinstance(value, int | float) and self.low <= value <= self.high

    def __str__(self) -> str:
        """Return such as ``from -3.14159 to 3.14159 rad``."""
        return f"from {_short(self.low)} to {_short(self.high)}{f' {self.unit}' if self.unit else ''}"


def _short(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:g}"


COORDINATE: Final = Range(-1000.0, 1000.0, "m")
"""Coordinates in frames; there is no skeleton at a distance of a kilometre."""
SCENE_COORDINATE: Final = Range(-1e6, 1e6, "m")
"""Coordinates in scenes; wider, because predictions from wrong frames may be far off, and must still be readable."""
TILT: Final = Range(-math.pi, math.pi, "rad")
"""Upward tilt of a sensor."""
FRAME_HEIGHT: Final = Range(-1000.0, 1000.0, "m")
"""Height of a sensor above the floor in its frames; 0 or less is unknown."""
SENSOR_HEIGHT: Final = Range(0.0, FRAME_HEIGHT.high, "m")
"""Height of a sensor above the floor, as set up and as used; 0 is unknown."""

MOST_SENSORS: Final = 64
"""Largest number of sensors of a session."""
SENSORS_EXPECTED: Final = Range(1, MOST_SENSORS)
"""Number of sensors to wait for before calibrating."""
PARTICIPANT: Final = Range(-(2**31), 2**31 - 1)
"""Number of a participant; any that a study log and a take can store."""

MOST_UNPROVEN: Final = 16
"""Largest number of sensors that have not sent a valid frame yet; further ones are refused."""
UNPROVEN_S: Final = 10.0
"""A sensor without a valid frame and without a connection is forgotten after this time [s]."""
STRANGERS_WAITING: Final = 16
"""Largest number of waiting messages from all sensors that are not registered yet; the oldest ones are dropped."""
STRANGERS_A_SECOND: Final = 200
"""Largest rate at which messages from sensors that are not registered yet are decoded [messages/s]."""
MOST_REFUSED_NODES: Final = 256
"""Largest number of refused nodes to remember, so that each is reported once."""

MOST_COMMANDS: Final = 64
"""Largest number of commands that wait for the tracker; further ones are refused."""
MOST_COMMANDS_OF_A_CLIENT: Final = 16
"""Largest number of waiting commands of one client; further ones are refused."""
COMMANDS_A_SECOND: Final = 4.0
"""Largest mean rate at which one client's commands are carried out; others wait [commands/s]."""
COMMANDS_AT_ONCE: Final = MOST_COMMANDS_OF_A_CLIENT
"""Largest number of one client's commands that are carried out without a pause, after a time with none."""
MAX_COMMAND_BYTES: Final = 1024 * 1024
"""Largest size of a command's encoded arguments [bytes]."""

NOTICES_A_SECOND: Final = 5
"""Largest mean rate at which notices about other programs are shown; others are only counted [notices/s]."""
NOTICES_AT_ONCE: Final = 20
"""Largest number of notices about other programs to show at once."""
LONGEST_NOTICE: Final = 500
"""Longest notice, in characters; longer ones are cut."""
