"""Wrapping and averaging of angles, for which π and −π are one direction."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]


def wrap(angle: Any) -> Float64:
    """Return angles of any shape, wrapped to [−π, π) [rad]; NaN stays NaN."""
    return np.asarray((np.asarray(angle, dtype=np.float64) + np.pi) % (2 * np.pi) - np.pi)


def circular_mean(angles: Any, axis: int = -1) -> Float64:
    """Return the circular mean: the direction of the sum of the unit vectors, valid across ±π.

    Args:
        angles: any shape [rad].
        axis: the axis to average over.

    Returns:
        (...) the shape of ``angles`` without ``axis``, within [−π, π] [rad]; NaN where an angle is NaN, 0 without
        angles, arbitrary where the unit vectors cancel.

    Source:
        Mardia and Jupp, *Directional Statistics*, section 2.2.1.
    """
    a = np.asarray(angles, dtype=np.float64)
    return np.asarray(np.arctan2(np.sin(a).sum(axis=axis), np.cos(a).sum(axis=axis)))
