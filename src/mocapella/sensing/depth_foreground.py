"""What came nearer to a depth camera than what was there when it was last looked at."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mocapella.sensing.arm_region import ArmRegionSettings, kernels

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]


class DepthForeground:
    """Remembers how far everything was, on a coarse grid.

    What goes farther away is taken in at once; what comes nearer is new until it was `looked` at. Where nothing is
    measured beside something, it is in that thing's shadow, and what comes out of it is as far as the shadow's edges.
    """

    def __init__(self, lens: Float64, settings: ArmRegionSettings) -> None:
        self.settings = settings
        fx, fy, cx, cy = lens[:4]
        self._lens = np.array([fx / _STEP, fy / _STEP, (cx - _STEP // 2) / _STEP, (cy - _STEP // 2) / _STEP])
        self._before: Float64 | None = None

    def _coarse(self, depth: Float32) -> Float64:
        seen = depth[_STEP // 2 :: _STEP, _STEP // 2 :: _STEP].astype(np.float64)
        return np.where((seen >= self.settings.near_m) & (seen <= self.settings.far_m), seen, 0.0)

    def looked(self, depth: Float32) -> None:
        """All of an image (height, width) [m] is known."""
        self._before = self._coarse(depth)

    def places(self, depth: Float32, arms: Iterable[Float64]) -> Float64:
        """(k, 3) of what is nearer in an image (height, width) [m] than what was there before; each as large as a hand.

        Args:
            depth: see there.
            arms: (k, 5) spheres of each arm [m], about which everything is its own.
        """
        seen = self._coarse(depth)
        before = seen if self._before is None else self._before
        beside = ndimage.maximum_filter(before, (1, _SHADOW))
        known = np.where(before > 0, before, np.where(beside > 0, beside, np.inf))
        new = (seen > 0) & (seen < known - _NEARER_M)
        for spheres in arms:
            low, high = np.empty(seen.shape), np.empty(seen.shape)
            kernels().bands(np.ascontiguousarray(spheres), self._lens, _ABOUT_M, _ABOUT_M, low, high)
            new &= high == 0.0
        self._before = np.where(new, before, np.maximum(before, seen))
        y, x = np.nonzero(ndimage.binary_erosion(new, np.ones((3, 3))))
        z, (fx, fy, cx, cy) = seen[y, x], self._lens
        return np.stack([(x - cx) * z / fx, (y - cy) * z / fy, z], axis=-1)


_STEP: Final = 8
"""Pixels."""
_SHADOW: Final = 13
"""Steps that a shadow is wide."""
_NEARER_M: Final = 0.05
"""What moves by less is the same thing."""
_ABOUT_M: Final = 0.08
"""About an arm: its clothes, and what is predicted or fitted wrongly."""
