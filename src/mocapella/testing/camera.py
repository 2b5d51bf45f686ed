"""A fake camera: a `mocapella.sources.picture_source.PictureSource` without a device."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import numpy as np

from mocapella.conventions import NS_PER_S
from mocapella.errors import InputError
from mocapella.sources.picture_source import Image, Picture, SourceState

_USUAL = SourceState((64, 48), 30.0)
_POLL_S = 0.01


class FakeCamera:
    """A live camera with synthetic images, which can be disconnected.

    Args:
        state: state that `open` returns; by default, a colour camera of 64 x 48 px at 30 Hz. With ``unit_m``, it is a
            depth camera. Images come at its ``fps``, or without a wait if that is None. Capture times are 1 / fps,
            2 / fps, …, with 30 Hz for None, rounded to nanoseconds.
        image: function of an image's number, from 0, that returns the image, of the state's size: (height, width, 3)
            uint8 BGR, or of a depth camera (height, width) uint16. By default, every pixel is the number modulo 256 (of
            a depth camera, 700 plus the number modulo 256).
        name: name of the source, as a user would write it.

    Attributes:
        plugged: set it to False to disconnect the camera: `read` returns None, and `open` raises `InputError`.
        opened, closed: number of times that it was opened and closed.
        count: number of images so far, over all openings; the next image's number.
    """

    live = True
    times = "a counter"

    def __init__(
        self,
        state: SourceState = _USUAL,
        image: Callable[[int], Image] | None = None,
        *,
        name: str = "fake camera",
    ) -> None:
        self.name, self.plugged = name, True
        self.opened = self.closed = self.count = 0
        self._state, self._image = state, image or self._numbered

    def open(self) -> SourceState:
        """Open the camera and return its state.

        Raises:
            InputError: ``plugged`` is False.
        """
        if not self.plugged:
            raise InputError("cannot be opened", file=self.name, fix="set its attribute plugged to True")
        self.opened += 1
        return self._state

    def begin(self, zero_s: float) -> None:
        """Do nothing: a camera has a clock of its own."""

    def read(self, stop: threading.Event) -> Picture | None:
        """Wait for the next image; return None if ``stop`` is set or ``plugged`` is False, before or during the wait.

        The image comes one frame interval after the call, also before `open` and after `close`.
        """
        due_s = time.monotonic() + (1 / self._state.fps if self._state.fps else 0.0)
        while self.plugged and not stop.is_set():
            left_s = due_s - time.monotonic()
            if left_s <= 0:
                number, self.count = self.count, self.count + 1
                time_ns = round((number + 1) * NS_PER_S / (self._state.fps or 30.0))
                return Picture(self._image(number), time_ns, number, time.monotonic(), 0.0)
            stop.wait(min(left_s, _POLL_S))
        return None

    def close(self) -> None:
        """Count the call in ``closed``; nothing else changes."""
        self.closed += 1

    def _numbered(self, number: int) -> Image:
        width, height = self._state.size_px or (64, 48)
        if self._state.unit_m is not None:
            return np.full((height, width), 700 + number % 256, np.uint16)
        return np.full((height, width, 3), number % 256, np.uint8)
