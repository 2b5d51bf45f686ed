"""Rigid things beside a hand: by markers, by tags, or by another tracker's poses; and whether the hand holds them.

things.see(camera, frame, at_s)          pixels of their markers and tags
things.hear(frame, at_s)                 poses of another tracker, in a space that is aligned
objects = things.tell(hand, at_s)        where they are, and which is held
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
from mocapella.model.observations import JointState
from mocapella.model.poses import PoseFrame
from mocapella.model.scene import TrackedHand, TrackedObject
from mocapella.model.tags import corner_names, corner_places
from mocapella.settings import check

Float64 = NDArray[np.float64]

_LEAST_MARKERS: Final = 3
_HEARD: Final = 8
"""Poses of another tracker that are kept."""
_BASE_S, _AHEAD_S = 0.03, 0.05
"""Beyond the newest pose, its motion since so long before is believed for so long."""
_FLAT_M: Final = 0.001
"""Markers that are nearer to a plane are on it."""
UNSAID_SD_PX: Final = 0.5
"""Of a camera that does not say how sure it is."""


@dataclass(frozen=True)
class TagPlace:
    """A tag on a thing.

    Attributes:
        tag: its number.
        side_m: of its dark square.
        middle_m: where its middle is, in the thing's frame.
        right, up: directions of the tag's own right and up there, as one reads it.
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
        """(4, 3) in the thing's frame, in the order of `mocapella.model.tags.corner_names`."""
        R = np.stack([self.right, self.up, np.cross(self.right, self.up)], axis=1)
        return apply(rigid(R, self.middle_m), corner_places(self.side_m))


@dataclass(frozen=True)
class ObjectSettings:
    """A rigid thing with markers or tags of its own, or one that another tracker follows.

    Attributes:
        name: what it is called.
        markers: names of colour markers; where there is no tag, three or more that are not on a line.
        places_m: (markers, 3) where they are on it.
        size_m: of the box that it fills, about its origin.
        tag: number of a tag on the box's side towards z, upright with y; None where there is none.
        tag_side_m: of that tag's dark square.
        tags: tags anywhere on it.
        space: in which another tracker says where ``body`` is; see `mocapella calibrate space`.
        body: the other tracker's name of it.
        origin_m: the thing's origin, the middle of its box, in the frame of ``body``.
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
            check(alone, f"body of {self.name}", self.body, "of a thing without markers and tags")
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
        """`tags`, and the one of ``tag``."""
        if self.tag is None:
            return self.tags
        return TagPlace(self.tag, self.tag_side_m, (0.0, 0.0, 0.5 * self.size_m[2])), *self.tags

    @property
    def points(self) -> tuple[str, ...]:
        """Names of all that cameras see of it: its markers, then its tags' corners."""
        return *self.markers, *(name for tag in self.all_tags for name in corner_names(tag.tag))

    @property
    def points_m(self) -> Float64:
        """(points, 3) where they are on it."""
        return np.concatenate([np.array(self.places_m).reshape(-1, 3), *(tag.corners_m for tag in self.all_tags)])

    @property
    def planes(self) -> tuple[tuple[int, ...], ...]:
        """Which of the points are on a plane, four or more."""
        n = len(self.markers)
        planes = [tuple(range(n + 4 * k, n + 4 * k + 4)) for k in range(len(self.all_tags))]
        if n >= 4:
            places = np.array(self.places_m)
            if np.linalg.svd(places - places.mean(axis=0), compute_uv=False)[2] < _FLAT_M:
                planes.append(tuple(range(n)))
        return tuple(planes)


class HeardPose(msgspec.Struct, frozen=True, eq=False):
    """What another tracker said of a thing, in the world."""

    at_s: float
    T: Float64
    state: int


class _Thing:
    """One of them: what is known of it, and of the hand about it."""

    def __init__(self, rig: CameraRig, settings: ObjectSettings, poses: ObjectPoseSettings, grasp: GraspSettings):
        self.settings = settings
        self.poses = None if settings.body else ObjectPoses(rig, settings.points_m, poses, planes=settings.planes)
        self.grasp = Grasp(grasp)
        self.T_body_thing = rigid(np.eye(3), settings.origin_m)
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

    def tell(self, hand: TrackedHand | None, at_s: float) -> TrackedObject:
        """By what is seen of it; while that is hidden it stays where it was, or in the palm that holds it."""
        palm = None if hand is None else hand.T_world_palm
        seen = self._seen(at_s)
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

    def hear(self, T_world_body: Float64, state: int, at_s: float) -> None:
        """Take another tracker's pose in."""
        if self.heard and not self.heard[-1].at_s < at_s <= self.heard[-1].at_s + self.forget_s:
            self.heard = []  # its clock has jumped, or it was away
        self.heard = [*self.heard[1 - _HEARD :], HeardPose(at_s, T_world_body @ self.T_body_thing, state)]

    def _heard(self, at_s: float) -> _Seen:
        """Between the poses that were told, or by the motion of the last ones beyond them, for a moment."""
        if not self.heard or at_s - self.heard[-1].at_s > self.forget_s:
            return _Seen(None, JointState.NOT_TRACKED, math.inf)
        newest = self.heard[-1]
        unseen_s = max(0.0, at_s - newest.at_s)
        state = JointState(newest.state) if unseen_s <= self.gone_s else JointState.INFERRED
        after = next((k for k, told in enumerate(self.heard) if told.at_s >= at_s), len(self.heard) - 1)
        earlier = [told for told in self.heard[:after] if self.heard[after].at_s - told.at_s >= _BASE_S]
        before = earlier[-1] if earlier and at_s > newest.at_s else self.heard[max(after - 1, 0)]
        span = self.heard[after].at_s - before.at_s
        if span <= 0:
            return _Seen(newest.T, state, unseen_s)
        part = (min(at_s, newest.at_s + _AHEAD_S) - before.at_s) / span
        turn = log_motion(rigid(self.heard[after].T[:3, :3] @ before.T[:3, :3].T, np.zeros(3)))[3:]
        R = exp_twist(np.r_[np.zeros(3), part * turn])[:3, :3] @ before.T[:3, :3]
        t = before.T[:3, 3] + part * (self.heard[after].T[:3, 3] - before.T[:3, 3])
        return _Seen(rigid(R, t), state, unseen_s)

    def _seen(self, at_s: float) -> _Seen:
        if self.poses is None:
            return self._heard(at_s)
        pose = self.poses.at(at_s)
        state = JointState.TRACKED if pose.state == RayState.TRACKED else JointState.INFERRED
        return _Seen(pose.T_world_object, state, pose.unseen_s)


