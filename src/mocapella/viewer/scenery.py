"""Draw the obstacles of a simulated room on the stages of the view."""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.rigid import apply, inverse
from mocapella.model.scenery import Scenery
from mocapella.viewer.meshes import Mesh
from mocapella.viewer.palette import OBSTACLE
from mocapella.viewer.perspective import FREE
from mocapella.viewer.room import RoomView
from mocapella.viewer.stage import Surface

Float64 = NDArray[np.float64]

PROP: Final = "scenery"
"""Name of the prop, a function given to the view, that returns a `Scenery`."""
_OPACITY: Final = 0.32
"""Opacity of obstacles on the Scene stage, so that people behind them are visible."""
_DECIMALS: Final = 3
"""Decimals of an obstacle's rounded pose [m]; smaller changes do not redraw it."""


def room_surfaces(scenery: Scenery, room: RoomView) -> dict[str, Surface]:
    """Return the obstacles in a perspective as meshes in the view's space, by name.

    The result is empty until the pose of a simulated sensor is known in the perspective.

    Args:
        scenery: obstacles and true sensor poses of the simulated room.
        room: viewpoint of the drawing.
    """
    T = _stage_room(scenery, room)
    return {} if T is None else _surfaces(scenery, T, _OPACITY)


def lane_surfaces(scenery: Scenery, sensor: str, T_view_sensor: Float64) -> dict[str, Surface]:
    """Return the obstacles in a sensor's lane as meshes, by name; empty for a sensor outside the simulated room.

    Args:
        scenery: obstacles and true sensor poses of the simulated room.
        sensor: name of the sensor.
        T_view_sensor: (4, 4) transform from the sensor's camera space to its lane in the view's space, including the
            gallery's scale [m].
    """
    if sensor not in scenery.T_room_sensor:
        return {}
    return _surfaces(scenery, T_view_sensor @ inverse(scenery.T_room_sensor[sensor]), 1.0)


def _stage_room(scenery: Scenery, room: RoomView) -> Float64 | None:
    perspective, known = room.perspective, scenery.T_room_sensor
    if perspective in known:
        return room.T_stage_perspective @ inverse(known[perspective])
    places = room.seen.places
    for sensor, T_room_sensor in known.items():
        if sensor in places and (perspective == FREE or perspective in places):
            return room.T_stage_world @ places[sensor] @ inverse(T_room_sensor)
    return None


def _surfaces(scenery: Scenery, T: Float64, opacity: float) -> dict[str, Surface]:
    meshes = _meshes(scenery, (T[:3].round(_DECIMALS) + 0.0).tobytes())
    return {f"solid {k}": Surface(mesh, OBSTACLE, opacity) for k, mesh in enumerate(meshes)}


@lru_cache(maxsize=64)
def _meshes(scenery: Scenery, rows: bytes) -> tuple[Mesh, ...]:
    """Return the solids transformed by the ``rows`` (3, 4) of a matrix; equal rows give the same mesh objects."""
    T = np.vstack([np.frombuffer(rows).reshape(3, 4), [0.0, 0.0, 0.0, 1.0]])
    return tuple(Mesh(apply(T, solid.vertices).astype(np.float32), solid.faces) for solid in scenery.solids)
