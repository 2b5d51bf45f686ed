"""Remove mixed pixels, whose depth is between the depths of two surfaces that both are seen in the pixel.

Cameras with time of flight have them along edges, because the light of both surfaces adds up (S. Foix, G. Alenyà,
C. Torras, "Lock-in time-of-flight (ToF) cameras: a survey", IEEE Sensors J. 11, 2011, section III: flying pixels), and
so have depth images that were made larger by interpolation.
"""

from __future__ import annotations

from functools import cache
from types import ModuleType
from typing import Final

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]


def without_mixed_pixels(depth: Float32, *, jump: float, far_m: float) -> Float32:
    """Return a depth image without mixed pixels, a new array; itself if it has fewer than a share of `FEW`.

    A pixel is mixed if, of two opposite pixels `REACH_PX` away, one is nearer and the other one farther by the jump or
    more. Both must be measured, so that an edge before nothing keeps its pixels, as does the image's border. Of pixels
    that are opposite along a diagonal, it must also differ from one above, below or beside it.

    Args:
        depth: (height, width) C-contiguous [m]; 0 where nothing was measured.
        jump: least difference in depth, as a share of the pixel's depth; larger: fewer pixels are mixed [ratio].
        far_m: pixels that are not nearer are kept, which saves time [m].
    """
    out = np.empty_like(depth)
    count = _kernels().remove_mixed(depth, jump, REACH_PX, far_m, out)
    return out if count >= FEW * depth.size else depth


FEW: Final = 0.0003
"""Least share of mixed pixels of an image: structured light has fewer, in the rendered scenes."""
REACH_PX: Final = 2
"""Distance of the compared pixels: an image that was made twice as large has mixed pixels two wide [px]."""


@cache
def _kernels() -> ModuleType:
    """Import the kernel, and numba, on first use."""
    from mocapella.sensing import mixed_pixels_kernels

    return mixed_pixels_kernels
