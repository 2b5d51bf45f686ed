"""The method ``hands``: coloured markers that several cameras see, a hand, and things that it holds.

    points = rays(pixels)            each camera's pixels at their own instants, one point for each marker
    steady = smooth(points)          where that is asked for
    hand   = fit(steady)             within the limits of a hand
    things = align(steady)           rigid objects, by their own markers; held or not

See docs/methods/hand.md and docs/triangulation.md.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.rig_fit import RigFit, RigFitSettings
from mocapella.conventions import NS_PER_S
from mocapella.errors import one_of
from mocapella.fusion.marker_rays import MarkerPoints, MarkerRays, MarkerRaysSettings, RayState
from mocapella.geometry.alignment import align, moments
from mocapella.geometry.rigid import apply, inverse
from mocapella.kinematics.grasp import Grasp, GraspSettings, distance_to_box
from mocapella.kinematics.hand_tracker import HandReport, HandSettings, HandTracker, _State, base_layout
from mocapella.model.camera import CameraRig
from mocapella.model.hand import TIPS, ConstraintSet, Hand, HandShape, hand_model
from mocapella.model.markers import MarkerFrame
from mocapella.model.memory import pack, unpack
from mocapella.model.observations import Arrival, JointState
from mocapella.model.scene import Phase, Scene, SensorPlace, TrackedHand, TrackedObject, TrackedPoints, TrackerState
from mocapella.model.topology import topology
from mocapella.settings import check
from mocapella.smoothing.one_euro import OneEuro, OneEuroSettings
from mocapella.tracker.protocol import TrackerReport

Float64 = NDArray[np.float64]

_TO_SENSOR: Final = np.diag([-1.0, -1.0, 1.0, 1.0])
"""From a sensor's space (x left, y up) to a camera's (x right, y down)."""
_LEAST_MARKERS: Final = 3
_MOST_RESIDUAL_M: Final = 0.02
"""An object whose markers fit worse is not believed."""


@dataclass(frozen=True)
class ObjectSettings:
    """A rigid thing with markers of its own.

    Attributes:
        name: what it is called.
        markers: names; three or more that are not on a line.
        places_m: (markers, 3) where they are on it.
        size_m: of the box that it fills, about its origin.
    """

    name: str
    markers: tuple[str, ...]
    places_m: tuple[tuple[float, float, float], ...]
    size_m: tuple[float, float, float] = (0.06, 0.06, 0.06)

    def __post_init__(self) -> None:
        check(0 < len(self.name) <= 80, "name", self.name[:80], "1 to 80 characters")
        enough = len(self.markers) >= _LEAST_MARKERS and len(set(self.markers)) == len(self.markers)
        check(enough, f"markers of {self.name}", self.markers, "three or more, each once")
        fits = len(self.places_m) == len(self.markers)
        check(fits, f"places_m of {self.name}", len(self.places_m), f"one for each of {len(self.markers)} markers")
        places = np.array(self.places_m)
        plane = np.isfinite(places).all() and np.linalg.svd(places - places.mean(axis=0), compute_uv=False)[1] > 0.005
        check(bool(plane), f"places_m of {self.name}", self.places_m, "finite, and not on a line")
        check(all(0 < s <= 5 for s in self.size_m), f"size_m of {self.name}", self.size_m, "above 0, up to 5 m")


@dataclass(frozen=True)
class HandsSettings:
    """Which markers are what, and the settings of every stage.

    Attributes:
        tips: the markers of thumb to little finger.
        base: the markers of the hand's base.
        base_places_m: (base, 3) where they are in the palm's frame of a right hand; empty takes the usual places, on
            the palm's side.
        middle_sd_px: how far the middle of what a camera sees of a marker is from that of the whole marker; on top of
            what the camera says of its own error.
        constraints: ``thesis`` or ``full``: which angles are free.
        rays: how markers move.
        fit: how hands move.
        smoothing: of the points, before the hand is fitted; None does without.
        objects: things that are tracked, too.
        grasp: when they are held.
        rig_fit: when cameras are said to be swapped, or the rig not to fit.
        silent_after_s: a camera without a frame for so long is not waited for.
    """

    tips: tuple[str, str, str, str, str] = ("red", "yellow", "green", "blue", "magenta")
    base: tuple[str, ...] = ("cyan",)
    base_places_m: tuple[tuple[float, float, float], ...] = ()
    middle_sd_px: float = 0.4
    constraints: ConstraintSet = "thesis"
    rays: MarkerRaysSettings = field(default_factory=MarkerRaysSettings)
    fit: HandSettings = field(default_factory=HandSettings)
    smoothing: OneEuroSettings | None = None
    objects: tuple[ObjectSettings, ...] = ()
    grasp: GraspSettings = field(default_factory=GraspSettings)
    rig_fit: RigFitSettings = field(default_factory=RigFitSettings)
    silent_after_s: float = 1.0

    def __post_init__(self) -> None:
        names = self.markers
        check(len(set(names)) == len(names), "tips, base, objects", names, "each marker's name once")
        check(len(self.base) >= 1, "base", self.base, "at least one marker of the hand's base")
        fits = len(self.base_places_m) in (0, len(self.base))
        check(fits, "base_places_m", self.base_places_m, f"empty, or one place for each of {', '.join(self.base)}")
        check(0 <= self.middle_sd_px <= 100, "middle_sd_px", self.middle_sd_px, "from 0 to 100 px")
        check(0 < self.silent_after_s <= 3600, "silent_after_s", self.silent_after_s, "above 0 and at most 3600 s")

    @property
    def markers(self) -> tuple[str, ...]:
        """All of them: tips, base, and those of the objects."""
        return (*self.tips, *self.base, *(name for thing in self.objects for name in thing.markers))


class HandsTracker:
    """See the module. Cameras that are not in the rig are refused."""

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
        # Arrivals say when a frame was captured on the clock of all; the rig's offsets are those of recordings.
        cameras = {name: msgspec.structs.replace(camera, clock_s=0.0) for name, camera in rig.cameras.items()}
        self.rig = CameraRig(cameras)
        model = hand_model(s.constraints)
        self.shape = shape or model.shape("right")
        places = np.array(s.base_places_m) if s.base_places_m else base_layout(self.shape, len(s.base), _PALM_SIDE_M)
        self._rays = MarkerRays(self.rig, len(s.markers), s.rays)
        self._rig_fit = RigFit(self.rig, len(s.markers), s.rig_fit)
        self._fit = HandTracker(model, self.shape, places, s.fit)
        self._smooth = None if s.smoothing is None else OneEuro(s.smoothing)
        self._grasps = [Grasp(s.grasp) for _ in s.objects]
        self._outlines = [_outline(thing.size_m) for thing in s.objects]
        self._places = {name: _place(name, camera.T_camera_world) for name, camera in sorted(cameras.items())}
        self.reset()

    def reset(self) -> None:
        """Forget everything, as if newly made."""
        self._rays.reset()
        self._rig_fit.reset()
        self._fit.reset()
        if self._smooth is not None:
            self._smooth.reset()
        for grasp in self._grasps:
            grasp.reset()
        self._objects: list[Float64 | None] = [None] * len(self.settings.objects)
        self._held_in_palm: list[Float64 | None] = [None] * len(self.settings.objects)
        self._heard_ns: dict[str, int] = {}
        self._newest: dict[str, tuple[int, int]] = {}
        self._rejected: Counter[str] = Counter()
        self._steps = 0
        self._hand_id = -1
        self._there = False
        self._said = _Said((), None, ())
        self._state = TrackerState(Phase.WAITING_FOR_SENSORS, sensors_missing=self._sensors_expected)

    def recalibrate(self, reason: str) -> None:
        """Find markers and hand anew; where the cameras are is the rig's, which `mocapella calibrate` makes."""
        rejected, steps, hand_id = self._rejected, self._steps, self._hand_id
        self.reset()
        self._rejected, self._steps, self._hand_id = rejected, steps, hand_id
        self._state = TrackerState(Phase.WAITING_FOR_SENSORS, self._sensors_expected, reason=reason)

    def snapshot(self) -> bytes:
        """See `Tracker`."""
        parts = [
            {name: getattr(self, name) for name in _OWN_MEMORY},
            {name: value for name, value in vars(self._rays).items() if name not in _RAYS_MADE_OF},
            {name: getattr(self._rig_fit, name) for name in _RIG_FIT_MEMORY},
            {name: getattr(self._fit, name) for name in ("_state", "report")},
            None if self._smooth is None else {n: v for n, v in vars(self._smooth).items() if n != "settings"},
            [{n: v for n, v in vars(grasp).items() if n != "settings"} for grasp in self._grasps],
        ]
        return pack(parts, _REMEMBERED)

    def restore(self, data: bytes) -> None:
        """See `Tracker`."""
        own, rays, rig_fit, fit, smooth, grasps = unpack(data, _REMEMBERED)
        vars(self).update(own)
        vars(self._rays).update(rays)
        vars(self._rig_fit).update(rig_fit)
        vars(self._fit).update(fit)
        if self._smooth is not None:
            vars(self._smooth).update(smooth)
        for grasp, memory in zip(self._grasps, grasps, strict=True):
            vars(grasp).update(memory)

    @property
    def report(self) -> TrackerReport:
        """What came of all frames so far."""
        return TrackerReport(self._steps, self._steps - self._rejected.total(), dict(self._rejected), 0, 0)

    def update(self, arrival: Arrival) -> Scene:
        """Take one frame in and say what there is now. A frame that cannot be used is counted and changes nothing."""
        problem = self._problem(arrival)
        if problem:
            self._rejected[problem] += 1
            return self._scene(arrival)
        frame = arrival.frame
        assert isinstance(frame, MarkerFrame)
        self._newest[frame.sensor], self._heard_ns[frame.sensor] = (frame.node_id, frame.time_ns), arrival.at_ns
        pixels, sd = self._in_order(frame)
        at_s = arrival.at_ns / NS_PER_S
        points = self._rays.update(frame.sensor, pixels, sd, at_s)
        self._rig_fit.update(frame.sensor, pixels, at_s)
        self._state = self._stand(arrival.at_ns)
        self._said = self._describe(points, arrival.at_ns)
        return self._scene(arrival)

    def _problem(self, arrival: Arrival) -> str:
        frame = arrival.frame
        if not isinstance(frame, MarkerFrame):
            return "it sends skeletons, of which the method hands makes nothing: set up the method default"
        if frame.sensor not in self.rig.cameras:
            return f"the rig has no camera {frame.sensor!r}; it has {one_of(frame.sensor, self.rig.cameras)}"
        size = self.rig.cameras[frame.sensor].camera.size_px
        if frame.size_px != size:
            told = f"{frame.size_px[0]} × {frame.size_px[1]}"
            return f"its pictures are {told}, the rig's {size[0]} × {size[1]}: calibrate with this size"
        if not set(frame.names) & set(self.settings.markers):
            return f"none of its markers is wanted: {one_of('', self.settings.markers)}"
        node_id, last_ns = self._newest.get(frame.sensor, (frame.node_id, frame.time_ns - 1))
        if frame.node_id == node_id and frame.time_ns <= last_ns:  # a new process may have a new clock
            return "time goes backwards" if frame.time_ns < last_ns else "repeats the time of the frame before"
        return ""

    def _in_order(self, frame: MarkerFrame) -> tuple[Float64, Float64]:
        """Pixels and their standard deviations in the order of our markers; NaN of one that the frame does not have."""
        place = {name: i for i, name in enumerate(frame.names)}
        pixels = np.full((len(self.settings.markers), 2), np.nan)
        sd = np.full(len(pixels), _UNSAID_SD_PX)
        for i, name in enumerate(self.settings.markers):
            if (k := place.get(name)) is not None:
                pixels[i] = frame.positions_px[k]
                sd[i] = frame.sd_px[k] if frame.sd_px[k] > 0 else _UNSAID_SD_PX
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
        n = 5 + len(s.base)
        hand = self._fit.update(points[:n], found.at_s, found.covariances[:n])
        hands = self._hands(hand)
        sd = np.sqrt(np.trace(found.covariances, axis1=1, axis2=2) / 3).astype(np.float32)
        cameras = np.where(found.states == RayState.TRACKED, 2, known.astype(int)).astype(np.uint8)
        told = TrackedPoints(s.markers, points, sd, cameras)
        objects = tuple(self._object(i, points, found.states, hand, found.at_s) for i in range(len(s.objects)))
        holds = next((thing.name for thing, grasp in zip(s.objects, self._grasps, strict=True) if grasp.held), "")
        return _Said(tuple(msgspec.structs.replace(one, holds=holds) for one in hands), told, objects)

    def _hands(self, hand: Hand) -> tuple[TrackedHand, ...]:
        there = bool(np.isfinite(hand.landmarks).any())
        if there and not self._there:
            self._hand_id += 1
        self._there = there
        if not there:
            return ()
        left, sd = hand.handedness == "left", hand.sd_m.astype(np.float32)
        return (TrackedHand(self._hand_id, left, hand.landmarks, hand.states, sd, hand.angles, hand.T_world_palm),)

    def _object(self, i: int, points: Float64, states: NDArray[np.uint8], hand: Hand, at_s: float) -> TrackedObject:
        """By its own markers; while they are hidden it stays where it was, or in the palm that holds it."""
        s, thing = self.settings, self.settings.objects[i]
        begin = 5 + len(s.base) + sum(len(other.markers) for other in s.objects[:i])
        own, how = points[begin : begin + len(thing.markers)], states[begin : begin + len(thing.markers)]
        seen = how != RayState.LOST
        measured = _aligned(own[seen], np.array(thing.places_m)[seen])
        palm = hand.T_world_palm if np.isfinite(hand.T_world_palm).all() else None
        carried = self._held_in_palm[i]
        if measured is not None:
            enough = np.count_nonzero(how == RayState.TRACKED) >= _LEAST_MARKERS
            self._objects[i], state = measured, JointState.TRACKED if enough else JointState.INFERRED
        else:
            if carried is not None and palm is not None:
                self._objects[i] = palm @ carried
            state = JointState.INFERRED if self._objects[i] is not None else JointState.NOT_TRACKED
        T = self._objects[i]
        if T is not None:
            tips = distance_to_box(hand.landmarks[list(TIPS)], T, 0.5 * np.array(thing.size_m))
            held = self._grasps[i].update(tips, at_s)
            if not held or palm is None:
                self._held_in_palm[i] = None
            elif measured is not None or carried is None:
                self._held_in_palm[i] = inverse(palm) @ T
        return TrackedObject(thing.name, T, self._outlines[i], int(state))

    def _scene(self, arrival: Arrival) -> Scene:
        frame, step, said = arrival.frame, self._steps, self._said
        self._steps += 1
        return Scene(
            step=step,
            at_ns=arrival.at_ns,
            sensor=frame.sensor,
            node_id=frame.node_id,
            sequence=frame.sequence,
            topology=topology("hand"),
            state=self._state,
            people=(),
            sensors=tuple(self._places.values()),
            hands=said.hands,
            points=said.points,
            objects=said.objects,
        )


