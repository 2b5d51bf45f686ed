"""How far samples are from an outline, and on which side of it."""

from __future__ import annotations

from functools import cache
from types import ModuleType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.settings import check

MOST_REACH: Final = 255
"""[samples]"""


def signed_distance(inside: NDArray[Any], reach_px: float, step_px: int = 1) -> NDArray[np.float32]:
    """Compute the signed distance of every sample to a region's outline; positive inside.

    Args:
        inside: (rows, columns) bool or uint8, a mask, whose outline passes midway between two samples that differ;
            or floating-point numbers, whose outline is where they cross 0, linearly between samples: what a sample's
            square is covered by, less a half, gives the outline of a rasterised mesh between the samples.
        reach_px: farther away, the distance is cut off at the reach, a whole number of steps [px].
        step_px: between samples.

    Returns:
        (rows, columns) float32 [px], at least to the outline's crossings with the sample's rows and columns exact.

    Raises:
        SettingsError: another shape, or the reach is not of 1 to 255 steps.
    """
    if inside.ndim != 2 or not inside.size:
        raise SettingsError(f"inside is of shape {inside.shape}; it must be (rows, columns) with at least one sample")
    check(step_px >= 1, "step_px", step_px, "1 or more")
    reach = int(np.ceil(reach_px / step_px)) if np.isfinite(reach_px) else 0
    check(1 <= reach <= MOST_REACH, "reach_px", reach_px, f"above 0 and up to {MOST_REACH} steps")
    out = np.empty(inside.shape, dtype=np.float32)
    if inside.dtype.kind in "bu":
        mask = np.ascontiguousarray(inside if inside.dtype == np.uint8 else inside != 0).view(np.uint8)
        kernels().of_mask(mask, reach, np.float32(step_px), out)
    else:
        kernels().signed_distance(np.ascontiguousarray(inside, dtype=np.float32), reach, np.float32(step_px), out)
    return out


@cache
def kernels() -> ModuleType:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.geometry import signed_distance_kernels

    return signed_distance_kernels
