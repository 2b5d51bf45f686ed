"""Skeletons of one sensor as read from a table in a file, such as a CSV."""

from __future__ import annotations

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.model.topology import Topology


class BodyRows(msgspec.Struct, frozen=True, eq=False):
    """The rows of a file, in its order: each is one body at one instant.

    Attributes:
        source: the file's name, for errors.
        topology: names and order of the joints.
        first_row: number in the file of the arrays' first row, for errors: 2 after a header, otherwise 1.
        time_ns: (rows,) capture times, on the sensor's clock [ns].
        ids: (rows,) tracking id of the body.
        positions: (rows, joints, 3) float32, camera space: x to the sensor's left, y up, z out of the lens [m]; NaN
            where not tracked.
        states: (rows, joints) `JointState`.
    """

    source: str
    topology: Topology
    first_row: int
    time_ns: NDArray[np.int64]
    ids: NDArray[np.int64]
    positions: NDArray[np.float32]
    states: NDArray[np.uint8]
