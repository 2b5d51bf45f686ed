"""The method ``hands``: track coloured markers with several cameras, fit a hand, and track objects that it holds.

    pixels  = smooth(pixels)         each camera's, if configured
    points  = rays(pixels)           each camera's pixels at their own times, one point per marker
    steady  = smooth(points)         if configured
    hand    = fit(steady)            within the joint limits of a hand
    objects = poses(pixels)          rigid objects, from markers, tags or another tracker; held or not

See docs/methods/hand.md and docs/triangulation.md.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.rig_fit import RigFit, RigFitSettings
from mocapella.conventions import NS_PER_S
from mocapella.errors import one_of
from mocapella.fusion.marker_rays import MarkerPoints, MarkerRays, MarkerRaysSettings, RayState
from mocapella.fusion.object_poses import ObjectPoseSettings
from mocapella.geometry.rigid import inverse
from mocapella.kinematics.grasp import GraspSettings
from mocapella.kinematics.hand_settings import HandReport, HandSettings
from mocapella.kinematics.hand_solvers import MAP, SOLVER_NAMES
from mocapella.kinematics.hand_tracker import HandTracker, _State, base_layout
from mocapella.model.camera import CameraRig
from mocapella.model.hand import ConstraintSet, Hand, HandShape, hand_model
from mocapella.model.markers import MarkerFrame
from mocapella.model.memory import pack, recalls, set_memory, unpack
from mocapella.model.observations import Arrival
from mocapella.model.poses import PoseFrame
from mocapella.model.scene import Phase, Scene, SensorPlace, TrackedHand, TrackedObject, TrackedPoints, TrackerState
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.space import SpaceAlignment
from mocapella.model.topology import topology
from mocapella.settings import check
from mocapella.smoothing.one_euro import OneEuro, OneEuroSettings
from mocapella.tracker.arrivals import camera_problem, time_problem
from mocapella.tracker.method import not_taken
from mocapella.tracker.objects import REMEMBERED, UNSAID_SD_PX, ObjectSettings, RigidObjects
from mocapella.tracker.protocol import TrackerReport, scene_at

Float64 = NDArray[np.float64]

_TO_SENSOR: Final = np.diag([-1.0, -1.0, 1.0, 1.0])
"""From a sensor's space (x left, y up) to a camera's (x right, y down)."""


@dataclass(frozen=True)
class HandsSettings:
    """Markers, and the settings of every stage.

    Attributes:
        tips: names of the markers on the fingertips, thumb to little finger.
        base: names of the markers on the hand's base.
        base_places_m: (base, 3) positions of the base markers in the palm frame of a right hand; empty for the default
            positions on the palm [m].
        middle_sd_px: standard deviation of a marker's centre because it may be partly visible, in addition to the
            camera's own; larger: the prediction counts more, with less jitter and more lag [px].
        constraints: ``full``: 21 joint angles are free; ``thesis``: 15, as each finger's last joint follows the one
            before, and the middle finger and the thumb's second joint do not spread.
        solver: inverse kinematics of the digits whose tips are seen: ``map`` fits palm and angles together with priors;
            ``closed-form``, ``fabrik``, ``transpose``, ``pseudo-inverse``, ``dls`` and ``newton`` take the palm of that
            fit, and bring each tip to its marker.
        rays: tracking of markers.
        fit: fit of the hand.
        smoothing_2d: 1-euro filter of each camera's pixels, before triangulation, with speeds in px/s; None for none.
            Keys: min_cutoff_hz, beta_per_m, speed_cutoff_hz, forget_after_s, per_component.
        smoothing: 1-euro filter of the 3D points, before the hand is fitted; None for none. Keys as of
            ``smoothing_2d``.
        objects: rigid objects to track, a mapping for each with the keys of `mocapella.tracker.objects.ObjectSettings`:
            its name, and markers, tags or another tracker's body; docs/hands.md has examples.
        poses: tracking of objects.
        tag_sd_px: standard deviation of a tag's corner by lens and mounting, in addition to the camera's own; larger:
            the prediction counts more [px].
        spaces: frames of reference of other trackers, as estimated by `mocapella calibrate space`.
        grasp: detection of held objects.
        rig_fit: thresholds for reporting swapped cameras, or a rig that does not fit.
        silent_after_s: a camera without a frame for this long is not waited for [s].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    tips: tuple[str, str, str, str, str] = ("red", "yellow", "green", "blue", "magenta")
    base: tuple[str, ...] = ("cyan",)
    base_places_m: tuple[tuple[float, float, float], ...] = ()
    middle_sd_px: float = 0.4
    constraints: ConstraintSet = "thesis"
    solver: str = MAP
    rays: MarkerRaysSettings = field(default_factory=MarkerRaysSettings)
    fit: HandSettings = field(default_factory=HandSettings)
    smoothing_2d: OneEuroSettings | None = None
    smoothing: OneEuroSettings | None = None
    objects: tuple[ObjectSettings, ...] = ()
    poses: ObjectPoseSettings = field(default_factory=ObjectPoseSettings)
    tag_sd_px: float = 0.1
    spaces: tuple[SpaceAlignment, ...] = ()
    grasp: GraspSettings = field(default_factory=GraspSettings)
    rig_fit: RigFitSettings = field(default_factory=RigFitSettings)
    silent_after_s: float = 1.0

    def __post_init__(self) -> None:
        names = self.markers
        check(len(set(names)) == len(names), "tips, base, objects", names, "each marker's name once")
        check(len(self.base) >= 1, "base", self.base, "at least one marker of the hand's base")
        fits = len(self.base_places_m) in (0, len(self.base))
        check(fits, "base_places_m", self.base_places_m, f"empty, or one place for each of {', '.join(self.base)}")
        check(self.solver in SOLVER_NAMES, "solver", self.solver, f"one of {one_of(self.solver, SOLVER_NAMES)}")
        check(0 <= self.middle_sd_px <= 100, "middle_sd_px", self.middle_sd_px, "from 0 to 100 px")
        check(0 <= self.tag_sd_px <= 100, "tag_sd_px", self.tag_sd_px, "from 0 to 100 px")
        own = [one.name for one in self.objects]
        check(len(set(own)) == len(own), "objects", own, "each with its own name")
        spaces = [one.space for one in self.spaces]
        check(len(set(spaces)) == len(spaces), "spaces", spaces, "each once")
        check(0 < self.silent_after_s <= 3600, "silent_after_s", self.silent_after_s, "above 0 and at most 3600 s")

    @property
    def hand_markers(self) -> tuple[str, ...]:
        """Markers of the hand: tips and base."""
        return *self.tips, *self.base

    @property
    def markers(self) -> tuple[str, ...]:
        """All markers: of the hand and of the objects, with the tags' corners."""
        return (*self.hand_markers, *(name for one in self.objects for name in one.points))


