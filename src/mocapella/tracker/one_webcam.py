"""The method ``one-webcam``: people before a single camera, from a detector that estimates depth relative to the body.

    place  = rays + relative body + stature      by linear least squares
    size   = stature and floor                   averaged by their variances
    person = smoothed size, floor frame          nothing is measured: all joints are inferred

See `mocapella.fusion.one_camera`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.association.keypoint_rays import halpe_keypoints, sources_named
from mocapella.conventions import NS_PER_S
from mocapella.decoding import FAULTS, convert, decode_msgpack
from mocapella.errors import MocapellaError, WireError
from mocapella.fusion.one_camera import camera_of_view, place_by_rays, scale_by_floor, stature_of
from mocapella.geometry.lens import undistort
from mocapella.geometry.rigid import apply, rigid, rotation_about_x
from mocapella.model.keypoints import NO_ID, KeypointFrame
from mocapella.model.observations import Arrival, JointState
from mocapella.model.scene import Person, Phase, Scene, SensorPlace, TrackerState
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.topology import topology
from mocapella.settings import check
from mocapella.tracker.arrivals import time_problem
from mocapella.tracker.method import not_taken
from mocapella.tracker.protocol import TrackerReport, scene_at

Float64 = NDArray[np.float64]

HALPE: Final = topology("halpe_26")
SIDES: Final = ("L", "R")
CHAINS: Final = np.array([[HALPE.index(s + j) for j in ("Ankle", "Knee", "Hip", "Shoulder")] for s in SIDES])
FEET: Final = [HALPE.index(s + j) for s in SIDES for j in ("Ankle", "Heel", "BigToe")]
MEANS: Final = {"Hip": ("LHip", "RHip"), "Neck": ("LShoulder", "RShoulder")}
"""Joints that a detector may lack, as means of others."""
DEPTH_SD: Final = 0.15
"""Standard deviation of a detector's relative depth, part of the stature; ours, rounded."""
LEAST: Final = 0.3
"""Least confidence of a keypoint that is used."""
MOST_PEOPLE: Final = 16
"""Most detections of an image that are used."""
TILT_SD_RAD: Final = math.radians(2.0)
CAMERA_HEIGHT_SD_M: Final = 0.03
"""Standard deviations of the camera's stated tilt [rad] and height [m]."""


