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
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from mocapella.association.tracks import Track, Tracks, TrackSettings
from mocapella.conventions import NS_PER_S
from mocapella.fusion.weighted_mean import FusionSettings
from mocapella.geometry.rigid import apply
from mocapella.model.bodies import Bodies, BodyKey
from mocapella.model.memory import pack, unpack
from mocapella.model.observations import Arrival, BodyFrame
from mocapella.model.scene import Float64, Person, Phase, PotentialSkeleton, Scene, SensorPlace, TrackerState
from mocapella.model.session import SensorPose
from mocapella.smoothing.kalman import KalmanSettings, Points
from mocapella.tracker.arrivals import Arrivals, Heard, Sighting
from mocapella.tracker.people import Body, People, PeopleSettings, SeenView, Sight
from mocapella.tracker.protocol import TrackerReport


class Rig(Protocol):
    """Where the sensors are, as far as is known: what the calibration offers the tracker."""

    @property
    def T_world_sensor(self) -> Mapping[str, Float64]:  # noqa: N802
        """(4, 4) by sensor; who is not in it is not tied to the others yet."""

    @property
    def time_offset_s(self) -> Mapping[str, float]:
        """By sensor: its frames were captured so much later than the common clock says [s]."""

    @property
    def condition(self) -> str:
        """What is wanted, or wrong, in words; empty where all is well."""

    def update(self, bodies: Bodies, people: Mapping[BodyKey, int], at_s: float) -> None:
        """Learn from one frame; ``people`` says whose bodies are known to be whose."""

    def start_from(self, T_world_sensor: Mapping[str, Float64]) -> None:
        """Begin with what an earlier calibration found."""

    def places(self) -> tuple[SensorPlace, ...]:
        """Every sensor that was heard, by name."""

    def memory(self) -> Any:
        """All that it remembers, of kinds that `mocapella.model.memory` knows."""

    def remember(self, memory: Any) -> None:
        """Go on from a `memory`."""

    def reset(self) -> None:
        """Forget everything."""


@dataclass(frozen=True)
class DefaultSettings:
    """The settings of every stage.

    Attributes:
        tracks: who is who.
        fusion: what a view is worth.
        motion: how people move.
        silent_after_s: a sensor without a frame for so long is not waited for.
        shown_for_s: somebody whom no sensor sees is shown, as predicted, for so long.
    """

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
        rig: Rig,
        settings: DefaultSettings | None = None,
        *,
        sensors_expected: int = 1,
        sensors: Mapping[str, SensorPose] | None = None,
    ) -> None:
        self.settings = settings or DefaultSettings()
        self._rig = rig
        self._poses = dict(sensors or {})
        self._sensors_expected = sensors_expected
        self._arrivals = Arrivals(self.settings.silent_after_s, _NEEDED_PARTS)
        self._tracks = Tracks(self.settings.tracks)
        self.reset()

    def reset(self) -> None:
        """Forget everything, as if newly made."""
        self._arrivals.reset()
        self._tracks.reset()
        self._rig.reset()
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
        self._rig.reset()
        self._state = TrackerState(Phase.CALIBRATING, reason=reason)

    def snapshot(self) -> bytes:
        """See `Tracker`."""
        own = {name: getattr(self, name) for name in _OWN_MEMORY}
        people = None if self._people is None else (self._people.mirror, self._people.bodies)
        parts = [own, vars(self._arrivals), vars(self._tracks), people, self._rig.memory()]
        return pack(parts, _REMEMBERED)

    def restore(self, data: bytes) -> None:
        """See `Tracker`."""
        own, arrivals, tracks, people, rig = unpack(data, _REMEMBERED)
        vars(self).update(own)
        vars(self._arrivals).update(arrivals)
        vars(self._tracks).update(tracks)
        self._people = None
        if people is not None:
            self._people = self._make_people(people[0])
            self._people.bodies = people[1]
        self._rig.remember(rig)

    def start_from(self, T_world_sensor: Mapping[str, Float64]) -> None:
        """Begin with what an earlier calibration found."""
        self._rig.start_from(T_world_sensor)

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
        at_s = sighting.at_ns / NS_PER_S + self._rig.time_offset_s.get(heard.sensor, 0.0)
        known = self._track(sighting, at_s, self._people)
        self._rig.update(sighting.bodies, known, at_s)
        self._places = self._rig.places()
        self._state = self._stand(heard)
        self._shown = self._show(heard, self._people)
        return self._scene(arrival)

    def _make_people(self, mirror: NDArray[np.int64]) -> People:
        self._middle = np.flatnonzero(mirror == np.arange(len(mirror)))
        return People(PeopleSettings(self.settings.fusion, self.settings.motion), mirror)

    def _track(self, sighting: Sighting, at_s: float, people: People) -> dict[BodyKey, int]:
        """Whose bodies these are; everybody brought up to date. Nobody's where the sensor's place is not known."""
        bodies, sensor = sighting.bodies, sighting.bodies.sensor
        T = self._rig.T_world_sensor.get(sensor)
        if T is None:
            return {}
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
        return {(sensor, body): person for body, person in zip(bodies.ids, owners, strict=True) if person >= 0}

    def _stand(self, heard: Heard) -> TrackerState:
        missing = self._sensors_expected - len(heard.newest)
        if missing > 0:
            return TrackerState(Phase.WAITING_FOR_SENSORS, sensors_missing=missing)
        untied = [sensor for sensor in heard.newest if sensor not in self._rig.T_world_sensor]
        return TrackerState(Phase.CALIBRATING if untied else Phase.TRACKING, reason=self._rig.condition)

    def _show(self, heard: Heard, people: People) -> tuple[Person, ...]:
        """Everybody who is confirmed and was seen lately, with the views that are not too old."""
        shown = []
        for track in self._tracks.tracks:
            body = people.bodies.get(track.person)
            if body is None or not track.confirmed or self._now_s - track.seen_s > self.settings.shown_for_s:
                continue
            views = tuple(
                self._view(sensor, view, heard) for sensor, view in body.views.items() if sensor in heard.newest
            )
            sd = np.sqrt(body.points.variances[:, 0]).astype(np.float32)
            shown.append(Person(track.person, body.points.positions, body.states, views, sd))
        return tuple(shown)

    def _view(self, sensor: str, view: SeenView, heard: Heard) -> PotentialSkeleton:
        frame = heard.newest[sensor].frame
        pose = self._poses.get(sensor, frame)
        T = self._rig.T_world_sensor[sensor]
        return PotentialSkeleton(
            sensor, view.tracking_id, frame.time_ns, pose.tilt, pose.height, T, view.positions, view.states
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


_OWN_MEMORY: Final = ("_now_s", "_steps", "_rejected", "_state", "_shown", "_places")
_REMEMBERED: Final = (
    Bodies,
    Body,
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
