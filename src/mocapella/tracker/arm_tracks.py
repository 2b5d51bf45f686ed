"""Track arms through one or more depth cameras, and fuse their views.

    which    = match(seen, expected)        assign each camera's arms to tracks, one to one
    aligned  = predict(views)               bring each camera's newest view to one time by its own motion
    fused    = fuse(aligned)                fuse joints by their uncertainty
    left     = evidence(views)              accumulate evidence of the side

Cameras are not synchronised, and frames arrive in any order. A view is kept in its camera's frame, so that refining the
camera's pose moves it only once. Nothing is smoothed here: the cameras' detectors do that.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.association.arms import ArmMatchSettings, match_arms
from mocapella.fusion.arm_points import ArmFusionSettings, fuse_angles, fuse_points, fuse_poses
from mocapella.geometry.rigid import apply
from mocapella.geometry.rigid_velocity import rigid_velocity
from mocapella.model.arms import ARM_POINTS, ELBOW, PALM, SeenArm
from mocapella.model.hand import WRIST
from mocapella.model.observations import JointState
from mocapella.model.scene import TrackedArm
from mocapella.settings import check

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]

TO_SENSOR: Final = np.diag([-1.0, -1.0, 1.0, 1.0])
"""(4, 4) from a sensor's space (x left, y up) to a camera's (x right, y down); it is its own inverse."""
_OF_EITHER_SIDE: Final = [WRIST, PALM, ELBOW]
"""Points that a detector places correctly even if it takes a left hand for a right one."""
_SIDE_CAP: Final = 12.0
_SIDE_STEP: Final = 2.0
"""Largest log-odds of left against right: of a track (`_SIDE_CAP`), and added by one view (`_SIDE_STEP`)."""
_FASTEST_M_S: Final = 6.0


@dataclass(frozen=True)
class ArmTracksSettings:
    """How arms are tracked and reported.

    Attributes:
        match: association of arms with tracks.
        fusion: fusion of views.
        fresh_s: age of the oldest view that is used; larger: a camera's gaps are bridged for longer, by extrapolation
            [s].
        velocity_s: time constant of the velocity filter of a hand as a rigid whole; larger: less jitter of extrapolated
            views, but more error when the hand turns back [s].
        finger_velocity_s: time constant of the velocity filter of the joints relative to the hand; larger: less jitter,
            but more error when fingers turn back [s].
        acceleration_m_s2: unknown acceleration a: the standard deviation of a view of age t grows by a · t² / 2;
            larger: older views count less [m/s²].
        shown_for_s: time for which an unseen arm is reported, as inferred [s].
        keep_s: time within which an unseen arm that reappears keeps its id [s].
        coast_s: time for which the motion of an unseen arm is extrapolated [s].
        one_m: two arms that no camera sees together are merged if their palms stay nearer than this for ``one_s`` [m].
        one_s: time for which the palms of two arms must stay within ``one_m`` before they are merged [s].
        gesture_margin: another gesture replaces the present one if its confidence, summed over the views, is higher by
            this; larger: gestures change more rarely [0 to 1].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    match: ArmMatchSettings = field(default_factory=ArmMatchSettings)
    fusion: ArmFusionSettings = field(default_factory=ArmFusionSettings)
    fresh_s: float = 0.1
    velocity_s: float = 0.03
    finger_velocity_s: float = 0.1
    acceleration_m_s2: float = 10.0
    shown_for_s: float = 0.3
    keep_s: float = 1.0
    coast_s: float = 0.1
    one_m: float = 0.06
    one_s: float = 0.2
    gesture_margin: float = 0.15

    def __post_init__(self) -> None:
        for name in ("fresh_s", "velocity_s", "finger_velocity_s", "shown_for_s", "keep_s", "coast_s", "one_s"):
            check(0 < getattr(self, name) <= 60, name, getattr(self, name), "above 0 and at most 60 s")
        check(self.shown_for_s <= self.keep_s, "shown_for_s", self.shown_for_s, f"at most keep_s, {self.keep_s:g} s")
        check(0 <= self.acceleration_m_s2 <= 1000, "acceleration_m_s2", self.acceleration_m_s2, "from 0 to 1000 m/s²")
        check(0 <= self.one_m <= 1, "one_m", self.one_m, "from 0 to 1 m")
        check(0 <= self.gesture_margin <= 1, "gesture_margin", self.gesture_margin, "from 0 to 1")


