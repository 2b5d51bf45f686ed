"""Measure the texture of a depth image: what remains of surfaces after a smooth surface is subtracted.

    texture(depth, far_m=1.5)

It depends on how a camera measures. A stereo camera rounds its disparity, and all pixels of a block share an error
(L. Keselman et al., "Intel RealSense stereoscopic depth cameras", CVPR workshops 2017, sections 3 and 5). So its
surfaces are not smoother than the rounding, and neighbouring pixels have like errors. Coded light is much smoother;
errors of single pixels are independent in time of flight.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]


class Texture(NamedTuple):
    """What remains of the surfaces of a depth image in squares of 7 × 7 px, after their best quadratic is subtracted.

    Attributes:
        rough_m: standard deviation, without what the image's unit of depth explains by rounding [m].
        rough_per_m: the same of the inverse depth [1/m]: a stereo camera's is independent of the distance.
        alike: correlation of pixels side by side; -0.1 if their errors are independent, because of the subtraction.
    """

    rough_m: float
    rough_per_m: float
    alike: float


def texture(depth: Float32, *, far_m: float) -> Texture | None:
    """Measure the texture of a depth image's surfaces, the median of squares; None with fewer than `LEAST` squares.

    Args:
        depth: (height, width) [m]; 0 where nothing was measured.
        far_m: surfaces that are not nearer are left out [m].
    """
    if min(depth.shape) < SQUARE_PX:
        return None
    squares = np.lib.stride_tricks.sliding_window_view(depth, (SQUARE_PX, SQUARE_PX))[::_EVERY_PX, ::_EVERY_PX]
    squares = squares.reshape(-1, SQUARE_PX**2)
    near, far = squares.min(axis=1), squares.max(axis=1)
    whole = squares[(near > 0) & (far < far_m) & (far - near < _JUMP_M)].astype(np.float64)
    if len(whole) < LEAST:
        return None
    left = (whole @ _without_quadratic()).reshape(-1, SQUARE_PX, SQUARE_PX)
    squared = (left**2).sum(axis=(1, 2))
    beside = (left[:, :, 1:] * left[:, :, :-1]).mean(axis=(1, 2))
    alike = beside / np.maximum(squared / SQUARE_PX**2, _LEAST_M2)
    # Rounding to a unit has a variance of a twelfth of its square.
    variance = float(np.median(squared)) / (SQUARE_PX**2 - _TERMS) - _unit_m(whole) ** 2 / 12
    rough_m = math.sqrt(max(variance, 0.0))
    return Texture(rough_m, rough_m / float(np.median(whole)) ** 2, float(np.median(alike)))


def _unit_m(depths: Float64) -> float:
    """Return the least difference of depths that differ [m]; 0 if none do."""
    apart = np.diff(np.unique(depths))
    return float(apart[apart > _LEAST_UNIT_M].min(initial=np.inf)) if (apart > _LEAST_UNIT_M).any() else 0.0


@cache
def _without_quadratic() -> Float64:
    """Return the projection (49, 49) of a square's values onto what no quadratic explains."""
    y, x = (part.ravel() for part in np.indices((SQUARE_PX, SQUARE_PX)) - SQUARE_PX // 2)
    terms = np.stack([np.ones(SQUARE_PX**2), x, y, x * x, x * y, y * y], axis=1)
    return np.asarray(np.eye(SQUARE_PX**2) - terms @ np.linalg.pinv(terms))


SQUARE_PX: Final = 7
LEAST: Final = 40
"""Least number of squares."""
_EVERY_PX: Final = 5
_TERMS: Final = 6
_JUMP_M: Final = 0.02
_LEAST_M2: Final = 1e-16
_LEAST_UNIT_M: Final = 1e-6
"""Difference of equal depths after the rounding of 32 bit numbers [m]."""
