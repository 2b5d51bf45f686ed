"""Cameras in whose images nothing is to be seen: black ones, uniform ones, and the same one again and again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

UInt8 = NDArray[np.uint8]

DARK: Final = 16
"""Of 255: what is not brighter is black …"""
BRIGHT_SHARE: Final = 0.01
"""but for so much of it, as of a sensor's broken pixels."""
UNIFORM: Final = 2.0
"""Grey levels: an image of whose channels no standard deviation is above has nothing in it."""
_EVERY: Final = 19


class DeadImages:
    """Remembers the last images, by camera."""

    def __init__(self) -> None:
        self._last: dict[str, UInt8] = {}
        self._same: dict[str, int] = {}

    def memory(self) -> list[Any]:
        """All that `recall` wants."""
        return [self._last, self._same]

    def recall(self, memory: Sequence[Any]) -> None:
        """Be as when `memory` was made."""
        self._last, self._same = memory

    def update(self, images: Mapping[str, UInt8]) -> dict[str, str]:
        """Why images of one instant (height, width[, 3]) should not count, by camera; those that should are left out.

        An image that comes a second time, while other cameras' change, says nothing of this instant, whether the camera
        is broken or slower than the others.
        """
        looked_at: dict[str, tuple[float, float]] = {}
        for name, image in images.items():
            pixels = image.reshape(*image.shape[:2], -1)
            shape = (-(-pixels.shape[0] // _EVERY), -(-pixels.shape[1] // _EVERY), pixels.shape[2])
            before = self._last.get(name)
            if before is None or before.shape != shape:
                self._same[name] = 0
                before = self._last[name] = np.zeros(shape, np.uint8)
            bright, sd, same = _kernels().looked_at(pixels, _EVERY, DARK, before)
            looked_at[name] = bright, sd
            self._same[name] = self._same[name] + 1 if same else 1
        moving = any(self._same[name] == 1 for name in looked_at)
        found = {}
        for name, (bright, sd) in looked_at.items():
            if bright <= BRIGHT_SHARE:
                found[name] = "its image is black"
            elif sd < UNIFORM:
                found[name] = "its image is of one colour"
            elif moving and self._same[name] > 1:
                found[name] = f"its image is frozen: the same for {self._same[name]} frames, while others change"
        return found


@cache
def _kernels() -> Any:
    """Compiled; numba is imported when it is first needed."""
    from mocapella.sensing import dead_images_kernels

    return dead_images_kernels
