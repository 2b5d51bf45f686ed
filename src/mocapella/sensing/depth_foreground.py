"""Foreground of a depth camera: surfaces nearer than the remembered background.

This is background subtraction in depth: each cell of a coarse grid remembers the farthest depth seen there, and a
nearer surface is foreground.
"""

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
    """Depth background model on a coarse grid: detects surfaces that came nearer, such as an arm that enters the view.

    Depths that increase update the background at once; nearer ones are foreground until `learn` is called. Unmeasured
    pixels beside a surface lie in its shadow, and take the depth of the shadow's edges.

    Args:
        lens: (4,) fx, fy, cx, cy of the camera [px], or (9,) with the distortion, which is not used.
        settings: its range of depths is used; depths out of range count as unmeasured.
    """

    def __init__(self, lens: Float64, settings: ArmRegionSettings) -> None:
        self.settings = settings
        fx, fy, cx, cy = lens[:4]
        self._lens = np.array([fx / _STEP, fy / _STEP, (cx - _STEP // 2) / _STEP, (cy - _STEP // 2) / _STEP])
        self._before: Float64 | None = None

    def _coarse(self, depth: Float32) -> Float64:
        seen = depth[_STEP // 2 :: _STEP, _STEP // 2 :: _STEP].astype(np.float64)
        return np.where((seen >= self.settings.near_m) & (seen <= self.settings.far_m), seen, 0.0)

    def learn(self, depth: Float32) -> None:
        """Replace the background by an image (height, width) [m], foreground included; it is copied."""
        self._before = self._coarse(depth)

    def places(self, depth: Float32, arms: Iterable[Float64]) -> Float64:
        """Return points of foreground surfaces of at least 3 × 3 grid cells, and update the background.

        If `learn` was not called, the first image becomes the background and has no foreground.

        Args:
            depth: (height, width) [m].
            arms: of each tracked arm, spheres (k, 5) as in `mocapella.sensing.arm_region.region` [m]; surfaces near
                them are not reported.

        Returns:
            (k, 3) in the camera frame [m]; (0, 3) without foreground.
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
"""Stride of the grid [px]."""
_SHADOW: Final = 13
"""Greatest width of a shadow [steps]."""
_NEARER_M: Final = 0.05
"""Least decrease of depth of the foreground."""
_ABOUT_M: Final = 0.08
"""Margin around an arm, for clothes and errors of prediction and fit."""
