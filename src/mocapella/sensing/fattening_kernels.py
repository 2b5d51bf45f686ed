"""Kernels of `mocapella.sensing.fattening`; importing this module imports numba."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Float32 = NDArray[np.float32]


@njit(cache=True)
def bridge(depth: Float32, gap_px: int, jump_m: float, along_rows: bool, out: Float32) -> None:
    """Fill short gaps of a depth image, linearly, between measurements of one surface.

    Args:
        depth: (height, width) [m]; 0 where nothing was measured.
        gap_px: longest gap that is filled [px].
        jump_m: greatest difference of the depths beside a gap [m].
        along_rows: fill along rows, else along columns.
        out: (height, width) written where gaps are filled [m]; other elements do not change.
    """
    lines, length = depth.shape if along_rows else depth.shape[::-1]
    for line in range(lines):
        last = -1
        for i in range(length):
            z = depth[line, i] if along_rows else depth[i, line]
            if z <= 0.0:
                continue
            gap = i - last - 1
            if last >= 0 and 0 < gap <= gap_px:
                before = depth[line, last] if along_rows else depth[last, line]
                if abs(z - before) <= jump_m:
                    for k in range(1, gap + 1):
                        filled = before + (z - before) * np.float32(k / (gap + 1))
                        if along_rows:
                            out[line, last + k] = filled
                        else:
                            out[last + k, line] = filled
            last = i


@njit(cache=True)
def erode(depth: Float32, reach_px: int, jump_m: float, out: Float32) -> None:
    """Give pixels beside a surface that is farther by a jump the depth of that surface.

    Args:
        depth: (height, width) [m]; 0 where nothing was measured, which counts as farther than anything.
        reach_px: half the width of the square around a pixel where something farther counts [px].
        jump_m: least difference of depths that makes an edge [m].
        out: (height, width) written [m]; 0 where nothing was measured, or where the farther surface has none.
    """
    height, width = depth.shape
    far = np.empty((height, width), np.float32)
    nothing = np.float32(np.inf)
    for y in range(height):
        for x in range(width):
            most = np.float32(0.0)
            for k in range(max(x - reach_px, 0), min(x + reach_px + 1, width)):
                z = depth[y, k]
                most = max(most, z if z > 0.0 else nothing)
            far[y, x] = most
    for y in range(height):
        top, bottom = max(y - reach_px, 0), min(y + reach_px + 1, height)
        for x in range(width):
            z = depth[y, x]
            out[y, x] = z
            if z <= 0.0:
                continue
            most = far[top, x]
            for k in range(top + 1, bottom):
                most = max(most, far[k, x])
            if most > z + jump_m:
                out[y, x] = most if most < nothing else 0.0
