"""Square tags: names and positions of their four corners."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]


def corner_names(number: int) -> tuple[str, str, str, str]:
    """Return the names of a tag's corners, clockwise from the upper left if upright: ``tag7.0`` to ``tag7.3``."""
    first, second, third, fourth = (f"tag{number}.{k}" for k in range(4))
    return first, second, third, fourth


def corner_places(side_m: float) -> Float64:
    """Return the corners (4, 3) in the tag's frame [m], in the order of `corner_names`: clockwise from the upper left.

    The frame's origin is the tag's centre, x points right, y up, z towards the viewer.

    Args:
        side_m: side of the tag's dark square [m].
    """
    h = 0.5 * side_m
    return np.array([[-h, h, 0.0], [h, h, 0.0], [h, -h, 0.0], [-h, -h, 0.0]])
