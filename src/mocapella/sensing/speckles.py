"""Remove single wrong pixels from images that have many, such as after bad transmission.

    image = without_speckles(image)

A wrong pixel inside a person tells nothing about the contour, but counts as much as a right one. The median of 3 × 3
pixels ignores it (J. Tukey, Exploratory Data Analysis, 1977). It also rounds fine corners, so an image without speckles
is returned unchanged.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import InputError

UInt8 = NDArray[np.uint8]

LEVELS = 30
"""A value that differs more than this from the median of its neighbours is wrong [grey levels]."""
EVERY = 40
"""Stride between the rows that are tested."""
FEWEST, MOST = 0.02, 0.6
"""Least and greatest share of wrong values in an image that is filtered; above, it is mere noise."""


def without_speckles(image: UInt8) -> UInt8:
    """Return the image, filtered by a 3 × 3 median if many single pixels are wrong: a copy then, else the array itself.

    Args:
        image: (height, width) or (height, width, channels) uint8, not modified.

    Raises:
        InputError: it is of another type or shape.
    """
    if image.dtype != np.uint8 or image.ndim not in {2, 3}:
        raise InputError(
            "no image", field="dtype, shape", value=(str(image.dtype), image.shape),
            fix="give uint8 of (height, width) or (height, width, channels)",
        )  # fmt: skip
    planes = np.ascontiguousarray(image).reshape(*image.shape[:2], -1)
    if not FEWEST <= _kernels().standing_out(planes, EVERY, LEVELS) <= MOST:
        return image
    out = np.empty_like(planes)
    _kernels().median_of_nine(planes, out)
    return out.reshape(image.shape)


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.sensing import speckles_kernels

    return speckles_kernels
