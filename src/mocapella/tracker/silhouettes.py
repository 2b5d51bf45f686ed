"""The method ``silhouettes``: fit body models to the images of several cameras.

    instant = sync(images)                 simultaneous images
    fits    = fit(instant, lost)           each body separately, with the others at their predicted poses
    bodies  = presence(fits, empty room)   present bodies, lost bodies, and where to search for the lost ones
    notes   = conditions, rig check        cameras that are left out, and whether the rig fits

A scene has the bodies of the last complete set of images. See docs/methods/silhouettes.md.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping, Sequence
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.errors import InputError
from mocapella.geometry.rigid import inverse
from mocapella.kinematics.silhouette_fit import eye
from mocapella.model.camera import CameraRig
from mocapella.model.images import REMEMBERED as IMAGES_REMEMBERED
from mocapella.model.images import ImageFrame
from mocapella.model.keypoints import KeypointFrame
from mocapella.model.memory import pack, recalls, set_memory, unpack
from mocapella.model.observations import Arrival
from mocapella.model.scene import Phase, Scene, SensorPlace, TrackedBody, TrackedBodyView, TrackerState
from mocapella.sensing.images import decode_image
from mocapella.settings import check
from mocapella.tracker.arrivals import camera_problem, time_problem
from mocapella.tracker.bodies_fitter import BodiesFitter
from mocapella.tracker.body_fitter import REMEMBERED as FITTER_REMEMBERED
from mocapella.tracker.body_presence import REMEMBERED as PRESENCE_REMEMBERED
from mocapella.tracker.body_presence import SilhouettePresence
from mocapella.tracker.body_size import size_doubt
from mocapella.tracker.frame_sync import REMEMBERED as SYNC_REMEMBERED
from mocapella.tracker.frame_sync import FrameSync, FrameSyncSettings, SyncedFrames
from mocapella.tracker.initial_body import InitialBody
from mocapella.tracker.limb_support import SupportConditions
from mocapella.tracker.method import not_taken
from mocapella.tracker.protocol import TrackerNote, TrackerReport, scene_at
from mocapella.tracker.rig_check import RigCheck
from mocapella.tracker.silhouette_conditions import CameraConditions
from mocapella.tracker.silhouette_keypoints import REMEMBERED as KEYPOINTS_REMEMBERED
from mocapella.tracker.silhouette_keypoints import SeenKeypoints, WaitingKeypoints, seen_keypoints
from mocapella.tracker.silhouette_room import IMAGES, LEARNING, EmptyRoomLearning, unknown_room
from mocapella.tracker.silhouette_scene import BodyScenes
from mocapella.tracker.silhouette_settings import SilhouetteSettings
from mocapella.tracker.silhouette_start import cameras_that_see
from mocapella.tracker.silhouette_views import DAMAGED, NO_PICTURE, SeenInstant, called

UInt8 = NDArray[np.uint8]
Float64 = NDArray[np.float64]

MOST_NOTES: Final = 200
"""Number of notes kept for a caller that has not drained them."""
TOO_LATE: Final = "it is an image of the empty room, and people are tracked already: send these images first"
_TO_SENSOR: Final = np.diag([-1.0, -1.0, 1.0, 1.0])
"""From a sensor's space (x left, y up) to a camera's (x right, y down)."""


class SilhouettesTracker:
    """Tracker of the method ``silhouettes``.

    Model-based: fits each body mesh's joint angles to the silhouettes and edges in the synchronised images of all
    cameras, from a predicted pose; detects when a person leaves and searches for lost ones. Keypoints of people in the
    same images refine the fit, if they arrive before the set of images is complete.

    Args:
        bodies: bodies with their initial poses, by name, at least one; a single body may have an empty name.
        rig: the cameras' intrinsics and poses; images of other sizes are rejected.
        settings: settings of the fit; the defaults if None.
        sync: grouping of the cameras' frames; the defaults if None. Bodies are at their initial poses one ``period_s``
            before the first images.
        empty_room_s: duration without people, to learn the room; then people are waited for [s].
        waiting: whether the room is empty at first: bodies count as lost, and are searched, until they are seen.

    Attributes:
        bodies, rig: the arguments of these names.
        seen: the last frame with its fits; None before the first.

    Raises:
        SettingsError: no body, a time out of range, or a body that no camera sees at its initial pose.
    """

    def __init__(
        self,
        bodies: Mapping[str, InitialBody],
        rig: CameraRig,
        settings: SilhouetteSettings | None = None,
        *,
        sync: FrameSyncSettings | None = None,
        empty_room_s: float = 0.0,
        waiting: bool = False,
    ) -> None:
        check(len(bodies) > 0, "bodies", list(bodies), "one or more")
        check(0 <= empty_room_s <= 600, "empty_room_s", empty_room_s, "0 to 600 s")
        self.bodies, self.rig = dict(bodies), rig
        self._waiting = waiting or empty_room_s > 0
        self._sync, self._keypoints = FrameSync(rig.cameras, sync), WaitingKeypoints()
        self._fitters = BodiesFitter({name: body.mesh for name, body in bodies.items()}, rig, settings)
        self._presence = SilhouettePresence(self._fitters, rig)
        self._conditions, self._rig_check = CameraConditions(rig), RigCheck(rig)
        self._support = SupportConditions(
            {name: {mark: at.part for mark, at in body.mesh.landmarks.items()} for name, body in bodies.items()}
        )
        sizes = [size_doubt(body.mesh, f"{name}'s" if name else "the body's") for name, body in bodies.items()]
        self._sizes = [said for said in sizes if said]
        self._room = EmptyRoomLearning(empty_room_s)
        self._scenes = BodyScenes(self.bodies, {name: eye(placed) for name, placed in rig.cameras.items()})
        self._places = tuple(
            SensorPlace(name, inverse(placed.T_camera_world) @ _TO_SENSOR, 0.0, 0.0, "as calibrated")
            for name, placed in sorted(rig.cameras.items())
        )
        self.reset()

    def reset(self) -> None:
        """Forget everything, as if newly made."""
        self._steps = self._instants = self._restarts = 0
        self._first_ns: int | None = None
        self._rejected: Counter[str] = Counter()
        self._notes: deque[TrackerNote] = deque(maxlen=MOST_NOTES)
        self._begin_anew("")

    def recalibrate(self, reason: str) -> None:
        """Learn the empty room again, and search all bodies at their initial poses; the rig stays.

        The tracker's state gives ``reason``, a text for the user, until the bodies are searched.
        """
        self._restarts += 1
        self._rejected += self._sync.dropped
        self._begin_anew(reason)

    def _begin_anew(self, reason: str) -> None:
        self._sync.reset()
        self._keypoints.reset()
        self._fitters.reset()
        self._presence.reset()
        self._conditions.reset()
        self._support.reset()
        self._rig_check.reset()
        self._room.reset()
        self._newest: dict[str, tuple[int, int]] = {}
        self._filmed: set[str] = set()
        self._begun, self._reason = False, reason
        self.seen: SeenInstant | None = None
        self._start(0)
        waiting = {name: self._presence.waiting(name) for name in self.bodies}
        self._bodies: tuple[TrackedBody, ...] = self._scenes.tracked(waiting, looked_for=False)
        self._state = self._stand()

    @property
    def report(self) -> TrackerReport:
        """Counts of all frames so far; images that wait for simultaneous ones count as kept."""
        rejected = self._rejected + self._sync.dropped
        learnt = int(self._room.done and bool(self._room.seen))
        return TrackerReport(self._steps, self._steps - rejected.total(), dict(rejected), learnt, self._restarts)

    @property
    def period_s(self) -> float:
        """Time between two frames, from the settings [s]."""
        return self._sync.settings.period_s

    @property
    def learning(self) -> bool:
        """Whether the empty room is being learnt."""
        return not self._room.done

    def drain_notes(self) -> list[TrackerNote]:
        """Return the notes since the last call, the oldest first, at most the `MOST_NOTES` newest, and forget them."""
        notes = list(self._notes)
        self._notes.clear()
        return notes

    def snapshot(self) -> bytes:
        """Return all state as bytes, for `restore`: a tracker made with the same arguments continues identically."""
        own = {name: getattr(self, name) for name in _OWN_MEMORY}
        return pack([_FORMAT, own, [part.memory() for part in self._parts()]], _REMEMBERED)

    @recalls
    def restore(self, data: bytes) -> None:
        """Replace all state by that of a `snapshot` of a tracker made with the same arguments.

        `seen` is None until the next complete set of images.

        Raises:
            WireError: the bytes are no snapshot of this method; the tracker is then reset.
        """
        kind, own, memories = unpack(data, _REMEMBERED)
        if kind != _FORMAT:
            raise ValueError(f"of {kind!r}")
        for part, memory in zip(self._parts(), memories, strict=True):
            part.recall(memory)
        set_memory(self, own, _OWN_MEMORY)
        self.seen = None

    def _parts(self) -> Sequence[Any]:
        said = self._conditions, self._support, self._rig_check
        return self._sync, self._keypoints, self._fitters, self._presence, *said, self._room

    def update(self, arrival: Arrival) -> Scene:
        """Process one frame and return the scene: the bodies of the last complete set of images.

        Keypoints wait for the image of their camera and time.

        An image that cannot be used is counted and changes nothing; a damaged one is counted once its set is complete.
        An image marked as one of the empty room is learnt at once, and rejected after the first other image.
        """
        frame: Any = arrival.frame
        if type(frame) is KeypointFrame:
            problem = self._add_keypoints(arrival, frame)
        elif type(frame) is not ImageFrame:
            problem = not_taken(frame, "silhouettes")
        elif not (problem := self._problem(frame)):
            self._add_image(arrival, frame)
        if problem:
            self._rejected[problem] += 1
        return self._scene(arrival)

    def _add_image(self, arrival: Arrival, frame: ImageFrame) -> None:
        """Process a usable image."""
        if frame.empty_room:
            self._learn_empty(frame)
            return
        self._newest[frame.sensor] = (frame.node_id, frame.time_ns)
        for instant in self._sync.update(arrival):
            self._take(instant)
        self._state = self._stand()

    def _add_keypoints(self, arrival: Arrival, frame: KeypointFrame) -> str:
        """Keep a camera's keypoints for the image of their time; return why they cannot be used, empty if they can."""
        if problem := camera_problem(self.rig, frame.sensor):
            return problem
        size = self.rig.cameras[frame.sensor].camera.size_px
        if frame.size_px != size:
            own = f"{frame.size_px[0]} × {frame.size_px[1]}"
            return f"its keypoints are of images of {own}, the rig's are {size[0]} × {size[1]}"
        seen = seen_keypoints(frame, arrival.at_ns)
        if seen is None:
            return f"its keypoints are {frame.topology.name}, which have no mapping to halpe_26: use another detector"
        self._keypoints.add(frame.sensor, seen)
        return ""

    def _problem(self, frame: ImageFrame) -> str:
        if problem := camera_problem(self.rig, frame.sensor, frame.size_px if frame.format else None):
            return problem
        if frame.empty_room:
            return TOO_LATE if self._newest else ""
        return time_problem(frame, self._newest.get(frame.sensor))

    def _learn_empty(self, frame: ImageFrame) -> None:
        image = self._decoded(frame)
        if image is not None:
            self._filmed.add(frame.sensor)
            self._fitters.learn_background({frame.sensor: image})
            self._presence.empty.learn({frame.sensor: image})

    def _decoded(self, frame: ImageFrame) -> UInt8 | None:
        """Return the pixels; None if there are none. Damaged images are counted."""
        if not frame.format:
            return None
        try:
            return decode_image(frame)
        except InputError as error:
            self._rejected[str(error)] += 1
            return None

    def _take(self, instant: SyncedFrames) -> None:
        """Process a complete set of simultaneous images."""
        images: dict[str, UInt8] = {}
        missing: dict[str, str] = {}
        for name in self.rig.cameras:  # in this order, not that of arrival
            frame: Any = instant.frames[name].frame if name in instant.frames else None
            image = None if frame is None else self._decoded(frame)
            if image is not None:
                images[name] = image
            else:
                missing[name] = DAMAGED if frame is not None and frame.format else NO_PICTURE
        numbers = {arrival.frame.sequence for arrival in instant.frames.values()}
        number = numbers.pop() if len(numbers) == 1 else self._instants
        self._instants += 1
        keypoints: dict[str, SeenKeypoints] = {}
        for name, arrival in instant.frames.items():
            seen = self._keypoints.take(name, arrival.at_ns, 0.5 * self._sync.period_ns)
            if seen is not None and name in images:
                keypoints[name] = seen
        if self._room.done:
            said = self._follow(number, instant.time_ns, images, missing, keypoints)
        else:
            said = self._room.update(instant.time_ns, images, self._presence.empty, self._fitters)
            said += unknown_room(self.rig.cameras, self._room.seen) if self._room.done else []
        self._notes.extend(TrackerNote(instant.time_ns, text) for text in said)

    def _follow(
        self,
        number: int,
        time_ns: int,
        images: Mapping[str, UInt8],
        missing: Mapping[str, str],
        keypoints: Mapping[str, SeenKeypoints],
    ) -> list[str]:
        """Fit all bodies and decide which are present; return messages."""
        said = [] if self._begun else self._begin(time_ns)
        found = self._fitters.update(images, time_ns, self._presence.lost, keypoints)
        found = {
            name: msgspec.structs.replace(fit, left_out={**fit.left_out, **missing}) for name, fit in found.items()
        }
        bodies, who = self._presence.update(number, found, images, self._joints_at(time_ns))
        said += who + self._conditions.update(number, bodies)
        supported = {
            name: one.fit.supported
            for name, one in bodies.items()
            if one.fit.supported is not None and one.fit.seen and not one.lost
        }
        said += self._support.update(number, time_ns, supported)
        if not self._presence.lost:
            fits = {name: one.fit for name, one in bodies.items()}
            said += self._rig_check.update(fits, images, self._presence.empty)
        self.seen = SeenInstant(number, time_ns, images, bodies)
        self._bodies = self._scenes.tracked(bodies)
        return said

    def _joints_at(self, time_ns: int) -> dict[str, Mapping[str, Float64]]:
        """Return the joints that are known at a time, by body; the time since the first frame counts."""
        if self._first_ns is None:
            self._first_ns = time_ns
        since_s = (time_ns - self._first_ns) / NS_PER_S
        return {name: body.known_at(since_s, 0.5 * self.period_s) for name, body in self.bodies.items()}

    def _begin(self, time_ns: int) -> list[str]:
        """Start all bodies, before the first fit; return messages."""
        self._begun, self._reason = True, ""
        self._start(time_ns - round(self.period_s * NS_PER_S))
        if self._waiting:
            self._presence.wait()
        said = [
            f"at the start {called(name)} is outside of {camera}'s image"
            for name, body in self.bodies.items()
            for seen_by in [cameras_that_see(body.mesh, body.pose, self.rig)]
            for camera in self.rig.cameras
            if camera not in seen_by
        ]
        said += self._sizes
        return said + (unknown_room(self.rig.cameras, self._filmed) if self._filmed else [])

    def _start(self, time_ns: int) -> None:
        """Set all bodies to their initial poses at a time."""
        for name, body in self.bodies.items():
            self._fitters.start(name, body.pose, time_ns, there=not self._waiting)
            self._presence.start(name, body.pose, time_ns)

    def _stand(self) -> TrackerState:
        if not self._room.done:
            return TrackerState(Phase.CALIBRATING, 0, self._room.remaining, IMAGES, reason=self._reason or LEARNING)
        if not self._begun:
            missing = len(self.rig.cameras) - len(self._sync.heard)
            return TrackerState(Phase.WAITING_FOR_SENSORS, missing, reason=self._reason)
        lost = [f"{called(name)} is in no camera's image" for name in self._presence.lost]
        clauses = (*self._sizes, *self._rig_check.said, *self._conditions.lasting, *self._support.lasting, *lost)
        return TrackerState(Phase.TRACKING, reason="; ".join(clause.replace("; ", ", ") for clause in clauses))

    def _scene(self, arrival: Arrival) -> Scene:
        step, self._steps = self._steps, self._steps + 1
        return scene_at(arrival, step, self._state, {"bodies": self._bodies}, sensors=self._places)


_FORMAT: Final = "silhouettes 7"
_OWN_MEMORY: Final = (
    *("_steps", "_instants", "_restarts", "_rejected", "_newest", "_filmed", "_begun", "_reason", "_notes", "_bodies"),
    *("_state", "_first_ns"),
)
_REMEMBERED: Final = (
    *(Phase, TrackerState, TrackerNote, TrackedBody, TrackedBodyView, *IMAGES_REMEMBERED),
    *(*SYNC_REMEMBERED, *KEYPOINTS_REMEMBERED, *FITTER_REMEMBERED, *PRESENCE_REMEMBERED),
)
