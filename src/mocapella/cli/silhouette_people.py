"""Keypoint files or detections of all people for `track silhouettes`.

The method ``webcams`` tracks the people, to start their bodies; the keypoints themselves refine the fits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from mocapella.cli.common import say
from mocapella.errors import InputError
from mocapella.model.point_tracks import match_cameras

if TYPE_CHECKING:
    from mocapella.library.motion_tracks import MotionTracks
    from mocapella.model.camera import CameraRig
    from mocapella.model.keypoints import KeypointFrame
    from mocapella.recording.detections import CameraDetections
    from mocapella.sources.frame_set import FrameSource
    from mocapella.tracker.silhouette_start import PersonJoints


@dataclass(frozen=True)
class PeopleWishes:
    """Where the bodies of all people come from.

    Attributes:
        paths: folders or files with keypoints of all people, as `mocapella triangulate` takes them; empty for none.
        finds: a keypoint detector for each camera by its name, in place of ``paths``; None for none.
        up: upward axis of the rig's world.
        order: order of keypoints without names.
        rig: the cameras.
        shown: the films; their rate is the rate of the keypoints' numbers.
        first: number of the first frame that is tracked.
    """

    paths: Sequence[str] = ()
    finds: Mapping[str, Any] | None = None
    up: str = "y"
    order: str = "auto"
    rig: CameraRig | None = None
    shown: FrameSource | None = None
    first: int = 0

    @property
    def given(self) -> bool:
        """Whether there are keypoints of all people."""
        return bool(self.paths) or self.finds is not None

    @cached_property
    def joints(self) -> dict[str, PersonJoints]:
        """Joints of all people over time, by name; a single one has the name `ALONE`.

        Raises:
            InputError: the keypoints cannot be read, or have no person that can be tracked.
        """
        from mocapella.recording.bodies_file import ALONE
        from mocapella.tracker.silhouette_start import people_joints

        assert self.rig is not None
        assert self.shown is not None
        rate_hz = self.shown.rate_hz
        people = self._detected() if self.finds is not None else self._of_files(rate_hz)
        where = ", ".join(self.paths) or "films"
        if people is None:
            raise InputError(
                "nobody is tracked in the keypoints", file=where,
                fix="do keypoints, films and rig belong together? --set up=z is of a rig whose z axis points up",
            )  # fmt: skip
        first_s = 0.0 if self.finds is not None else self.first / rate_hz  # detections begin with the first frame
        found = people_joints(people, first_s, self.up)
        there = {name: one for name, one in found.items() if one.start}
        for name in found.keys() - there.keys():
            say(f"{name} comes after the first images, and gets no body")
        if not there:
            raise InputError("nobody is in the first images", file=where, fix="begin at a later frame: --frames 30-")
        return there if len(there) > 1 else {ALONE: next(iter(there.values()))}

    @cached_property
    def frames(self) -> dict[int, list[KeypointFrame]]:
        """Keypoints in all images by the number of the films' frame, to refine the fit; empty for none.

        Raises:
            InputError: the keypoints cannot be read, or are no people's.
        """
        from mocapella.recording.detections import keypoint_frames

        if not self.given:
            return {}
        assert self.rig is not None
        assert self.shown is not None
        if self.finds is not None:
            return self._found
        files = self._files
        found: dict[int, list[KeypointFrame]] = {}
        first = min((int(one.numbers[0]) for one in files if len(one.numbers)), default=0)
        names = match_cameras([one.camera for one in files], self.rig.cameras, file=self.paths[0])
        for name, one in zip(names, files, strict=True):
            if name in self.shown.rig.cameras and len(one.numbers):
                size = self.shown.rig.cameras[name].camera.size_px
                made = keypoint_frames(one, name, size, self.shown.rate_hz)
                for number, frame in zip(one.numbers.tolist(), made, strict=True):
                    found.setdefault(number - first, []).append(frame)
        return found

    @cached_property
    def _files(self) -> list[CameraDetections]:
        from mocapella.recording.detection_files import read_detections

        return [*read_detections([Path(path) for path in self.paths], order=self.order)]

    def _of_files(self, rate_hz: float) -> MotionTracks | None:
        from mocapella.library.keypoint_tracking import rig_with_y_up
        from mocapella.library.people_triangulation import track_detections

        assert self.rig is not None
        turned, source = rig_with_y_up(self.rig, self.up), Path(self.paths[0])
        found = track_detections(self._files, turned, source=source, fps=rate_hz)
        for note in found.notes:
            say(note)
        return found.people

    @cached_property
    def _found(self) -> dict[int, list[KeypointFrame]]:
        """Detections in all images of the films, by number of the frame."""
        from mocapella.conventions import NS_PER_S
        from mocapella.detectors.keypoint_detector import frame_of

        assert self.shown is not None
        assert self.finds is not None
        found: dict[int, list[KeypointFrame]] = {}
        for shot in self.shown:
            at_s = shot.frame / self.shown.rate_hz
            for name, image in shot.images.items():
                finds, size = self.finds[name], (image.shape[1], image.shape[0])
                seen, time_ns = finds.update(image, at_s), round(at_s * NS_PER_S) + 1
                found.setdefault(shot.frame, []).append(frame_of(seen, finds.topology, name, time_ns, size))
        return found

    def _detected(self) -> MotionTracks | None:
        from mocapella.library.keypoint_tracking import arrivals_of, rig_with_y_up, track_arrivals

        assert self.rig is not None
        frames: dict[str, list[KeypointFrame]] = {}
        for some in self._found.values():
            for frame in some:
                frames.setdefault(frame.sensor, []).append(frame)
        rig = rig_with_y_up(self.rig, self.up)
        recording, _ = track_arrivals(arrivals_of(frames, rig), rig, source=Path("films"))
        return recording.people


NOBODY: Final = PeopleWishes()
