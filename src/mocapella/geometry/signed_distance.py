"""Signed distance of samples to an outline.

A distance transform with sub-sample accuracy; the method is in `signed_distance_kernels`.
"""

from __future__ import annotations

from functools import cache
from types import ModuleType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.settings import check

MOST_REACH: Final = 255
"""Largest reach of `signed_distance` [samples]."""


def signed_distance(inside: NDArray[Any], reach_px: float, step_px: int = 1) -> NDArray[np.float32]:
    """Compute the signed distance of every sample to a region's outline; positive inside.

    Args:
        inside: (rows, columns). A bool or uint8 mask has its outline midway between two samples that differ. Floating-
            point numbers have it where they cross 0, interpolated linearly between samples: for example, the covered
            fraction of each sample's square minus 0.5 gives the sub-sample outline of a rasterised mesh.
        reach_px: distances are clipped to ± this, rounded up to a whole number of steps [px].
        step_px: distance between samples [px].

    Returns:
        (rows, columns) float32 [px], a new array; exact to the outline's crossings with the sample's own row and
        column. Without an outline, all samples have plus or minus the reach.

    Raises:
        SettingsError: ``inside`` is empty or not two-dimensional, or the reach is not 1 to 255 steps.
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
    """Return the module of compiled kernels, importing it, and with it numba, on the first call."""
    from mocapella.geometry import signed_distance_kernels

    return signed_distance_kernels