class ArmView(msgspec.Struct, frozen=True, eq=False):
    """One camera's newest view of an arm, in that camera's frame.

    Attributes:
        arm: the arm as detected.
        at_s: capture time, on the common clock [s].
        velocity: (23, 3) velocity of the points in the order of `mocapella.model.arms.ARM_POINTS` [m/s].
    """

    arm: SeenArm
    at_s: float
    velocity: Float64


@dataclass
class ArmTrack:
    """A tracked arm: its views by camera, and the fused result in the world. `ArmTracks` changes it in place.

    Attributes:
        id: constant while the arm is tracked.
        views: each camera's newest view.
        evidence: log-odds that it is a left arm.
        seen_s: capture time of the newest image that shows it, on the common clock [s].
        at_s: time of the fused values, on the same clock [s].
        points, velocity, states, sd: (23, 3) [m], (23, 3) [m/s], (23,) `JointState` and (23,) standard deviation of a
            coordinate [m], in the order of `mocapella.model.arms.ARM_POINTS`; NaN for an unknown point.
        angles: (21,) angles in the order of `mocapella.model.hand.ANGLES` [rad]; NaN where unknown.
        T_world_palm: (4, 4) pose of the palm; None if unknown.
        gesture, gesture_sure: recognised gesture, and its confidence from 0 to 1.
        grabbing: whether the hand holds on to something.
        near_since_s: time since which another arm has been at the same position, by that arm's id [s].
    """

    id: int
    views: dict[str, ArmView]
    evidence: float
    seen_s: float
    at_s: float
    points: Float64
    velocity: Float64
    states: UInt8
    sd: Float32
    angles: Float64
    T_world_palm: Float64 | None
    gesture: str = ""
    gesture_sure: float = 0.0
    grabbing: bool = False
    near_since_s: dict[int, float] = field(default_factory=dict)

    @property
    def left(self) -> bool:
        """Whether it is a left arm, from all evidence."""
        return self.evidence > 0

    @property
    def side(self) -> float:
        """Confidence that it is a left arm: 1 surely left, 0 undecided, −1 surely right; tanh of half the log-odds."""
        return math.tanh(0.5 * self.evidence)

    def palm_at(self, at_s: float, coast_s: float) -> Float64:
        """Predict the palm, or the wrist if the palm is unknown, (3,) in the world [m].

        Args:
            at_s: the time to predict to, on the common clock [s].
            coast_s: the motion is extrapolated for at most this long, forwards or backwards [s].
        """
        i = _middle(self.points)
        dt = min(max(at_s - self.at_s, -coast_s), coast_s)
        return np.asarray(self.points[i] + dt * self.velocity[i])