class _Taken(NamedTuple):
    """Handlers of a frame type: ``problem`` says why a frame is rejected (empty if it is not), ``see`` processes it."""

    problem: Callable[[Any], str]
    see: Callable[[Arrival], None]


class HandsTracker:
    """Tracker of the method ``hands``: one hand with markers, and objects. Cameras outside of the rig are rejected.

    Triangulates the markers over time with a Kalman filter, fits the hand's joint angles to them (inverse kinematics
    with joint limits), and estimates the objects' 6-DoF poses.

    Args:
        rig: the cameras' intrinsics and poses; their clock offsets are ignored, because arrivals have the common clock.
        settings: markers, and the settings of every stage; the defaults if None.
        shape: measured lengths of the hand; the model's right hand if None.
        sensors_expected: number of cameras to wait for, limited to the number in the rig.

    Attributes:
        rig: the rig, without clock offsets.
        shape: lengths of the hand.
    """

    def __init__(
        self,
        rig: CameraRig,
        settings: HandsSettings | None = None,
        *,
        shape: HandShape | None = None,
        sensors_expected: int = 2,
    ) -> None:
        self.settings = s = settings or HandsSettings()
        self._sensors_expected = min(sensors_expected, len(rig.cameras))
        # Arrivals have the capture time on the common clock; the rig's offsets apply to recordings.
        cameras = {name: msgspec.structs.replace(camera, clock_s=0.0) for name, camera in rig.cameras.items()}
        self.rig = CameraRig(cameras)
        model = hand_model(s.constraints)
        self.shape = shape or model.shape("right")
        places = np.array(s.base_places_m) if s.base_places_m else base_layout(self.shape, len(s.base), _PALM_SIDE_M)
        self._rays = MarkerRays(self.rig, len(s.hand_markers), s.rays)
        self._rig_fit = RigFit(self.rig, len(s.hand_markers), s.rig_fit)
        self._fit = HandTracker(model, self.shape, places, s.fit, s.solver)
        self._smooth_2d = {} if s.smoothing_2d is None else {name: OneEuro(s.smoothing_2d) for name in sorted(cameras)}
        self._smooth = None if s.smoothing is None else OneEuro(s.smoothing)
        self._objects = RigidObjects(self.rig, s.objects, s.poses, s.grasp)
        self._spaces = {one.space: one for one in s.spaces}
        self._places = {name: _place(name, camera.T_camera_world) for name, camera in sorted(cameras.items())}
        self._takes: dict[type[SensorFrame], _Taken] = {
            MarkerFrame: _Taken(self._markers_problem, self._see_markers),
            PoseFrame: _Taken(self._bodies_problem, self._see_poses),
        }
        self.reset()

    def reset(self) -> None:
        """Forget everything, as if newly made."""
        self._rays.reset()
        self._rig_fit.reset()
        self._fit.reset()
        for smooth in self._smooth_2d.values():
            smooth.reset()
        if self._smooth is not None:
            self._smooth.reset()
        self._objects.reset()
        self._told_s = -math.inf
        self._heard_ns: dict[str, int] = {}
        self._newest: dict[str, tuple[int, int]] = {}
        self._rejected: Counter[str] = Counter()
        self._steps = 0
        self._hand_id = -1
        self._there = False
        self._said = _Said((), None, ())
        self._state = TrackerState(Phase.WAITING_FOR_SENSORS, sensors_missing=self._sensors_expected)

    def recalibrate(self, reason: str) -> None:
        """Forget the tracks of markers, hand and objects, and begin them anew.

        The rig, the hand's bone lengths and the counts of `report` stay. The tracker's state becomes
        `Phase.WAITING_FOR_SENSORS`, and has ``reason``, a text for the user, until enough cameras send markers.
        """
        rejected, steps, hand_id = self._rejected, self._steps, self._hand_id
        self.reset()
        self._rejected, self._steps, self._hand_id = rejected, steps, hand_id
        self._state = TrackerState(Phase.WAITING_FOR_SENSORS, self._sensors_expected, reason=reason)

    def snapshot(self) -> bytes:
        """Return all state as bytes, for `restore`: a tracker made with the same arguments continues identically."""
        parts = [
            {name: getattr(self, name) for name in _OWN_MEMORY},
            {name: value for name, value in vars(self._rays).items() if name not in _RAYS_MADE_OF},
            {name: getattr(self._rig_fit, name) for name in _RIG_FIT_MEMORY},
            {name: getattr(self._fit, name) for name in ("_state", "report")},
            None if self._smooth is None else {n: v for n, v in vars(self._smooth).items() if n != "settings"},
            [{n: v for n, v in vars(smooth).items() if n != "settings"} for smooth in self._smooth_2d.values()],
            self._objects.memory(),
        ]
        return pack(parts, _REMEMBERED)

    @recalls
    def restore(self, data: bytes) -> None:
        """Replace all state by that of a `snapshot` of a tracker made with the same arguments.

        Raises:
            WireError: the bytes are no snapshot of this method; the tracker is then reset.
        """
        own, rays, rig_fit, fit, smooth, smooth_2d, objects = unpack(data, _REMEMBERED)
        set_memory(self, own, _OWN_MEMORY)
        set_memory(self._rays, rays)
        set_memory(self._rig_fit, rig_fit)
        set_memory(self._fit, fit)
        if self._smooth is not None:
            set_memory(self._smooth, smooth)
        for filtered, memory in zip(self._smooth_2d.values(), smooth_2d, strict=True):
            set_memory(filtered, memory)
        self._objects.recall(objects)

    @property
    def report(self) -> TrackerReport:
        """Counts of all frames so far; calibrations and restarts are not counted and always 0."""
        return TrackerReport(self._steps, self._steps - self._rejected.total(), dict(self._rejected), 0, 0)

    def update(self, arrival: Arrival) -> Scene:
        """Process a frame of markers, or of another tracker's poses, and return the scene: hand, markers and objects.

        A frame that cannot be used is counted in `report` and changes nothing: its scene repeats the last results.
        """
        frame = arrival.frame
        takes = self._takes.get(type(frame))
        if takes is None:
            problem = not_taken(frame, "hands")
        elif not (problem := takes.problem(frame) or time_problem(frame, self._newest.get(frame.sensor))):
            self._newest[frame.sensor] = (frame.node_id, frame.time_ns)
            takes.see(arrival)
        if problem:
            self._rejected[problem] += 1
        return self._scene(arrival)

    def _see_poses(self, arrival: Arrival) -> None:
        """Process another tracker's poses of objects."""
        frame: Any = arrival.frame
        space = self._spaces[frame.space]
        at_s = arrival.at_ns / NS_PER_S - space.clock_s
        self._objects.add_poses(frame, space.T_world_space, at_s)
        self._said = self._with_objects(self._said, max(at_s, self._told_s))

    def _see_markers(self, arrival: Arrival) -> None:
        """Process a camera's markers."""
        frame: Any = arrival.frame
        at_s = arrival.at_ns / NS_PER_S
        self._heard_ns[frame.sensor] = arrival.at_ns
        pixels, sd = self._in_order(frame)
        self._rig_fit.update(frame.sensor, pixels, at_s)
        if self._smooth_2d:
            pixels = self._smooth_2d[frame.sensor].update(pixels, at_s)
        points = self._rays.update(frame.sensor, pixels, sd, at_s)
        s = self.settings
        self._objects.add_markers(frame, at_s, marker_sd_px=s.middle_sd_px, tag_sd_px=s.tag_sd_px)
        self._state = self._stand(arrival.at_ns)
        self._said = self._describe(points, arrival.at_ns)

    def _bodies_problem(self, frame: PoseFrame) -> str:
        if frame.space not in self._spaces:
            fix = "mocapella calibrate space, then mocapella serve --file alignment=FILE"
            return f"its space {frame.space!r} is not aligned with the cameras: {fix}"
        wanted = {one.body for one in self.settings.objects if one.space == frame.space}
        if frame.names and not set(frame.names) & wanted:
            fix = f"""--set 'objects=[{{"name": "thing", "space": "{frame.space}", "body": "{frame.names[0]}"}}]'"""
            return f"none of its bodies is a configured object: {fix}"
        return ""

    def _markers_problem(self, frame: MarkerFrame) -> str:
        if problem := camera_problem(self.rig, frame.sensor, frame.size_px):
            return problem
        if frame.names and not set(frame.names) & set(self.settings.markers):
            return f"none of its markers is wanted: {one_of('', self.settings.markers)}"
        return ""

    def _in_order(self, frame: MarkerFrame) -> tuple[Float64, Float64]:
        """Return pixels and standard deviations in the order of the hand's markers; NaN for missing ones."""
        place = {name: i for i, name in enumerate(frame.names)}
        names = self.settings.hand_markers
        pixels, sd = np.full((len(names), 2), np.nan), np.full(len(names), UNSAID_SD_PX)
        for i, name in enumerate(names):
            if (k := place.get(name)) is not None:
                pixels[i] = frame.positions_px[k]
                sd[i] = frame.sd_px[k] if frame.sd_px[k] > 0 else UNSAID_SD_PX
        return pixels, np.hypot(sd, self.settings.middle_sd_px)

    def _stand(self, now_ns: int) -> TrackerState:
        speaks = [s for s, at_ns in self._heard_ns.items() if now_ns - at_ns < self.settings.silent_after_s * NS_PER_S]
        missing = self._sensors_expected - len(speaks)
        if missing > 0:
            return TrackerState(Phase.WAITING_FOR_SENSORS, sensors_missing=missing, reason=self._state.reason)
        return TrackerState(Phase.TRACKING, reason=self._rig_fit.problem)

    def _describe(self, found: MarkerPoints, now_ns: int) -> _Said:
        s = self.settings
        points = found.points
        known = found.states != RayState.LOST
        if self._smooth is not None:
            points = self._smooth.update(points, found.at_s)
        hand = self._fit.update(points, found.at_s, found.covariances)
        hands = self._hands(hand)
        sd = np.sqrt(np.trace(found.covariances, axis1=1, axis2=2) / 3).astype(np.float32)
        cameras = np.where(found.states == RayState.TRACKED, 2, known.astype(int)).astype(np.uint8)
        tracked = TrackedPoints(s.hand_markers, points, sd, cameras)
        return self._with_objects(_Said(hands, tracked, ()), found.at_s)

    def _with_objects(self, said: _Said, at_s: float) -> _Said:
        """Return the results with the objects' poses at a time, and the held object."""
        self._told_s = at_s
        objects = self._objects.track(said.hands[0] if said.hands else None, at_s)
        hands = tuple(msgspec.structs.replace(one, holds=self._objects.held) for one in said.hands)
        return _Said(hands, said.points, objects)

    def _hands(self, hand: Hand) -> tuple[TrackedHand, ...]:
        there = bool(np.isfinite(hand.landmarks).any())
        if there and not self._there:
            self._hand_id += 1
        self._there = there
        if not there:
            return ()
        left, sd = hand.handedness == "left", hand.sd_m.astype(np.float32)
        return (TrackedHand(self._hand_id, left, hand.landmarks, hand.states, sd, hand.angles, hand.T_world_palm),)

    def _scene(self, arrival: Arrival) -> Scene:
        step, self._steps, said = self._steps, self._steps + 1, self._said
        points = () if said.points is None else (said.points,)
        parts = {"hands": said.hands, "points": points, "objects": said.objects}
        places = tuple(self._places.values())
        return scene_at(arrival, step, self._state, parts, topology=topology("hand"), sensors=places)


class _Said(msgspec.Struct, frozen=True, eq=False):
    """Results of the last usable frame."""

    hands: tuple[TrackedHand, ...]
    points: TrackedPoints | None
    objects: tuple[TrackedObject, ...]


_PALM_SIDE_M: Final = -0.0125
"""Height of the base markers over the joints, negative because they are on the palm, not the back [m]."""


def _place(name: str, T_camera_world: Float64) -> SensorPlace:
    return SensorPlace(name, inverse(T_camera_world) @ _TO_SENSOR, 0.0, 0.0, "as calibrated")


_OWN_MEMORY: Final = (
    *("_heard_ns", "_newest", "_rejected", "_steps", "_hand_id", "_there", "_said"),
    *("_state", "_told_s"),
)
_RAYS_MADE_OF: Final = ("settings", "rig", "_order", "_views", "_points")
_RIG_FIT_MEMORY: Final = ("_times", "_pixels", "_sums", "_looked_s")
_REMEMBERED: Final = (
    _Said,
    _State,
    HandReport,
    TrackedHand,
    TrackedPoints,
    TrackedObject,
    Phase,
    TrackerState,
    *REMEMBERED,
)
