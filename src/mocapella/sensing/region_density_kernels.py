"""Gaussian densities of grey or colour at the nodes of a lattice, on both sides of a contour; compiled.

T. Brox, D. Cremers, On Local Statistical Region Models (2009). Between nodes −log p is linear. Sample values are whole
numbers (half grey levels from the middle of the scale), and so are lattice weights. The sums that are updated as
samples change sides are therefore exact, and do not depend on the order. Importing this module imports numba.
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position
from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.sensing.region_mask_kernels import DENSITY_CHANGED

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int16 = NDArray[np.int16]
Int32 = NDArray[np.int32]
Int64 = NDArray[np.int64]
UInt8 = NDArray[np.uint8]

OUTLIER, INSIDE, OUTSIDE, UNKNOWN = np.uint8(0), np.uint8(1), np.uint8(2), np.uint8(3)
"""Labels of samples: only those inside and outside count in a density."""
# Loops over a block end at an array's length, not at a constant: constants are unrolled, not vectorised. They are short
# and use few arrays, because the compiler checks at run time that these do not overlap.


class DensityLattice(NamedTuple):
    """Densities at the nodes of a lattice over the window; nodes are one block of samples apart.

    Attributes:
        sums: (2, node rows, node columns, 1 + 2 channels) int64 inside and outside: sums of the samples' weights, of
            their weighted values and of the weighted squares.
        both: (node rows, node columns, 1 + 2 channels) int64 the sums of both sides at the start.
        leans: (node rows, node columns) cost of the virtual samples that `update_densities` adds [samples × nats].
        stale: (node rows, node columns) uint8, 1 where sums have changed since densities were computed.
        coefficients: (node rows, node columns, 2 + 4 channels) float32 of −log p = a + b v + c v² of a value v, scaled
            to three channels [nats]: a inside and outside, then of every channel b and c inside and outside.
    """

    sums: Int64
    both: Int64
    leans: Float64
    stale: UInt8
    coefficients: Float32


@njit(cache=True)
def node_rows(rows: int, size: int) -> int:
    """Return the number of rows of nodes, ``size`` samples apart, that cover ``rows`` rows of samples."""
    return (rows + size - 1) // size + 1


@njit(cache=True)
def node_row_above(i: int, rows: int, size: int) -> tuple[int, int]:
    """Return the row of nodes above row i of samples, and the weight of the next row of nodes [1 / (2 size)].

    The lattice is centred on the window's rows.

    Args:
        i: row of samples.
        rows: number of rows of samples.
        size: distance between nodes [samples].
    """
    doubled = 2 * i + 1 - rows + (node_rows(rows, size) - 1) * size
    return doubled // (2 * size), doubled % (2 * size)


@njit(cache=True, error_model="numpy")
def add_sample(
    values: Int16, n: int, j: int, top: int, low: int, k: int, sign: int, side: int, sums: Int64
) -> None:  # fmt: skip
    """Add sample j of block n to the sums of its four nodes, or subtract it.

    Args:
        values: (channels, blocks, size) int16 in half grey levels: grey level g is 2g − 255.
        n, j: indices of the block and of the sample in it.
        top, low: row of nodes above the block, and weight of the row below, from 0 to 2 size.
        k: the block's number in its row, which is the column of the nodes on its left.
        sign: 1 to add, -1 to subtract.
        side: 0 inside, 1 outside.
        sums: (2, node rows, node columns, 1 + 2 channels) of `DensityLattice`, updated.
    """
    channels, _, size = values.shape
    right = 2 * j + 1
    for b in range(2):
        down = low if b else 2 * size - low
        for a in range(2):
            weight = sign * down * (right if a else 2 * size - right)
            sums[side, top + b, k + a, 0] += weight
            for c in range(channels):
                value = np.int64(values[c, n, j])
                sums[side, top + b, k + a, 1 + c] += weight * value
                sums[side, top + b, k + a, 1 + channels + c] += weight * value * value


@njit(cache=True, error_model="numpy")
def add_changes(values: Int16, before: UInt8, label: UInt8, blocks: Int32, rows: int, odd: Int32, sums: Int64) -> None:
    """Add all samples to their new side's sums and subtract them from their old side's.

    Moments are first taken over a block, about its left end, then spread to the four nodes.

    Args:
        values: (channels, blocks, size) int16 in half grey levels: grey level g is 2g − 255.
        before, label: (blocks, size) old and new labels.
        blocks: (blocks, 2) int32 row of each block, and its number in the row.
        rows: number of rows of samples.
        odd: (size,) int32 1, 3, 5 …: a sample's distance along its block [1 / (2 size)].
        sums: (2, node rows, node columns, 1 + 2 channels) of `DensityLattice`, updated.
    """
    channels, _, size = values.shape
    full = 2 * size
    whole, along = np.empty(sums.shape[3], np.int64), np.empty(sums.shape[3], np.int64)
    on, weight = np.empty(len(odd), np.int32), np.empty(len(odd), np.int32)
    aside = odd - np.int32(size)  # from a block's middle: squares of long blocks would exceed 32 bits
    old_words, new_words = before.reshape(-1).view(np.uint64), label.reshape(-1).view(np.uint64)
    eights = size // 8
    for n in range(len(blocks)):
        same = True
        for m in range(n * eights, n * eights + eights):
            same &= old_words[m] == new_words[m]
        if same:
            continue
        k = np.int64(blocks[n, 1])
        top, low = node_row_above(np.int64(blocks[n, 0]), rows, size)
        for side in range(2):
            wanted = INSIDE if side == 0 else OUTSIDE
            for j in range(size):
                on[j] = np.int32(label[n, j] == wanted) - np.int32(before[n, j] == wanted)
            count, far, some = np.int32(0), np.int32(0), np.int32(0)
            for j in range(size):
                weight[j] = on[j] * odd[j]
            for j in range(size):
                count = np.int32(count + on[j])
                far = np.int32(far + weight[j])
                some = np.int32(some | on[j])
            if some == 0:
                continue
            whole[0], along[0] = count, far
            for c in range(channels):
                a, b, x, y = np.int32(0), np.int32(0), np.int32(0), np.int32(0)
                for j in range(size):
                    value = np.int32(values[c, n, j])
                    once = np.int32(on[j] * value)
                    a = np.int32(a + once)
                    b = np.int32(b + np.int32(odd[j] * once))
                    square = np.int32(once * value)
                    x = np.int32(x + square)
                    y = np.int32(y + np.int32(aside[j] * square))
                whole[1 + c], along[1 + c] = a, b
                whole[1 + channels + c], along[1 + channels + c] = x, np.int64(size) * x + y
            for m in range(len(whole)):
                rest = full * whole[m] - along[m]
                sums[side, top, k, m] += (full - low) * rest
                sums[side, top, k + 1, m] += (full - low) * along[m]
                sums[side, top + 1, k, m] += low * rest
                sums[side, top + 1, k + 1, m] += low * along[m]


@njit(cache=True, error_model="numpy")
def update_densities(lattice: DensityLattice, size: int, fewest: float, least_sd: float) -> None:
    """Compute the densities of all stale nodes from their sums.

    It adds to each side's samples ``fewest`` virtual ones with the common density, that of all samples about the node.
    They dominate a side with few samples.

    Args:
        lattice: sums, both and stale are read, coefficients and leans written.
        size: number of samples of a block.
        fewest: number of virtual samples.
        least_sd: smallest standard deviation [half grey levels].
    """
    sums, both, leans, stale, coefficients = lattice
    _, rows, columns, terms = sums.shape
    channels = terms // 2
    unit, share, least = 1.0 / (4 * size * size), 3.0 / channels, least_sd * least_sd
    for i in range(rows):
        for k in range(columns):
            if not stale[i, k]:
                continue
            cost = 0.0
            if both[i, k, 0] == 0:
                coefficients[i, k] = 0.0
                leans[i, k] = 0.0
                continue
            count = both[i, k, 0] * unit
            to = coefficients[i, k]
            for side in range(2):
                own = sums[side, i, k]
                total = own[0] * unit + fewest
                a, product, off = 0.0, 1.0, 0.0
                for c in range(channels):
                    common = both[i, k, 1 + c] * unit / count
                    spread = max(both[i, k, 1 + channels + c] * unit / count - common * common, least)
                    mean = (own[1 + c] * unit + fewest * common) / total
                    square = (own[1 + channels + c] * unit + fewest * (spread + common * common)) / total
                    variance = max(square - mean * mean, least)
                    product *= variance
                    a += mean * mean / variance
                    off += (spread + (mean - common) * (mean - common)) / variance
                    to[2 + 4 * c + side] = -share * mean / variance
                    to[4 + 4 * c + side] = 0.5 * share / variance
                log_product = math.log(product)
                to[side] = 0.5 * share * (a + log_product)
                cost += 0.5 * share * fewest * (log_product + off)
            leans[i, k] = cost


@njit(cache=True, error_model="numpy")
def mark_blocks(stale: UInt8, blocks: Int32, rows: int, size: int, dirty: UInt8) -> None:
    """Mark the blocks whose costs must be evaluated again, because one of their four nodes is stale.

    Args:
        stale: (node rows, node columns) of `DensityLattice`.
        blocks: (blocks, 2) int32 row of each block, and its number in the row.
        rows: number of rows of samples.
        size: number of samples of a block.
        dirty: (blocks,) updated: at least `DENSITY_CHANGED` for those blocks.
    """
    last, top = np.int64(-1), np.int64(0)
    for n in range(len(blocks)):
        i, k = np.int64(blocks[n, 0]), np.int64(blocks[n, 1])
        if i != last:
            last, (top, _) = i, node_row_above(i, rows, size)
        if stale[top, k] | stale[top, k + 1] | stale[top + 1, k] | stale[top + 1, k + 1]:
            dirty[n] = max(dirty[n], DENSITY_CHANGED)
