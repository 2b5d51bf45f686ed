"""The method ``webcams``: track people and hands in 3D with several cameras, from keypoints in their images.

Without a rig, the cameras are calibrated from the people first (`webcams_calibration`).

    instants = collect(frames)                 one frame of each camera
    people   = predict(people)
    matches  = assign(people, detections)      optimal in each camera
    new      = group(other detections)         consistent over all cameras
    people   = correct(people, rays)           a body model, each ray at its own time
    hands    = fit(hands, landmarks)           at the wrists of people, or alone

See docs/methods/webcams.md.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import groupby
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.association.hand_keypoints import hand_sources
from mocapella.association.keypoint_rays import JOINTS, CameraArrays, Matches, Rays, halpe_keypoints, sources_named
from mocapella.conventions import NS_PER_S
from mocapella.errors import SettingsError, WireError
from mocapella.geometry.lens import farthest_r2
from mocapella.geometry.rigid import inverse
from mocapella.kinematics.articulated_model import memory_size
from mocapella.kinematics.ray_body import RAY_SETTINGS, ray_model
from mocapella.model.camera import CameraRig
from mocapella.model.keypoints import KeypointFrame
from mocapella.model.markers import MarkerFrame
from mocapella.model.memory import pack, recalls, set_memory, unpack
from mocapella.model.observations import Arrival
from mocapella.model.scene import Person, Phase, Scene, SensorPlace, TrackedHand, TrackerState
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.topology import topology
from mocapella.settings import check
from mocapella.tracker.arrivals import camera_problem, time_problem
from mocapella.tracker.expected_regions import expected_regions
from mocapella.tracker.instants import MEMORY as INSTANTS_MEMORY
from mocapella.tracker.instants import MOST_DETECTIONS, CameraInstant, InstantFrame, Instants, most_confident
from mocapella.tracker.method import not_taken
from mocapella.tracker.protocol import TrackerReport, scene_at
from mocapella.tracker.webcams_calibration import ANEW, SelfCalibration
from mocapella.tracker.webcams_calibration import REMEMBERED as CALIBRATION_REMEMBERED
from mocapella.tracker.webcams_conditions import (
    PATIENCE_S,
    count_strangers,
    disagree,
    disagreeing,
    place_of,
    problems,
    trouble,
)
from mocapella.tracker.webcams_exchange import MEMORY as EXCHANGE_MEMORY
from mocapella.tracker.webcams_exchange import ExchangeWatch
from mocapella.tracker.webcams_hands import KINDS as HAND_KINDS
from mocapella.tracker.webcams_hands import WebcamsHands
from mocapella.tracker.webcams_identity import MEMORY as IDENTITY_MEMORY
from mocapella.tracker.webcams_identity import Identities, LostPerson, floor_of, ready
from mocapella.tracker.webcams_markers import MEMORY as MARKERS_MEMORY
from mocapella.tracker.webcams_markers import HandMarkers
from mocapella.tracker.webcams_memory import CANDIDATE, CameraCounts, PeopleArrays, no_counts, no_people
from mocapella.tracker.webcams_settings import WebcamsSettings
from mocapella.tracker.webcams_vertical import MEMORY as VERTICAL_MEMORY
from mocapella.tracker.webcams_vertical import Vertical

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

APART_M: Final = 0.05
"""Two cameras nearer than this see no distance [m]."""
ALONE_S: Final = 0.25
"""Time without agreement of two cameras after which a person's condition tells so [s]."""
UNSURE_M: Final = 0.5
"""Mean standard deviation of the joints, all axes together, above which a person is not shown any more [m]."""
UNSURE_S: Final = 0.4
"""Time without agreement of two cameras after which such a person is not shown [s]."""
AHEAD_S: Final = 0.05
"""Least time since the last instant for a scene to use the frames that the next instant has so far [s]."""
LOOK_EVERY: Final = 2
"""Number of instants from one search for strangers, in the next camera's image, to the next."""
LOOK_UP_EVERY: Final = 4
"""Number of instants from one comparison of people with the upward direction to the next, after the first."""


