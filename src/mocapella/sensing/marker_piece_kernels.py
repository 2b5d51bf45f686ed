"""Connected pieces of colour labels in an image, and their moments; compiled. Importing this module imports numba.

Pieces are found by runs: neighbouring pixels of a row with one label are a run, runs of one label that touch (also at
corners) in neighbouring rows are joined by union-find, and a piece's moments are sums over its runs in closed form
(run-based two-scan labelling: L. He, Y. Chao, K. Suzuki, A Run-Based Two-Scan Labeling Algorithm, IEEE Transactions on
Image Processing 17, 2008, sections II and III).
"""

# ruff: noqa: PLR0912, PLR0915, PLR0917, PLR1714 - compiled: arrays come by position, and loops are written out
from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
UInt8 = NDArray[np.uint8]
UInt16 = NDArray[np.uint16]

LABEL, SIZE, SX, SY, SXX, SXY, SYY, X0, Y0, X1, Y1 = range(11)
"""Columns of a piece: label, number of pixels, sums of x, y, xx, xy and yy over them, and bounds (inclusive) [px].

Sums are of coordinates from an origin (x0, y0), which is the same for all pieces of a search.
"""
PIECE = 11
_2, _3, _7, _248 = np.uint16(2), np.uint16(3), np.uint16(7), np.uint16(248)


class PieceBuffers(NamedTuple):
    """Arrays that `pieces` writes to.

    Attributes:
        cells: (w,) uint16 of one row of the image: indices in the look-up table of colours.
        labels: uint8 labels of one row of the image; its length is a multiple of 8, at least w + 8.
        runs: (capacity, 4) int64 row, begin, end and label of each run.
        parent: (capacity,) int64 parents of the runs in the union-find forest.
        found: (capacity, 11) float64 the pieces: label, number of pixels, sums of x, y [px], xx, xy and yy [px²] over
            the pixels, and bounds x0, y0, x1, y1, inclusive [px].
    """

    cells: UInt16
    labels: UInt8
    runs: Int64
    parent: Int64
    found: Float64


@njit(cache=True)
def _root(parent: Int64, i: int) -> int:
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True, error_model="numpy")
def pieces(image: UInt8, table: UInt8, x0: int, y0: int, x1: int, y1: int, only: int, buffers: PieceBuffers) -> int:
    """Find the connected pieces of every colour label in image[y0:y1, x0:x1]; return their number.

    Args:
        image: (h, w, 3) uint8.
        table: (32768,) uint8 label of a colour cell, 0 for none.
        x0, y0, x1, y1: the part of the image that is searched [px].
        only: the one label that is searched, or 0 for all.
        buffers: written; the first rows of ``found`` are the pieces, with sums from (x0, y0).

    Returns:
        The number; or −1 − number if there are more runs than capacity, and the rest of the image was not searched.
    """
    index, labels, runs, parent, found = buffers
    width, count, full, stride, flat = x1 - x0, 0, False, image.shape[1], image.reshape(-1)
    words = labels.view(np.uint64)
    before, before_end = 0, 0
    for y in range(y0, y1):
        line = flat[3 * (y * stride + x0) : 3 * (y * stride + x1)]
        for i in range(width):  # apart from the look-up and in 16 bits, so that the compiler vectorises it
            b, g, r = np.uint16(line[3 * i]), np.uint16(line[3 * i + 1]), np.uint16(line[3 * i + 2])
            index[i] = (b >> _3) | ((g & _248) << _2) | ((r & _248) << _7)
        for i in range(width):
            labels[i] = table[index[i]]
        blocks = (width + 7) >> 3
        for i in range(width, 8 * blocks):
            labels[i] = 0
        begin = count
        at, label = 0, np.uint8(0)
        for block in range(blocks):
            if words[block] == np.uint64(0) and label == 0:
                continue
            for i in range(8 * block, 8 * block + 8):
                now = labels[i]
                if now == label:
                    continue
                if label != 0 and (only == 0 or label == only):
                    if count == len(runs):
                        full = True
                        break
                    runs[count, 0], runs[count, 1], runs[count, 2], runs[count, 3] = y, x0 + at, x0 + i, label
                    parent[count] = count
                    count += 1
                label, at = now, i
        if label != 0 and (only == 0 or label == only) and count < len(runs):
            runs[count, 0], runs[count, 1], runs[count, 2], runs[count, 3] = y, x0 + at, x1, label
            parent[count] = count
            count += 1
        above = before
        for i in range(begin, count):  # both rows from left to right
            while above < before_end and runs[above, 2] < runs[i, 1]:
                above += 1
            other = above
            while other < before_end and runs[other, 1] <= runs[i, 2]:
                if runs[other, 3] == runs[i, 3]:
                    a, b = _root(parent, other), _root(parent, i)
                    if a != b:
                        parent[max(a, b)] = min(a, b)
                other += 1
        before, before_end = begin, count
        if full:
            break
    number = 0
    for i in range(count):
        root = _root(parent, i)
        if root == i:
            p = number
            number += 1
            runs[i, 3] = -1 - p  # from here on: the number of the piece
            for k in range(1, 7):
                found[p, k] = 0.0
            found[p, X0], found[p, Y0], found[p, X1], found[p, Y1] = 1e9, 1e9, -1.0, -1.0
            found[p, LABEL] = table_label(image, table, runs[i, 0], runs[i, 1])
        else:
            p = -1 - runs[root, 3]
        add_run(found[p], float(runs[i, 1] - x0), float(runs[i, 2] - x0), float(runs[i, 0] - y0))
        found[p, X0] = min(found[p, X0], float(runs[i, 1]))
        found[p, X1] = max(found[p, X1], float(runs[i, 2] - 1))
        found[p, Y0] = min(found[p, Y0], float(runs[i, 0]))
        found[p, Y1] = max(found[p, Y1], float(runs[i, 0]))
    return -1 - number if full else number


