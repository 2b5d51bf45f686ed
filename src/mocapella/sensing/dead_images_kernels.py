"""Brightness, contrast and change of an image on a subsampled grid; compiled. Importing this module imports numba."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit


@njit(cache=True)
def sampled(image: NDArray[np.uint8], every: int, dark: int, last: NDArray[np.uint8]) -> tuple[float, float, bool]:
    """Measure brightness, contrast and change of an image on a subsampled grid.

    Args:
        image: (height, width, channels) uint8.
        every: stride between the rows and columns that are measured [px].
        dark: values up to this count as dark [grey levels].
        last: (rows, columns, channels) the samples of the previous image; overwritten with this one's.

    Returns:
        The share of values above ``dark``, the largest of the channels' standard deviations [grey levels], and whether
        all samples equal ``last``.
    """
    rows, columns, channels = last.shape
    bright, same = np.int64(0), True
    sums, squares = np.zeros(channels, np.int64), np.zeros(channels, np.int64)
    for i in range(rows):
        for j in range(columns):
            for c in range(channels):
                value = np.int64(image[i * every, j * every, c])
                bright += value > dark
                same &= value == last[i, j, c]
                last[i, j, c] = value
                sums[c] += value
                squares[c] += value * value
    n, most = rows * columns, 0.0
    for c in range(channels):
        most = max(most, (squares[c] - sums[c] * sums[c] / n) / n)
    return bright / (n * channels), math.sqrt(most), same
