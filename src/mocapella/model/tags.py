"""What a square tag is to everybody else: four corners with names, and where they are on it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]


def corner_names(number: int) -> tuple[str, str, str, str]:
    """Of a tag's corners, clockwise from the upper left one of the upright tag: ``tag7.0`` to ``tag7.3``."""
    first, second, third, fourth = (f"tag{number}.{k}" for k in range(4))
    return first, second, third, fourth


def corner_places(side_m: float) -> Float64:
    """(4, 3) the corners in the tag's own frame [m]: its middle, x to the right, y up, z out of it to whoever reads it.

    Args:
        side_m: of the tag's dark square.
    """
    h = 0.5 * side_m
    return np.array([[-h, h, 0.0], [h, h, 0.0], [h, -h, 0.0], [-h, -h, 0.0]])
