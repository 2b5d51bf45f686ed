"""Track rigid objects beside a hand, from markers, tags or another tracker's poses, and detect whether it holds them.

objects.add_markers(frame, at_s, …)      pixels of markers and tags
objects.add_poses(frame, T, at_s)        poses of another tracker, in an aligned space
tracked = objects.track(hand, at_s)      poses at a time; updates which object is held
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.fusion.marker_rays import RayState
from mocapella.fusion.object_pose_values import Hypothesis, SeenFrame
from mocapella.fusion.object_poses import ObjectPoses, ObjectPoseSettings
from mocapella.geometry.rigid import apply, inverse, rigid
from mocapella.geometry.twists import exp_twist, log_motion
from mocapella.kinematics.grasp import Grasp, GraspSettings, distance_to_box
from mocapella.model.camera import CameraRig
from mocapella.model.hand import TIPS
from mocapella.model.markers import MarkerFrame
from mocapella.model.memory import set_memory
from mocapella.model.observations import JointState
from mocapella.model.poses import PoseFrame
from mocapella.model.scene import TrackedHand, TrackedObject
from mocapella.model.tags import corner_names, corner_places
from mocapella.settings import check

Float64 = NDArray[np.float64]

_LEAST_MARKERS: Final = 3
_HEARD: Final = 8
"""Number of another tracker's poses that are kept."""
_BASE_S, _AHEAD_S = 0.03, 0.05
"""Extrapolation of the newest pose: its velocity is the mean over at least `_BASE_S`, used up to `_AHEAD_S` [s]."""
_FLAT_M: Final = 0.001
"""Largest root sum of squared distances of markers from a plane for them to lie on it [m]."""
UNSAID_SD_PX: Final = 0.5
"""Standard deviation of a marker's coordinate that is assumed for a camera that reports none [px]."""


@dataclass(frozen=True)
class TagPlace:
    """A tag on an object.

    Attributes:
        tag: number of the tag.
        side_m: side of its dark square [m].
        middle_m: its centre, in the object's frame [m].
        right, up: unit vectors in the object's frame: to the right and up in the tag's image, when it is upright.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    tag: int
    side_m: float
    middle_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    right: tuple[float, float, float] = (1.0, 0.0, 0.0)
    up: tuple[float, float, float] = (0.0, 1.0, 0.0)

    def __post_init__(self) -> None:
        check(0 <= self.tag < 100_000, "tag", self.tag, "0 to 99999")
        check(0.001 <= self.side_m <= 5, "side_m", self.side_m, "from 0.001 to 5 m")
        check(bool(np.isfinite(self.middle_m).all()), "middle_m", self.middle_m, "finite")
        R = np.array([self.right, self.up])
        good = bool(np.isfinite(R).all()) and np.allclose(R @ R.T, np.eye(2), atol=1e-3)
        check(good, "right and up", (self.right, self.up), "of length 1, at right angles")

    @property
    def corners_m(self) -> Float64:
        """(4, 3) corners in the object's frame [m], in the order of `mocapella.model.tags.corner_names`."""
        R = np.stack([self.right, self.up, np.cross(self.right, self.up)], axis=1)
        return apply(rigid(R, self.middle_m), corner_places(self.side_m))


