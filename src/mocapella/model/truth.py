"""Ground truth of a simulated room, published beside its sensors' frames."""

from __future__ import annotations

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.model.topology import Topology


class Truth(msgspec.Struct, frozen=True, eq=False):
    """The ground truth at the capture of one sensor's frame.

    Attributes:
        sensor, sequence: the frame that it belongs to.
        room_ns: the room's own time.
        topology: of the people.
        people: (people,) int, who they are; never changes.
        positions: (people, joints, 3) float64, world [m].
        T_world_sensor: (4, 4), where the sensor stands.
        body_people: (bodies,) int, for each body of the frame, who it is.
        mirrored: (bodies,) bool, whether the sensor swapped left and right.
    """

    sensor: str
    sequence: int
    room_ns: int
    topology: Topology
    people: NDArray[np.int64]
    positions: NDArray[np.float64]
    T_world_sensor: NDArray[np.float64]
    body_people: NDArray[np.int64]
    mirrored: NDArray[np.bool_]
