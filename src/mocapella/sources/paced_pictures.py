"""Videos and folders of images as image sources in real time: each image is given when it is due."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.errors import InputError
from mocapella.sources.picture_source import Picture, SourceState
from mocapella.sources.video import IMAGES, open_video, read_image

UInt8 = NDArray[np.uint8]

USUAL_FPS: Final = 30.0
"""Frame rate assumed for a folder of images, and for a video that states none [Hz]."""


class PacedPictures:
    """A video, an image, or a folder's images in the order of their names, as an image source (`PictureSource`).

    The first image is due at `begin`. Images are never dropped: if they are read too slowly, they come late. Frames of
    a video have the container's times (``CAP_PROP_POS_MSEC``) as long as these rise; otherwise a frame follows the last
    one after one period of the frame rate.

    Args:
        path: path of the video, image or folder.
        fps: frame rate [Hz]; None uses the video's own times, and `USUAL_FPS` for a folder.
        loop: whether it repeats.
        rate_option: the command's option for ``fps``, named in the note on a video that states no rate.
        clock: the monotonic clock, in seconds.

    Attributes:
        name, live, times: name as the user wrote it, whether a missing image means a lost camera, and the origin of the
            capture times in words.
    """

    live = False

    def __init__(
        self,
        path: Path | str,
        *,
        fps: float | None = None,
        loop: bool = False,
        rate_option: str = "--fps",
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.name, self.times = str(path), "the film's own"
        self._path, self._wished_fps, self._loop, self._clock = Path(path), fps, loop, clock
        self._rate_option = rate_option
        self._fps = fps or USUAL_FPS
        self._zero_s, self._number = 0.0, 0
        self._next_s, self._frames = 0.0, iter(())  # type: float, Iterator[tuple[float, float, UInt8]]
        self._capture: cv2.VideoCapture | None = None

    def open(self) -> SourceState:
        """Open the source from its first image and return its state; see `PictureSource.open`.

        Raises:
            InputError: the path does not exist, is no video or image, or is a folder without images.
        """
        self.close()
        self._number, self._next_s = 0, 0.0
        path = self._path
        problems: tuple[str, ...] = ()
        if path.is_dir() or path.suffix.lower() in IMAGES:
            self._fps = self._wished_fps or USUAL_FPS
            files = [path] if not path.is_dir() else sorted(f for f in path.iterdir() if f.suffix.lower() in IMAGES)
            if not files:
                raise InputError("is a folder without images", file=path, fix=f"put images there ({', '.join(IMAGES)})")
            height, width = read_image(files[0]).shape[:2]
            self._frames = self._of_files(files)
            return SourceState((width, height), self._fps)
        if not path.is_file():
            fix = "name a film or a folder of images, camera:0, http://… or rendered:SCENE/CAMERA"
            raise InputError("is not there", file=path, fix=fix)
        self._capture = open_video(path)
        stated = float(self._capture.get(cv2.CAP_PROP_FPS))
        if not 0 < stated < math.inf and self._wished_fps is None:
            note = f"does not state its frame rate; {USUAL_FPS:g} Hz is assumed ({self._rate_option} sets it)"
            stated, problems = USUAL_FPS, (note,)
        self._fps = self._wished_fps or stated
        size = tuple(int(self._capture.get(k)) for k in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        self._frames = self._of_film(self._capture)
        return SourceState((size[0], size[1]), self._fps, problems=problems)

    def begin(self, zero_s: float) -> None:
        """Set the time on the monotonic clock at which the first image is due [s]."""
        self._zero_s = zero_s

    def read(self, stop: threading.Event) -> Picture | None:
        """Wait until the next image is due; None at the end, or if ``stop`` is set. See `PictureSource.read`."""
        found = next(self._frames, None)
        if found is None:
            return None
        at_s, retrieval_s, image = found
        self._next_s = at_s + 1 / self._fps
        if stop.wait(max(0.0, self._zero_s + at_s - self._clock())):
            return None
        number, self._number = self._number, self._number + 1
        return Picture(image, round(at_s * NS_PER_S) + 1, number, self._clock(), retrieval_s)

    def close(self) -> None:
        """Close the file: `read` returns None until the source is opened again. May be called twice."""
        self._frames = iter(())
        if self._capture is not None:
            self._capture.release()
            self._capture = None

    def _of_files(self, files: list[Path]) -> Iterator[tuple[float, float, UInt8]]:
        while True:
            for file in files:
                begin = self._clock()
                image = read_image(file)
                yield self._next_s, self._clock() - begin, image
            if not self._loop:
                return

    def _of_film(self, capture: cv2.VideoCapture) -> Iterator[tuple[float, float, UInt8]]:
        first_s = begun_s = 0.0
        before_s: float | None = None  # the last frame's time in this turn
        while True:
            if not capture.grab():
                if before_s is None or not self._loop:
                    return
                capture.release()
                capture.open(str(self._path))
                begun_s, before_s = self._next_s, None
                continue
            stamp_s = float(capture.get(cv2.CAP_PROP_POS_MSEC)) / 1e3
            first_s = stamp_s if before_s is None else first_s
            begin = self._clock()
            read, image = capture.retrieve()
            if not read:
                return
            at_s = begun_s + stamp_s - first_s
            if before_s is not None and (self._wished_fps is not None or at_s <= before_s):
                at_s = self._next_s
            before_s = at_s
            yield at_s, self._clock() - begin, np.asarray(image, dtype=np.uint8)