@dataclass(frozen=True)
class ObjectSettings:
    """A rigid object with markers or tags, or one that another tracker follows.

    Attributes:
        name: name of the object.
        markers: names of its colour markers; without a tag, three or more that are not on a line.
        places_m: (markers, 3) positions of the markers in the object's frame [m].
        size_m: size of the object's bounding box, centred on its origin [m].
        tag: number of a tag on the box's side towards z, upright with y; None for none.
        tag_side_m: side of that tag's dark square [m].
        tags: tags anywhere on the object.
        space: name of another tracker's frame of reference, for the poses of ``body``; see `mocapella calibrate space`.
        body: the other tracker's name of the object.
        origin_m: the object's origin, the centre of its box, in the frame of ``body`` [m].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    name: str
    markers: tuple[str, ...] = ()
    places_m: tuple[tuple[float, float, float], ...] = ()
    size_m: tuple[float, float, float] = (0.06, 0.06, 0.06)
    tag: int | None = None
    tag_side_m: float = 0.04
    tags: tuple[TagPlace, ...] = ()
    space: str = ""
    body: str = ""
    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        check(0 < len(self.name) <= 80, "name", self.name[:80], "1 to 80 characters")
        check(all(0 < s <= 5 for s in self.size_m), f"size_m of {self.name}", self.size_m, "above 0, up to 5 m")
        tags = [tag.tag for tag in self.all_tags]
        check(len(set(tags)) == len(tags), f"tags of {self.name}", tags, "each number once")
        finite = bool(np.isfinite(self.origin_m).all())
        check(finite, f"origin_m of {self.name}", self.origin_m, "three finite numbers")
        if self.space or self.body:
            both = bool(self.space and self.body) and max(len(self.space), len(self.body)) <= 80
            check(both, f"space and body of {self.name}", (self.space[:80], self.body[:80]), "1 to 80 characters each")
            alone = not (self.markers or self.places_m or tags)
            check(alone, f"body of {self.name}", self.body, "of an object without markers and tags")
            return
        enough = len(self.markers) >= (0 if tags else _LEAST_MARKERS) and len(set(self.markers)) == len(self.markers)
        wanted = "three or more, each once; or give it a tag, or the space and body of another tracker"
        check(enough, f"markers of {self.name}", self.markers, wanted)
        fits = len(self.places_m) == len(self.markers)
        check(fits, f"places_m of {self.name}", len(self.places_m), f"one for each of {len(self.markers)} markers")
        places = np.array(self.places_m).reshape(-1, 3)
        plane = bool(np.isfinite(places).all())
        if plane and not tags:
            plane = bool(np.linalg.svd(places - places.mean(axis=0), compute_uv=False)[1] > 0.005)
        check(plane, f"places_m of {self.name}", self.places_m, "finite, and not on a line")

    @property
    def all_tags(self) -> tuple[TagPlace, ...]:
        """All tags: `tags`, and the one of ``tag`` on the box's side."""
        if self.tag is None:
            return self.tags
        return TagPlace(self.tag, self.tag_side_m, (0.0, 0.0, 0.5 * self.size_m[2])), *self.tags

    @property
    def points(self) -> tuple[str, ...]:
        """Names of all points of the object: its markers, then its tags' corners."""
        return *self.markers, *(name for tag in self.all_tags for name in corner_names(tag.tag))

    @property
    def points_m(self) -> Float64:
        """(points, 3) positions of `points` in the object's frame [m]."""
        return np.concatenate([np.array(self.places_m).reshape(-1, 3), *(tag.corners_m for tag in self.all_tags)])

    @property
    def planes(self) -> tuple[tuple[int, ...], ...]:
        """Groups of points on one plane, as indices in `points`: each tag's corners; four or more markers if flat."""
        n = len(self.markers)
        planes = [tuple(range(n + 4 * k, n + 4 * k + 4)) for k in range(len(self.all_tags))]
        if n >= 4:
            places = np.array(self.places_m)
            if np.linalg.svd(places - places.mean(axis=0), compute_uv=False)[2] < _FLAT_M:
                planes.append(tuple(range(n)))
        return tuple(planes)


class HeardPose(msgspec.Struct, frozen=True, eq=False):
    """Another tracker's pose of an object.

    Attributes:
        at_s: capture time, on the rig's clock [s].
        T: (4, 4) from the object's frame, not that of ``body``, to the world.
        state: `JointState` of the pose.
    """

    at_s: float
    T: Float64
    state: int