@njit(cache=True)
def table_label(image: UInt8, table: UInt8, y: int, x: int) -> int:
    """Return the label of a pixel's colour; 0 for none.

    Args:
        image: (h, w, 3) uint8.
        table: (32768,) of `pieces`.
        y, x: row and column of the pixel.
    """
    b, g, r = image[y, x, 0], image[y, x, 1], image[y, x, 2]
    label: int = table[(b >> 3) | ((g & 248) << 2) | ((r & 248) << 7)]
    return label


@njit(cache=True, error_model="numpy")
def shape_of(piece: Float64, shape: Float64) -> None:
    """Write centre, variances, elongation and fill of a piece.

    Fill is the area divided by that of the ellipse with the same moments: 1 for a solid ellipse, 0.95 for a rectangle,
    less for a piece with holes or arms.

    Args:
        piece: (11,) a row of `PieceBuffers.found`.
        shape: (7,) written: x and y of the centre from the origin of the piece's sums [px], variances xx, xy, yy,
            including 1/12 for a pixel's own extent [px²], elongation and fill.
    """
    n = piece[SIZE]
    x, y = piece[SX] / n, piece[SY] / n
    xx, xy, yy = piece[SXX] / n - x * x + 1 / 12, piece[SXY] / n - x * y, piece[SYY] / n - y * y + 1 / 12
    middle, apart = 0.5 * (xx + yy), math.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    small = max(middle - apart, 1 / 12)
    shape[0], shape[1], shape[2], shape[3], shape[4] = x, y, xx, xy, yy
    shape[5] = math.sqrt((middle + apart) / small)
    shape[6] = n / (4.0 * math.pi * math.sqrt(max((middle + apart) * small, 1e-12)))


@njit(cache=True, error_model="numpy")
def fill(image: UInt8, table: UInt8, label: int, mine: Float64, x0: int, y0: int) -> None:
    """Fill a piece's holes and notches, made by reflections: replace its moments by the moments of the filled piece.

    All pixels between two of its pixels in a row or a column are filled.

    Args:
        image, table: (h, w, 3) uint8 and (32768,) uint8 labels of colour cells, as in `pieces`.
        label: the piece's label.
        mine: (11,) the piece, with sums from (x0, y0), in and out.
        x0, y0: origin of its sums [px].
    """
    left, top = int(mine[X0]), int(mine[Y0])
    w, h = int(mine[X1]) - left + 1, int(mine[Y1]) - top + 1
    high, low = np.full(w, h), np.full(w, -1)
    for x in range(w):  # from both ends, so that the inside is not read
        for y in range(h):
            if table_label(image, table, top + y, left + x) == label:
                high[x] = y
                break
        for y in range(h - 1, high[x] - 1, -1):
            if table_label(image, table, top + y, left + x) == label:
                low[x] = y
                break
    mine[SIZE : SYY + 1] = 0.0
    for y in range(h):
        begin, end = w, w - 1
        for x in range(w):
            if high[x] <= y <= low[x]:
                if table_label(image, table, top + y, left + x) == label:
                    begin = x
                    break
                add(mine, float(left + x - x0), float(top + y - y0))  # between others above and below
        for x in range(w - 1, begin, -1):
            if high[x] <= y <= low[x]:
                if table_label(image, table, top + y, left + x) == label:
                    end = x
                    break
                add(mine, float(left + x - x0), float(top + y - y0))
            end = x - 1
        if begin < w:
            add_run(mine, float(left + begin - x0), float(left + max(end, begin) + 1 - x0), float(top + y - y0))


@njit(cache=True)
def add(mine: Float64, x: float, y: float) -> None:
    """Add the pixel (x, y), relative to the origin of the sums [px], to the sums of a piece mine (11,)."""
    mine[SIZE] += 1.0
    mine[SX] += x
    mine[SY] += y
    mine[SXX] += x * x
    mine[SXY] += x * y
    mine[SYY] += y * y


@njit(cache=True)
def add_run(mine: Float64, left: float, right: float, row: float) -> None:
    """Add a row's pixels from ``left`` to before ``right`` to a piece, relative to the origin of its sums [px].

    Args:
        mine: (11,) the piece; its sums are updated, its bounds are not.
        left, right, row: columns and row [px].
    """
    n = right - left
    sx = 0.5 * n * (left + right - 1.0)
    mine[SIZE] += n
    mine[SX] += sx
    mine[SY] += n * row
    mine[SXX] += ((right - 1.0) * right * (2.0 * right - 1.0) - (left - 1.0) * left * (2.0 * left - 1.0)) / 6.0
    mine[SXY] += sx * row
    mine[SYY] += n * row * row