class ArmTracks:
    """Tracks arms through the frames of depth cameras. The same frames in the same order give the same result.

    Args:
        settings: how arms are tracked and reported; the defaults if None.

    Attributes:
        tracks: the tracks, in the order of their ids.
        now_s: newest capture time so far, on the common clock [s].
        next_id: id of the next new track; ids are not reused.
        away: for each camera the smoothed distance of its palms from the mean of all cameras [m], and the time of the
            last update of that distance [s].
        disputed: number of measured points that other views contradicted.
    """

    def __init__(self, settings: ArmTracksSettings | None = None) -> None:
        self.settings = settings or ArmTracksSettings()
        self.reset()

    def reset(self) -> None:
        """Forget everything, as if newly made."""
        self.tracks: list[ArmTrack] = []
        self.now_s = -math.inf
        self.next_id = 0
        self.away: dict[str, tuple[float, float]] = {}
        self.disputed = 0

    def update(self, camera: str, arms: Iterable[SeenArm], at_s: float, places: Mapping[str, Float64]) -> None:
        """Assign the arms of a camera's frame to tracks, and fuse the views; `tracked_arms` returns the result.

        An arm that matches no track begins one. A track without an arm in this frame loses this camera's view.

        Args:
            camera: name of the camera.
            arms: the arms in this frame, in the camera frame; those without wrist and palm are ignored.
            at_s: capture time on the common clock [s]; frames may come in any order.
            places: pose ``T_world_camera`` (4, 4) of each calibrated camera, by name.

        Raises:
            KeyError: this camera is not in ``places``.
        """
        s, T = self.settings, places[camera]
        self.now_s = max(self.now_s, at_s)
        self.tracks = [track for track in self.tracks if self.now_s - track.seen_s <= s.keep_s]
        arms = [arm for arm in arms if np.isfinite(arm.points[[WRIST, PALM]]).all(axis=-1).any()]
        rows = self._match(camera, arms, at_s, T)
        seen: set[int] = set()
        for arm, row in zip(arms, rows.tolist(), strict=True):
            if row < 0:
                track = self._begin(arm, at_s, T)
                self.tracks.append(track)
            else:
                track = self.tracks[row]
            seen.add(track.id)
            track.views[camera] = self._view(arm, at_s, track, camera, T)
            track.seen_s = max(track.seen_s, at_s)
            track.evidence = min(max(track.evidence + _side_of(arm), -_SIDE_CAP), _SIDE_CAP)
        for track in self.tracks:
            if track.id not in seen:
                track.views.pop(camera, None)
            self._fuse(track, places)
        self._join()

    def advance(self, now_s: float) -> None:
        """Advance the time to ``now_s`` on the common clock [s], without a new frame; an earlier time is ignored."""
        self.now_s = max(self.now_s, now_s)

    def forget(self, camera: str) -> None:
        """Drop a camera's views, because its pose is not valid any more; the tracks stay."""
        self.away.pop(camera, None)
        for track in self.tracks:
            track.views.pop(camera, None)

    def tracked_arms(self) -> tuple[TrackedArm, ...]:
        """Return the present arms, predicted to `now_s`, in the world, in the order of their ids; ``person`` is −1.

        An arm that no camera has seen within ``fresh_s`` is inferred, and one unseen for longer than ``shown_for_s`` is
        missing.
        """
        return tuple(
            self._tracked_arm(track) for track in self.tracks if self.now_s - track.seen_s <= self.settings.shown_for_s
        )

    def _match(self, camera: str, arms: list[SeenArm], at_s: float, T: Float64) -> NDArray[np.int64]:
        s, tracks = self.settings, self.tracks
        if not arms or not tracks:
            return np.full(len(arms), -1, dtype=np.int64)
        known = np.array([track.palm_at(at_s, s.coast_s) for track in tracks])
        sides = np.array([track.side for track in tracks])
        lost_s = np.array([max(0.0, at_s - track.seen_s) for track in tracks])
        followed = np.array(
            [[camera in track.views and track.views[camera].arm.id == arm.id for track in tracks] for arm in arms]
        )
        palms = apply(T, np.array([arm.points[_middle(arm.points)] for arm in arms]))
        seen_sides = np.array([math.tanh(0.5 * _side_of(arm)) for arm in arms])
        return match_arms(palms, seen_sides, known, sides, followed, 0.5 * np.minimum(lost_s, s.keep_s), s.match)

    def _begin(self, arm: SeenArm, at_s: float, T: Float64) -> ArmTrack:
        self.next_id += 1
        points, n = apply(T, arm.points), len(ARM_POINTS)
        return ArmTrack(
            self.next_id - 1, {}, 0.0, at_s, at_s, points, np.zeros((n, 3)), arm.states, arm.sd, arm.angles, None
        )

    def _view(self, arm: SeenArm, at_s: float, track: ArmTrack, camera: str, T: Float64) -> ArmView:
        s, before = self.settings, track.views.get(camera)
        if before is None or at_s - before.at_s > 3.0 * s.fresh_s:
            return ArmView(arm, at_s, track.velocity @ T[:3, :3])
        dt = at_s - before.at_s
        moved = (arm.points - before.arm.points) / dt
        own = moved[_middle(arm.points)]
        own = own if np.isfinite(own).all() else np.zeros(3)
        # A point that changes from inferred to measured jumps without moving.
        steady = (arm.states == before.arm.states) & np.isfinite(moved).all(axis=-1)
        moved = np.where(steady[:, None], moved, own)
        velocity = self._steadied(arm, before, moved, dt)
        speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
        return ArmView(arm, at_s, velocity * np.minimum(1.0, _FASTEST_M_S / np.maximum(speed, 1e-9)))

    def _steadied(self, arm: SeenArm, before: ArmView, moved: Float64, dt: float) -> Float64:
        """Filter the velocity (23, 3) [m/s]: fast for the hand as a rigid whole, slowly for points relative to it.

        The rigid motion is a mean over many points and has little noise. The elbow moves separately.
        """
        s, points = self.settings, np.where(np.isfinite(arm.points), arm.points, before.arm.points)
        whole, whole_before = (rigid_velocity(points, v, ~_OF_FOREARM) for v in (moved, before.velocity))
        whole, whole_before = (np.where(np.isfinite(field), field, 0.0) for field in (whole, whole_before))
        at_once, slowly = (1.0 - math.exp(-dt / time_s) for time_s in (s.velocity_s, s.finger_velocity_s))
        beside, beside_before = moved - whole, before.velocity - whole_before
        gain = np.where(_OF_FOREARM, at_once, slowly)[:, None]
        velocity = whole_before + at_once * (whole - whole_before) + beside_before + gain * (beside - beside_before)
        return np.asarray(velocity)

    def _fuse(self, track: ArmTrack, places: Mapping[str, Float64]) -> None:
        s, now = self.settings, self.now_s
        fresh = [
            (camera, view)
            for camera, view in sorted(track.views.items())
            if now - view.at_s <= s.fresh_s and camera in places
        ]
        track.views = {camera: view for camera, view in track.views.items() if now - view.at_s <= 3.0 * s.fresh_s}
        if not fresh:
            return
        views = [view for _, view in fresh]
        transforms = np.array([places[camera] for camera, _ in fresh])
        dt = np.array([now - view.at_s for view in views])
        velocity = np.array([view.velocity @ T[:3, :3].T for view, T in zip(views, transforms, strict=True)])
        points = np.array([apply(T, view.arm.points) for view, T in zip(views, transforms, strict=True)])
        points = points + dt[:, None, None] * velocity
        states = np.array([view.arm.states for view in views])
        right_side = self._of_the_side(track, views)
        states[~right_side] = np.where(_EITHER, states[~right_side], 0)
        sd = np.array([view.arm.sd for view in views], dtype=np.float64)
        sd = np.hypot(sd, 0.5 * s.acceleration_m_s2 * (dt * dt)[:, None])
        expected = track.points + min(max(now - track.at_s, 0.0), s.coast_s) * track.velocity
        fused = fuse_points(points, states, sd, expected, s.fusion)
        self.disputed += int(fused.disputed.sum())
        track.points, track.states, track.sd, track.at_s = fused.points, fused.states, fused.sd, now
        track.velocity = velocity[right_side].mean(axis=0)
        track.angles = fuse_angles(np.array([view.arm.angles for view in views])[right_side], fused.weights[right_side])
        posed = [k for k in np.flatnonzero(right_side) if views[k].arm.T_camera_palm is not None]
        track.T_world_palm = fuse_poses(
            np.array([_moved(transforms[k] @ views[k].arm.T_camera_palm, dt[k] * velocity[k, PALM]) for k in posed]),
            fused.weights[posed],
        )
        self._update_gesture(track, [view.arm for view in views])
        if len(fresh) > 1:
            self._note_distances([camera for camera, _ in fresh], points)

    def _of_the_side(self, track: ArmTrack, views: list[ArmView]) -> NDArray[np.bool_]:
        """Return which views (views,) were detected as the track's side, or all if none was.

        The fingers of the others are mislabelled.
        """
        right = np.array([view.arm.left == track.left for view in views])
        return right if right.any() else ~right

    def _update_gesture(self, track: ArmTrack, arms: list[SeenArm]) -> None:
        """Choose the most confident gesture; the present one stays unless another exceeds it by the margin."""
        support: dict[str, float] = {}
        for arm in arms:
            support[arm.gesture] = support.get(arm.gesture, 0.0) + arm.gesture_sure
        best = max(sorted(support), key=lambda gesture: support[gesture])
        if track.gesture not in support or support[best] > support[track.gesture] + self.settings.gesture_margin:
            track.gesture = best
        track.gesture_sure = max(arm.gesture_sure for arm in arms if arm.gesture == track.gesture)
        holds = sum((arm.gesture_sure + 0.01) * (1.0 if arm.grabbing else -1.0) for arm in arms)
        least = 0.0 if len(arms) == 1 else self.settings.gesture_margin
        track.grabbing = track.grabbing if abs(holds) < least else holds > 0

    def _note_distances(self, cameras: list[str], points: Float64) -> None:
        away = np.linalg.norm(points[:, PALM] - points[:, PALM].mean(axis=0), axis=-1)
        for camera, off in zip(cameras, away.tolist(), strict=True):
            if not math.isfinite(off):
                continue
            before, then_s = self.away.get(camera, (0.0, self.now_s))
            gain = 1.0 - math.exp(-(self.now_s - then_s) / _AWAY_S)
            self.away[camera] = (before + gain * (off - before), self.now_s)

    def _join(self) -> None:
        """Merge two arms at one position that no camera sees together, into the older one."""
        s = self.settings
        gone: set[int] = set()
        for i, one in enumerate(self.tracks):
            for other in self.tracks[i + 1 :]:
                if one.id in gone or other.id in gone:
                    continue
                apart = np.linalg.norm(one.palm_at(self.now_s, s.coast_s) - other.palm_at(self.now_s, s.coast_s))
                if one.views.keys() & other.views.keys() or apart > s.one_m or not one.views or not other.views:
                    one.near_since_s.pop(other.id, None)
                    continue
                if self.now_s - one.near_since_s.setdefault(other.id, self.now_s) >= s.one_s:
                    one.views |= other.views
                    one.evidence = min(max(one.evidence + other.evidence, -_SIDE_CAP), _SIDE_CAP)
                    gone.add(other.id)
        if gone:
            self.tracks = [track for track in self.tracks if track.id not in gone]
            for track in self.tracks:
                track.near_since_s = {k: t for k, t in track.near_since_s.items() if k not in gone}

    def _tracked_arm(self, track: ArmTrack) -> TrackedArm:
        s, ago = self.settings, self.now_s - track.at_s
        points, states, sd, T = track.points, track.states, track.sd, track.T_world_palm
        cameras = tuple(sorted(name for name, view in track.views.items() if self.now_s - view.at_s <= s.fresh_s))
        if ago > 0.0:
            step = min(ago, s.coast_s) * track.velocity
            points = points + step
            T = None if T is None else _moved(T, step[PALM])
            sd = np.hypot(sd, 0.5 * s.acceleration_m_s2 * ago * ago).astype(np.float32)
        if not cameras:
            states = np.minimum(states, np.uint8(JointState.INFERRED))
        return TrackedArm(
            track.id, track.left, points, states, sd, track.angles, T, track.gesture,
            float(np.float32(track.gesture_sure)), track.grabbing, -1, cameras,
        )  # fmt: skip


_AWAY_S: Final = 2.0
_OF_FOREARM: Final = np.arange(len(ARM_POINTS)) == ELBOW
_EITHER: Final = np.isin(np.arange(len(ARM_POINTS)), _OF_EITHER_SIDE)


def _middle(points: Float64) -> int:
    """Return the index of the point that represents an arm: palm, or wrist if the palm is unknown."""
    return PALM if np.isfinite(points[PALM]).all() else WRIST


def _side_of(arm: SeenArm) -> float:
    """Return the log-odds that a detected arm is a left one, within ± `_SIDE_STEP`."""
    sure = min(max(arm.left_sure, 0.5), 1.0 - 1e-9)
    odds = min(math.log(sure / (1.0 - sure)), _SIDE_STEP)
    return odds if arm.left else -odds


def _moved(T: Float64, by: Float64) -> Float64:
    out = T.copy()
    out[:3, 3] += np.where(np.isfinite(by), by, 0.0)
    return out


REMEMBERED: Final = (ArmTrack, ArmView, SeenArm)
"""Classes in the state of an `ArmTracks`, see `mocapella.model.memory`."""
