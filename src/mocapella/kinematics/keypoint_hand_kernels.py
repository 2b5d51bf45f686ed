"""Kernel that measures the size of a hand; importing it imports numba."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.geometry.alignment_kernels import rotation_of

Float64 = NDArray[np.float64]

CORNERS = 6
"""Number of the palm's corners: the wrist, and the digits' first joints, which are the landmarks 0, 1, 5, 9, 13, 17."""


@njit(cache=True, error_model="numpy")
def measure(points: Float64, corners: Float64, mirror: float, lengths: Float64, own: Float64) -> float:
    """Measure bones and palm of a hand; return the palm's root mean square distance from the present one [m].

    Args:
        points: (21, 3) landmarks, world [m]; the palm's corners are finite.
        corners: (`CORNERS`, 3) the palm's corners in the palm's frame of a right hand [m].
        mirror: −1 for a left hand, else 1.
        lengths: (5, 3) written: lengths of the bones [m]; NaN where an end is NaN.
        own: (`CORNERS`, 3) written: the measured corners, aligned to the palm's frame of a right hand [m].
    """
    mean, mean_own, S, R = np.zeros(3), np.zeros(3), np.zeros((3, 3)), np.empty((3, 3))
    for digit in range(5):
        for k in range(3):
            total = 0.0
            for c in range(3):
                total += (points[2 + 4 * digit + k, c] - points[1 + 4 * digit + k, c]) ** 2
            lengths[digit, k] = math.sqrt(total)
    for i in range(CORNERS):
        at = max(4 * i - 3, 0)
        for c in range(3):
            mean[c] += points[at, c] / CORNERS
            mean_own[c] += corners[i, c] / CORNERS
    for i in range(CORNERS):
        at = max(4 * i - 3, 0)
        for a in range(3):
            for b in range(3):
                side = mirror if b == 0 else 1.0
                S[a, b] += (points[at, a] - mean[a]) * side * (corners[i, b] - mean_own[b])
    rotation_of(S, R)
    away = 0.0
    for i in range(CORNERS):
        at = max(4 * i - 3, 0)
        for a in range(3):
            value = 0.0
            for b in range(3):
                value += R[a, b] * (points[at, b] - mean[b])
            own[i, a] = (mirror if a == 0 else 1.0) * value + mean_own[a]
            away += (own[i, a] - corners[i, a]) ** 2
    return math.sqrt(away / CORNERS)
