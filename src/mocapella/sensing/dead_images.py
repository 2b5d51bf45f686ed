"""Detect cameras that deliver black, uniform or frozen images.

Three tests of a subsampled image: share of bright values, standard deviation, and equality with the camera's last
image.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

UInt8 = NDArray[np.uint8]

DARK: Final = 16
"""Values up to this are black [grey levels]."""
BRIGHT_SHARE: Final = 0.01
"""Share of brighter values that a black image may have, such as a sensor's broken pixels."""
UNIFORM: Final = 2.0
"""An image is uniform if no channel has a larger standard deviation [grey levels]."""
_EVERY: Final = 19


class DeadImages:
    """Detects black, uniform and frozen images by comparing each camera's image with its previous one.

    It keeps every 19th pixel of every 19th row of each camera's last image.
    """

    def __init__(self) -> None:
        self._last: dict[str, UInt8] = {}
        self._same: dict[str, int] = {}

    def memory(self) -> list[Any]:
        """Return the state for `recall`: the object's own, which `update` changes, not a copy."""
        return [self._last, self._same]

    def recall(self, memory: Sequence[Any]) -> None:
        """Restore a state that `memory` returned: the last samples of each camera, which are kept, not copied."""
        self._last, self._same = memory

    def update(self, images: Mapping[str, UInt8]) -> dict[str, str]:
        """Find images that must not be used because they are black, uniform or frozen.

        An image is frozen if it equals the camera's last one while another camera's image has changed: the camera is
        broken, or slower. If all images are repeated, or there is one camera, none is reported as frozen.

        Args:
            images: (height, width) or (height, width, 3) uint8 of one instant, by camera. An image of another size than
                the camera's last one is compared with no earlier one.

        Returns:
            The reason, for users, by camera; cameras with usable images are left out.
        """
        measured: dict[str, tuple[float, float]] = {}
        for name, image in images.items():
            pixels = image.reshape(*image.shape[:2], -1)
            shape = (-(-pixels.shape[0] // _EVERY), -(-pixels.shape[1] // _EVERY), pixels.shape[2])
            before = self._last.get(name)
            if before is None or before.shape != shape:
                self._same[name] = 0
                before = self._last[name] = np.zeros(shape, np.uint8)
            bright, sd, same = _kernels().sampled(pixels, _EVERY, DARK, before)
            measured[name] = bright, sd
            self._same[name] = self._same[name] + 1 if same else 1
        moving = any(self._same[name] == 1 for name in measured)
        found = {}
        for name, (bright, sd) in measured.items():
            if bright <= BRIGHT_SHARE:
                found[name] = "its image is black"
            elif sd < UNIFORM:
                found[name] = "its image is of one colour"
            elif moving and self._same[name] > 1:
                found[name] = f"its image is frozen: the same for {self._same[name]} frames, while others change"
        return found


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.sensing import dead_images_kernels

    return dead_images_kernels
