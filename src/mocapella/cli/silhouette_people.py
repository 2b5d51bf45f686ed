"""Starts of `track silhouettes` from keypoint files or detections of all people, tracked by the method ``webcams``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from mocapella.cli.common import say
from mocapella.errors import InputError

if TYPE_CHECKING:
    from mocapella.library.motion_tracks import MotionTracks
    from mocapella.model.camera import CameraRig
    from mocapella.sources.frame_set import FrameSource
    from mocapella.tracker.silhouette_start import PersonJoints

DETECT_EVERY_S: Final = 0.1
"""Time between two images of a film that are searched for people [s]."""


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
        people = self._detected(rate_hz) if self.finds is not None else self._of_files(rate_hz)
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

    def _of_files(self, rate_hz: float) -> MotionTracks | None:
        from mocapella.library.people_triangulation import triangulate_people

        assert self.rig is not None
        found = triangulate_people(
            [Path(path) for path in self.paths], self.rig, fps=rate_hz, up=self.up, order=self.order
        )
        for note in found.notes:
            say(note)
        return found.people

    def _detected(self, rate_hz: float) -> MotionTracks | None:
        from mocapella.conventions import NS_PER_S
        from mocapella.detectors.keypoint_detector import frame_of
        from mocapella.library.keypoint_tracking import arrivals_of, rig_with_y_up, track_arrivals

        assert self.rig is not None
        assert self.shown is not None
        assert self.finds is not None
        every, frames = max(1, round(rate_hz * DETECT_EVERY_S)), dict[str, list[Any]]()
        for count, shot in enumerate(self.shown):
            if count % every:
                continue
            at_s = shot.frame / rate_hz
            for name, image in shot.images.items():
                finds, size = self.finds[name], (image.shape[1], image.shape[0])
                seen = finds.update(image, at_s)
                time_ns = round(at_s * NS_PER_S) + 1
                frames.setdefault(name, []).append(frame_of(seen, finds.topology, name, time_ns, size))
        rig = rig_with_y_up(self.rig, self.up)
        recording, _ = track_arrivals(arrivals_of(frames, rig), rig, source=Path("films"))
        return recording.people


NOBODY: Final = PeopleWishes()
