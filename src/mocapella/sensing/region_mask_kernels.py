"""Blurred masks and blocks of samples for `region_contour_kernels`; compiled. Importing this module imports numba.

A window of an image is padded to whole blocks, each of ``size`` consecutive samples of a row. The band is the samples
that may change sides. Blocks that it touches are stored one after another, and copied as words of 8 bytes.
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Float32 = NDArray[np.float32]
Int32 = NDArray[np.int32]
UInt8 = NDArray[np.uint8]
UInt16 = NDArray[np.uint16]
UInt64 = NDArray[np.uint64]

DENSITY_CHANGED, SIDE_CHANGED = np.uint8(1), np.uint8(2)
"""Why a block must be evaluated again: its densities changed, or a sample in or near it changed sides."""
_0F, _0B = np.float32(0.0), np.uint8(0)


@njit(cache=True, error_model="numpy")
def blur(inside: UInt8, out: UInt16) -> None:
    """Write a binomial mean over 5 × 5 samples of a mask [1/256]; 0 beyond the window.

    Args:
        inside: (rows, columns) uint8, 0 or 1.
        out: (rows, columns) uint16, written.
    """
    rows, columns = inside.shape
    line, down = np.zeros(columns + 4, np.uint8), np.zeros((rows + 4, columns), np.uint8)
    a, b, c, d, e = line[:columns], line[1:], line[2:], line[3:], line[4:]
    for i in range(rows):
        for j in range(columns):
            c[j] = inside[i, j]
        for j in range(columns):
            down[i + 2, j] = np.uint8(np.uint8(a[j] + e[j]) + np.uint8(np.uint8(b[j] + d[j]) << 2) + np.uint8(c[j] * 6))
    for i in range(rows):
        for j in range(columns):
            outer = np.uint16(down[i, j]) + np.uint16(down[i + 4, j])
            inner = np.uint16(down[i + 1, j]) + np.uint16(down[i + 3, j])
            out[i, j] = np.uint16(outer + (inner << 2) + np.uint16(down[i + 2, j]) * 6)


@njit(cache=True, error_model="numpy")
def flip(inside: UInt8, i: int, j: int, size: int, blurred: UInt16, block_at: Int32, dirty: UInt8) -> None:
    """Move sample (i, j) to the other side; update the blurred mask and mark the blocks near it.

    Args:
        inside: (rows, columns) uint8 the mask, updated.
        i, j: row and column of the sample.
        size: number of samples of a block.
        blurred: (rows, columns) of `blur`, updated.
        block_at: (rows, blocks of a row) int32 index of each block in the list of blocks, -1 for none.
        dirty: (blocks,) updated: `SIDE_CHANGED` for the blocks near the sample.
    """
    rows, columns = inside.shape
    now = 1 - np.int64(inside[i, j])
    inside[i, j] = now
    sign = 2 * now - 1
    for a in range(max(i - 2, 0), min(i + 3, rows)):
        down = 6 if a == i else 4 if abs(a - i) == 1 else 1
        for b in range(max(j - 2, 0), min(j + 3, columns)):
            across = 6 if b == j else 4 if abs(b - j) == 1 else 1
            blurred[a, b] = np.int64(blurred[a, b]) + sign * down * across
        for k in range(max(j - 2, 0) // size, (min(j + 2, columns - 1)) // size + 1):
            if block_at[a, k] >= 0:
                dirty[block_at[a, k]] = SIDE_CHANGED


@njit(cache=True, error_model="numpy")
def gather(window: UInt64, blocks: Int32, chosen: UInt8, wanted: np.uint8, out: UInt64) -> None:
    """Copy chosen blocks of a window into a list of blocks; all arrays are views as words of 8 bytes.

    Args:
        window: (rows, words of a row).
        blocks: (blocks, 2) int32 row of each block, and its number in the row.
        chosen: (blocks,) uint8.
        wanted: blocks whose ``chosen`` is at least this are copied.
        out: (blocks, words of a block), the chosen rows are written.
    """
    words = out.shape[1]
    for n in range(len(blocks)):
        if chosen[n] >= wanted:
            i, first = blocks[n, 0], blocks[n, 1] * words
            for m in range(words):
                out[n, m] = window[i, first + m]


@njit(cache=True, error_model="numpy")
def scatter(parts: UInt64, blocks: Int32, window: UInt64) -> None:
    """Copy a list of blocks back into a window; the reverse of `gather`.

    Args:
        parts: (blocks, words of a block).
        blocks: (blocks, 2) int32 row of each block, and its number in the row.
        window: (rows, words of a row), the blocks' words are written.
    """
    words = parts.shape[1]
    for n in range(len(blocks)):
        i, first = blocks[n, 0], blocks[n, 1] * words
        for m in range(words):
            window[i, first + m] = parts[n, m]


@njit(cache=True, error_model="numpy")
def replace(old: UInt8, new: UInt8) -> np.bool_:
    """Copy ``new`` over ``old``, both (samples,) uint8; return whether any sample differed: the contour has moved."""
    other = _0B
    for j in range(len(old)):
        other |= old[j] ^ new[j]
        old[j] = new[j]
    return other > _0B


@njit(cache=True, error_model="numpy")
def surety_of(contrast: Float32, inside: UInt8, out: Float32) -> None:
    """Write the evidence of the contour at each sample: mean log-likelihood ratio of its side to the other [nats], ≥ 0.

    It is the binomial mean over 5 × 5 samples of ``contrast``, negated for samples outside. Unknown samples, and those
    beyond the arrays, count as 0.

    Args:
        contrast: (rows, columns) float32 log p1 − log p2 of each sample, p1 the density inside; 0 where unknown.
        inside: (rows, columns) uint8, 1 inside the contour.
        out: (rows, columns) float32, written; 0 where the mean is negative and so supports the other sides.
    """
    rows, columns = contrast.shape
    line, across = np.zeros(columns + 4, np.float32), np.zeros((rows + 4, columns), np.float32)
    four, six, scale = np.float32(4.0), np.float32(6.0), np.float32(1 / 256)
    for i in range(rows):
        source, side, to = contrast[i], inside[i], across[i + 2]
        a, b, c = line[:columns], line[1 : 1 + columns], line[2 : 2 + columns]
        d, e = line[3 : 3 + columns], line[4 : 4 + columns]
        for j in range(columns):
            value = source[j]
            c[j] = value if side[j] > 0 else -value
        for j in range(columns):
            to[j] = (a[j] + e[j]) + four * (b[j] + d[j]) + six * c[j]
    for i in range(rows):
        a, b, c, d, e, to = across[i], across[i + 1], across[i + 2], across[i + 3], across[i + 4], out[i]
        for j in range(columns):
            mean = scale * ((a[j] + e[j]) + four * (b[j] + d[j]) + six * c[j])
            to[j] = mean if mean > _0F else _0F
