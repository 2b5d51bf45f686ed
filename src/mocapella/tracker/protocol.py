"""What every tracking method offers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.sensor_layout import SensorLayout
from mocapella.model.bodies import BodyKey
from mocapella.model.observations import Arrival
from mocapella.model.scene import Scene, SensorPlace, TrackerState
from mocapella.model.topology import Topology
from mocapella.model.topology import topology as named_topology

Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class TrackerReport:
    """What came of all frames so far.

    Attributes:
        frames: that came in.
        kept: that were used.
        rejected: how many were not, by the reason.
        calibrations: that were completed.
        restarts: how often a calibration began again.
    """

    frames: int
    kept: int
    rejected: Mapping[str, int]
    calibrations: int
    restarts: int


class SensorViews(msgspec.Struct, frozen=True, eq=False):
    """What a method knows of the sensors after a frame; it is applied to *later* frames only.

    Attributes:
        T_world_sensor: (4, 4) by sensor: one motion, shared by all people; a sensor that is not in it is unknown.
        time_offset_s: by sensor: its frames were captured so much later than their ``at_ns`` says [s]. Two sensors
            that are both in it have their views brought to one instant; others are compared as they came.
        swapped: the views whose left and right labels are to be swapped so that the sensors agree.
    """

    T_world_sensor: Mapping[str, Float64]
    time_offset_s: Mapping[str, float] = {}
    swapped: frozenset[BodyKey] = frozenset()


def scene_at(
    arrival: Arrival,
    step: int,
    state: TrackerState,
    parts: Mapping[str, tuple[Any, ...]],
    *,
    topology: Topology | None = None,
    sensors: tuple[SensorPlace, ...] = (),
) -> Scene:
    """The scene of a step.

    Args:
        arrival: whose frame made it.
        step: its number.
        state: where the tracker stands.
        parts: by the name of their type.
        topology: of the skeletons; any where there are none.
        sensors: where they stand.
    """
    frame = arrival.frame
    of = topology or named_topology("kinect_v2")
    return Scene(step, arrival.at_ns, frame.sensor, frame.node_id, frame.sequence, of, state, parts, sensors)


class Tracker(Protocol):
    """One step a frame. The same arrivals and commands in the same order give the same scenes, to the bit."""

    def update(self, arrival: Arrival) -> Scene:
        """Take one frame in and say what there is now. A frame that cannot be used is counted and changes nothing."""

    def recalibrate(self, reason: str) -> None:
        """Begin the calibration again; the next scene says why."""

    def reset(self) -> None:
        """Forget everything, as if newly made."""

    def snapshot(self) -> bytes:
        """All that it remembers: a new tracker of the same settings that restores it goes on to the bit alike."""

    def restore(self, data: bytes) -> None:
        """Remember what a `snapshot` holds, and nothing else.

        Raises:
            WireError: the bytes are no snapshot of this method.
        """

    @property
    def report(self) -> TrackerReport:
        """What came of all frames so far."""


@runtime_checkable
class KeepsLayout(Protocol):
    """A tracker that finds out where the sensors are, so that it can be kept for the next time."""

    def use_layout(self, layout: SensorLayout) -> None:
        """Begin anew from a layout: its sensors are where it says until people show something else."""

    def layout(self) -> SensorLayout | None:
        """The layout that was found; None before two of them are tied to each other."""