@dataclass(frozen=True)
class OneWebcamSettings:
    """Settings of the method ``one-webcam``.

    Attributes:
        height_m: stature of the people; larger: people are farther away [m].
        height_sd_m: standard deviation of the statures; larger: the floor counts more [m].
        camera_height_m: height of the camera above the floor; 0: unknown, and people's size alone tells the distance,
            and the camera is taken to be at their height; larger: people are farther away [m].
        tilt_deg: tilt of the camera, upwards positive; larger: it looks higher [°].
        field_of_view_deg: across the image's longer side, of a camera without a rig; larger: people are nearer [°].
        sd_px: standard deviation of a sure keypoint; larger: less certain places [px].
        size_s: time constant of a person's size; larger: steadier, and later right [s].
        unseen_s: an unseen person is forgotten after this time; larger: people stay longer [s].
        same_within_m: people without an id of the detector are the same if they move less than this from image to
            image; larger: faster people keep their number, and close ones may exchange it [m].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    height_m: float = 1.7
    height_sd_m: float = 0.1
    camera_height_m: float = 0.0
    tilt_deg: float = 0.0
    field_of_view_deg: float = 65.0
    sd_px: float = 5.0
    size_s: float = 2.0
    unseen_s: float = 0.7
    same_within_m: float = 0.6

    def __post_init__(self) -> None:
        check(0.4 <= self.height_m <= 2.5, "height_m", self.height_m, "from 0.4 to 2.5 m")
        check(0.001 <= self.height_sd_m <= 1, "height_sd_m", self.height_sd_m, "from 0.001 to 1 m")
        check(0 <= self.camera_height_m <= 20, "camera_height_m", self.camera_height_m, "from 0 to 20 m")
        check(-80 <= self.tilt_deg <= 80, "tilt_deg", self.tilt_deg, "from -80 to 80°")
        check(10 <= self.field_of_view_deg <= 150, "field_of_view_deg", self.field_of_view_deg, "from 10 to 150°")
        check(0.1 <= self.sd_px <= 100, "sd_px", self.sd_px, "from 0.1 to 100 px")
        check(0 <= self.size_s <= 600, "size_s", self.size_s, "from 0 to 600 s")
        check(0 < self.unseen_s <= 60, "unseen_s", self.unseen_s, "above 0 and at most 60 s")
        check(0 < self.same_within_m <= 5, "same_within_m", self.same_within_m, "above 0 and at most 5 m")


class _Followed(msgspec.Struct):
    """A person: number, the detector's id, time [s], place in the camera's axes [m], stature ratio and size factor."""

    id: int
    seen_as: int
    at_s: float
    place: tuple[float, float, float]
    ratio: float
    factor: float


class _Memory(msgspec.Struct):
    """State of the tracker, except the people that are shown."""

    steps: int = 0
    next_id: int = 0
    sensor: str = ""
    newest: tuple[int, int] | None = None
    rejected: dict[str, int] = {}
    people: list[_Followed] = []


class OneWebcamTracker:
    """Tracker of the method ``one-webcam``; see `mocapella.tracker.protocol.Tracker`.

    Args:
        settings: statures, and where the camera is; the defaults if None.
        lens: (9,) intrinsics of the calibrated camera; None for an unknown lens of ``field_of_view_deg``.
    """

    def __init__(self, settings: OneWebcamSettings | None = None, lens: Float64 | None = None) -> None:
        self.settings, self._lens = settings or OneWebcamSettings(), lens
        s = self.settings
        # The world has y up, its floor is at 0, and the camera looks along -z from above the origin.
        level = np.diag([1.0, -1.0, -1.0]) @ rotation_about_x(math.radians(s.tilt_deg))
        self._height_m = s.camera_height_m
        self._T_world_camera = rigid(level, (0.0, s.camera_height_m or s.height_m, 0.0))
        self._down = level.T @ np.array([0.0, -1.0, 0.0])
        self.reset()

    def reset(self) -> None:
        """Forget everything, as if newly made."""
        self._memory, self._shown = _Memory(), tuple[Person, ...]()

    def recalibrate(self, reason: str) -> None:
        """Forget all people: the camera's place is a setting."""
        self._memory.people, self._shown = [], ()

    def snapshot(self) -> bytes:
        """Return all state as bytes, for `restore`."""
        shown = [(p.id, p.positions.tolist(), p.states.tolist(), None if p.sd is None else p.sd.tolist())
                 for p in self._shown]  # fmt: skip
        return msgspec.msgpack.encode(_Snapshot(self._memory, shown))

    def restore(self, data: bytes) -> None:
        """Replace all state by that of a `snapshot`.

        Raises:
            WireError: the bytes are no snapshot of this method; the tracker is then reset.
        """
        try:
            kept = convert(decode_msgpack(data), _Snapshot, what="memory")
            people = tuple(_person(*row) for row in kept.people)
        except (*FAULTS, MocapellaError) as error:
            self.reset()
            raise WireError(f"{len(data)} bytes that are no memory of the method one-webcam ({error})") from error
        self._memory, self._shown = kept.memory, people

    @property
    def report(self) -> TrackerReport:
        """Counts of all frames so far; calibrations and restarts are not counted and always 0."""
        m = self._memory
        return TrackerReport(m.steps, m.steps - sum(m.rejected.values()), dict(m.rejected), 0, 0)

    def update(self, arrival: Arrival) -> Scene:
        """Process the camera's keypoints, and return the scene. A frame that cannot be used is counted in `report`."""
        m, frame = self._memory, arrival.frame
        if problem := self._problem(frame):
            m.rejected[problem] = m.rejected.get(problem, 0) + 1
        elif isinstance(frame, KeypointFrame):  # others are for the take only
            m.sensor, m.newest = frame.sensor, (frame.node_id, frame.time_ns)
            self._shown = self._track(frame, arrival.at_ns / NS_PER_S)
        step, m.steps = m.steps, m.steps + 1
        state = TrackerState(Phase.TRACKING) if m.sensor else TrackerState(Phase.WAITING_FOR_SENSORS, sensors_missing=1)
        why = "one camera: distances are inferred from the people's height"
        places = (SensorPlace(m.sensor, self._T_world_camera, quality="as set", problem=why),) if m.sensor else ()
        return scene_at(arrival, step, state, {"people": self._shown}, topology=HALPE, sensors=places)

    def _problem(self, frame: SensorFrame) -> str:
        m = self._memory
        if not isinstance(frame, KeypointFrame):
            return not_taken(frame, "one-webcam")
        if m.sensor and frame.sensor != m.sensor:
            return f"the method one-webcam tracks {m.sensor} alone; calibrate both, and use the method webcams"
        if frame.relative is None and frame.bodies:
            return "its detector estimates no depth of its own; use --detector mediapipe"
        if sources_named(frame.topology.name) is None:
            return f"its keypoints are {frame.topology.name}, which have no mapping to halpe_26: use another detector"
        return time_problem(frame, m.newest)

    def _track(self, frame: KeypointFrame, at_s: float) -> tuple[Person, ...]:
        m, s = self._memory, self.settings
        kept = [one for one in m.people if 0 <= at_s - one.at_s <= s.unseen_s]
        lens = camera_of_view(frame.size_px, math.radians(s.field_of_view_deg)) if self._lens is None else self._lens
        shown: list[Person] = []
        taken: set[int] = set()
        for k in range(min(frame.bodies, MOST_PEOPLE)):
            slopes, relative, sds = self._seen(frame, k, lens)
            implied = stature_of(relative, CHAINS)
            if not implied > 0.2:
                continue
            ratio = s.height_m / implied
            placed = place_by_rays(slopes, relative * ratio, sds)
            if placed is None:
                continue
            person = self._same(kept, taken, int(frame.ids[k]), placed.translation)
            share = 1.0 if person is None or s.size_s == 0 else 1 - math.exp(-(at_s - person.at_s) / s.size_s)
            if person is not None:
                ratio = person.ratio + share * (ratio - person.ratio)
                placed = place_by_rays(slopes, relative * ratio, sds)
            if placed is None:
                continue
            body = relative * ratio + placed.translation
            factor, factor_sd = self._factor(body)
            if person is not None:
                factor = person.factor + share * (factor - person.factor)
            else:
                person = _Followed(m.next_id, NO_ID, at_s, (0.0, 0.0, 0.0), ratio, factor)
                m.next_id += 1
                kept.append(person)
            taken.add(person.id)
            place = placed.translation
            person.seen_as, person.at_s, person.ratio, person.factor = int(frame.ids[k]), at_s, ratio, factor
            person.place = (float(place[0]), float(place[1]), float(place[2]))
            shown.append(self._shown_person(person.id, factor * body, factor_sd))
        m.people = kept
        return tuple(sorted(shown, key=lambda one: one.id))

    def _seen(self, frame: KeypointFrame, k: int, lens: Float64) -> tuple[Float64, Float64, Float64]:
        """Return a detection's slopes, relative body and standard deviations of the slopes, as Halpe's joints.

        Joints that the topology shifts are shifted in the image and in the body, see `halpe_keypoints`.
        """
        assert frame.relative is not None
        name, confidences = frame.topology.name, frame.confidences[k : k + 1]
        places, certain = halpe_keypoints(name, frame.positions_px[k : k + 1], confidences)
        body, _ = halpe_keypoints(name, frame.relative[k : k + 1], confidences)
        there = (np.asarray(sources_named(name)) >= 0)[:, None]
        pixels = np.where(there, places[0], np.nan).astype(np.float64)
        relative = np.where(there, body[0], np.nan).astype(np.float64)
        sure = certain[0]
        pixels[sure < LEAST] = np.nan
        sds = self.settings.sd_px / lens[0] / np.maximum(sure, LEAST)
        return undistort(pixels, lens), relative, sds

    def _same(self, kept: list[_Followed], taken: set[int], seen_as: int, place: Float64) -> _Followed | None:
        free = [one for one in kept if one.id not in taken]
        if seen_as != NO_ID:
            return next((one for one in free if one.seen_as == seen_as), None)
        far = [math.dist(one.place, place.tolist()) for one in free]
        best = min(range(len(free)), key=far.__getitem__, default=None)
        return None if best is None or far[best] > self.settings.same_within_m else free[best]

    def _factor(self, body: Float64) -> tuple[float, float]:
        s = self.settings
        size_sd = s.height_sd_m / s.height_m
        feet = body[FEET]
        feet = feet[np.isfinite(feet).all(axis=-1)]
        if not len(feet) or self._height_m == 0:
            return 1.0, size_sd
        lowest = feet[np.argmax(feet @ self._down)]
        return scale_by_floor(
            lowest, self._down, self._height_m, height_sd=CAMERA_HEIGHT_SD_M, tilt_sd=TILT_SD_RAD, size_sd=size_sd
        )

    def _shown_person(self, number: int, body: Float64, factor_sd: float) -> Person:
        positions = apply(self._T_world_camera, body)
        for joint, (one, other) in MEANS.items():
            if not np.isfinite(positions[HALPE.index(joint)]).all():
                positions[HALPE.index(joint)] = (positions[HALPE.index(one)] + positions[HALPE.index(other)]) / 2
        away = np.linalg.norm(body, axis=-1)
        away[~np.isfinite(away)] = np.nanmean(away)
        # Mean over the three axes: the size changes the distance, the detector's depth the place along the ray.
        sd = np.sqrt(((factor_sd * away) ** 2 + (DEPTH_SD * self.settings.height_m) ** 2) / 3)
        known = np.isfinite(positions).all(axis=-1)
        states = np.where(known, JointState.INFERRED, JointState.NOT_TRACKED)
        return _person(number, positions, states, np.where(known, sd, np.nan))


_Shown = tuple[int, list[list[float | None]], list[int], list[float | None] | None]


class _Snapshot(msgspec.Struct):
    """All state: the memory, and the people that are shown."""

    memory: _Memory
    people: list[_Shown]


def _person(number: int, positions: Any, states: Any, sd: Any) -> Person:
    placed, kinds = np.array(positions, np.float64), np.array(states, np.uint8)
    scatter = None if sd is None else np.array(sd, np.float32)
    if placed.shape != (26, 3) or kinds.shape != (26,) or (scatter is not None and scatter.shape != (26,)):
        raise WireError("a person of another shape")
    if (kinds > JointState.INFERRED).any():
        raise WireError("a joint that is measured")
    return Person(number, placed, kinds, (), scatter, "", "seen by one camera: its distance is inferred")
