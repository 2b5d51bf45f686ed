"""Undo what the matching of blocks does to a depth image: wider things, and small holes.

    depth = without_fattening(depth, 3)

A stereo camera gives a block of pixels one depth. A block at an edge gets that of the nearer side, so things are wider
by up to half a block ("foreground fattening": D. Scharstein, R. Szeliski, "A taxonomy and evaluation of dense two-frame
stereo correspondence algorithms", IJCV 47, 2002, section 3.2), and blocks without a match leave holes in a surface.
"""

from __future__ import annotations

from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]

JUMP_M: Final = 0.02
"""Difference of depths that makes an edge [m]."""


def without_fattening(depth: Float32, px: int) -> Float32:
    """Return a depth image with narrower near things, and small holes filled; a new array unless px is 0.

    Holes up to 2 px + 3 wide are filled between measurements of one surface, along rows, then along columns.

    Args:
        depth: (height, width) [m]; 0 where nothing was measured. It is not changed.
        px: by how much things are wider than they are, on each side [px].
    """
    if px <= 0:
        return depth
    filled = depth.copy()
    for along_rows in (True, False):
        _kernels().bridge(depth, 2 * px + 3, JUMP_M, along_rows, filled)
    out = np.empty_like(filled)
    _kernels().erode(filled, px, JUMP_M, out)
    return out


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.sensing import fattening_kernels

    return fattening_kernels