class _Said(msgspec.Struct, frozen=True, eq=False):
    """What the last frame that could be used came to."""

    hands: tuple[TrackedHand, ...]
    points: TrackedPoints | None
    objects: tuple[TrackedObject, ...]


_PALM_SIDE_M: Final = -0.0125
"""Markers of the base are on the palm, so far from the joints [m]."""
_UNSAID_SD_PX: Final = 0.5
"""Of a camera that does not say how sure it is."""


def _aligned(points: Float64, places: Float64) -> Float64 | None:
    """(4, 4) the rigid motion from places to points; None where they are too few, on a line, or do not fit."""
    if len(points) < _LEAST_MARKERS:
        return None
    spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    if spread[1] < 0.003:
        return None
    T = align(moments(points, places, np.ones(len(points))))
    if not np.isfinite(T).all() or np.linalg.norm(points - apply(T, places), axis=-1).max() > _MOST_RESIDUAL_M:
        return None
    return T


def _outline(size_m: tuple[float, float, float]) -> Float64:
    """(10, 3) one line along the edges of a box."""
    x, y, z = 0.5 * np.array(size_m)
    low = [(-x, -y, -z), (x, -y, -z), (x, -y, z), (-x, -y, z), (-x, -y, -z)]
    return np.array([*low, *((a, -b, c) for a, b, c in low)])


def _place(name: str, T_camera_world: Float64) -> SensorPlace:
    return SensorPlace(name, inverse(T_camera_world) @ _TO_SENSOR, 0.0, 0.0, "as calibrated")


_OWN_MEMORY: Final = (
    *("_objects", "_held_in_palm", "_heard_ns", "_newest", "_rejected", "_steps", "_hand_id", "_there", "_said"),
    "_state",
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
)
