"""The KinectMultiTrack thesis' tracker (2015), for any number of sensors: ``stand-still``.

Its known flaw: every body is centred on itself, so two people stand at the same place in its world, and identity is
decided by body shape alone. See docs/methods/stand-still.md.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import msgspec
import numpy as np

from mocapella.association.closest_pairs import HeldPairs, PersonViews
from mocapella.association.reidentification import reidentified
from mocapella.calibration.stand_still import Calibration, StandStill, StandStillSettings
from mocapella.fusion.tracked_mean import tracked_mean
from mocapella.geometry.rigid import apply
from mocapella.model.bodies import Bodies, BodyKey
from mocapella.model.memory import pack, recalls, set_memory, unpack
from mocapella.model.observations import Arrival, BodyFrame, JointState
from mocapella.model.scene import Float64, Person, Phase, PotentialSkeleton, Scene, TrackerState
from mocapella.model.session import SensorPose
from mocapella.settings import check
from mocapella.tracker.arrivals import Arrivals, Heard, Sighting
from mocapella.tracker.method import not_taken
from mocapella.tracker.protocol import TrackerReport, scene_at


@dataclass(frozen=True)
class StandStillTrackerSettings(StandStillSettings):
    """The settings of the calibration and of the later stages.

    Attributes:
        max_distance_m: skeletons farther apart are not one person; the thesis has no such limit [m].
        regain_within_m: a body with a new tracking id is a person whom its sensor had lost, if it is nearer than this
            to the person's last position; 0 makes every new tracking id a new person [m].
        silent_after_s: a sensor without a frame for this long is left out of the fusion until its next frame [s].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    max_distance_m: float = float("inf")
    regain_within_m: float = 0.5
    silent_after_s: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check(self.max_distance_m > 0, "max_distance_m", self.max_distance_m, "greater than 0 m")
        check(self.regain_within_m >= 0, "regain_within_m", self.regain_within_m, "0 m or more")
        check(0 < self.silent_after_s <= 3600, "silent_after_s", self.silent_after_s, "above 0 and at most 3600 s")


_OWN_MEMORY: Final = ("_steps", "_rejected", "_state", "_people")


class StandStillTracker:
    """Tracker of the method ``stand-still``, the baseline that other methods are compared to.

    Sensors' newest frames → each body's transform to the world → assignment to people → mean of tracked joints.

    Args:
        settings: the settings of every stage; the defaults if None.
        sensors_expected: number of sensors that the calibration waits for.
        sensors: tilt and height by sensor name; they override those in the sensor's frames.
    """

    def __init__(
        self,
        settings: StandStillTrackerSettings | None = None,
        *,
        sensors_expected: int = 1,
        sensors: Mapping[str, SensorPose] | None = None,
    ) -> None:
        self.settings = settings or StandStillTrackerSettings()
        self._arrivals = Arrivals(self.settings.silent_after_s)
        self._calibration = StandStill(self.settings, sensors_expected)
        self._views = CalibratedViews(sensors or {})
        self._pairs = HeldPairs(self.settings.max_distance_m)
        self._sensors_expected = sensors_expected
        self.reset()

    def reset(self) -> None:
        """Forget everything, as if newly made."""
        self._arrivals.reset()
        self._calibration.reset()
        self._views.reset()
        self._pairs.reset()
        self._steps = 0
        self._rejected: Counter[str] = Counter()
        self._state = TrackerState(Phase.WAITING_FOR_SENSORS, sensors_missing=self._sensors_expected)
        self._people: tuple[Person, ...] = ()

    def recalibrate(self, reason: str) -> None:
        """Restart the calibration; the next scene's state gives ``reason``, a text for the user."""
        self._calibration.restart(reason)

    def snapshot(self) -> bytes:
        """Return all state as bytes, for `restore`: a tracker made with the same arguments continues identically."""
        own = {name: getattr(self, name) for name in _OWN_MEMORY}
        return pack([own, *map(vars, self._stages())], _REMEMBERED)

    @recalls
    def restore(self, data: bytes) -> None:
        """Replace all state by that of a `snapshot` of a tracker made with the same arguments.

        Raises:
            WireError: the bytes are no snapshot of this method; the tracker is then reset.
        """
        own, *stages = unpack(data, _REMEMBERED)
        set_memory(self, own, _OWN_MEMORY)
        for part, memory in zip(self._stages(), stages, strict=True):
            set_memory(part, memory)

    def _stages(self) -> tuple[object, ...]:
        return self._arrivals, self._calibration, self._views, self._pairs

    @property
    def report(self) -> TrackerReport:
        """Counts of used and rejected frames, calibrations and restarts so far."""
        kept = self._steps - self._rejected.total()
        calibration = self._calibration
        return TrackerReport(self._steps, kept, dict(self._rejected), calibration.completed, calibration.restarts)

    def update(self, arrival: Arrival) -> Scene:
        """Process a body sensor's frame, and return the scene: all people, from the newest frames of all sensors.

        A frame that cannot be used is counted in `report` and changes nothing: its scene repeats the last people.
        """
        bodies = type(arrival.frame) is BodyFrame
        problem = self._see_bodies(arrival) if bodies else not_taken(arrival.frame, "stand-still")
        if problem:
            self._rejected[problem] += 1
        return self._scene(arrival)

    def _see_bodies(self, arrival: Arrival) -> str:
        """Process a sensor's bodies; return why the frame cannot be used."""
        heard = self._arrivals.update(arrival)
        if heard.problem:
            return heard.problem
        if heard.node_changed:
            self._calibration.restart(f"{heard.sensor}: its node was started again")
        bodies = heard.newest[heard.sensor].bodies
        if self._calibration.unknown(bodies):
            self._rename(heard.sensor, reidentified(bodies, self._people, self.settings.regain_within_m))
        calibration = self._calibration.update(bodies, heard.newest)
        views = self._views.update(heard, calibration)
        people = self._pairs.update(views, calibration.number)
        self._people = fuse(people)
        self._state = calibration.state
        return ""

    def _rename(self, sensor: str, new_ids: Mapping[int, int]) -> None:
        self._calibration.rename(sensor, new_ids)
        self._pairs.rename(sensor, new_ids)

    def _scene(self, arrival: Arrival) -> Scene:
        step, self._steps = self._steps, self._steps + 1
        return scene_at(arrival, step, self._state, {"people": self._people}, topology=self._arrivals.topology)


