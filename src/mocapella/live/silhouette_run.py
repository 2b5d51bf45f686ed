"""Track bodies by silhouettes through videos or live, frame by frame, for the command and the demo.

The tracker makes all decisions; this module measures its time, passes on its notes, and counts the results.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.live.silhouette_statistics import STEP_MS, BinnedValues, BodyStatistics
from mocapella.model.keypoints import KeypointFrame
from mocapella.model.observations import Arrival
from mocapella.model.outline_colours import Colour, body_colour
from mocapella.model.scene import Scene
from mocapella.model.silhouettes import Silhouette
from mocapella.recording.bodies_file import FollowedFrame, frame_of
from mocapella.sensing.outline_picture import Outlines, outlined
from mocapella.sources.frame_set import FrameSet
from mocapella.tracker.body_fitter import FittedBody
from mocapella.tracker.image_arrivals import arrivals_of
from mocapella.tracker.silhouette_views import SeenBody, unsupported
from mocapella.tracker.silhouettes import SilhouettesTracker

UInt8 = NDArray[np.uint8]
Say = Callable[[str], None]
RecordStep = Callable[[Arrival, int | None, Scene], None]
ROOM_NODE, VIDEO_NODE, KEYPOINT_NODE = 1, 2, 3
"""Node ids of the frames in a recorded take: of images of the empty room, of the videos, and of keypoints in these."""


class PersonStep(msgspec.Struct, frozen=True, eq=False):
    """One body in one frame.

    Attributes:
        followed: the tracker's fit.
        row: the body in this frame, in the form of the result file.
        waits: silhouette of a lost body at its last clearly seen pose, or at first the initial one, by camera; else
            empty.
    """

    followed: FittedBody
    row: FollowedFrame
    waits: Mapping[str, Silhouette] = {}

    def outlines(self, camera: str, colour: Colour) -> Outlines | None:
        """Return the outlines to draw in a camera's image, in this colour; None if the body is not in the image."""
        if self.row.lost:
            waiting = self.waits.get(camera)
            return None if waiting is None else Outlines(waiting, waiting, colour)
        seen = self.followed.seen.get(camera)
        return None if seen is None else Outlines(seen.contour, seen.outline.silhouette, colour)


class Step(msgspec.Struct, frozen=True, eq=False):
    """One set of simultaneous images of the silhouettes tracker, and its results.

    Attributes:
        frame: number of the set in the videos.
        images: (height, width, 3) uint8 BGR by camera, as available.
        people: results by the body's name.
        took_s: duration of tracking [s].
        scene: the tracker's scene after the last of the images.
    """

    frame: int
    images: Mapping[str, UInt8]
    people: Mapping[str, PersonStep]
    took_s: float
    scene: Scene

    def pictures(self, width: int | None = None) -> dict[str, UInt8]:
        """Return a copy of each camera's image with outlines, ``width`` pixels wide; None keeps the image's width.

        Returns:
            (height, width, 3) uint8 BGR, by camera.
        """
        return {name: outlined(image, self._outlines(name), width) for name, image in self.images.items()}

    def _outlines(self, camera: str) -> list[Outlines]:
        drawn = [one.outlines(camera, body_colour(k)) for k, one in enumerate(self.people.values())]
        return [one for one in drawn if one is not None]