class WebcamsTracker:
    """Tracker of the method ``webcams``: people and hands, from the keypoints that calibrated cameras see.

    Args:
        rig: the cameras' intrinsics and poses; their clock offsets are used with the setting ``rig_clocks`` only,
            because arrivals have the common clock. None: the cameras calibrate themselves while people walk about.
        settings: settings of every stage; the defaults if None.
        sensors_expected: number of cameras to wait for, at least two, limited to the number in a given rig.

    Attributes:
        rig: the rig in use; without cameras until these are calibrated.

    Raises:
        SettingsError: the rig has fewer than two cameras, or all are at one place.
    """

    def __init__(
        self, rig: CameraRig | None = None, settings: WebcamsSettings | None = None, *, sensors_expected: int = 2
    ) -> None:
        self.settings = s = settings or WebcamsSettings()
        self._wanted = sensors_expected
        kept_s = max(RAY_SETTINGS.forget_after_s, s.hidden_s + 0.1, s.unseen_s + 0.1)
        model = ray_model(replace(RAY_SETTINGS, forget_after_s=kept_s))
        self._model, self._row = model.arrays, memory_size(model)
        self._kernels = _kernels()
        self._gates = s.association.gates
        self._limits = self._kernels.PeopleLimits(
            float(s.one_camera_s), float(s.unseen_s), int(s.doubtful_instants), float(s.same_within_m),
            float(s.measured_sd_m), float(s.measured_s), float(s.slow_error_s), float(s.hidden_s),
        )  # fmt: skip
        self._identities = Identities(s)
        self._hands = WebcamsHands(s)
        self._markers = HandMarkers(s.hands)
        self._vertical = Vertical()
        self._exchange = ExchangeWatch()
        self._own = SelfCalibration(s, max(self._wanted, 2)) if rig is None else None
        self._names: list[str] = []
        if rig is not None:
            self._set_rig(rig)
        self.reset()

    def _set_rig(self, rig: CameraRig) -> None:
        _check_rig(rig)
        names = sorted(rig.cameras)
        if names != self._names:
            self._instants = Instants(self.settings.silent_after_s, len(names))
        self.rig, self._names = rig, names
        self._hands.set_rig(rig)
        self._column = {name: i for i, name in enumerate(names)}
        self._sensors_expected = min(max(self._wanted, 2), len(names))
        placed = [rig.cameras[name] for name in names]
        used = self._own is not None or self.settings.rig_clocks
        self._clocks_s = [one.clock_s if used else 0.0 for one in placed]
        poses = [inverse(one.T_camera_world) for one in placed]
        self._cameras = CameraArrays(
            np.array([one.camera.lens for one in placed], dtype=np.float64),
            np.array([min(farthest_r2(one.camera.lens), 1e9) for one in placed]),
            np.array([T[:3, :3] for T in poses]),
            np.array([T[:3, 3] for T in poses]),
            np.array([one.camera.size_px for one in placed], dtype=np.float64),
            self._vertical.up,
        )
        self._places = tuple(place_of(one) for one in placed)
        if self._own is not None:
            self._places = self._own.places(self._places)

    def _time_sds_s(self) -> Float64:
        """Return the standard deviations (cameras,) of the cameras' times: the setting's, or smaller ones if stated."""
        stated = np.full(len(self._names), self.settings.time_sd_s)
        return stated if self._own is None else np.minimum(stated, self._own.time_sds_s(self._names))

    def _set_no_rig(self) -> None:
        """Wait for the cameras' own calibration."""
        self.rig, self._names, self._column, self._places = CameraRig({}), [], {}, ()
        self._sensors_expected = max(self._wanted, 2)
        self._instants = Instants(self.settings.silent_after_s, self._sensors_expected)

    def _use_own_rig(self, rig: CameraRig, *, small: bool) -> None:
        """Use a rig of the cameras' own calibration; people keep their numbers, and their places after a small step."""
        names = self._names
        self._set_rig(rig)
        if not small or self._names != names:
            self._instants.reset()
            self._identities.forget_people()
            self._hands.forget_hands()
            self._forget_people()
            self._state = TrackerState(Phase.WAITING_FOR_SENSORS, self._sensors_expected)
        self._counts = no_counts(len(self._names), self._time_sds_s())

    def use_rig(self, rig: CameraRig, reason: str) -> None:
        """Replace the rig, such as by a newer calibration; people are found anew, with new numbers.

        A tracker whose cameras calibrate themselves uses the rig from now on, and calibrates no more.

        Args:
            rig: the new rig.
            reason: text for the user, see `recalibrate`.

        Raises:
            SettingsError: the rig has fewer than two cameras, or all are at one place.
        """
        _check_rig(rig)
        self._own = None
        self._set_rig(rig)
        self.recalibrate(reason)

    def reset(self) -> None:
        """Forget everything, as if newly made."""
        if self._own is not None:
            self._own.reset()
            self._set_no_rig()
        self._instants.reset()
        self._identities.reset()
        self._hands.reset()
        self._markers.reset()
        self._newest: dict[str, tuple[int, int]] = {}
        self._rejected: Counter[str] = Counter()
        self._steps = 0
        self._forget_people()
        self._state = TrackerState(Phase.WAITING_FOR_SENSORS, sensors_missing=self._sensors_expected)

    def _forget_people(self) -> None:
        self._vertical.reset()
        self._exchange.reset()
        self._use_vertical()
        self._people = no_people(self._row, len(self._names))
        self._counts = no_counts(len(self._names), self._time_sds_s())
        self._began_s, self._shown_s, self._at_s = math.nan, math.nan, math.nan
        self._partial, self._looks = False, 0
        self._scene_of: tuple[int, tuple[Person, ...], tuple[TrackedHand, ...], tuple[SensorPlace, ...]] | None = None

    def _use_vertical(self) -> None:
        """Measure heights along the upward direction that is known now."""
        if self._names:
            self._cameras = self._cameras._replace(up=self._vertical.up)

    def recalibrate(self, reason: str) -> None:
        """Forget all people, and find them anew; the rig, the numbers given so far and the counts of `report` stay.

        Cameras that calibrate themselves forget their rig, and begin anew. The tracker's state becomes
        `Phase.WAITING_FOR_SENSORS`, and has ``reason``, a text for the user, until enough cameras send keypoints.
        """
        if self._own is not None:
            self._own.reset()
            self._set_no_rig()
        self._instants.reset()
        self._identities.forget_people()
        self._hands.forget_hands()
        self._forget_people()
        self._state = TrackerState(Phase.WAITING_FOR_SENSORS, self._sensors_expected, reason=reason)

    def snapshot(self) -> bytes:
        """Return all state as bytes, for `restore`: a tracker made with the same arguments continues identically."""
        own = {name: getattr(self, name) for name in _OWN_MEMORY}
        people, counts = self._people._asdict(), self._counts._asdict()
        calibration = None if self._own is None else [self._own.memory(), self.rig]
        parts = [self._instants.memory(), self._identities.memory(), self._hands.memory(), calibration]
        parts += [self._markers.memory(), self._vertical.memory(), self._exchange.memory()]
        return pack([own, people, counts, *parts], _REMEMBERED)

    @recalls
    def restore(self, data: bytes) -> None:
        """Replace all state by that of a `snapshot` of a tracker made with the same arguments.

        Raises:
            WireError: the bytes are no snapshot of this method; the tracker is then reset.
        """
        own, people, counts, instants, identities, hands, calibration, *others = unpack(data, _REMEMBERED)
        markers, vertical, exchange = others
        if (calibration is None) != (self._own is None):
            raise WireError("the snapshot and this tracker differ in whether a rig is given")
        if self._own is not None:
            self._own.recall(calibration[0])
            if calibration[1].cameras:
                self._set_rig(calibration[1])
            else:
                self._set_no_rig()
        self._scene_of = None
        self._people = _arrays_like(no_people(self._row, len(self._names)), people)
        self._counts = _arrays_like(no_counts(len(self._names)), counts)
        set_memory(self, own, _OWN_MEMORY)
        set_memory(self._instants, instants, INSTANTS_MEMORY)
        set_memory(self._identities, identities, IDENTITY_MEMORY)
        self._hands.recall(hands)
        set_memory(self._markers, markers, MARKERS_MEMORY)
        set_memory(self._vertical, vertical, VERTICAL_MEMORY)
        set_memory(self._exchange, exchange, EXCHANGE_MEMORY)
        self._use_vertical()

    @property
    def report(self) -> TrackerReport:
        """Counts of all frames so far, and of the cameras' own calibrations."""
        kept = self._steps - self._rejected.total()
        counted = (0, 0) if self._own is None else (self._own.calibrations, self._own.restarts)
        return TrackerReport(self._steps, kept, dict(self._rejected), *counted)

    def update(self, arrival: Arrival) -> Scene:
        """Process a camera's keypoints, and return the scene: the people at the time of the arrival.

        A frame that completes no instant gives people predicted to its time. A frame that cannot be used is counted in
        `report` and changes nothing.
        """
        frame = arrival.frame
        if problem := self._problem(frame, arrival.at_ns):
            self._rejected[problem] += 1
        elif isinstance(frame, MarkerFrame):
            self._newest[frame.sensor] = (frame.node_id, frame.time_ns)
            self._markers.add(frame, arrival.at_ns)
        elif isinstance(frame, KeypointFrame):  # others are for the take only
            self._newest[frame.sensor] = (frame.node_id, frame.time_ns)
            self._calibrate(frame, arrival.at_ns)
            known = frame.sensor in self._column
            done = self._instants.update(frame, arrival.at_ns) if known else []
            for instant in done:
                self._track(instant)
            if done or self._state.phase != Phase.TRACKING:
                self._state = self._new_state()
                self._scene_of = None
        if self._scene_of is None or self._scene_of[0] != arrival.at_ns:
            people = self._shown(arrival.at_ns / NS_PER_S)
            hands = self._hands.shown(arrival.at_ns / NS_PER_S)
            remedy = "calibrate again" if self._own is None else ANEW
            self._scene_of = (arrival.at_ns, people, hands, self._problems(remedy))
        step, self._steps = self._steps, self._steps + 1
        _, people, hands, sensors = self._scene_of
        halpe = topology("halpe_26")
        return scene_at(arrival, step, self._state, {"people": people, "hands": hands}, topology=halpe, sensors=sensors)

    def expected_regions(self, sensor: str) -> Float32:
        """Return the boxes (people, 4) of the last scene's people in a camera's image; see `ExpectsPeople`."""
        placed = self.rig.cameras.get(sensor)
        if self._scene_of is None or placed is None:
            return np.empty((0, 4), np.float32)
        return expected_regions(self._scene_of[1], placed)

    def _calibrate(self, frame: KeypointFrame, at_ns: int) -> None:
        """Give a frame to the cameras' own calibration, if there is no given rig."""
        if self._own is None or sources_named(frame.topology.name) is None:
            return
        if self._names and disagreeing(self._counts).any():
            self._own.begin_anew()
        new = self._own.update(frame, at_ns / NS_PER_S)
        if new is not None:
            self._use_own_rig(new.rig, small=new.small)

    def _problem(self, frame: SensorFrame, at_ns: int) -> str:
        """Return why a frame is rejected, with a remedy; empty if it is used."""
        if isinstance(frame, MarkerFrame):
            problem = self._markers.problem(frame, self.rig)
        elif isinstance(frame, KeypointFrame):
            problem = self._foreign(frame)
        else:
            return not_taken(frame, "webcams")
        if problem:
            return problem
        if problem := time_problem(frame, self._newest.get(frame.sensor)):
            return problem
        newest = self._instants.newest_ns
        if newest is not None and newest - at_ns > self.settings.late_s * NS_PER_S:
            old = f"it is more than {self.settings.late_s:g} s older than other cameras' frames"
            return f"{old}: check its clock, and whether its machine is too busy"
        return ""

    def _foreign(self, frame: KeypointFrame) -> str:
        """Return why a frame does not belong to the rig, or has keypoints that are not known; empty if it does."""
        if frame.sensor not in self.rig.cameras and self._own is not None:  # not calibrated yet
            return _unmapped(frame)
        return camera_problem(self.rig, frame.sensor, frame.size_px) or _unmapped(frame)

    def _track(self, instant: CameraInstant) -> None:
        """Track one instant, and give new people their numbers."""
        s, people, kernels, at_s = self.settings, self._people, self._kernels, instant.at_ns / NS_PER_S
        pixels, rays, delivered = self._rays(instant)
        self._at_s, self._partial = at_s, self._lacks_frames(instant)
        matches, agreed, gone = self._correct(
            at_s, pixels, rays, delivered, incomplete=self._partial, people=people, counts=self._counts
        )
        for row in np.flatnonzero(gone).tolist():
            if people.ids[row] >= 0:
                self._identities.lose(people, row)
            kernels.forget(people, row)
        if (people.ids == CANDIDATE).any():
            returns, up = partial(self._identities.returns, people, at_s=at_s), self._vertical.up
            for row in ready(
                people, s, agreed, self._cameras.origins, missed=self._counts.missed, floor=floor_of(people, up), up=up,
                known=returns,
            ):  # fmt: skip
                self._identities.confirm(people, row, at_s, agreed, kernels.forget)
        due = self._looks % LOOK_UP_EVERY == 0 or not self._vertical.compared
        if due and self._vertical.update(people):
            self._use_vertical()
        self._look_for_strangers(pixels, rays, delivered)
        if self._own is None:
            self._exchange.update(
                instant, self.rig.cameras, lambda: disagree(self._counts) or self._nobody_s() > PATIENCE_S
            )
        self._hands.update(instant, matches, people, self._markers.take(instant.at_ns, self._column))
        if math.isnan(self._began_s):
            self._began_s = at_s
        if (people.ids >= 0).any():
            self._shown_s = at_s

    def _correct(
        self, at_s: float, pixels: Float64, rays: Rays, delivered: Bools, *, incomplete: bool, people: PeopleArrays,
        counts: CameraCounts,
    ) -> tuple[Matches, Bools, Bools]:  # fmt: skip
        """Correct people and counts, in place, by an instant's rays; return matches, who agreed, and who is gone."""
        association, count = self.settings.association, len(pixels)
        matches = Matches(
            np.full(count, -1, dtype=np.int64), np.zeros(count, dtype=np.bool_), np.full(count, -1, dtype=np.int64),
            np.full(count, np.nan),
        )  # fmt: skip
        gone = np.zeros(len(people.ids), dtype=np.bool_)
        agreed = np.zeros((len(people.ids), len(self._names)), dtype=np.bool_)
        self._kernels.track_instant(
            self._model, people, at_s, pixels, rays, self._cameras, float(association.joint_sd),
            float(association.least_sd_px), self._gates, self._limits, matches, counts, delivered, incomplete,
            agreed, gone,
        )  # fmt: skip
        return matches, agreed, gone

    def _latest(self) -> tuple[PeopleArrays, float, bool]:
        """Return the people as of the newest frames, their time [s], and whether active cameras have not delivered.

        Slow or busy cameras complete few instants. Where the next one is late, the people of the last one are copied
        and corrected by the frames that it has so far; the tracker's own people are corrected once it is complete.
        """
        instant = self._instants.collected()
        if instant is None or not instant.at_ns / NS_PER_S - self._at_s >= AHEAD_S:
            return self._people, self._at_s, self._partial
        people = PeopleArrays(**{name: array.copy() for name, array in self._people._asdict().items()})
        counts = CameraCounts(**{name: array.copy() for name, array in self._counts._asdict().items()})
        at_s, incomplete = instant.at_ns / NS_PER_S, self._lacks_frames(instant)
        self._correct(at_s, *self._rays(instant), incomplete=incomplete, people=people, counts=counts)
        return people, at_s, incomplete

    def _lacks_frames(self, instant: CameraInstant) -> bool:
        """Tell whether active cameras have no frame in an instant."""
        return len(instant.frames) < len(self._instants.active())

    def _look_for_strangers(self, pixels: Float64, rays: Rays, delivered: Bools) -> None:
        """Compare the detections of one camera, in turn, with the people; in every second instant, to save time."""
        turn, self._looks = self._looks, self._looks + 1
        c, rows = turn // LOOK_EVERY % len(self._names), np.flatnonzero(self._people.ids >= 0)
        if turn % LOOK_EVERY or not delivered[c] or not len(rows):
            return
        mine = rays.camera == c
        keypoints = np.where(rays.confidences[mine, :, None] > 0.0, pixels[mine], np.nan)
        if len(keypoints):
            placed = self.rig.cameras[self._names[c]]
            count_strangers(self._counts, c, keypoints, self._people.positions[rows], placed)

    def _rays(self, instant: CameraInstant) -> tuple[Float64, Rays, Bools]:
        """Return the keypoints of all detections of an instant, their cameras and times, and who delivered."""
        frames = [one for one in instant.frames.values() if sources_named(one.frame.topology.name) is not None]
        delivered, first = np.zeros(len(self._names), dtype=np.bool_), 0
        counts = [min(len(one.frame.ids), MOST_DETECTIONS) for one in frames]
        columns = [self._column[one.frame.sensor] for one in frames]
        after_s = [
            (one.at_ns - instant.at_ns) / NS_PER_S - self._clocks_s[column]
            for one, column in zip(frames, columns, strict=True)
        ]
        delivered[columns] = True
        count = sum(counts)
        pixels, confidences = _of_joints(frames, self.settings.association.least_confidence)
        rays = Rays(
            np.repeat(np.array(columns, dtype=np.int64), counts), np.repeat(np.array(after_s), counts),
            np.full((count, JOINTS, 3), np.nan), np.full((count, JOINTS), np.nan), confidences,
        )  # fmt: skip
        for one, own in zip(frames, counts, strict=True):
            readout_s, last = self.rig.cameras[one.frame.sensor].camera.readout_s, first + own
            if readout_s > 0.0:
                rows = _middle_row(pixels[first:last], confidences[first:last])
                rays.after_s[first:last] += rows / one.frame.size_px[1] * readout_s
            first = last
        return pixels, rays, delivered

    def _new_state(self) -> TrackerState:
        if self._own is not None and not self._names:
            return self._own.state(self._sensors_expected, self._state.reason)
        tracking, newest = self._state.phase == Phase.TRACKING, self._instants.newest_ns
        after_s = self.settings.missing_after_s if tracking else self.settings.silent_after_s
        present = set(self._instants.present(after_s))
        if newest is not None:
            present |= self._markers.sending(newest, after_s)
        missing = self._sensors_expected - len(present)
        if missing > 0:
            return TrackerState(Phase.WAITING_FOR_SENSORS, sensors_missing=missing, reason=self._state.reason)
        reason = self._exchange.text or trouble(self._counts, self._names, self._nobody_s())
        return TrackerState(Phase.TRACKING, reason=reason or ("" if self._own is None else self._own.advice))

    def _nobody_s(self) -> float:
        """Return the time since the last person was tracked, or since the first frame [s]."""
        return self._at_s - (self._began_s if math.isnan(self._shown_s) else self._shown_s)

    def _problems(self, remedy: str) -> tuple[SensorPlace, ...]:
        """Return the cameras' places with their problems; ``remedy`` says what to do about one that disagrees."""
        return problems(self._places, self._counts, remedy, exchanged=self._exchange.cameras, text=self._exchange.text)

    def _shown(self, at_s: float) -> tuple[Person, ...]:
        """Return the confirmed people at a time, in the order of their numbers."""
        if not (self._people.ids >= 0).any():
            return ()
        people, last_s, partial = self._latest()
        rows = np.flatnonzero(people.ids >= 0)
        rows = rows[~_unsure(people, rows, last_s)]
        count = len(rows)
        rows = rows[np.argsort(people.ids[rows])]
        positions, sds = np.empty((count, JOINTS, 3)), np.empty((count, JOINTS), dtype=np.float32)
        states = np.empty((count, JOINTS), dtype=np.uint8)
        ahead_s = at_s - last_s
        if ahead_s > self.settings.unseen_s:
            ahead_s = 0.0
        self._kernels.show(self._model, people, rows, last_s, ahead_s, self._limits, partial, positions, sds, states)
        numbers, views = people.ids[rows].tolist(), people.cameras[rows].tolist()
        alone = (last_s - people.agreed_s[rows] > ALONE_S).tolist()
        return tuple(
            Person(number, positions[k], states[k], (), sds[k], "", _condition(views[k]) if alone[k] else "")
            for k, number in enumerate(numbers)
        )


