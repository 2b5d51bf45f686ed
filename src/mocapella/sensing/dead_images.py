"""Cameras in whose images nothing is to be seen: black ones, uniform ones, and the same one again and again."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

UInt8 = NDArray[np.uint8]

DARK: Final = 16
"""Of 255: what is not brighter is black …"""
BRIGHT_SHARE: Final = 0.01
"""but for so much of it, as of a sensor's broken pixels."""
UNIFORM: Final = 2.0
"""Grey levels: an image of whose channels no standard deviation is above has nothing in it."""
_EVERY: Final = 13


class DeadImages:
    """Remembers the last images, by camera."""

    def __init__(self) -> None:
        self._last: dict[str, UInt8] = {}
        self._same: dict[str, int] = {}

    def update(self, images: Mapping[str, UInt8]) -> dict[str, str]:
        """Why images of one instant (height, width[, 3]) should not count, by camera; those that should are left out.

        An image that comes a second time, while other cameras' change, says nothing of this instant, whether the camera
        is broken or slower than the others.
        """
        sampled = {name: np.ascontiguousarray(image[::_EVERY, ::_EVERY]) for name, image in images.items()}
        for name, image in sampled.items():
            same = name in self._last and np.array_equal(self._last[name], image)
            self._same[name] = self._same.get(name, 1) + 1 if same else 1
        self._last |= sampled
        moving = any(self._same[name] == 1 for name in sampled)
        found = {}
        for name, image in sampled.items():
            if np.count_nonzero(image > DARK) <= BRIGHT_SHARE * image.size:
                found[name] = "its image is black"
            elif cv2.meanStdDev(image)[1].max() < UNIFORM:
                found[name] = "its image is of one colour"
            elif moving and self._same[name] > 1:
                found[name] = f"its image is frozen: the same for {self._same[name]} frames, while others change"
        return found
