"""Decide which bodies are visible and which are lost, and re-acquire lost ones.

A camera sees a body if the segmented contour overlaps the model's outline and stands out from the empty room. A body
that no camera sees is extrapolated for `LOST_AFTER_S`. Then it is lost: it is searched where the images differ from the
empty room, or, if that is unknown, from the background learnt during tracking; there in its last posture, in its first
one, and in earlier ones of this run. Where its joints are known, as of keypoints, it is placed by them instead. Else it
is searched at its *waiting pose*, the last one that was seen well.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.errors import CalibrationError, SettingsError
from mocapella.kinematics.silhouette_fit import eye, within
from mocapella.model.camera import CameraRig
from mocapella.model.rigged_mesh import RiggedMesh, landmarks_at
from mocapella.model.silhouettes import Silhouette
from mocapella.model.twist_tree import TreePose
from mocapella.sensing.empty_room import EmptyRoom
from mocapella.tracker.bodies_fitter import BodiesFitter
from mocapella.tracker.body_fitter import FittedBody
from mocapella.tracker.body_reacquisition import reacquire
from mocapella.tracker.silhouette_camera import SeenIn
from mocapella.tracker.silhouette_start import FAR_M, start_pose
from mocapella.tracker.silhouette_views import SeenBody, called, covered_by_all

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]
Bool = NDArray[np.bool_]

SEEN_FROM: Final = 0.5
"""Least overlap (IoU) of contour and model outline for a camera to count as seeing the body."""
HIDDEN_FROM: Final = 0.7
"""Least fraction of a body behind other bodies for a camera not to count as seeing it."""
STANDS_OUT: Final = 0.3
"""Least fraction of the segmented body that differs from the empty room, for a camera to see it."""
STANDS_OUT_WELL: Final = 0.75
"""Least mean of that fraction over the cameras for a pose to become the waiting pose."""
STANDS_OUT_HALF: Final = 0.5
"""That fraction, in one camera, below which the body may be elsewhere in its image."""
ELSEWHERE: Final = 0.5
"""Least area of a foreground object beside the body, in units of the body's, for the body to be there instead."""
LOST_AFTER_S: Final = 0.5
"""Time unseen after which a body is lost [s]."""
POSTURES: Final = 8
"""Number of earlier postures that are remembered, of each body."""
APART_RAD: Final = 0.6
"""Least difference of two remembered postures, of the joint that differs most or of the inclination [rad]."""
DOUBTED: Final = 0.7
"""Least mean, over the cameras that know the room there, of the share of a body that differs from it."""
DOUBTED_S: Final = 0.1
"""A body is searched elsewhere each time it has been doubted for so long [s]."""
SEARCHED_AGAIN_S: Final = 0.4
"""Further time after which a doubted body is searched again, if it was not found elsewhere [s]."""
ANY_WAY_UP_EVERY: Final = 5
"""Frames between two searches of a lost body upside down and lying, which take longer than a frame."""
WITNESSES: Final = 2
"""Number of cameras, or all if fewer, that must see a lost body to re-acquire one alone accepts any object."""
LAST: Final = "found in its last posture"
FIRST: Final = "found in its first posture"
EARLIER: Final = "found in an earlier posture"
KEYPOINTS: Final = "found by its keypoints"
"""How a search found a body, in words of the messages."""


class BodyPresence(msgspec.Struct, eq=False):
    """State of one body.

    Attributes:
        initial: the pose given to `SilhouettePresence.start`.
        pose: the waiting pose: the last one that `WITNESSES` cameras saw completely and clearly.
        landmarks: (n, 3) in that pose, in the world [m].
        seen_ns: capture time of the last frame that showed the body, on the common clock.
        whole_in: number of cameras whose image contained the whole body in that pose.
        lost: whether the body is lost.
        came: False for a body that has not appeared yet in a room that was empty at first (`wait`).
        placed: whether the last search of a lost body found foreground of its shape, or knew too few empty rooms to
            tell; otherwise the body cannot be re-acquired.
        postures: earlier poses that were seen as well as waiting poses, with postures unlike each other, the oldest
            first; at most `POSTURES`.
        sure_ns: capture time of the last frame when the body was not doubted, or was searched.
        found: how the last search found the body, in words; empty if it did not.
    """

    initial: TreePose
    pose: TreePose
    landmarks: Float64
    seen_ns: int
    whole_in: int
    lost: bool = False
    came: bool = True
    placed: bool = True
    postures: tuple[TreePose, ...] = ()
    sure_ns: int = 0
    found: str = ""

    def away(self, time_ns: int) -> bool:
        """Return whether the body is absent at a time on the common clock, because it has been unseen for too long.

        A lost body is absent until it is seen again, any other body once it has been unseen for `LOST_AFTER_S`.
        """
        return (self.lost and time_ns > self.seen_ns) or time_ns - self.seen_ns >= LOST_AFTER_S * NS_PER_S


