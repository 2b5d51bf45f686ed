"""Static objects of a simulated room, and the poses of its sensors, for the view."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Solid:
    """A static object as triangles.

    Attributes:
        vertices: (n, 3) float32, in the room's frame [m].
        faces: (m, 3) uint32, indices of each triangle's vertices, counter-clockwise as seen from outside.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.uint32]


@dataclass(frozen=True, eq=False)
class Scenery:
    """The objects of a room, and the true poses of its sensors, by which a view can place the objects.

    Attributes:
        solids: the objects.
        T_room_sensor: (4, 4) from each sensor's camera frame to the room, by sensor.
    """

    solids: tuple[Solid, ...]
    T_room_sensor: Mapping[str, NDArray[np.float64]]
