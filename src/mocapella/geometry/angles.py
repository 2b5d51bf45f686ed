"""Angles, which wrap: π and −π are one direction."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]


def wrap(angle: Any) -> Float64:
    """The same directions within [−π, π), any shape."""
    return np.asarray((np.asarray(angle, dtype=np.float64) + np.pi) % (2 * np.pi) - np.pi)


def circular_mean(angles: Any, axis: int = -1) -> Float64:
    """The direction of the sum of the unit vectors: a mean that is right across ±π too.

    Args:
        angles: any shape [rad].
        axis: over which.

    Returns:
        ``angles``' shape without ``axis``, within [−π, π].

    Source:
        Mardia and Jupp, *Directional Statistics*, section 2.2.1.
    """
    a = np.asarray(angles, dtype=np.float64)
    return np.asarray(np.arctan2(np.sin(a).sum(axis=axis), np.cos(a).sum(axis=axis)))