class SilhouettePresence:
    """Decides for each frame which of the fitted bodies are present, and where the fitter searches for the others.

    Args:
        fitters: the fitters of all bodies; `update` restarts a lost body's.
        rig: the cameras' intrinsics and poses.

    Attributes:
        empty: image of the empty room of each camera, as far as known.
    """

    def __init__(self, fitters: BodiesFitter, rig: CameraRig) -> None:
        self._fitters, self._rig = fitters, rig
        self._eyes = {name: eye(placed) for name, placed in rig.cameras.items()}
        self._witnesses = min(WITNESSES, len(rig.cameras))
        self.reset()

    def reset(self) -> None:
        """Forget all bodies and the empty room."""
        self._bodies: dict[str, BodyPresence] = {}
        self._waits: dict[str, tuple[TreePose, dict[str, Silhouette]]] = {}
        self.empty = EmptyRoom()

    def memory(self) -> list[Any]:
        """Return all state, for `recall` and a tracker's snapshot; its mutable values are shared, not copied."""
        return [self._bodies, self.empty.memory()]

    def recall(self, memory: Sequence[Any]) -> None:
        """Restore the state that `memory` returned for the same bodies and rig."""
        self.reset()
        self._bodies, empty = memory
        self.empty.recall(empty)

    @property
    def lost(self) -> tuple[str, ...]:
        """Names of the bodies that are lost or have not appeared yet."""
        return tuple(name for name, body in self._bodies.items() if body.lost)

    def start(self, name: str, pose: TreePose, time_ns: int) -> None:
        """Set a body's initial pose, as given to the fitter; the body counts as present.

        ``time_ns`` is the time of the pose, on the common clock.
        """
        landmarks = landmarks_at(self._fitters.fitters[name].mesh, pose)
        whole_in = self._whole_in(landmarks, self._rig.cameras)
        self._bodies[name] = BodyPresence(pose, pose, landmarks, time_ns, whole_in, sure_ns=time_ns)

    def wait(self) -> None:
        """Treat all bodies as lost, because the room is empty at first. After `start`.

        The empty room should be known; without it, any object is taken for a person.
        """
        for body in self._bodies.values():
            body.lost, body.came = True, False

    def waiting(self, name: str) -> SeenBody:
        """Return a body as lost, at its waiting pose, without a search; only after `start`."""
        body = self._bodies[name]
        fit = FittedBody(body.seen_ns, body.pose, body.landmarks, {}, {})
        return SeenBody(fit, True, self._covers(name, body.pose))

    def update(
        self,
        number: int,
        found: Mapping[str, FittedBody],
        images: Mapping[str, UInt8],
        joints: Mapping[str, Mapping[str, Float64]] | None = None,
    ) -> tuple[dict[str, SeenBody], list[str]]:
        """Decide which fitted bodies are present in a frame and which are lost; restart the fitters of the lost ones.

        A body that is not seen stays present for `LOST_AFTER_S`. Then it is lost until enough cameras see it again. The
        waiting pose is the last pose that enough cameras saw completely and clearly, at first that of `start`. The
        fitter of a lost body is restarted where the images differ from the empty room, or else at its waiting pose.

        Args:
            number: number of the frame, for the messages.
            found: results of the fitters for this frame, by name; `start` must have been called for each.
            images: (height, width, 3) uint8 BGR, by camera; at least the images that the fitters used.
            joints: positions (3,) of joints that are known in this frame, in the world [m], by landmark name, by body;
                None for none. A lost or doubted body is placed by them.

        Returns:
            All of ``found`` by name, lost ones at their waiting pose; and messages about departures and arrivals.
        """
        for name, fit in found.items():
            self._look_for(name, fit, images)
        self._learn_empty(found, images)
        seen, notes = {}, list[str]()
        for name, fit in found.items():
            body, known = self._bodies[name], (joints or {}).get(name, {})
            away = body.away(fit.time_ns)
            if away:
                self._look_again(number, name, fit, images, joints=known)
                held = msgspec.structs.replace(fit, pose=body.pose, landmarks=body.landmarks)
                seen[name] = SeenBody(held, True, self._covers(name, body.pose))
            else:
                seen[name] = SeenBody(fit, False)
                doubted = self._doubted(name, fit)
                if doubted and self._look_again(number, name, fit, images, joints=known, doubted=True):
                    notes.append(f"frame {number}: {called(name)} did not stand out from the room: {body.found}")
            if away and not body.lost:
                notes.append(
                    f"frame {number}: {called(name)} is in no camera's image any more; the last place is watched"
                )
            elif body.lost and not away:
                how = f", {body.found}" if body.found else ""
                notes.append(f"frame {number}: {called(name)} is there{f' again{how}' if body.came else ''}")
                body.came = True
            body.lost = away
        return seen, notes

    def _look_for(self, name: str, fit: FittedBody, images: Mapping[str, UInt8]) -> None:
        """Record when a body was seen, and the pose to wait at.

        A lost body is re-acquired only if enough cameras see it, whole if its waiting pose was, and at foreground of
        its shape; if only legs were seen, it would soon be lost again.
        """
        body, others = self._bodies[name], self._fitters.others[name]
        good = elsewhere = 0
        for camera, one in fit.seen.items():
            share = self._stands_out(one, images[camera], camera, others.get(camera))
            # Behind the last place of a lost body the room may be unknown, and then says nothing.
            doubtful = share < STANDS_OUT_HALF or (body.lost and body.came and np.isnan(share))
            if doubtful and self._beside(name, one, images[camera], camera):
                elsewhere += 1
            else:
                good += not share < STANDS_OUT and self._sees(one, others.get(camera))
        whole = self._whole_in(fit.landmarks, fit.seen)
        clear = not self._room_shows(fit) and self._clear(name, fit, images)
        if good >= self._witnesses and not body.lost and whole >= self._witnesses and clear:
            body.pose, body.landmarks, body.whole_in = fit.pose, fit.landmarks, whole
            body.postures = remembered(body.postures, fit.pose)
        again = good >= self._witnesses and whole >= min(self._witnesses, body.whole_in) and body.placed
        if again if body.lost else good >= max(1, elsewhere):
            body.seen_ns = fit.time_ns

    def _learn_empty(self, found: Mapping[str, FittedBody], images: Mapping[str, UInt8]) -> None:
        """Learn the room from images without one of the bodies, while all bodies' poses are known."""
        if any(self._bodies[name].lost or self._bodies[name].away(one.time_ns) for name, one in found.items()):
            return
        without = [
            camera
            for camera in images
            if not any(camera in one.left_out for one in found.values())
            and any(camera not in one.seen for one in found.values())
        ]
        self.empty.learn({camera: images[camera] for camera in without}, covered_by_all(found, self._rig))

    def _room_shows(self, fit: FittedBody) -> bool:
        """Whether enough cameras know the room where the body is, and too little of the body differs from it."""
        shares = [one.stands_out for one in fit.seen.values() if not np.isnan(one.stands_out)]
        return len(shares) >= self._witnesses and float(np.mean(shares)) < DOUBTED

    def _doubted(self, name: str, fit: FittedBody) -> bool:
        """Whether a body that is present should be searched elsewhere in this frame."""
        body = self._bodies[name]
        if not self._room_shows(fit):
            body.sure_ns = fit.time_ns
        doubted = bool(fit.seen) and fit.time_ns - body.sure_ns >= DOUBTED_S * NS_PER_S
        if doubted:
            body.sure_ns = fit.time_ns
        return doubted

    def _look_again(
        self, number: int, name: str, fit: FittedBody, images: Mapping[str, UInt8], *,
        joints: Mapping[str, Float64], doubted: bool = False,
    ) -> bool:  # fmt: skip
        """Restart the fitter at known joints, or where the images differ from the empty room, or at the waiting pose.

        A body that is only doubted is restarted if it covers the foreground much better elsewhere. Returns whether it
        was found.

        One earlier posture is tried in each frame, in turns. An image that was left out counts where the empty room is
        unknown: a person who moved on differs from the learnt background as another scene does.
        """
        body, fitter = self._bodies[name], self._fitters.fitters[name]
        by_joints = _placed(fitter.mesh, joints)
        if by_joints is not None:
            apart = not doubted or _apart_m(fitter.mesh, fit.landmarks, joints) > FAR_M
            body.sure_ns, body.placed, body.found = fit.time_ns, True, KEYPOINTS if apart else ""
            if apart:
                fitter.start(by_joints, fit.time_ns)
            return apart
        strange = {
            camera: self._foreground(name, image, camera)
            for camera, image in images.items()
            if camera not in fit.left_out or not self.empty.knows(camera)
        }
        seen = {camera: one for camera, one in strange.items() if one is not None}
        tried = {LAST: body.pose, FIRST: body.initial}
        if body.postures:
            tried[EARLIER] = body.postures[number % len(body.postures)]
        there = reacquire(
            seen, fitter.body, list(tried.values()), fitter.eyes, fit.pose if doubted else None,
            any_way_up=not doubted and number % ANY_WAY_UP_EVERY == 0,
        )  # fmt: skip
        found = (words for words, pose in tried.items() if there is not None and pose.angles is there.angles)
        body.found = next(found, "")
        if doubted:
            if there is None:
                body.sure_ns = fit.time_ns + round(SEARCHED_AGAIN_S * NS_PER_S)
            else:
                fitter.start(there, fit.time_ns)
            return there is not None
        known = [camera for camera in self._rig.cameras if self.empty.knows(camera)]
        body.sure_ns = fit.time_ns
        body.placed = there is not None or len(known) < self._witnesses
        fitter.start(there or body.pose, fit.time_ns)
        return there is not None

    def _whole_in(self, landmarks: Float64, cameras: Iterable[str]) -> int:
        """Return in how many of these cameras' images all landmarks (n, 3) are."""
        return sum(within(landmarks, self._eyes[name]) for name in cameras)

    def _stands_out(self, one: SeenIn, image: UInt8, camera: str, others: Bool | None) -> float:
        """Return the share of a segmented body that differs from the room, 0 to 1; NaN if that is unknown there.

        The empty room counts, and where it is unknown the background that was learnt during tracking.
        """
        share = self.empty.differs(camera, image, one.contour, others)
        return one.stands_out if np.isnan(share) else share

    @staticmethod
    def _sees(one: SeenIn, others: Bool | None) -> bool:
        """Whether a camera sees a body of this shape, rather than another person."""
        if others is not None:
            body = one.outline.silhouette.mask((others.shape[1], others.shape[0]))
            if np.count_nonzero(others & body) >= HIDDEN_FROM * max(int(np.count_nonzero(body)), 1):
                return False
        return one.overlap >= SEEN_FROM

    def _beside(self, name: str, one: SeenIn, image: UInt8, camera: str) -> bool:
        """Whether a camera shows foreground of about the body's size beside the body.

        A body that does not stand out is no evidence alone: it may be behind furniture.
        """
        foreground = self._foreground(name, image, camera)
        if foreground is None:
            return False
        size_px = (image.shape[1], image.shape[0])
        body = one.outline.silhouette.mask(size_px)
        beside, covered = np.count_nonzero(foreground.mask(size_px) & ~body), np.count_nonzero(body)
        return bool(covered > 0 and beside >= ELSEWHERE * covered)

    def _foreground(self, name: str, image: UInt8, camera: str) -> Silhouette | None:
        """Return the largest object that differs from the empty room, or from the learnt background if that is unknown.

        Of a body that never came nothing was learnt.
        """
        others = self._fitters.others[name].get(camera)
        if self.empty.knows(camera):
            return self.empty.silhouette(camera, image, others=others)
        return self._fitters.fitters[name].foreground(camera, image, others) if self._bodies[name].came else None

    def _clear(self, name: str, fit: FittedBody, images: Mapping[str, UInt8]) -> bool:
        """Whether the segmented body stands out well from the empty room, as far as that is known."""
        others = self._fitters.others[name]
        shares = [self.empty.differs(k, images[k], one.contour, others.get(k)) for k, one in fit.seen.items()]
        known = [share for share in shares if not np.isnan(share)]
        return not known or float(np.mean(known)) >= STANDS_OUT_WELL

    def _covers(self, name: str, pose: TreePose) -> dict[str, Silhouette]:
        """Return the silhouette of a body's mesh in its waiting pose, by camera in whose image that pose is."""
        if name not in self._waits or self._waits[name][0] is not pose:
            covered = self._fitters.fitters[name].covered(pose)
            drawn = {
                camera: Silhouette((0, 0), 1, mask.astype(np.float32) - np.float32(0.5))
                for camera, mask in covered.items()
                if mask.any()
            }
            self._waits[name] = pose, drawn
        return self._waits[name][1]