def _of_joints(frames: Sequence[InstantFrame], least: float) -> tuple[Float64, Float64]:
    """Return the pixels (detections, 26, 2) and confidences (detections, 26) of the joints of all detections.

    A joint without a keypoint, or with a confidence below ``least``, has the confidence 0. Frames of one topology that
    follow each other are mapped to the joints together.
    """
    pixels, confidences = [np.empty((0, JOINTS, 2))], [np.empty((0, JOINTS))]
    for name, some in groupby((one.frame for one in frames), key=_topology_name):
        used = [_detections(frame) for frame in some]
        places: Any
        places, sure = halpe_keypoints(name, *(np.concatenate(parts) for parts in zip(*used, strict=True)))
        confidences.append(np.where(sure >= least, sure, 0.0))
        pixels.append(places)
    return np.concatenate(pixels), np.concatenate(confidences)


def _detections(frame: KeypointFrame) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return positions [px] and confidences of the detections that are used."""
    if len(frame.ids) <= MOST_DETECTIONS:
        return frame.positions_px, frame.confidences
    chosen = most_confident(frame)
    return frame.positions_px[chosen], frame.confidences[chosen]


def _topology_name(frame: KeypointFrame) -> str:
    return frame.topology.name


def _unmapped(frame: KeypointFrame) -> str:
    """Return why a frame has keypoints of neither people nor hands; empty if it has."""
    if sources_named(frame.topology.name) is not None or hand_sources(frame.topology.name):
        return ""
    return f"its keypoints are {frame.topology.name}, which have no mapping to halpe_26: use another detector"


def _unsure(people: PeopleArrays, rows: NDArray[np.intp], at_s: float) -> Bools:
    """Return which people (rows,) are too uncertain to be shown: their place is anywhere within about half a metre.

    They are followed, and shown again with their number once a camera tells more.
    """
    variances = np.trace(people.covariances[rows], axis1=2, axis2=3)
    known = np.isfinite(variances)
    total = np.sqrt(np.where(known, np.maximum(variances, 0.0), 0.0)).sum(axis=1)
    unsure: Bools = (total > UNSURE_M * known.sum(axis=1)) & (at_s - people.agreed_s[rows] > UNSURE_S)
    return unsure


def _condition(views: int) -> str:
    if views == 0:
        return "no camera sees this person"
    return "only one camera sees this person" if views == 1 else "the cameras do not agree about this person"


def _check_rig(rig: CameraRig) -> None:
    """Raise `SettingsError` for a rig that cannot measure distances."""
    fix = "a rig with two cameras at different places, by mocapella calibrate cameras"
    check(len(rig.cameras) >= 2, "rig", sorted(rig.cameras), fix)
    centres = np.array([inverse(one.T_camera_world)[:3, 3] for one in rig.cameras.values()])
    if np.linalg.norm(centres[:, None] - centres[None], axis=-1).max() < APART_M:
        raise SettingsError(f"rig has all cameras within {APART_M * 100:g} cm, which see no distance; it must be {fix}")


def _middle_row(pixels: Float64, confidences: Float64) -> Float64:
    rows = np.where(confidences > 0.0, pixels[..., 1], 0.0).sum(axis=1)
    middle: Float64 = rows / np.maximum((confidences > 0.0).sum(axis=1), 1)
    return middle


def _arrays_like(own: Any, given: Any) -> Any:
    """Return arrays of a snapshot as the named tuple of ``own``; raise `WireError` if a type or shape differs."""
    if set(given) != set(own._fields):
        raise WireError("the arrays of people or cameras are not those of this method")
    for name, array in own._asdict().items():
        if given[name].dtype != array.dtype or given[name].shape != array.shape:
            raise WireError(f"{name} has the shape {given[name].shape} and type {given[name].dtype}")
    return type(own)(**given)


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.tracker import webcams_kernels

    return webcams_kernels


_OWN_MEMORY: Final = ("_newest", "_rejected", "_steps", "_began_s", "_shown_s", "_at_s", "_partial", "_state", "_looks")
_REMEMBERED: Final = (
    KeypointFrame, MarkerFrame, InstantFrame, LostPerson, TrackerState, Phase, *HAND_KINDS, *CALIBRATION_REMEMBERED,
)  # fmt: skip