class CalibratedBodies(msgspec.Struct, frozen=True, eq=False):
    """One sensor's calibrated bodies: tracking ``ids`` (bodies,), and each one's ``T_world_sensor`` (bodies, 4, 4)."""

    ids: tuple[int, ...]
    T_world_sensor: Float64


class CalibratedViews:
    """Transforms every calibrated body of its sensor's newest frame to the world; only changes are recomputed.

    Args:
        poses: tilt and height by sensor name, for the views; for a missing sensor, its frames give them.
    """

    def __init__(self, poses: Mapping[str, SensorPose]) -> None:
        self._poses = dict(poses)
        self.reset()

    def reset(self) -> None:
        """Forget every view."""
        self._T_world_sensor: Mapping[BodyKey, Float64] = {}
        self._calibrated: dict[str, CalibratedBodies] = {}
        self._of_sensor: dict[str, tuple[PotentialSkeleton, ...]] = {}

    def update(self, heard: Heard, calibration: Calibration) -> list[PotentialSkeleton]:
        """Return the views of all active sensors, in the order of sensors and tracking ids; none before a calibration.

        A body that its sensor does not see now keeps a view without tracked joints (NaN), because the person can still
        be shown from that sensor's perspective, as the others see them. A body that was not calibrated has no view.

        Args:
            heard: result of the present arrival, with the newest frames of all active sensors.
            calibration: the present calibration.
        """
        if not calibration.T_world_sensor:
            return []
        if calibration.T_world_sensor is not self._T_world_sensor:
            self._T_world_sensor = calibration.T_world_sensor
            self._calibrated = by_sensor(calibration.T_world_sensor)
            self._of_sensor = {}
        self._of_sensor.pop(heard.sensor, None)
        for sensor, sighting in heard.newest.items():
            if sensor not in self._of_sensor:
                self._of_sensor[sensor] = self._see(sighting)
        return [view for sensor in heard.newest for view in self._of_sensor[sensor]]

    def _see(self, sighting: Sighting) -> tuple[PotentialSkeleton, ...]:
        frame, bodies = sighting.frame, sighting.bodies
        calibrated = self._calibrated.get(frame.sensor)
        if calibrated is None:
            return ()
        positions, states = bodies.positions, bodies.states
        if bodies.ids != calibrated.ids:
            pairs = [(calibrated.ids.index(body), i) for i, body in enumerate(bodies.ids) if body in calibrated.ids]
            rows, seen = [row for row, _ in pairs], [i for _, i in pairs]
            positions = np.full((len(calibrated.ids), len(bodies.topology), 3), np.nan)
            states = np.full(positions.shape[:2], JointState.NOT_TRACKED, dtype=np.uint8)
            positions[rows], states[rows] = bodies.positions[seen], bodies.states[seen]
        in_world = apply(calibrated.T_world_sensor, positions)
        pose = self._poses.get(frame.sensor, frame)
        return tuple(
            PotentialSkeleton(frame.sensor, body, frame.time_ns, pose.tilt, pose.height, T, p, s)
            for body, T, p, s in zip(calibrated.ids, calibrated.T_world_sensor, in_world, states, strict=True)
        )


_REMEMBERED: Final = (
    Bodies,
    BodyFrame,
    CalibratedBodies,
    Person,
    Phase,
    PotentialSkeleton,
    SensorPose,
    Sighting,
    StandStillTrackerSettings,
    TrackerState,
)


def by_sensor(T_world_sensor: Mapping[BodyKey, Float64]) -> dict[str, CalibratedBodies]:
    """Group the transforms ``T_world_sensor`` (4, 4) of calibrated bodies by sensor, in the order of tracking ids."""
    bodies: dict[str, list[int]] = {}
    for sensor, body in sorted(T_world_sensor):
        bodies.setdefault(sensor, []).append(body)
    return {
        sensor: CalibratedBodies(tuple(ids), np.stack([T_world_sensor[sensor, body] for body in ids]))
        for sensor, ids in bodies.items()
    }


def fuse(people: Sequence[PersonViews]) -> tuple[Person, ...]:
    """Return each person's skeleton, fused by `tracked_mean`, with its views; in the order of ``people``.

    Each person has at least one view, and all views have the same joints.
    """
    if not people:
        return ()
    joints = len(people[0].views[0].states)
    shape = (len(people), max(len(person.views) for person in people), joints)
    positions = np.full((*shape, 3), np.nan)
    states = np.full(shape, JointState.NOT_TRACKED, dtype=np.uint8)
    for i, person in enumerate(people):
        for j, view in enumerate(person.views):
            positions[i, j], states[i, j] = view.positions, view.states
    fused = tracked_mean(positions, states)
    return tuple(
        Person(person.person, p, s, person.views)
        for person, p, s in zip(people, fused.positions, fused.states, strict=True)
    )
