"""Ground truth of a simulated room, published beside its sensors' frames."""

from __future__ import annotations

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.model.topology import Topology


class Truth(msgspec.Struct, frozen=True, eq=False):
    """The ground truth at the capture of one sensor's frame.

    Attributes:
        sensor, sequence: identity of the frame.
        room_ns: capture time, on the simulated room's clock.
        topology: topology of the skeletons, which need not be the frame's.
        people: (people,) int, numbers of the people, which never change.
        positions: (people, joints, 3) float64, exact joints in the room's world frame [m].
        T_world_sensor: (4, 4) exact pose: from the sensor's camera space to that frame.
        body_people: (bodies,) int, number of the person of each body in the frame.
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
