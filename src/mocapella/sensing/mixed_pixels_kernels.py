"""Kernel that finds mixed pixels in depth images. Importing this module imports numba."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Float32 = NDArray[np.float32]


@njit(cache=True, error_model="numpy")
def remove_mixed(depth: Float32, jump: float, reach: int, far: float, out: Float32) -> int:
    """Write a depth image without its mixed pixels; return their number. See `mixed_pixels.without_mixed_pixels`.

    Args:
        depth: (height, width) [m]; 0 where nothing was measured.
        jump: least difference of a mixed pixel's depth from both surfaces, as a share of its depth [ratio].
        reach: distance of the compared pixels on both sides [px].
        far: pixels that are not nearer are kept [m].
        out: (height, width) written; another array than ``depth``.
    """
    height, width = depth.shape
    count = 0
    for i in range(height):
        for j in range(width):
            out[i, j] = depth[i, j]
    for i in range(reach, height - reach):
        for j in range(reach, width - reach):
            z = depth[i, j]
            if not 0.0 < z < far:
                continue
            t = jump * z
            # Inside a surface, which most pixels are, no neighbour is another surface's.
            beside = max(abs(depth[i, j + reach] - z), abs(depth[i, j - reach] - z))
            if max(beside, abs(depth[i - reach, j] - z), abs(depth[i + reach, j] - z)) <= t:
                continue
            for way in range(4):
                di = 0 if way == 0 else reach
                dj = reach if way == 0 else (way - 2) * reach
                a, b = depth[i - di, j - dj], depth[i + di, j + dj]
                if a > 0.0 and b > 0.0 and min(a, b) < z - t and max(a, b) > z + t:
                    out[i, j] = 0.0
                    count += 1
                    break
    return count