class _ObjectState:
    """State of one object, and of the hand's grasp of it."""

    def __init__(self, rig: CameraRig, settings: ObjectSettings, poses: ObjectPoseSettings, grasp: GraspSettings):
        self.settings = settings
        self.poses = None if settings.body else ObjectPoses(rig, settings.points_m, poses, planes=settings.planes)
        self.grasp = Grasp(grasp)
        self.T_body_object = rigid(np.eye(3), settings.origin_m)
        self.gone_s, self.forget_s = poses.alone_s, poses.forget_after_s
        self.half_m = 0.5 * np.array(settings.size_m)
        self.outline = _outline(settings.size_m)
        self.reset()

    def reset(self) -> None:
        if self.poses is not None:
            self.poses.reset()
        self.grasp.reset()
        self.heard: list[HeardPose] = []
        self.T: Float64 | None = None
        self.T_palm: Float64 | None = None

    def track(self, hand: TrackedHand | None, at_s: float) -> TrackedObject:
        """Return the object's pose: as observed; while hidden, at its last pose, or in the palm that holds it."""
        palm = None if hand is None else hand.T_world_palm
        seen = self._observed(at_s)
        carried = None if self.T_palm is None or palm is None else palm @ self.T_palm
        if seen.T is not None and not (seen.unseen_s > self.gone_s and carried is not None):
            self.T, state = seen.T, seen.state
        else:
            self.T = self.T if carried is None else carried
            state = JointState.NOT_TRACKED if self.T is None else JointState.INFERRED
        if self.T is not None:
            tips = np.full((5, 3), np.nan) if hand is None else hand.landmarks[list(TIPS)]
            held = self.grasp.update(distance_to_box(tips, self.T, self.half_m), at_s)
            if not held or palm is None:
                self.T_palm = None
            elif (seen.T is not None and seen.unseen_s <= 0.5 * self.gone_s) or self.T_palm is None:
                self.T_palm = inverse(palm) @ self.T
        return TrackedObject(self.settings.name, self.T, self.outline, int(state))

    def add_pose(self, T_world_body: Float64, state: int, at_s: float) -> None:
        """Process another tracker's pose."""
        if self.heard and not self.heard[-1].at_s < at_s <= self.heard[-1].at_s + self.forget_s:
            self.heard = []  # its clock jumped, or it was absent
        self.heard = [*self.heard[1 - _HEARD :], HeardPose(at_s, T_world_body @ self.T_body_object, state)]

    def _heard(self, at_s: float) -> _Observed:
        """Interpolate the other tracker's poses, or extrapolate the newest ones for a moment."""
        if not self.heard or at_s - self.heard[-1].at_s > self.forget_s:
            return _Observed(None, JointState.NOT_TRACKED, math.inf)
        newest = self.heard[-1]
        unseen_s = max(0.0, at_s - newest.at_s)
        state = JointState(newest.state) if unseen_s <= self.gone_s else JointState.INFERRED
        after = next((k for k, told in enumerate(self.heard) if told.at_s >= at_s), len(self.heard) - 1)
        earlier = [told for told in self.heard[:after] if self.heard[after].at_s - told.at_s >= _BASE_S]
        before = earlier[-1] if earlier and at_s > newest.at_s else self.heard[max(after - 1, 0)]
        span = self.heard[after].at_s - before.at_s
        if span <= 0:
            return _Observed(newest.T, state, unseen_s)
        part = (min(at_s, newest.at_s + _AHEAD_S) - before.at_s) / span
        turn = log_motion(rigid(self.heard[after].T[:3, :3] @ before.T[:3, :3].T, np.zeros(3)))[3:]
        R = exp_twist(np.r_[np.zeros(3), part * turn])[:3, :3] @ before.T[:3, :3]
        t = before.T[:3, 3] + part * (self.heard[after].T[:3, 3] - before.T[:3, 3])
        return _Observed(rigid(R, t), state, unseen_s)

    def _observed(self, at_s: float) -> _Observed:
        if self.poses is None:
            return self._heard(at_s)
        pose = self.poses.at(at_s)
        state = JointState.TRACKED if pose.state == RayState.TRACKED else JointState.INFERRED
        return _Observed(pose.T_world_object, state, pose.unseen_s)


class _Observed(NamedTuple):
    """The observed pose, None if unknown, and the time since the last observation."""

    T: Float64 | None
    state: JointState
    unseen_s: float


