"""Base class of rendered image sources: each image is rendered just before it is due."""

from __future__ import annotations

import math
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.sources.picture_source import Image, Picture


class RenderedSource(ABC):
    """A `mocapella.sources.picture_source.PictureSource` without `open`, which must call `restart`.

    Capture times are the scene's time plus 1 ns. Images that cannot be rendered in time are skipped. It does not end.

    Args:
        name: name of the source, as the user wrote it.
        fps: frame rate [Hz].
        phase_s: due time of the first image, on the scene's clock [s].
        clock: the monotonic clock, in seconds.

    Attributes:
        name, live, times: name as the user wrote it, whether a missing image means a lost camera, and the origin of the
            capture times in words.
        colour: (height, width, 3) uint8 BGR of the last rendered image, of a depth camera with colour; else None.
    """

    live = False

    def __init__(
        self, name: str, fps: float, phase_s: float = 0.0, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.name, self.times = name, "the scene's own"
        self._fps, self._phase_s, self._clock, self._zero_s = fps, phase_s, clock, 0.0
        self._turn = self._number = 0
        self.colour: NDArray[np.uint8] | None = None

    @abstractmethod
    def render(self, at_s: float) -> Image:
        """Render the image at a time on the scene's clock [s]: (h, w, 3) uint8 BGR, or (h, w) uint16 depth in units."""

    def restart(self) -> None:
        """Render once, so that kernels are compiled before real time starts, and begin with the first image."""
        self.render(0.0)
        self._turn = 0

    def begin(self, zero_s: float) -> None:
        """Set the time on the monotonic clock at which the scene's time is 0 [s]."""
        self._zero_s = zero_s

    def read(self, stop: threading.Event) -> Picture | None:
        """Render the next image that is not overdue, and wait until it is due; None only if ``stop`` is set.

        Overdue images are skipped; `Picture.number` does not count them. An image that becomes overdue while it is
        rendered is returned late. An image is due at its time on the scene's clock, see `begin`.
        """
        now_s = max(0.0, self._clock() - self._zero_s)
        self._turn = max(self._turn, math.ceil((now_s - self._phase_s) * self._fps))
        at_s = self._phase_s + self._turn / self._fps
        self._turn += 1
        begin_s = self._clock()
        image = self.render(at_s)
        rendered_s = self._clock() - begin_s
        if stop.wait(max(0.0, self._zero_s + at_s - self._clock())):
            return None
        number, self._number = self._number, self._number + 1
        return Picture(image, round(at_s * NS_PER_S) + 1, number, self._clock(), rendered_s, self.colour)

    def close(self) -> None:  # noqa: B027 - no subclass needs to override it
        """Do nothing: no resources are held."""
