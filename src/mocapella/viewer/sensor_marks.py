"""The marks of the sensors on the Scene stage: pose, colour, label and field of view."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from mocapella.model.conditions import is_warning, trouble
from mocapella.model.scene import SensorPlace
from mocapella.viewer import layout
from mocapella.viewer.palette import AMBER, GREY, RED, Rgb

Float64 = NDArray[np.float64]

REACH_M = 4.5
"""Length of a drawn field of view: the largest distance of people that a Kinect v2 tracks [m]."""


class PlaceState(Enum):
    """Reliability of a sensor's pose: good; with a problem; known before but not now; not calibrated yet."""

    GOOD = "good"
    DOUBTED = "doubted"
    LOST = "lost"
    UNKNOWN = "unknown"


_SAID = {PlaceState.DOUBTED: "in doubt", PlaceState.LOST: "not used", PlaceState.UNKNOWN: "not calibrated yet"}
_COLOUR = {PlaceState.DOUBTED: AMBER, PlaceState.LOST: RED, PlaceState.UNKNOWN: GREY}


@dataclass(frozen=True, eq=False)
class SensorMark:
    """Mark of a sensor on the stage.

    Attributes:
        T: (4, 4) transform from the sensor's camera space to the view's space [m]; beside the stage if the pose is
            unknown.
        standing: reliability of the pose.
        words: label: the sensor's name and problem.
    """

    T: Float64
    standing: PlaceState
    words: str

    def colour(self, own: Rgb) -> Rgb:
        """Return the mark's colour: the sensor's ``own`` colour, or the colour of the pose's problem."""
        return _COLOUR.get(self.standing, own)


def standing(place: SensorPlace, was_placed: bool) -> PlaceState:
    """Return the reliability of a sensor's pose; ``was_placed`` is whether the pose was known in an earlier scene."""
    if place.T_world_sensor is None:
        return PlaceState.LOST if was_placed else PlaceState.UNKNOWN
    return PlaceState.DOUBTED if is_warning(place.problem) else PlaceState.GOOD


def words(place: SensorPlace, how: PlaceState) -> str:
    """Return a sensor's label, such as ``left``, ``left · not calibrated yet`` or ``left · not used: it was moved``.

    Args:
        place: the sensor's pose and problem.
        how: reliability of the pose.
    """
    if how is PlaceState.GOOD:
        return place.sensor
    why = trouble(place.problem).partition(": ")[0].partition(" (")[0] if how is PlaceState.LOST else ""
    return f"{place.sensor} · {_SAID[how]}{f': {why}' if why else ''}"


def marks(
    places: tuple[SensorPlace, ...], remembered: Mapping[str, Float64], T_stage_world: Float64 | None
) -> dict[str, SensorMark]:
    """Return the marks of all sensors of a scene, by sensor.

    Args:
        places: sensor poses of the scene.
        remembered: last known pose T_world_sensor (4, 4) of each sensor, by sensor [m].
        T_stage_world: (4, 4) transform from the world to the stage [m]; None if the perspective's pose in the world is
            unknown.
    """
    made: dict[str, SensorMark] = {}
    aside = 0
    for place in places:
        how = standing(place, place.sensor in remembered)
        T = remembered.get(place.sensor)
        if T is None or T_stage_world is None:
            where, aside = layout.aside(aside), aside + 1
        else:
            where = T_stage_world @ T
        made[place.sensor] = SensorMark(where, how, words(place, how))
    return made


def field_lines(T: Float64, field_deg: tuple[float, float]) -> NDArray[np.float32]:
    """Return the edges of a sensor's field of view, a pyramid of height `REACH_M`, as (8, 2, 3) end points [m].

    Args:
        T: (4, 4) transform from the sensor's camera space to the view's space [m].
        field_deg: horizontal and vertical field of view [°].
    """
    x, y = np.tan(np.radians(field_deg) / 2)
    corners = np.array([[x, y, 1.0], [-x, y, 1.0], [-x, -y, 1.0], [x, -y, 1.0]]) * REACH_M
    far = corners @ T[:3, :3].T + T[:3, 3]
    edges = [
        np.stack([np.broadcast_to(T[:3, 3], far.shape), far], axis=1),
        np.stack([far, np.roll(far, -1, 0)], axis=1),
    ]
    return np.concatenate(edges).astype(np.float32)
