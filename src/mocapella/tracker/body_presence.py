"""Which bodies are there, which are lost, where these wait, and when they are found again.

A body is seen where the outlines of a camera agree and differ from the empty room. For a moment without that it goes on
as it did; then it is lost, and looked for where something is that was not in the empty room, or else where it was.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.kinematics.silhouette_fit import eye, within
from mocapella.model.camera import CameraRig
from mocapella.model.rigged_mesh import landmarks_at
from mocapella.model.silhouettes import Silhouette
from mocapella.model.twist_tree import TreePose
from mocapella.sensing.empty_room import EmptyRoom
from mocapella.tracker.bodies_fitter import BodiesFitter
from mocapella.tracker.body_fitter import FittedBody
from mocapella.tracker.body_reacquisition import reacquire
from mocapella.tracker.silhouette_camera import SeenIn
from mocapella.tracker.silhouette_views import SeenBody, called, covered_by_all

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]
Bool = NDArray[np.bool_]

SEEN_FROM: Final = 0.5
"""Least overlap of the outlines for a camera to count as seeing the body."""
HIDDEN_FROM: Final = 0.7
"""Least share of a body covered by others for a camera not to be asked about it."""
STANDS_OUT: Final = 0.3
"""Least foreground share of the segmented body."""
LOST_AFTER_S: Final = 0.5
"""A body that is not seen for so long is lost [s]."""
WITNESSES: Final = 2
"""Cameras, of as many as there are, that have to see a body to find it again: one alone would take anything for it."""


class BodyPresence(msgspec.Struct, eq=False):
    """State of one body from instant to instant.

    Attributes:
        pose: the last one that enough cameras saw whole; a lost body waits there.
        landmarks: (n, 3) in that pose [m].
        seen_ns: when it was seen last.
        whole_in: in how many images all of it was then.
        lost: whether it is.
        came: whether it has been seen at all.
        placed: whether a person can be at the place that is searched.
    """

    pose: TreePose
    landmarks: Float64
    seen_ns: int
    whole_in: int
    lost: bool = False
    came: bool = True
    placed: bool = True

    def away(self, time_ns: int) -> bool:
        """Whether the body has been unseen for so long that it is absent."""
        return (self.lost and time_ns > self.seen_ns) or time_ns - self.seen_ns >= LOST_AFTER_S * NS_PER_S


class SilhouettePresence:
    """Decides after every instant which of the fitted bodies are there, and where the fitter looks for the others.

    Args:
        fitters: of the bodies.
        rig: whose cameras see them.

    Attributes:
        empty: the background of each camera, as far as known.
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
        """All that `recall` wants."""
        return [self._bodies, self.empty.memory()]

    def recall(self, memory: Sequence[Any]) -> None:
        """Be as when `memory` was made; of the same bodies and rig."""
        self.reset()
        self._bodies, empty = memory
        self.empty.recall(empty)

    @property
    def lost(self) -> tuple[str, ...]:
        """Names of the bodies that are lost or have not appeared yet."""
        return tuple(name for name, body in self._bodies.items() if body.lost)

    def start(self, name: str, pose: TreePose, time_ns: int) -> None:
        """A body is there, as the fitter was told."""
        landmarks = landmarks_at(self._fitters.fitters[name].mesh, pose)
        self._bodies[name] = BodyPresence(pose, landmarks, time_ns, self._whole_in(landmarks, self._rig.cameras))

    def wait(self) -> None:
        """Nobody is there yet: all bodies are looked for as lost ones are. After `start`.

        The empty room should be known: without it, any object is taken for a person.
        """
        for body in self._bodies.values():
            body.lost, body.came = True, False

    def waiting(self, name: str) -> SeenBody:
        """A body where it waits, before anything is looked for."""
        body = self._bodies[name]
        fit = FittedBody(body.seen_ns, body.pose, body.landmarks, {}, {})
        return SeenBody(fit, True, self._covers(name, body.pose))

    def update(
        self, number: int, found: Mapping[str, FittedBody], images: Mapping[str, UInt8]
    ) -> tuple[dict[str, SeenBody], list[str]]:
        """The bodies of one instant, the lost ones where they wait; and departures and arrivals in words.

        Args:
            number: of the instant, for the words.
            found: by the fitter, by name.
            images: (height, width, 3) by camera.
        """
        for name, fit in found.items():
            self._look_for(name, fit, images)
        self._learn_empty(found, images)
        seen, said = {}, []
        for name, fit in found.items():
            body = self._bodies[name]
            away = body.away(fit.time_ns)
            if away:
                self._look_again(name, fit, images)
                held = msgspec.structs.replace(fit, pose=body.pose, landmarks=body.landmarks)
                seen[name] = SeenBody(held, True, self._covers(name, body.pose))
            else:
                seen[name] = SeenBody(fit, False)
            if away and not body.lost:
                said.append(
                    f"frame {number}: {called(name)} is in no camera's image any more; the last place is watched"
                )
            elif body.lost and not away:
                said.append(f"frame {number}: {called(name)} is there{' again' if body.came else ''}")
                body.came = True
            body.lost = away
        return seen, said

    def _look_for(self, name: str, fit: FittedBody, images: Mapping[str, UInt8]) -> None:
        """Note when a body was seen, and the pose to wait at.

        It waits only in a pose that enough cameras saw. A lost body is found again where all of it is seen, if it ever
        was, and where the foreground shows a person: legs alone are soon lost again.
        """
        body, others = self._bodies[name], self._fitters.others[name]
        good = sum(self._sees(one, images[k], k, others.get(k)) for k, one in fit.seen.items())
        whole = self._whole_in(fit.landmarks, fit.seen)
        if good >= self._witnesses and not body.lost and whole >= self._witnesses:
            body.pose, body.landmarks, body.whole_in = fit.pose, fit.landmarks, whole
        again = good >= self._witnesses and whole >= min(self._witnesses, body.whole_in) and body.placed
        if again if body.lost else good >= 1:
            body.seen_ns = fit.time_ns

    def _learn_empty(self, found: Mapping[str, FittedBody], images: Mapping[str, UInt8]) -> None:
        """Learn the room from images without one of the bodies, while the places of all bodies are known."""
        if any(self._bodies[name].lost or self._bodies[name].away(one.time_ns) for name, one in found.items()):
            return
        without = [
            camera
            for camera in images
            if not any(camera in one.left_out for one in found.values())
            and any(camera not in one.seen for one in found.values())
        ]
        self.empty.learn({camera: images[camera] for camera in without}, covered_by_all(found, self._rig))

    def _look_again(self, name: str, fit: FittedBody, images: Mapping[str, UInt8]) -> None:
        """Start the fitter where something is that was not in the empty room; else where the body was last."""
        body, fitter, others = self._bodies[name], self._fitters.fitters[name], self._fitters.others[name]
        strange = {
            camera: self.empty.silhouette(camera, image, others=others.get(camera))
            for camera, image in images.items()
            if camera not in fit.left_out
        }
        seen = {camera: one for camera, one in strange.items() if one is not None}
        there = reacquire(seen, fitter.body, body.pose, fitter.eyes)
        known = [camera for camera in self._rig.cameras if self.empty.knows(camera)]
        body.placed = there is not None or len(known) < self._witnesses
        fitter.start(there or body.pose, fit.time_ns)

    def _whole_in(self, landmarks: Float64, cameras: Iterable[str]) -> int:
        """In how many of these cameras' images all landmarks (n, 3) are."""
        return sum(within(landmarks, self._eyes[name]) for name in cameras)

    def _sees(self, one: SeenIn, image: UInt8, name: str, others: Bool | None) -> bool:
        """Whether a camera sees this body, rather than another person or the empty room."""
        if others is not None:
            body = one.outline.silhouette.mask((others.shape[1], others.shape[0]))
            if np.count_nonzero(others & body) >= HIDDEN_FROM * max(int(np.count_nonzero(body)), 1):
                return False
        return one.overlap >= SEEN_FROM and not self.empty.differs(name, image, one.contour, others) < STANDS_OUT

    def _covers(self, name: str, pose: TreePose) -> dict[str, Silhouette]:
        """What a body covers where it waits, by camera that sees it there."""
        if name not in self._waits or self._waits[name][0] is not pose:
            covered = self._fitters.fitters[name].covered(pose)
            drawn = {
                camera: Silhouette((0, 0), 1, mask.astype(np.float32) - np.float32(0.5))
                for camera, mask in covered.items()
                if mask.any()
            }
            self._waits[name] = pose, drawn
        return self._waits[name][1]


REMEMBERED: Final[tuple[type, ...]] = (BodyPresence, TreePose)
"""Kinds that are in a memory."""
