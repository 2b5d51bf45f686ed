"""Images with single wrong pixels, as of bad transmission: these are taken out, where there are many.

    image = without_speckles(image)

A pixel among others that are all of a person says nothing of where the person ends, but it counts as much as they do.
The median of 3 × 3 pixels does not see it (J. Tukey, Exploratory Data Analysis, 1977). It also rounds fine corners off,
so an image without speckles stays as it is.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import InputError

UInt8 = NDArray[np.uint8]

LEVELS = 30
"""A value that is so far from the median of its neighbours is wrong [grey levels] …"""
EVERY = 40
"""… and asked is every so manieth row."""
FEWEST, MOST = 0.02, 0.6
"""Where less than this share of them is wrong, the image is let be; where more is, it is none."""


def without_speckles(image: UInt8) -> UInt8:
    """The image, or the medians of its pixels' 3 × 3, where many single pixels are wrong.

    Args:
        image: (height, width) or (height, width, channels).

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
    """Compiled; numba is imported when it is first needed."""
    from mocapella.sensing import speckles_kernels

    return speckles_kernels