class SilhouetteRun:
    """Passes frames to the tracker, measures its time, and counts its results.

    Args:
        tracker: a tracker that has seen no frame yet.
        say: receives messages about the run.
        record: receives each arrival, the number of its frame (None for an image of the empty room), and the resulting
            scene.

    Attributes:
        tracker: the tracker.
        meshes: body meshes by the bodies' names.
        rig: rig of the cameras.
        frames: number of frames of `step` so far; frames of `feed` alone do not count.
        statistics: statistics of each body by name; the rows are not kept.
        took_ms: durations of tracking of these frames [ms].
        notes: all messages so far.
        keypoints: people's keypoints by the number of the frame, which refine the fits; empty for none.
    """

    def __init__(
        self, tracker: SilhouettesTracker, say: Say = lambda _text: None, record: RecordStep | None = None
    ) -> None:
        self.tracker, self.rig = tracker, tracker.rig
        self.meshes = {name: body.mesh for name, body in tracker.bodies.items()}
        self.frames, self.took_ms = 0, BinnedValues(STEP_MS)
        self.statistics = {name: BodyStatistics() for name in self.meshes}
        self.notes: list[str] = []
        self.keypoints: Mapping[int, Sequence[KeypointFrame]] = {}
        self._say, self._record = say, record
        self._fed: Counter[tuple[str, int]] = Counter()
        self._zero_ns, self._last_ns = 0, -1
        self._scene: Scene | None = None

    def learn_empty(self, images: Mapping[str, UInt8]) -> None:
        """Learn the empty room from one image of each camera; before the first frame, repeatedly if wanted.

        Images of a camera that is not in the rig or of another size, and all images after the first frame, are not
        used; the tracker counts them as rejected and raises nothing.

        Args:
            images: (height, width, 3) uint8 BGR by the camera's name; cameras may be missing.

        Raises:
            SettingsError: an array has another shape or type.
        """
        for arrival in arrivals_of(images, 0, empty_room=True):
            self._give(arrival, None, ROOM_NODE)

    def feed(self, shown: FrameSet) -> float:
        """Pass a frame to the tracker without counting it, for example before a measurement; return the duration [s].

        A frame whose time does not follow the last one's, as when live cameras start again, is taken as one frame
        period later.
        """
        if self._zero_ns + shown.time_ns <= self._last_ns:  # live cameras started again, and the tracker's time goes on
            self._zero_ns = self._last_ns + round(self.tracker.period_s * NS_PER_S) - shown.time_ns
        self._last_ns = self._zero_ns + shown.time_ns
        arrivals = arrivals_of(shown.images, self._last_ns, cameras=self.rig.cameras, number=shown.frame)
        seen = [
            Arrival(msgspec.structs.replace(frame, time_ns=self._last_ns), self._last_ns)
            for frame in self.keypoints.get(shown.frame, ())
        ]
        begin_s = time.perf_counter()
        for arrival in seen:
            self._give(arrival, shown.frame, KEYPOINT_NODE)
        for arrival in arrivals:
            self._give(arrival, shown.frame, VIDEO_NODE)
        took_s = time.perf_counter() - begin_s
        for note in self.tracker.drain_notes():
            self.note(note.text)
        return took_s

    def _give(self, arrival: Arrival, number: int | None, node: int) -> None:
        """Pass a frame to the tracker; a recorded frame gets a sequence number of its own."""
        if self._record is None:
            self._scene = self.tracker.update(arrival)
            return
        key = arrival.frame.sensor, node
        frame = msgspec.structs.replace(arrival.frame, node_id=node, sequence=self._fed[key])
        self._fed[key] += 1
        arrival = Arrival(frame, arrival.at_ns)
        self._scene = self.tracker.update(arrival)
        self._record(arrival, number, self._scene)

    def steps(self, frames: Iterable[FrameSet]) -> Iterator[Step]:
        """Yield the result of each frame; a frame is tracked only when the iterator is advanced."""
        for shown in frames:
            yield self.step(shown)

    def step(self, shown: FrameSet) -> Step:
        """Track the next frame and count it; return its images and results as a `Step`.

        A frame whose time does not follow the last one's is taken as one frame period later, as in `feed`.
        """
        took_s = self.feed(shown)
        seen = self.tracker.seen
        assert seen is not None  # a frame has an arrival for every camera, also without an image
        assert self._scene is not None
        people = {
            name: PersonStep(one.fit, self._row(name, one, shown), one.waits) for name, one in seen.bodies.items()
        }
        for name, person in people.items():
            self.statistics[name].add(person.row)
            if self.keypoints:
                before = self.statistics[name].keypoints_left_out or 0
                self.statistics[name].keypoints_left_out = before + person.followed.contradicted
        self.frames += 1
        self.took_ms.add(1e3 * took_s)
        return Step(shown.frame, seen.images, people, took_s, self._scene)

    def _row(self, name: str, one: SeenBody, shown: FrameSet) -> FollowedFrame:
        fit, mesh = one.fit, self.meshes[name]
        return frame_of(
            shown.frame,
            shown.time_ns / NS_PER_S,
            fit.pose,
            joint_names=mesh.joint_names,
            landmarks=dict(zip(mesh.landmarks, fit.landmarks, strict=True)),
            overlap={camera: seen.overlap for camera, seen in fit.seen.items()},
            left_out=fit.left_out,
            lost=one.lost,
            unsupported=unsupported(fit, tuple(mesh.landmarks)),
            shown={camera: seen.shown for camera, seen in fit.seen.items()},
        )

    def note(self, text: str) -> None:
        """Pass a message to ``say``, and keep it in ``notes``."""
        self.notes.append(text)
        self._say(text)

    def summary(self) -> dict[str, object]:
        """Return the result of the run, in the form of ``--json``."""
        median_ms = self.took_ms.median
        return {
            "frames": self.frames,
            "median_ms": None if median_ms is None else round(median_ms, 2),
            "notes": self.notes,
        }

    def summary_of(self, name: str) -> dict[str, object]:
        """Return the statistics of one body, in the form of ``--json``.

        Raises:
            KeyError: there is no body of this name.
        """
        return self.statistics[name].summary()
