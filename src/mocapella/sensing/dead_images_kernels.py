"""What an image is like at every so manieth pixel; compiled. Importing this module imports numba."""

from __future__ import annotations

import math

import numpy as np

from mocapella.compiled import njit


@njit(cache=True)
def looked_at(image, every, dark, last):
    """How much of every so manieth row and column is brighter than ``dark``, how much its channels vary, and whether it
    is as it was.

    Args:
        image: (height, width, channels) uint8.
        last: (rows, columns, channels) what was seen before; becomes what is seen now.

    Returns:
        The share of values above ``dark``, the largest of the channels' standard deviations [grey levels], and whether
        nothing of ``last`` changed.
    """
    rows, columns, channels = last.shape
    bright, same = 0, True
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