class _Seen(NamedTuple):
    """Where a thing is by what is seen of it, None where that says nothing, and for how long none of it was seen."""

    T: Float64 | None
    state: JointState
    unseen_s: float


class RigidObjects:
    """All things of a session."""

    def __init__(
        self,
        rig: CameraRig,
        things: Sequence[ObjectSettings],
        poses: ObjectPoseSettings,
        grasp: GraspSettings,
    ) -> None:
        self._things = [_Thing(rig, thing, poses, grasp) for thing in things]

    def reset(self) -> None:
        """Forget everything, as if newly made."""
        for thing in self._things:
            thing.reset()

    def see(self, frame: MarkerFrame, at_s: float, *, marker_sd_px: float, tag_sd_px: float) -> None:
        """Take in what a camera sees of them.

        Args:
            frame: of a camera of the rig.
            at_s: when its first row was captured, on the camera's clock [s].
            marker_sd_px, tag_sd_px: on top of what the camera says of a colour marker's or a corner's error.
        """
        place = {name: i for i, name in enumerate(frame.names)}
        for thing in self._things:
            if thing.poses is None:
                continue
            names = thing.settings.points
            pixels, sd = np.full((len(names), 2), np.nan), np.full(len(names), UNSAID_SD_PX)
            for i, name in enumerate(names):
                if (k := place.get(name)) is not None:
                    pixels[i] = frame.positions_px[k]
                    sd[i] = frame.sd_px[k] if frame.sd_px[k] > 0 else UNSAID_SD_PX
            colours = len(thing.settings.markers)
            more = np.where(np.arange(len(names)) < colours, marker_sd_px, tag_sd_px)
            thing.poses.update(frame.sensor, pixels, np.hypot(sd, more), at_s)

    def hear(self, frame: PoseFrame, T_world_space: Float64, at_s: float) -> None:
        """Take in what another tracker says of them, at an instant of the rig's clock."""
        for thing in self._things:
            if thing.settings.space != frame.space:
                continue
            T = frame.T_space_body(thing.settings.body)
            if T is not None:
                thing.hear(T_world_space @ T, int(frame.states[frame.names.index(thing.settings.body)]), at_s)

    def tell(self, hand: TrackedHand | None, at_s: float) -> tuple[TrackedObject, ...]:
        """Where they are at an instant."""
        return tuple(thing.tell(hand, at_s) for thing in self._things)

    @property
    def held(self) -> str:
        """Name of the thing in the hand; empty where there is none."""
        return next((thing.settings.name for thing in self._things if thing.grasp.held), "")

    def memory(self) -> list[Any]:
        """All that `recall` wants."""
        return [
            [
                {name: getattr(thing, name) for name in _THING},
                None if thing.poses is None else {name: getattr(thing.poses, name) for name in _POSES},
                {n: v for n, v in vars(thing.grasp).items() if n != "settings"},
            ]
            for thing in self._things
        ]

    def recall(self, memory: list[Any]) -> None:
        """Be as when `memory` was made."""
        for thing, (own, poses, grasp) in zip(self._things, memory, strict=True):
            vars(thing).update(own)
            if thing.poses is not None:
                vars(thing.poses).update(poses)
            vars(thing.grasp).update(grasp)


_THING: Final = ("T", "T_palm", "heard")
_POSES: Final = ("_hypotheses", "_frames", "_believed", "_refused", "_counts")
REMEMBERED: Final[tuple[type, ...]] = (Hypothesis, SeenFrame, HeardPose)
"""Kinds that are in a memory."""


def _outline(size_m: tuple[float, float, float]) -> Float64:
    """(10, 3) one line along the edges of a box."""
    x, y, z = 0.5 * np.array(size_m)
    low = [(-x, -y, -z), (x, -y, -z), (x, -y, z), (-x, -y, z), (-x, -y, -z)]
    return np.array([*low, *((a, -b, c) for a, b, c in low)])
