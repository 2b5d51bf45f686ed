"""Convert the 11-bit raw disparities of a Kinect v1 to depth.

The conversion is the OpenKinect community's linear fit of the inverse depth,
1/Z = −0.0030711016·raw + 3.3309495161. It has a pole between 1084 and 1085: at 1084 it gives 533 m and beyond it depths
behind the camera, so that a depth counts only where the denominator is above 0 and the depth within the sensor's range.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
UInt16 = NDArray[np.uint16]

SLOPE_PER_M: Final = -0.0030711016
OFFSET_PER_M: Final = 3.3309495161
NOTHING: Final = 2047
"""Raw disparity that the sensor sends where it measured nothing."""
NEAREST_M: Final = 0.4
FARTHEST_M: Final = 8.0
"""Largest depth that Microsoft's own interface delivers [m]; `NEAREST_M` is the smallest, that of its near mode."""
UNIT_M: Final = 0.000125
"""Unit of the depths of `kinect_units` [m]; 8 m are 64000."""


def kinect_metres(raw: Any, nearest_m: float = NEAREST_M, farthest_m: float = FARTHEST_M) -> Float32:
    """Convert a Kinect's raw disparities to depths.

    Args:
        raw: (...) integers; 2047 (`NOTHING`), values above it and negative ones are invalid.
        nearest_m, farthest_m: range of valid depths, both ends included [m].

    Returns:
        (...) float32 depth [m]; 0 where invalid.
    """
    # The line falls to 0 between 1084 and 1085: from there on, `NOTHING` included, the depth is 0.
    disparity = np.asarray(raw, dtype=np.float64)
    denominator = SLOPE_PER_M * disparity + OFFSET_PER_M
    depth = 1.0 / np.where(denominator > 0, denominator, np.inf)
    there = (disparity >= 0) & (depth >= nearest_m) & (depth <= farthest_m)
    return np.where(there, depth, 0.0).astype(np.float32)


_UNITS: Final = np.rint(kinect_metres(np.arange(NOTHING + 1)).astype(np.float64) / UNIT_M).astype(np.uint16)


def kinect_units(raw: UInt16) -> UInt16:
    """Convert raw disparities (...) uint16 to depths (...) uint16 in units of `UNIT_M` (0.125 mm), by a table.

    A depth is 0 where it is invalid or not within `NEAREST_M` to `FARTHEST_M`, as in `kinect_metres`.
    """
    return np.asarray(_UNITS[np.minimum(raw, NOTHING)])
