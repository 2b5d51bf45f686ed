"""The method ``default``: calibrate sensors from people's motion, and track each person from a prediction.

    T, offsets  = calibrate(bodies)             one motion and clock offset for each sensor, shared by all people
    people      = associate(bodies, expected)   global assignment to people's predicted positions
    labels      = facing(views)                 which way people face, and which views are mirrored
    measured    = fuse(views)                   mean of the views, weighted by their reliability
    steady      = body(measured)                the prediction is part of the estimate
    arms        = follow(arms)                  of depth cameras beside the sensors, assigned to people
    bodies      = fit(images)                   of cameras beside the sensors, assigned to people

See docs/methods/default.md.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from functools import lru_cache
from itertools import compress
from typing import Any, Final

import msgspec
import numpy as np

from mocapella.association.jumps import Jumps, JumpSettings, SeenBodies
from mocapella.association.tracks import TrackMemory, Tracks, TrackSettings
from mocapella.calibration.cold_start import ColdStart
from mocapella.calibration.floor import Floor, FloorFromFeet
from mocapella.calibration.pair_calibration import PairCalibration, PairEstimate, PairSettings
from mocapella.calibration.pair_memory import SensorTracks
from mocapella.calibration.people import PeopleCalibration
from mocapella.calibration.people_settings import PeopleCalibrationSettings
from mocapella.calibration.people_state import CalibratedSensor, PeopleState
from mocapella.calibration.sensor_graph import Component, PlacedSensor, SensorPair
from mocapella.calibration.sensor_layout import LayoutPair, LayoutSensor, SensorLayout
from mocapella.calibration.sensor_pair import PairOfSensors
from mocapella.calibration.time_offset import TimeOffset
from mocapella.conventions import NS_PER_S
from mocapella.fusion.facing import FacingMemory
from mocapella.fusion.joint_bias import JointBiasModel, shipped_model
from mocapella.geometry.rigid import inverse
from mocapella.geometry.rigid_approach import approached
from mocapella.model.arms import ArmFrame
from mocapella.model.bodies import Bodies
from mocapella.model.images import ImageFrame
from mocapella.model.memory import pack, recalls, set_memory, unpack
from mocapella.model.observations import Arrival, BodyFrame
from mocapella.model.scene import (
    Float64,
    Person,
    Phase,
    PotentialSkeleton,
    Scene,
    SensorPlace,
    TrackedArm,
    TrackedBody,
    TrackerState,
)
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.session import SensorPose
from mocapella.model.skeleton import SKELETON
from mocapella.tracker.arrivals import Arrivals, Heard, Sighting
from mocapella.tracker.default_settings import DefaultSettings
from mocapella.tracker.method import not_taken
from mocapella.tracker.people import People, PeopleResults
from mocapella.tracker.people_arms import REMEMBERED as ARMS_REMEMBERED
from mocapella.tracker.people_arms import PeopleArms
from mocapella.tracker.people_bodies import REMEMBERED as BODIES_REMEMBERED
from mocapella.tracker.people_bodies import PeopleBodies
from mocapella.tracker.people_memory import PeopleMemory
from mocapella.tracker.people_update import associate_and_fuse
from mocapella.tracker.people_views import followed
from mocapella.tracker.protocol import SensorViews, TrackerReport, scene_at

_APPROACH_EVERY_S: Final = 0.03
"""Interval of the steps of poses towards refined ones [s]."""


class DefaultTracker:
    """Tracker of the method ``default``: people, their arms and fitted bodies. See the module for its steps.

    Fuses the skeletons that several depth sensors detect: calibrates the sensors' extrinsics and clock offsets from
    people's motion, associates skeletons with people, corrects left-right swaps, and filters the joints.

    Args:
        settings: the settings of every stage; the defaults if None.
        sensors_expected: number of sensors to wait for; the scene's phase is WAITING_FOR_SENSORS before.
        sensors: tilt and height by sensor name; they override those in the sensor's frames.

    Attributes:
        joint_bias: bias that is subtracted from the views of sensors with the model's topology, but not from mapped
            ones; None subtracts none. It may be replaced between two frames.
    """

    joint_bias: JointBiasModel | None

    def __init__(
        self,
        settings: DefaultSettings | None = None,
        *,
        sensors_expected: int = 1,
        sensors: Mapping[str, SensorPose] | None = None,
    ) -> None:
        self.settings = settings or DefaultSettings()
        self.joint_bias = shipped_model() if self.settings.joint_bias == "learnt" else None
        self._calibration = PeopleCalibration(self.settings.calibration)
        self._poses = dict(sensors or {})
        self._sensors_expected = sensors_expected
        self._arrivals = Arrivals(self.settings.silent_after_s)
        self._jumps = Jumps(self.settings.jumps)
        self._tracks = Tracks(self.settings.tracks)
        self._arms = PeopleArms(self.settings.arms)
        self._bodies = PeopleBodies(self.settings.bodies)
        self._see: dict[type[SensorFrame], Callable[[Arrival], str]] = {
            BodyFrame: self._see_bodies,
            ArmFrame: self._see_arms,
            ImageFrame: self._see_images,
        }
        self.reset()

    def reset(self) -> None:
        """Forget everything, as if newly made."""
        for part in (self._arrivals, self._jumps, self._tracks, self._arms, self._bodies, self._calibration):
            part.reset()
        self._shown_bodies: tuple[TrackedBody, ...] = ()
        self._shown_arms: tuple[TrackedArm, ...] = ()
        self._root = ""
        self._T_root_sensor: dict[str, Float64] = {}
        self._T_world_root = self._T_world_known = np.eye(4)
        self._T_root_known: dict[str, Float64] = {}
        self._T_world_shown: dict[str, Float64] = {}
        self._people: People | None = None
        self._known: PeopleState | None = None
        self._now_s = self._approached_s = 0.0
        self._outvoted_s: float | None = None
        self._steps = 0
        self._rejected: Counter[str] = Counter()
        self._state = TrackerState(Phase.WAITING_FOR_SENSORS, sensors_missing=self._sensors_expected)
        self._shown: tuple[Person, ...] = ()
        self._views: dict[int, dict[str, PotentialSkeleton]] | None = None
        self._places: tuple[SensorPlace, ...] = ()
        self._conditions = ""

    def recalibrate(self, reason: str) -> None:
        """Restart the calibration of the sensors, without a layout; people keep their ids.

        The tracker's state gives ``reason``, a text for the user, until the next frame of bodies updates the state.
        """
        self._calibration.layout = None
        self._calibration.reset()
        self._T_root_sensor, self._T_root_known = {}, {}
        self._known, self._outvoted_s = None, None
        self._state = TrackerState(Phase.CALIBRATING, reason=reason)

    def snapshot(self) -> bytes:
        """Return all state as bytes, for `restore`: a tracker made with the same arguments continues identically."""
        own = {name: getattr(self, name) for name in _OWN_MEMORY}
        people = None if self._people is None else (self._people.topology, self._people.state())
        parts = [own, vars(self._arrivals), vars(self._jumps), vars(self._tracks), people, self._calibration.memory()]
        return pack([*parts, self._arms.memory(), self._bodies.memory()], _REMEMBERED)

    @recalls
    def restore(self, data: bytes) -> None:
        """Replace all state by that of a `snapshot` of a tracker made with the same arguments.

        Raises:
            WireError: the bytes are no snapshot of this method; the tracker is then reset.
        """
        own, arrivals, jumps, tracks, people, calibration, *others = unpack(data, _REMEMBERED)
        set_memory(self, own, _OWN_MEMORY)
        set_memory(self._arrivals, arrivals)
        set_memory(self._jumps, jumps)
        set_memory(self._tracks, tracks)
        for recall, memory in zip((self._arms.recall, self._bodies.recall), others, strict=False):
            recall(memory)  # older takes have fewer
        self._people = None
        if people is not None:
            if people[0] is not SKELETON:
                raise ValueError(f"people of topology {people[0].name}")
            self._people = People(self.settings.people, SKELETON)
            self._people.restore(people[1])
        self._calibration.recall(calibration)
        self._known = self._calibration.state
        self._T_world_known, self._T_root_known = self._known_poses()
        self._T_world_shown = {}

    def start_from(self, T_world_sensor: Mapping[str, Float64]) -> None:
        """Start from known poses ``T_world_sensor`` (4, 4), by sensor; each is used until a better one is estimated."""
        self._calibration.start_from(T_world_sensor)

    def use_layout(self, layout: SensorLayout) -> None:
        """Forget everything, and start from a layout of an earlier session, until people contradict its poses."""
        self.reset()
        self._calibration.layout = layout

    def layout(self) -> SensorLayout | None:
        """Return the sensors' estimated poses, to be kept; None before two sensors' relative pose is known."""
        return self._calibration.layout_now() if self._calibration.tied else None

    def sensor_views(self) -> SensorViews:
        """Return the estimated poses, clock offsets and swapped views of the sensors; unknown ones are missing."""
        layout = self._calibration.layout
        given = {name: np.array(sensor.T_world_sensor) for name, sensor in layout.sensors.items()} if layout else {}
        if self._people is None:
            return SensorViews(given)
        clocks = {name: sensor.clock for name, sensor in self._calibration.state.sensors.items()}
        places = {name: self._T_world_root @ T for name, T in self._T_root_known.items()}
        if self._root in given:  # add sensors without a frame yet
            T_world_layout = self._T_world_root @ inverse(given[self._root])
            places |= {name: T_world_layout @ T for name, T in given.items() if name not in clocks}
        return SensorViews(
            places,
            {name: -clock.seconds for name, clock in clocks.items() if clock is not None and clock.known},
            self._people.swapped(),
        )

    @property
    def calibrated_sensors(self) -> Mapping[str, CalibratedSensor]:
        """Poses of the sensors with covariances, by name, as calibrated from people."""
        return self._calibration.state.sensors

    @property
    def report(self) -> TrackerReport:
        """Counts of all frames so far; calibrations and restarts are not counted and always 0."""
        return TrackerReport(self._steps, self._steps - self._rejected.total(), dict(self._rejected), 0, 0)

    def update(self, arrival: Arrival) -> Scene:
        """Process a frame of bodies, arms or an image, and return the scene: all people, their arms, fitted bodies.

        A frame that cannot be used is counted in `report` and changes nothing: its scene repeats the last results.
        """
        see = self._see.get(type(arrival.frame))
        problem = not_taken(arrival.frame, "default") if see is None else see(arrival)
        if problem:
            self._rejected[problem] += 1
        return self._scene(arrival)

    def _see_bodies(self, arrival: Arrival) -> str:
        """Process a sensor's bodies; return why the frame cannot be used."""
        heard = self._arrivals.update(arrival)
        if heard.problem:
            return heard.problem
        if self._people is None:
            self._people = People(self.settings.people, SKELETON)
        sighting = self._without_jumps(heard.newest[heard.sensor], self._people)
        corrections = self._corrections(sighting, self._people)
        self._calibrate(sighting, heard, corrections)
        self._track(sighting, heard, self._people, corrections)
        self._approach_known_poses()
        self._state = self._stand(heard)
        self._shown = self._show(heard, self._people)
        self._update_arms(arrival.at_ns)
        return ""

    def _see_arms(self, arrival: Arrival) -> str:
        """Process a depth camera's arms; return why the frame cannot be used."""
        frame: Any = arrival.frame
        placed = {name: self._T_world_root @ T for name, T in self._T_root_sensor.items()}
        if problem := self._arms.problem(frame, placed):
            return problem
        self._arms.update(frame, arrival.at_ns / NS_PER_S, placed)
        self._update_arms(arrival.at_ns)
        return ""

    def _see_images(self, arrival: Arrival) -> str:
        """Process a camera's image; return why it cannot be used."""
        problem = self._bodies.see(arrival, self._shown, self._arrivals.topology)
        self._shown_bodies = self._bodies.tracked_bodies(self._shown, self._arrivals.topology)
        return problem

    def _update_arms(self, at_ns: int) -> None:
        if self._shown_arms or self._arms.there:
            self._shown_arms = self._arms.tracked_arms(self._shown, self._arrivals.topology, at_ns / NS_PER_S)

    def _without_jumps(self, sighting: Sighting, people: People) -> Sighting:
        """Return the frame's bodies without those at impossible positions."""
        bodies = sighting.bodies
        there = self._jumps.update(
            bodies.sensor, bodies.ids, bodies.positions.take(people.middle, axis=1), sighting.at_ns / NS_PER_S
        )
        return sighting if all(there.tolist()) else msgspec.structs.replace(sighting, bodies=bodies.only(there))

    def leave_out(self, participant: int) -> None:
        """Use the joint bias learnt without this participant of the KinectMultiTrack studies; for scoring.

        Raises:
            SettingsError: the participant was in the training data of every model.
        """
        if self.joint_bias is not None:
            self.joint_bias = self.joint_bias.without(participant)

    def _corrections(self, sighting: Sighting, people: People) -> Float64 | None:
        """Corrections to add to the bodies' joints in the sensor's own space [m], from the state before the frame."""
        bodies, model = sighting.bodies, self.joint_bias
        T = self._T_root_sensor.get(bodies.sensor)
        if model is None or T is None or not sighting.frame.topology.name == model.topology == people.topology.name:
            return None  # not of this kind of sensor: bodies of other sensors are mapped, and their bias is another one
        at_s = self._common_s(sighting)
        rows = self._tracks.rows(bodies.sensor, bodies.ids)
        return people.corrections(model, bodies, rows, T, max(self._now_s, at_s))

    def _common_s(self, sighting: Sighting) -> float:
        """Return a frame's capture time on the common clock [s]."""
        clock = self._calibration.state.sensors[sighting.bodies.sensor].clock
        return sighting.at_ns / NS_PER_S - (clock.seconds if clock is not None and clock.known else 0.0)

    def _calibrate(self, sighting: Sighting, heard: Heard, corrections: Float64 | None) -> None:
        """Calibrate the sensors from the frame. The root sensor's space is the frame of all other results."""
        frame = sighting.frame
        pose = self._poses.get(frame.sensor) or _frame_pose(frame.tilt, max(0.0, frame.height))
        bodies = sighting.bodies
        if corrections is not None:
            bodies = msgspec.structs.replace(bodies, positions=bodies.positions + corrections)
        state = self._calibration.update(bodies, sighting.at_ns, self._tracks.owners, pose)
        if state is self._known:
            return
        self._known, sensors, self._views = state, state.sensors, None
        self._conditions = "; ".join(state.conditions)
        if self._root in heard.newest and self._root not in sensors:
            return  # the calibration began again, and its next frame is still to come
        root = self._choose_root(state, heard)
        if root != self._root:
            if self._root in sensors and self._people is not None and sensors[self._root].trusted:
                T_root_old = inverse(sensors[root].T_world_sensor) @ sensors[self._root].T_world_sensor
                self._people.move(T_root_old)
                self._tracks.move(T_root_old)
                self._T_world_root = self._T_world_root @ inverse(T_root_old)
            self._root, self._T_root_sensor = root, {}
        self._T_world_known, self._T_root_known = self._known_poses()
        self._T_root_sensor = {name: self._T_root_sensor.get(name, T) for name, T in self._T_root_known.items()}
        if self._people is not None:
            self._people.level(self._T_world_known[:3, :3])
        self._places = self._sensor_places()

    def _known_poses(self) -> tuple[Float64, dict[str, Float64]]:
        """Return the calibration's poses of the root sensor in the world, and of the tied sensors in the root's space.

        The root continues alone with its last pose where its own is not trusted.
        """
        state = self._calibration.state
        if self._root not in state.sensors:
            return self._T_world_root, dict(self._T_root_sensor)
        root = state.sensors[self._root]
        return root.T_world_sensor if root.trusted else self._T_world_root, state.poses_from(self._root)

    def _approach_known_poses(self) -> None:
        """Let the poses in use approach the calibration's, so that refinements do not let shown people jump.

        They do so in steps, because each step changes all that is drawn.
        """
        elapsed_s = max(0.0, self._now_s - self._approached_s)
        if self._shown and elapsed_s < _APPROACH_EVERY_S:
            return
        self._approached_s = self._now_s
        names, known = list(self._T_root_known), [self._T_world_known, *self._T_root_known.values()]
        before = [self._T_world_root, *(self._T_root_sensor[name] for name in names)]
        if all(now is wanted for now, wanted in zip(before, known, strict=True)):
            return
        now = approached(before, known, elapsed_s) if self._shown else known
        self._T_world_root, self._T_root_sensor = now[0], dict(zip(names, now[1:], strict=True))
        if self._people is not None and names:
            old, new = np.array(before[1:]), np.array(now[1:])
            moved = (old != new).any(axis=(1, 2))
            self._people.move_sensors(list(compress(names, moved.tolist())), new[moved] @ inverse(old[moved]))
        self._views, self._places = None, self._sensor_places()

    def _choose_root(self, state: PeopleState, heard: Heard) -> str:
        """Return the root sensor, whose space defines the world.

        It is that of the old component, unless one is larger, or all sensors of the old one have long been silent.
        """
        sensors, tied = state.sensors, state.trusted_by_root
        most = max(tied.values(), key=len, default=[])
        if self._root not in sensors:
            return most[0] if most else next(iter(sensors))
        own = tied.get(sensors[self._root].root, [])
        largest = len(most) < 2 or (self._root in own and len(own) == len(most))
        silent = heard.newest.keys().isdisjoint((self._root, *own))
        if largest and not silent:
            self._outvoted_s = None
            root = sensors[self._root].root  # with another, all people would jump in the world as poses are refined
            return root if {root, self._root} <= set(own) else self._root
        # A change would lose the visible people; usually the root is tied to the others a little later.
        self._outvoted_s = self._now_s if self._outvoted_s is None else self._outvoted_s
        waits = largest or (self._root not in own and self._tracks.memory.present.any())
        waits = waits and self._now_s - self._outvoted_s < self.settings.keep_root_s
        if waits or (largest and not sensors[heard.sensor].trusted):
            return self._root
        self._outvoted_s = None
        return sensors[heard.sensor].root if largest else most[0]

    def _track(self, sighting: Sighting, heard: Heard, people: People, corrections: Float64 | None) -> None:
        """Assign the bodies to people and update all people; does nothing where the sensor's pose is not known.

        The time of such a sensor, whose clock is not known either, counts only while all others are silent.
        """
        bodies, sensor = sighting.bodies, sighting.bodies.sensor
        T, at_s = self._T_root_sensor.get(sensor), self._common_s(sighting)
        if T is not None or heard.newest.keys().isdisjoint(self._T_root_sensor):
            self._now_s = max(self._now_s, at_s)
        if T is None:
            return
        associate_and_fuse(self._tracks, people, sighting.frame, bodies, T, corrections, at_s=at_s, now_s=self._now_s)

    def _sensor_places(self) -> tuple[SensorPlace, ...]:
        used = self._T_root_sensor
        sensors = self._calibration.state.sensors.items()
        return tuple(one.place(self._T_world_root @ used[name] if name in used else None) for name, one in sensors)

    def _stand(self, heard: Heard) -> TrackerState:
        missing = self._sensors_expected - len(heard.newest)
        if missing > 0:
            return TrackerState(Phase.WAITING_FOR_SENSORS, sensors_missing=missing)
        tied = heard.newest.keys() <= self._T_root_sensor.keys()
        return TrackerState(Phase.TRACKING if tied else Phase.CALIBRATING, reason=self._conditions)

    def _show(self, heard: Heard, people: People) -> tuple[Person, ...]:
        """Return the confirmed people who were seen recently, with the views that are recent enough."""
        anew = self._views is None or bool(self._tracks.merged)
        tracks = self._tracks.memory
        results = people.results(self._T_world_root, self._now_s, "" if anew else heard.sensor)
        positions, states, sd = results.positions, results.states, results.sd
        views, said = self._follow_views(heard, people, results, anew), people.conditions(results)
        shown = tracks.confirmed & (self._now_s - tracks.seen_s <= self.settings.shown_for_s)
        return tuple(
            Person(number, positions[row], states[row], tuple(views[row].values()), sd[row], condition=said[row])
            for row, (number, is_shown) in enumerate(zip(people.numbers, shown.tolist(), strict=True))
            if is_shown
        )

    def _follow_views(
        self, heard: Heard, people: People, results: PeopleResults, anew: bool
    ) -> list[dict[str, PotentialSkeleton]]:
        """Return the views in use for each row of people, in the order of the sensors' names.

        Only those of the newest frame are rebuilt, unless all are made anew: a pose has changed, or tracks were merged.
        """
        if anew:
            self._T_world_shown = {}
        shown = [sensor for sensor in people.sensors if sensor in heard.newest and sensor in self._T_root_sensor]
        newest: dict[str, list[PotentialSkeleton]] = {}
        for sensor in shown if anew else {heard.sensor}.intersection(shown):
            frame, T = heard.newest[sensor].frame, self._T_world_shown.get(sensor)
            if T is None:
                T = self._T_world_shown[sensor] = self._T_world_root @ self._T_root_sensor[sensor]
            newest[sensor] = people.views_of(results, sensor, frame.time_ns, self._poses.get(sensor, frame), T)
        before = None if anew else self._views
        self._views = followed(before or {}, newest, sorted(shown), people, results.fresh)
        return list(self._views.values())

    def _scene(self, arrival: Arrival) -> Scene:
        step, self._steps = self._steps, self._steps + 1
        parts: dict[str, tuple[Any, ...]] = {"people": self._shown, "arms": self._shown_arms}
        state, places = self._state, self._places
        if cameras := self._bodies.places():
            parts["bodies"] = self._shown_bodies
            reason = "; ".join(part for part in (state.reason, self._bodies.reason) if part)
            state = msgspec.structs.replace(state, reason=reason)
            places = tuple(sorted((*places, *cameras), key=lambda place: place.sensor))
        return scene_at(arrival, step, state, parts, topology=self._arrivals.topology, sensors=places)