def _placed(mesh: RiggedMesh, joints: Mapping[str, Float64]) -> TreePose | None:
    """Return a body's pose by its joints; None if there are too few, or they are no person's of its size."""
    try:
        return start_pose(mesh, joints) if joints else None
    except (SettingsError, CalibrationError):
        return None


def _apart_m(mesh: RiggedMesh, landmarks: Float64, joints: Mapping[str, Float64]) -> float:
    """Return the median distance of landmarks (n, 3) of a mesh from known joints [m]."""
    both = [(at, joints[name]) for name, at in zip(mesh.landmarks, landmarks, strict=True) if name in joints]
    return float(np.median([np.linalg.norm(at - known) for at, known in both]))


def remembered(postures: tuple[TreePose, ...], pose: TreePose) -> tuple[TreePose, ...]:
    """Return the remembered poses with another one, if its posture is unlike all of them by `APART_RAD`.

    The posture is the joint angles, and the inclination of the body's long axis to the vertical. Of more than
    `POSTURES` the oldest is dropped.
    """
    for one in postures:
        between = float(np.arccos(np.clip(one.T_world_model[:3, 1] @ pose.T_world_model[:3, 1], -1.0, 1.0)))
        if max(between, float(np.abs(one.angles - pose.angles).max(initial=0.0))) < APART_RAD:
            return postures
    return (*postures, pose)[-POSTURES:]


REMEMBERED: Final[tuple[type, ...]] = (BodyPresence, TreePose)
"""Classes in the state."""
