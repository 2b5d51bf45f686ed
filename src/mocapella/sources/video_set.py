"""Videos of several cameras, read frame by frame; each is checked before the first frame is read.

Frames with the same number belong to the same instant. Videos of different lengths are read to the end of the shortest.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any, Final

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import InputError
from mocapella.model.camera import CameraRig
from mocapella.model.point_tracks import match_cameras
from mocapella.sources.frame_set import FrameSet, check_other_size, fitted
from mocapella.sources.video import IMAGES, Frames, open_video, pictures

UInt8 = NDArray[np.uint8]

RATES_WITHIN: Final = 2e-4
"""Largest relative difference of frame rates that count as equal; 29.97 and 30 Hz do not, a frame apart after 33 s."""


class Video(msgspec.Struct, frozen=True):
    """Properties of a video, an image, or a folder of images.

    Attributes:
        path: path of the video, image or folder.
        size_px: (width, height) of the images.
        rate_hz: frame rate [Hz]; None if unknown, as for an image or a folder of images.
        count: number of frames according to the header, or number of images; None if the header states none.
    """

    path: Path
    size_px: tuple[int, int]
    rate_hz: float | None
    count: int | None


def probe(path: Path) -> Video:
    """Read the properties of a video, an image or a folder of images; its first image is decoded for the size.

    Raises:
        InputError: it cannot be read, or has no image.
    """
    with closing(pictures(path)) as found:
        first = next(found, None)
    if first is None:
        raise InputError("has no picture", file=path, fix="make it an MP4 (H.264) or AVI")
    height, width = first[1].shape[:2]
    if path.is_dir():
        count = sum(file.suffix.lower() in IMAGES for file in path.iterdir())
        return Video(path, (width, height), None, count)
    if path.suffix.lower() in IMAGES:
        return Video(path, (width, height), None, 1)
    capture = open_video(path)
    try:
        rate, frames = (float(capture.get(key)) for key in (cv2.CAP_PROP_FPS, cv2.CAP_PROP_FRAME_COUNT))
    finally:
        capture.release()
    known = np.isfinite(rate) and 0 < rate < 1e4
    return Video(path, (width, height), rate if known else None, int(frames) if frames >= 1 else None)


class VideoSet:
    """The videos of a rig's cameras, as synchronised images. Each iteration reads them from the beginning.

    An iteration yields a `FrameSet` for each selected frame, to the end of the shortest video. The constructor checks
    all videos, and raises the errors below; `__iter__` describes its own.

    Args:
        paths: a video, an image (one frame) or a folder of images for each camera, by any name that `match_cameras`
            knows.
        rig: calibrated cameras; not all need a video.
        frames: selection of frames; None for all.
        rate_hz: frame rate [Hz]; None for that of the files.
        other_size: how the images' size may differ from the calibration's: ``crop``, if only the right and lower border
            is missing, or ``scale``, if the whole image was resized; None refuses another size.

    Attributes:
        rig: the cameras that have videos, with intrinsics for the videos' image sizes.
        videos: properties of the videos, by the rig's camera names.
        rate_hz: frame rate before the selection [Hz].
        count: number of selected frames, by the headers; None if unknown.
        notes: choices and omissions to report, one line each; the iteration adds a line for each video that ends early.

    Raises:
        InputError: no video is given, the videos have none of the selected frames, or no frame rate is known; or a
            video cannot be read, is of a camera that the rig does not have or that has two videos, has another frame
            rate than the others (unless ``rate_hz`` is given), or a size that ``other_size`` does not allow.
        SettingsError: unknown ``other_size``.
    """

    def __init__(
        self,
        paths: Mapping[str, Path],
        rig: CameraRig,
        *,
        frames: Frames | None = None,
        rate_hz: float | None = None,
        other_size: str | None = None,
    ) -> None:
        if not paths:
            raise InputError("no videos are named", field="VIDEO…", fix="name a video for each camera of the rig")
        check_other_size(other_size)
        for name, path in paths.items():
            if not path.exists():  # also a misspelt name may be no camera's
                raise InputError("is not there", file=path, fix="name a film, or a folder of images")
            remedy = f"write {next(iter(rig.cameras), 'CAMERA')}={path} if it is of that camera"
            match_cameras([name], rig.cameras, file=path, remedy=remedy)
        names = match_cameras(list(paths), rig.cameras)
        self.videos = {name: probe(path) for name, path in zip(names, paths.values(), strict=True)}
        self._frames, self.notes = frames or Frames(), []
        self.rate_hz = rate_hz or self._rate()
        placed = {}
        for name in (name for name in rig.cameras if name in self.videos):
            video = self.videos[name]
            placed[name], note = fitted(rig.cameras[name], video.size_px, other_size, source=video.path)
            self.notes += [note] if note else []
        self.rig = CameraRig(placed)
        self.count = self._count()

    def described(self) -> dict[str, dict[str, Any]]:
        """Return video and image size by camera, as JSON types, for ``--json``."""
        return {
            name: {"video": str(self.videos[name].path), "size_px": list(self.videos[name].size_px)}
            for name in self.rig.cameras
        }

    def summary(self) -> dict[str, Any]:
        """Return an empty summary: `FrameSource.summary` has nothing to report of videos."""
        return {}

    def __iter__(self) -> Iterator[FrameSet]:
        """Yield the selected frames, each with an image of every camera, to the end of the shortest video.

        Raises:
            InputError: the images of a folder or video differ in size, or a file cannot be read any more.
        """
        with ExitStack() as stack:
            shown = {
                name: stack.enter_context(closing(pictures(self.videos[name].path, self._frames)))
                for name in self.rig.cameras
            }
            number = self._frames.first
            while True:
                images = {name: next(video, None) for name, video in shown.items()}
                ended = [name for name, one in images.items() if one is None]
                if ended:
                    self._note_early_end(ended, number)
                    return
                got = {name: one[1] for name, one in images.items() if one is not None}
                for name, image in got.items():
                    self._check_size(name, image, number)
                yield FrameSet.at_rate(number, self.rate_hz, got)
                number += self._frames.step

    def _rate(self) -> float:
        rates = {name: video.rate_hz for name, video in self.videos.items() if video.rate_hz is not None}
        if not rates:
            path = next(iter(self.videos.values())).path
            raise InputError("the frame rate is unknown", file=path, fix="give it with --fps")
        (first, rate), *others = rates.items()
        for name, other in others:
            if abs(other - rate) > RATES_WITHIN * rate:
                raise InputError(
                    f"has {other:g} frames a second, and {self.videos[first].path} {rate:g}",
                    file=self.videos[name].path, field="frame rate", value=other,
                    fix="convert all videos to one rate, such as with ffmpeg -r, or give their common rate with --fps",
                )  # fmt: skip
        return rate

    def _count(self) -> int | None:
        counts = {name: video.count for name, video in self.videos.items() if video.count is not None}
        if len(counts) < len(self.videos):
            return None
        least, most = min(counts.values()), max(counts.values())
        if least < most:
            said = ", ".join(f"{name} {count}" for name, count in counts.items())
            self.notes.append(f"the videos differ in length ({said} frames): the shortest, {least} frames, counts")
        end = least if self._frames.end is None else min(least, self._frames.end)
        count = len(range(self._frames.first, end, self._frames.step))
        if count == 0:
            raise InputError(
                "has none of the selected frames", field="--frames", value=f"from {self._frames.first}",
                file=min(self.videos.values(), key=lambda video: video.count or 0).path, fix=f"it has {least} frames",
            )  # fmt: skip
        return count

    def _note_early_end(self, ended: list[str], number: int) -> None:
        """Note videos that end before the number of frames in their header."""
        for name in ended:
            count, end = self.videos[name].count, self._frames.end
            if count is not None and number < count and (end is None or number < end):
                self.notes.append(
                    f"{self.videos[name].path} ends before frame {number}, though its header states {count} frames"
                )

    def _check_size(self, name: str, image: UInt8, number: int) -> None:
        size = (image.shape[1], image.shape[0])
        if size != self.videos[name].size_px:
            wanted = self.videos[name].size_px
            raise InputError(
                "is of another size than the first image", file=self.videos[name].path, field=f"frame {number}",
                value=size, fix=f"make all {wanted[0]} × {wanted[1]} px",
            )  # fmt: skip