class RigidObjects:
    """Tracker of all objects of a session; it detects which object the hand holds.

    Args:
        rig: the cameras of the markers and tags.
        items: the objects.
        poses: settings of their tracking.
        grasp: settings of the detection of held objects.
    """

    def __init__(
        self,
        rig: CameraRig,
        items: Sequence[ObjectSettings],
        poses: ObjectPoseSettings,
        grasp: GraspSettings,
    ) -> None:
        self._items = [_ObjectState(rig, item, poses, grasp) for item in items]

    def reset(self) -> None:
        """Forget everything, as if newly made."""
        for item in self._items:
            item.reset()

    def add_markers(self, frame: MarkerFrame, at_s: float, *, marker_sd_px: float, tag_sd_px: float) -> None:
        """Process a camera's markers; names that no object has are ignored.

        Args:
            frame: frame of a camera of the rig.
            at_s: capture time of the image's first row, on the camera's clock [s].
            marker_sd_px, tag_sd_px: standard deviations of a colour marker and of a tag's corner, in addition to the
                camera's own [px].
        """
        place = {name: i for i, name in enumerate(frame.names)}
        for item in self._items:
            if item.poses is None:
                continue
            names = item.settings.points
            pixels, sd = np.full((len(names), 2), np.nan), np.full(len(names), UNSAID_SD_PX)
            for i, name in enumerate(names):
                if (k := place.get(name)) is not None:
                    pixels[i] = frame.positions_px[k]
                    sd[i] = frame.sd_px[k] if frame.sd_px[k] > 0 else UNSAID_SD_PX
            colours = len(item.settings.markers)
            more = np.where(np.arange(len(names)) < colours, marker_sd_px, tag_sd_px)
            item.poses.update(frame.sensor, pixels, np.hypot(sd, more), at_s)

    def add_poses(self, frame: PoseFrame, T_world_space: Float64, at_s: float) -> None:
        """Process another tracker's poses; those of other spaces, and of bodies that no object names, are ignored.

        Args:
            frame: the poses.
            T_world_space: (4, 4) from that tracker's frame of reference to the world.
            at_s: capture time, on the rig's clock [s].
        """
        for item in self._items:
            if item.settings.space != frame.space:
                continue
            T = frame.T_space_body(item.settings.body)
            if T is not None:
                item.add_pose(T_world_space @ T, int(frame.states[frame.names.index(item.settings.body)]), at_s)

    def track(self, hand: TrackedHand | None, at_s: float) -> tuple[TrackedObject, ...]:
        """Return all objects at a time, in the order of ``items``, and update which one is held.

        An object is returned at its observed pose; while hidden, in the palm that holds it (inferred), or else at its
        last pose (inferred). Its pose is None before the first observation.

        Args:
            hand: the hand at that time; None without one.
            at_s: the time, on the rig's clock [s].
        """
        return tuple(item.track(hand, at_s) for item in self._items)

    @property
    def held(self) -> str:
        """Name of the object in the hand; empty if none."""
        return next((item.settings.name for item in self._items if item.grasp.held), "")

    def memory(self) -> list[Any]:
        """Return all state, for `recall` and a tracker's snapshot; its mutable values are shared, not copied."""
        return [
            [
                {name: getattr(item, name) for name in _OBJECT},
                None if item.poses is None else {name: getattr(item.poses, name) for name in _POSES},
                {n: v for n, v in vars(item.grasp).items() if n != "settings"},
            ]
            for item in self._items
        ]

    def recall(self, memory: list[Any]) -> None:
        """Restore the state that `memory` returned for the same objects."""
        for item, (own, poses, grasp) in zip(self._items, memory, strict=True):
            set_memory(item, own)
            if item.poses is not None:
                set_memory(item.poses, poses)
            set_memory(item.grasp, grasp)


_OBJECT: Final = ("T", "T_palm", "heard")
_POSES: Final = ("_hypotheses", "_frames", "_believed", "_refused", "_counts")
REMEMBERED: Final[tuple[type, ...]] = (Hypothesis, SeenFrame, HeardPose)
"""Classes in the state that `RigidObjects.memory` returns, for `mocapella.model.memory`."""


def _outline(size_m: tuple[float, float, float]) -> Float64:
    """Return one polyline (10, 3) along the edges of a box."""
    x, y, z = 0.5 * np.array(size_m)
    low = [(-x, -y, -z), (x, -y, -z), (x, -y, z), (-x, -y, z), (-x, -y, -z)]
    return np.array([*low, *((a, -b, c) for a, b, c in low)])
