"""Recorded depth images as an image source in real time: each image is given when it is due."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator

from mocapella.conventions import NS_PER_S
from mocapella.sources.depth_files import USUAL_FPS, DepthRecording, RecordedDepth
from mocapella.sources.picture_source import Picture, SourceState


class PacedDepth:
    """A recording of depth images as an image source (`PictureSource`). Unreadable images are skipped.

    Images are never dropped: whoever reads too slowly gets them late, and one after the other until none is overdue.
    `open` begins from the first image again, and `begin` sets the time at which that image is due.

    Args:
        recording: the recording.
        loop: whether it repeats.
        clock: the monotonic clock, in seconds.

    Attributes:
        name, live, times: the recording's name, whether a missing image means a lost camera, and the origin of the
            capture times in words.
        recording: as given.
        damaged: number of unreadable images since `open`.
    """

    live = False

    def __init__(
        self, recording: DepthRecording, *, loop: bool = False, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.name, self.times = recording.name, "the recording's own"
        self.recording, self._loop, self._clock = recording, loop, clock
        self.damaged = 0
        self._zero_s, self._number, self._last_ns = 0.0, 0, 0
        self._images: Iterator[tuple[int, RecordedDepth]] = iter(())

    def open(self) -> SourceState:
        """Begin with the recording's first image, and return the recording's state: size, rate, unit and lens."""
        self._number = self._last_ns = self.damaged = 0
        self._images = self._timed()
        return self.recording.state

    def begin(self, zero_s: float) -> None:
        """Set the time on the monotonic clock at which the first image is due [s]."""
        self._zero_s = zero_s

    def read(self, stop: threading.Event) -> Picture | None:
        """Wait until the next image is due; None at the end, or if ``stop`` is set. See `PictureSource.read`."""
        begin_s = self._clock()
        for due_ns, image in self._images:
            if image.depth is None:
                self.damaged += 1
                continue
            read_s = self._clock() - begin_s
            if stop.wait(max(0.0, self._zero_s + due_ns / NS_PER_S - self._clock())):
                return None
            self._last_ns = max(due_ns + 1, self._last_ns + 1)
            number, self._number = self._number, self._number + 1
            return Picture(image.depth, self._last_ns, number, self._clock(), read_s, image.colour)
        return None

    def close(self) -> None:
        """End the images: `read` returns None until the source is opened again."""
        self._images = iter(())

    def _timed(self) -> Iterator[tuple[int, RecordedDepth]]:
        """Yield each image with its due time after the first [ns].

        Where the recording's clock goes back, the image is due one frame period after the previous one.
        """
        gap_ns = round(NS_PER_S / (self.recording.state.fps or USUAL_FPS))
        due_ns, last_ns = 0, None
        while True:
            for image in self.recording.images():
                step = 0 if last_ns is None else image.time_ns - last_ns
                due_ns += step if last_ns is None or step > 0 else gap_ns
                last_ns = image.time_ns
                yield due_ns, image
            if not self._loop or last_ns is None:
                return
