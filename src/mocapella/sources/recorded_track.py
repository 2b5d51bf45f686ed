"""One sensor's recorded rows, each a body at an instant, as frames in the order of capture."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.model.observations import BodyFrame
from mocapella.model.topology import Topology

MAX_STEP_BACK: Final = 0.5
"""Out-of-order frames of a sensor are sorted, up to this far back [s]."""
MAX_LENGTH: Final = 86_400.0
"""Longest time from a sensor's first row in a file to any later row [s]."""
ONE_RUN: Final = "a file is one run of the sensors: split it where the time restarts"
"""Advice for a file whose times go back or leap."""


class ReplayReport(msgspec.Struct, frozen=True):
    """Counts of a replay.

    Attributes:
        rows: number of replayed rows: all rows of the file; of a study log, those of the chosen placement.
        frames: number of frames made of these rows; a sensor's bodies of one instant are one frame.
        duplicates_dropped: number of rows that repeat a person's skeleton of the same sensor and instant.
        sorted: number of rows that follow a newer row of their sensor in the file.
        joints_not_tracked: number of joints in the frames that are not tracked.
    """

    rows: int
    frames: int
    duplicates_dropped: int
    sorted: int
    joints_not_tracked: int


class FrameOrder(NamedTuple):
    """How rows become frames.

    Attributes:
        kept: indices of the rows in the order of capture, then of bodies, without repeated ones.
        repeated: indices of the rows that repeat a body and instant, each after the row of ``kept`` that it repeats.
        first: index of the row of ``kept`` that each of ``repeated`` repeats.
        starts: (frames + 1,), frame i has the rows ``kept[starts[i] : starts[i + 1]]``.
        sorted: number of kept rows that follow a newer row.
    """

    kept: NDArray[np.intp]
    repeated: NDArray[np.intp]
    first: NDArray[np.intp]
    starts: list[int]
    sorted: int


def order_rows(time_ns: NDArray[np.int64], ids: NDArray[np.int64]) -> FrameOrder:
    """Sort rows, each a body at an instant, into frames; of rows with equal body and time, the first is kept.

    Args:
        time_ns: (rows,) capture times [ns].
        ids: (rows,) tracking ids of the bodies.
    """
    order = np.lexsort((ids, time_ns))  # stable: of duplicates, the first in the file is first
    repeats = np.append(False, (np.diff(time_ns[order]) == 0) & (np.diff(ids[order]) == 0))
    kept = order[~repeats]
    first = kept[np.cumsum(~repeats) - 1][repeats]
    starts = np.flatnonzero(np.append(True, np.diff(time_ns[kept]) > 0))
    late = (np.maximum.accumulate(time_ns) > time_ns)[kept]
    return FrameOrder(kept, order[repeats], first, [*starts.tolist(), len(kept)], int(late.sum()))


class RecordedTrack(msgspec.Struct, frozen=True, eq=False):
    """One sensor's rows as frames.

    Attributes:
        sensor: its name.
        topology: names and order of the joints.
        bodies: fields of `BodyFrame` by name, each an array over the bodies of all frames, in the order of capture.
        starts: (frames + 1,), frame i has the bodies ``starts[i]`` to ``starts[i + 1] - 1``.
        tilt, height: (frames,) tilt of the sensor [rad] and its height above the floor [m]; 0 if the file has none.
        time_ns: (frames,) capture times on the sensor's own clock, strictly rising [ns].
        at_ns: (frames,) capture times in Unix time, or on the sensor's clock if the file has no other [ns].
        duplicates_dropped, sorted: see `ReplayReport`.
    """

    sensor: str
    topology: Topology
    bodies: dict[str, NDArray[Any]]
    starts: list[int]
    tilt: list[float]
    height: list[float]
    time_ns: NDArray[np.int64]
    at_ns: NDArray[np.int64]
    duplicates_dropped: int
    sorted: int

    def frame(self, number: int) -> BodyFrame:
        """Make the sensor's frame of this number, from 0."""
        first, end = self.starts[number], self.starts[number + 1]
        return BodyFrame(
            sensor=self.sensor,
            node_id=0,
            sequence=number,
            time_ns=int(self.time_ns[number]),
            sent_ns=0,
            topology=self.topology,
            depth_size_px=(0, 0),
            tilt=self.tilt[number],
            height=self.height[number],
            **{name: values[first:end] for name, values in self.bodies.items()},
        )
