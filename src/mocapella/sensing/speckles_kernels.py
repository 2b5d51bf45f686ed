"""Pixels that differ from their neighbours, and 3 × 3 medians; compiled.

Importing this module imports numba.
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

UInt8 = NDArray[np.uint8]


@njit(cache=True)
def _sorted_columns(above: UInt8, here: UInt8, below: UInt8, low: UInt8, mid: UInt8, high: UInt8) -> None:
    for x in range(len(low)):
        a, b, c = above[x], here[x], below[x]
        less, more = a if a < b else b, b if a < b else a
        other = more if more < c else c
        high[x] = c if more < c else more
        low[x] = less if less < other else other
        mid[x] = other if less < other else less


@njit(cache=True)
def _median(
    l1: UInt8, l2: UInt8, l3: UInt8, m1: UInt8, m2: UInt8, m3: UInt8, h1: UInt8, h2: UInt8, h3: UInt8, out: UInt8
) -> None:
    for x in range(len(out)):
        a, b, c = l1[x], l2[x], l3[x]
        low = b if a < b else a
        low = c if low < c else low
        a, b, c = h1[x], h2[x], h3[x]
        high = a if a < b else b
        high = high if high < c else c
        a, b, c = m1[x], m2[x], m3[x]
        less, more = a if a < b else b, b if a < b else a
        other = more if more < c else c
        mid = other if less < other else less
        less, more = low if low < mid else mid, mid if low < mid else low
        other = more if more < high else high
        out[x] = other if less < other else less


@njit(cache=True)
def _row_of_medians(
    above: UInt8, here: UInt8, below: UInt8, c: int, low: UInt8, mid: UInt8, high: UInt8, out: UInt8
) -> None:
    """Write the medians of a row of pixels of ``c`` channels, except its ends; low, mid and high are scratch."""
    _sorted_columns(above, here, below, low, mid, high)
    _median(
        low[: -2 * c], low[c:-c], low[2 * c :], mid[: -2 * c], mid[c:-c], mid[2 * c :],
        high[: -2 * c], high[c:-c], high[2 * c :], out[c:-c],
    )  # fmt: skip


@njit(cache=True)
def median_of_nine(image: UInt8, out: UInt8) -> None:
    """Write the median of each pixel's 3 × 3 neighbourhood, by channel; at the border the pixel itself.

    Columns of three are sorted first: the median of nine is the median of the largest of the lowest, the median of the
    middle and the smallest of the highest ones (A. Paeth, "Median finding on a 3 × 3 grid", Graphics Gems, 1990). Rows
    are whole arrays, so that many pixels are compared at once.

    Args:
        image: (height, width, channels) uint8.
        out: (height, width, channels) uint8, written.
    """
    height, n, c = image.shape[0], image.shape[1] * image.shape[2], image.shape[2]
    rows, written = image.reshape(height, n), out.reshape(height, n)
    for y in range(height):
        for x in range(n):
            written[y, x] = rows[y, x]
    if image.shape[1] < 3:
        return
    low, mid, high = np.empty(n, np.uint8), np.empty(n, np.uint8), np.empty(n, np.uint8)
    for y in range(1, height - 1):
        _row_of_medians(rows[y - 1], rows[y], rows[y + 1], c, low, mid, high, written[y])


@njit(cache=True)
def standing_out(image: UInt8, every: int, levels: int) -> float:
    """Return the share of values, 0 to 1, that differ much from the median of their 3 × 3 neighbourhood.

    Args:
        image: (height, width, channels) uint8.
        every: stride between the rows that are measured.
        levels: difference above which a value counts [grey levels].
    """
    height, n, c = image.shape[0], image.shape[1] * image.shape[2], image.shape[2]
    rows, medians = image.reshape(height, n), np.empty(n, np.uint8)
    low, mid, high = np.empty(n, np.uint8), np.empty(n, np.uint8), np.empty(n, np.uint8)
    out = asked = 0
    for y in range(1, height - 1, every):
        if image.shape[1] > 2:
            _row_of_medians(rows[y - 1], rows[y], rows[y + 1], c, low, mid, high, medians)
            out += _apart(rows[y, c:-c], medians[c:-c], levels)
        asked += n
    return out / asked if asked else 0.0


@njit(cache=True)
def _apart(values: UInt8, medians: UInt8, levels: int) -> np.int64:
    count = np.int64(0)
    for x in range(len(values)):
        a, b = np.int32(values[x]), np.int32(medians[x])
        count += np.int64(a - b > levels) + np.int64(b - a > levels)
    return count
