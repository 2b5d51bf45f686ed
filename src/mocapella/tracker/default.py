"""The method ``default``: one place for each sensor, found from how people move; everybody by where they are expected.

    T, offsets  = calibrate(bodies)             one motion and clock offset for each sensor, shared by all people
    people      = associate(bodies, expected)   global assignment to where everybody is expected
    skeletons   = fuse(views)                   each view by what it is worth; labels repaired between the sensors
    steady      = smooth(skeletons)             the prediction is part of the estimate

See docs/methods/default.md.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.association.tracks import Track, Tracks, TrackSettings
from mocapella.calibration.cold_start import ColdStart
from mocapella.calibration.floor import Floor, FloorFromFeet
from mocapella.calibration.pair_calibration import PairCalibration, PairEstimate, PairSettings
from mocapella.calibration.pair_memory import SensorTracks
from mocapella.calibration.people import PairOfSensors, PeopleCalibration
from mocapella.calibration.people import PeopleSettings as CalibrationSettings
from mocapella.calibration.people_state import CalibratedSensor, PeopleState
from mocapella.calibration.rig import Rig, RigPair, RigSensor
from mocapella.calibration.sensor_graph import PlacedSensor
from mocapella.calibration.time_offset import TimeOffset
from mocapella.conventions import NS_PER_S
from mocapella.fusion.weighted_mean import FusionSettings
from mocapella.geometry.rigid import apply, inverse
from mocapella.model.bodies import Bodies
from mocapella.model.memory import pack, unpack
from mocapella.model.observations import Arrival, BodyFrame
from mocapella.model.scene import Float64, Person, Phase, PotentialSkeleton, Scene, SensorPlace, TrackerState
from mocapella.model.session import SensorPose
from mocapella.smoothing.kalman import KalmanSettings, Points
from mocapella.tracker.arrivals import Arrivals, Heard, Sighting
from mocapella.tracker.people import Body, People, PeopleSettings, SeenView, Sight
from mocapella.tracker.protocol import SensorViews, TrackerReport


@dataclass(frozen=True)
class DefaultSettings:
    """The settings of every stage.

    Attributes:
        calibration: where the sensors are.
        tracks: who is who.
        fusion: what a view is worth.
        motion: how people move.
        silent_after_s: a sensor without a frame for so long is not waited for.
        shown_for_s: somebody whom no sensor sees is shown, as predicted, for so long.
    """

    calibration: CalibrationSettings = field(default_factory=CalibrationSettings)
    tracks: TrackSettings = field(default_factory=TrackSettings)
    fusion: FusionSettings = field(default_factory=FusionSettings)
    motion: KalmanSettings = field(default_factory=KalmanSettings)
    silent_after_s: float = 1.0
    shown_for_s: float = 1.0


_NEEDED_PARTS: Final = ("root",)


class DefaultTracker:
    """See the module."""

    joint_bias = None
    """None is declared."""

    def __init__(
        self,
        settings: DefaultSettings | None = None,
        *,
        sensors_expected: int = 1,
        sensors: Mapping[str, SensorPose] | None = None,
    ) -> None:
        self.settings = settings or DefaultSettings()
        self._calibration = PeopleCalibration(self.settings.calibration)
        self._poses = dict(sensors or {})
        self._sensors_expected = sensors_expected
        self._arrivals = Arrivals(self.settings.silent_after_s, _NEEDED_PARTS)
        self._tracks = Tracks(self.settings.tracks)
        self.reset()

    def reset(self) -> None:
        """Forget everything, as if newly made."""
        self._arrivals.reset()
        self._tracks.reset()
        self._calibration.reset()
        self._root = ""
        self._T_root_sensor: dict[str, Float64] = {}
        self._T_world_root = np.eye(4)
        self._people: People | None = None
        self._middle = np.empty(0, dtype=np.intp)
        self._now_s = 0.0
        self._steps = 0
        self._rejected: Counter[str] = Counter()
        self._state = TrackerState(Phase.WAITING_FOR_SENSORS, sensors_missing=self._sensors_expected)
        self._shown: tuple[Person, ...] = ()
        self._places: tuple[SensorPlace, ...] = ()

    def recalibrate(self, reason: str) -> None:
        """Begin the calibration again; the next scene says why."""
        self._calibration.rig = None
        self._calibration.reset()
        self._T_root_sensor, self._root = {}, ""
        self._state = TrackerState(Phase.CALIBRATING, reason=reason)

    def snapshot(self) -> bytes:
        """See `Tracker`."""
        own = {name: getattr(self, name) for name in _OWN_MEMORY}
        people = None if self._people is None else (self._people.mirror, self._people.bodies)
        parts = [own, vars(self._arrivals), vars(self._tracks), people, vars(self._calibration)]
        return pack(parts, _REMEMBERED)

    def restore(self, data: bytes) -> None:
        """See `Tracker`."""
        own, arrivals, tracks, people, calibration = unpack(data, _REMEMBERED)
        vars(self).update(own)
        vars(self._arrivals).update(arrivals)
        vars(self._tracks).update(tracks)
        self._people = None
        if people is not None:
            self._people = self._make_people(people[0])
            self._people.bodies = people[1]
        vars(self._calibration).update(calibration)

    def start_from(self, T_world_sensor: Mapping[str, Float64]) -> None:
        """A rig that is known before the first frame: used for a sensor until its own place is known better."""
        self._calibration.start_from(T_world_sensor)

    def use_rig(self, rig: Rig) -> None:
        """See `KeepsRig`."""
        self.reset()
        self._calibration.rig = rig

    def rig(self) -> Rig | None:
        """See `KeepsRig`."""
        return self._calibration.rig_now() if self._calibration.tied else None

    def sensor_views(self) -> SensorViews:
        """What is known of the sensors now."""
        rig = self._calibration.rig
        told = {name: np.array(sensor.T_world_sensor) for name, sensor in rig.sensors.items()} if rig else {}
        if self._people is None:
            return SensorViews(told)
        bodies = self._people.bodies
        clocks = {name: sensor.clock for name, sensor in self._calibration.state.sensors.items()}
        places = {name: self._T_world_root @ T for name, T in self._T_root_sensor.items()}
        if self._root in told:  # of sensors that were not heard yet
            T_world_rig = self._T_world_root @ inverse(told[self._root])
            places |= {name: T_world_rig @ T for name, T in told.items() if name not in clocks}
        return SensorViews(
            places,
            {name: -clock.seconds for name, clock in clocks.items() if clock is not None and clock.known},
            frozenset(
                (sensor, view.tracking_id)
                for body in bodies.values()
                for sensor, view in body.views.items()
                if view.swapped
            ),
        )

    @property
    def report(self) -> TrackerReport:
        """What came of all frames so far."""
        return TrackerReport(self._steps, self._steps - self._rejected.total(), dict(self._rejected), 0, 0)

    def update(self, arrival: Arrival) -> Scene:
        """Take one frame in and say what there is now. A frame that cannot be used is counted and changes nothing."""
        heard = self._arrivals.update(arrival)
        if heard.problem:
            self._rejected[heard.problem] += 1
            return self._scene(arrival)
        if self._people is None:
            topology = heard.newest[heard.sensor].frame.topology
            self._people = self._make_people(np.asarray(topology.mirror))
        sighting = heard.newest[heard.sensor]
        self._calibrate(sighting)
        self._track(sighting, self._people)
        self._places = self._say_places()
        self._state = self._stand(heard)
        self._shown = self._show(heard, self._people)
        return self._scene(arrival)

    def _calibrate(self, sighting: Sighting) -> None:
        """Learn from the frame where the sensors are. Everything else is told in the frame of the first of them."""
        owners = {
            (sensor, body): track.person for track in self._tracks.tracks for sensor, body in track.bodies.items()
        }
        frame = sighting.frame
        pose = self._poses.get(frame.sensor, SensorPose(frame.tilt, max(0.0, frame.height)))
        state = self._calibration.update(sighting.bodies, sighting.at_ns, owners, pose)
        sensors = state.sensors
        trusted: dict[str, int] = {}
        for sensor in sensors.values():
            trusted[sensor.root] = trusted.get(sensor.root, 0) + sensor.trusted
        root = max(trusted, key=lambda name: (trusted[name], name == self._root))
        self._T_world_root = sensors[root].T_world_sensor
        to_root = inverse(self._T_world_root)
        self._T_root_sensor = {
            name: to_root @ sensor.T_world_sensor
            for name, sensor in sensors.items()
            if sensor.root == root and sensor.trusted
        }
        if root != self._root:
            if self._root and self._people is not None and self._root in self._T_root_sensor:
                self._people.move(self._T_root_sensor[self._root])
                self._tracks.move(self._T_root_sensor[self._root])
            self._root = root

    def _make_people(self, mirror: NDArray[np.int64]) -> People:
        self._middle = np.flatnonzero(mirror == np.arange(len(mirror)))
        return People(PeopleSettings(self.settings.fusion, self.settings.motion), mirror)

    def _track(self, sighting: Sighting, people: People) -> None:
        """Whose bodies these are, and everybody brought up to date; nothing where the sensor's place is not known."""
        bodies, sensor = sighting.bodies, sighting.bodies.sensor
        T = self._T_root_sensor.get(sensor)
        if T is None:
            return
        clock = self._calibration.state.sensors[sensor].clock
        at_s = sighting.at_ns / NS_PER_S - (clock.seconds if clock is not None and clock.known else 0.0)
        self._now_s = max(self._now_s, at_s)
        world = apply(T, bodies.positions)
        expected = people.expected(self._now_s)
        middles = {person: points.positions[self._middle] for person, points in expected.items()}
        certain = {person: middle for person, middle in middles.items() if np.isfinite(middle).any()}
        owners = self._tracks.update(sensor, bodies.ids, world[:, self._middle], certain, at_s)
        for stays, gone in self._tracks.merged:
            people.join(stays, gone)
        clipped = dict(zip(sighting.frame.tracking_ids.tolist(), sighting.frame.clipped_edges.tolist(), strict=True))
        far = np.linalg.norm(np.nanmean(bodies.positions, axis=1), axis=-1) if bodies.ids else np.empty(0)
        sights = {
            person: Sight(sensor, body, at_s, world[i], bodies.states[i], float(far[i]), bool(clipped[body]))
            for i, (body, person) in enumerate(zip(bodies.ids, owners, strict=True))
            if person >= 0
        }
        people.update(expected, sights, self._now_s)
        people.keep([track.person for track in self._tracks.tracks])

    def _say_places(self) -> tuple[SensorPlace, ...]:
        return tuple(
            SensorPlace(
                name,
                self._T_world_root @ self._T_root_sensor[name] if name in self._T_root_sensor else None,
                float(np.sqrt(np.trace(sensor.covariance[:3, :3]))),
                float(np.sqrt(np.trace(sensor.covariance[3:, 3:]))),
                sensor.quality,
                sensor.condition,
            )
            for name, sensor in self._calibration.state.sensors.items()
        )

    def _stand(self, heard: Heard) -> TrackerState:
        missing = self._sensors_expected - len(heard.newest)
        if missing > 0:
            return TrackerState(Phase.WAITING_FOR_SENSORS, sensors_missing=missing)
        untied = [sensor for sensor in heard.newest if sensor not in self._T_root_sensor]
        reason = "; ".join(self._calibration.state.conditions)
        return TrackerState(Phase.CALIBRATING if untied else Phase.TRACKING, reason=reason)

    def _show(self, heard: Heard, people: People) -> tuple[Person, ...]:
        """Everybody who is confirmed and was seen lately, with the views that are not too old."""
        shown = []
        for track in self._tracks.tracks:
            body = people.bodies.get(track.person)
            if body is None or not track.confirmed or self._now_s - track.seen_s > self.settings.shown_for_s:
                continue
            views = tuple(
                self._view(sensor, view, heard)
                for sensor, view in body.views.items()
                if sensor in heard.newest and sensor in self._T_root_sensor
            )
            sd = np.sqrt(body.points.variances[:, 0]).astype(np.float32)
            positions = apply(self._T_world_root, body.points.positions)
            shown.append(Person(track.person, positions, body.states, views, sd))
        return tuple(shown)

    def _view(self, sensor: str, view: SeenView, heard: Heard) -> PotentialSkeleton:
        frame = heard.newest[sensor].frame
        pose = self._poses.get(sensor, frame)
        T = self._T_world_root @ self._T_root_sensor[sensor]
        positions = apply(self._T_world_root, view.positions)
        return PotentialSkeleton(
            sensor, view.tracking_id, frame.time_ns, pose.tilt, pose.height, T, positions, view.states
        )

    def _scene(self, arrival: Arrival) -> Scene:
        frame, step = arrival.frame, self._steps
        self._steps += 1
        return Scene(
            step=step,
            at_ns=arrival.at_ns,
            sensor=frame.sensor,
            node_id=frame.node_id,
            sequence=frame.sequence,
            topology=self._arrivals.topology or frame.topology,
            state=self._state,
            people=self._shown,
            sensors=self._places,
        )


_OWN_MEMORY: Final = (
    *("_now_s", "_steps", "_rejected", "_state", "_shown", "_places"),
    *("_root", "_T_root_sensor", "_T_world_root"),
)
_REMEMBERED: Final = (
    Bodies,
    Body,
    CalibratedSensor,
    CalibrationSettings,
    ColdStart,
    Floor,
    FloorFromFeet,
    PairCalibration,
    PairEstimate,
    PairOfSensors,
    PairSettings,
    PeopleState,
    PlacedSensor,
    Rig,
    RigPair,
    RigSensor,
    SensorPose,
    SensorTracks,
    TimeOffset,
    BodyFrame,
    Person,
    Phase,
    Points,
    PotentialSkeleton,
    SeenView,
    SensorPlace,
    Sighting,
    Track,
    TrackerState,
    TrackSettings,
)