@lru_cache(maxsize=64)
def _frame_pose(tilt: float, height: float) -> SensorPose:
    """Return a pose that frames repeat, as one shared value."""
    return SensorPose(tilt, height)


_OWN_MEMORY: Final = (
    *("_now_s", "_approached_s", "_outvoted_s", "_steps", "_rejected", "_state", "_conditions"),
    *("_shown", "_views", "_places"),
    *("_shown_arms", "_shown_bodies"),
    *("_root", "_T_root_sensor", "_T_world_root"),
)
_REMEMBERED: Final = (
    Bodies,
    CalibratedSensor,
    PeopleCalibrationSettings,
    ColdStart,
    Component,
    *(Floor, FloorFromFeet),
    JumpSettings,
    *(PairCalibration, PairEstimate, PairOfSensors, PairSettings),
    PeopleState,
    PlacedSensor,
    *(SensorLayout, LayoutPair, LayoutSensor),
    SensorPair,
    SensorPose,
    SensorTracks,
    TimeOffset,
    BodyFrame,
    Person,
    Phase,
    FacingMemory,
    PeopleMemory,
    PotentialSkeleton,
    SeenBodies,
    SensorPlace,
    Sighting,
    TrackMemory,
    TrackerState,
    TrackSettings,
    TrackedArm,
    *ARMS_REMEMBERED,
    *BODIES_REMEMBERED,
)
