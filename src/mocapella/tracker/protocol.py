"""Interface of all trackers."""

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

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class TrackerReport:
    """Counts of all frames so far.

    Attributes:
        frames: number of arrivals.
        kept: number of used frames.
        rejected: number of rejected frames, by reason.
        calibrations: number of completed calibrations.
        restarts: number of restarts of the calibration.
    """

    frames: int
    kept: int
    rejected: Mapping[str, int]
    calibrations: int
    restarts: int


class SensorViews(msgspec.Struct, frozen=True, eq=False):
    """A method's knowledge of the sensors after a frame, to be applied to *later* frames only.

    Attributes:
        T_world_sensor: (4, 4) pose of each sensor in the world, shared by all people; missing sensors are unknown.
        time_offset_s: correction to add to ``at_ns`` of a sensor's frames, by sensor [s]. Views of two sensors that
            both have one are brought to one time; others are compared without correction.
        swapped: views whose left and right labels must be swapped so that the sensors agree.
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
    """Return the scene of a step, with time and sensor of the arrival. All trackers create their scenes by it.

    Parts and sensors are neither sorted nor checked nor copied; `Scene` defines their order.

    Args:
        arrival: the frame that the scene is the result of.
        step: number of the scene, from 0.
        state: state of the tracker.
        parts: the scene's parts, by the name of their registered type (`mocapella.model.part_types`).
        topology: topology of the skeletons; ``kinect_v2`` if None, for scenes without skeletons.
        sensors: poses of the sensors.
    """
    frame = arrival.frame
    of = topology or named_topology("kinect_v2")
    return Scene(step, arrival.at_ns, frame.sensor, frame.node_id, frame.sequence, of, state, parts, sensors)


class Tracker(Protocol):
    """Interface of a tracker: one step per frame.

    The same arrivals and commands in the same order give the same scenes, to the bit.
    """

    def update(self, arrival: Arrival) -> Scene:
        """Process one frame and return the scene, with the step's number.

        A frame that cannot be used is counted in `report` and changes nothing: its scene repeats the last results.
        """

    def recalibrate(self, reason: str) -> None:
        """Restart the calibration; the next scene's state gives ``reason``, a text for the user."""

    def reset(self) -> None:
        """Forget everything, as if newly made."""

    def snapshot(self) -> bytes:
        """Return all state, for `restore`: a tracker made with the same arguments continues identically, to the bit."""

    def restore(self, data: bytes) -> None:
        """Replace all state by that of a `snapshot` of a tracker made with the same arguments.

        Raises:
            WireError: the bytes are no snapshot of this method; the tracker is then reset.
        """

    @property
    def report(self) -> TrackerReport:
        """Counts of used and rejected frames, calibrations and restarts so far."""


class TrackerNote(msgspec.Struct, frozen=True):
    """An event to report to the user once; lasting conditions are in the state's reason.

    Attributes:
        time_ns: capture time of its evidence, on the common clock.
        text: the message.
    """

    time_ns: int
    text: str


@runtime_checkable
class TellsNotes(Protocol):
    """A tracker that reports events."""

    def drain_notes(self) -> list[TrackerNote]:
        """Return the events since the last call, the oldest first, and forget them."""


@runtime_checkable
class ExpectsPeople(Protocol):
    """A tracker that knows where people will be in the images of its sensors."""

    def expected_regions(self, sensor: str) -> Float32:
        """Return the boxes (people, 4) where people are expected in a sensor's next image [px].

        Each row has left, top, right and bottom. Empty for a sensor that is not known.
        """


@runtime_checkable
class KeepsLayout(Protocol):
    """A tracker that estimates sensor poses that can be kept for the next session."""

    def use_layout(self, layout: SensorLayout) -> None:
        """Restart from a layout, whose poses are used until people contradict them."""

    def layout(self) -> SensorLayout | None:
        """Return the estimated layout; None before the relative pose of two sensors is known."""
