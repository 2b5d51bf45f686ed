"""Kernels that read an image near a contour for `mocapella.sensing.region_contour`. Importing this imports numba.

A window is padded to whole blocks, each of ``size`` consecutive samples of a row. The band is the samples near the
contour, which may change sides. All samples of the blocks that it touches are read, and stored one block after
another, so that later stages run in long loops.
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position, loops are written out
from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Bool = NDArray[np.bool_]
Float32 = NDArray[np.float32]
Int16 = NDArray[np.int16]
Int32 = NDArray[np.int32]
UInt8 = NDArray[np.uint8]

_0F, _0B, _1B = np.float32(0.0), np.uint8(0), np.uint8(1)


class WindowLayout(NamedTuple):
    """Layout of a window's samples in the image and in blocks.

    Attributes:
        x0, y0: pixel of the first sample, which may lie beyond the image.
        step: distance between samples [px].
        pad: number of columns of padding before the first sample.
        padded: number of columns with all padding.
        size: number of samples of a block, a multiple of 8.
    """

    x0: int
    y0: int
    step: int
    pad: int
    padded: int
    size: int


@njit(cache=True, error_model="numpy")
def farthest(phi: Float32) -> np.float32:
    """Return the largest magnitude of the distances phi (rows, columns) float32; NaN where any is NaN."""
    # The bit patterns of floats above 0, read as integers, are in the same order; infinity and then NaN come last.
    bits, most = phi.view(np.int32), np.zeros(1, np.int32)
    for i in range(len(bits)):
        row, largest = bits[i], most[0]
        for j in range(len(row)):
            far = np.int32(row[j] & np.int32(0x7FFFFFFF))
            largest = far if far > largest else largest
        most[0] = largest
    largest_float: np.float32 = most.view(np.float32)[0]
    return largest_float


@njit(cache=True, error_model="numpy")
def lay_out(
    phi: Float32, start: UInt8, band: np.float32, unguided: bool, layout: WindowLayout, size_px: tuple[int, int],
    wide: Float32, inside: UInt8, active: UInt8, known: UInt8, blocks: Int32,
) -> int:  # fmt: skip
    """Pad a window, and list its blocks that have samples which may change sides; return their number.

    Args:
        phi: (rows, columns) float32 signed distance to the prior's contour [px], above 0 inside.
        start: (rows, columns) uint8, 1 inside the initial contour; or (0, 0): the prior's.
        band: samples farther from the prior's contour cannot change sides [px], unless ``unguided``.
        unguided: whether all samples may.
        layout: layout of the window.
        size_px: (width, height) of the image.
        wide: (rows, padded) float32 written: phi; far outside in the padding.
        inside: (rows, padded) uint8 written: the initial contour.
        active: (capacity, size) uint8 written for each block: 1 where a sample may change sides.
        known: (capacity, size) uint8 written for each block: 1 where a sample is active and in the image.
        blocks: (capacity, 2) int32 written: row of each block, and its number in the row.
    """
    x0, y0, step, pad, _, size = layout
    rows, columns = phi.shape
    padded = wide.shape[1]
    width, height = size_px
    first, last = min(max((-x0 + step - 1) // step, 0), columns), min(max((width - x0 + step - 1) // step, 0), columns)
    count, words = 0, size // 8
    on, shown, seen = np.zeros(padded, np.uint8), np.zeros(padded, np.uint8), np.zeros(padded, np.uint8)
    seen[pad + first : pad + last] = _1B
    undecided, on_by_8, seen_by_8 = on[pad : pad + columns], on.view(np.uint64), shown.view(np.uint64)
    active_by_8, known_by_8 = active.reshape(-1).view(np.uint64), known.reshape(-1).view(np.uint64)
    wide[:], inside[:] = np.float32(-1e6), _0B
    for i in range(rows):
        p, w, u = phi[i], wide[i, pad : pad + columns], inside[i, pad : pad + columns]
        for j in range(columns):
            w[j] = p[j]
        for j in range(columns):
            u[j] = _1B if p[j] > _0F else _0B
        for j in range(columns):
            undecided[j] = _1B if abs(p[j]) <= band or unguided else _0B
        if start.size > 0:
            begin = start[i]
            for j in range(columns):
                u[j] = begin[j] if undecided[j] > _0B else u[j]
        in_image = 0 <= y0 + i * step < height
        for j in range(padded):
            shown[j] = on[j] & seen[j] if in_image else _0B
        for b in range(0, len(on_by_8), words):
            some = np.uint64(0)
            for m in range(b, b + words):
                some |= on_by_8[m]
            if some:
                blocks[count, 0], blocks[count, 1] = i, b // words
                for m in range(words):
                    active_by_8[count * words + m], known_by_8[count * words + m] = on_by_8[b + m], seen_by_8[b + m]
                count += 1
    return count


@njit(cache=True, error_model="numpy")
def _copy_row(source: UInt8, begin: int, end: int, channels: int, target: UInt8) -> None:
    """Copy pixels ``begin`` to ``end`` of an image row; beyond the image its border pixel is repeated."""
    width = len(source) // channels
    low, high = min(max(begin, 0), width), max(min(end, width), 0)
    for x in range(begin, min(low, end)):
        for c in range(channels):
            target[channels * (x - begin) + c] = source[c]
    if high > low:
        span = channels * (high - low)
        part, place = source[channels * low :], target[channels * (low - begin) :]
        for k in range(span):
            place[k] = part[k]
    for x in range(max(high, begin), end):
        for c in range(channels):
            target[channels * (x - begin) + c] = source[channels * (width - 1) + c]


@njit(cache=True, error_model="numpy")
def _median_row(rows: UInt8, channels: int, middle: UInt8, out: UInt8) -> None:
    """Write the median of columns, then of rows, of three image rows (3, n); ``middle`` (n,) is scratch."""
    a, b, d = rows[0], rows[1], rows[2]
    for k in range(len(middle)):
        p, q, r = a[k], b[k], d[k]
        less, more = (p if p < q else q), (q if p < q else p)
        more = more if more < r else r
        middle[k] = less if less > more else more
    left, centre, right = middle[: len(out)], middle[channels:], middle[2 * channels :]
    for k in range(len(out)):
        p, q, r = left[k], centre[k], right[k]
        less, more = (p if p < q else q), (q if p < q else p)
        more = more if more < r else r
        out[k] = less if less > more else more


@njit(cache=True, error_model="numpy")
def _tent_row(smooth: UInt8, i: int, step: int, channels: int, small: Int16, line: Int32, ready: Int16) -> None:
    """Write the tent-weighted means about the pixels of sample row i, in half grey levels from the middle of the scale.

    Args:
        smooth: (2 step − 1, n) ring of image rows.
        i: row of samples.
        step: distance between samples [px].
        channels: number of channels of a pixel.
        small, line: (n,) scratch.
        ready: (n,) written.
    """
    taps, inner, whole = 2 * step - 1, smooth.shape[1], step**4
    if step == 1:
        row = smooth[0]
        for k in range(inner):
            ready[k] = 2 * np.int16(row[k]) - 255
    elif step == 2:
        above, here, below = smooth[2 * i % 3], smooth[(2 * i + 1) % 3], smooth[(2 * i + 2) % 3]
        # In 16 bits each, so that a vector holds more.
        for k in range(inner):
            small[k] = np.int16(np.int16(above[k]) + np.int16(np.int16(here[k]) << 1) + np.int16(below[k]))
        left, centre, right = small, small[channels:], small[2 * channels :]
        for k in range(inner - 2 * channels):
            off = np.int16(np.int16(left[k] + np.int16(centre[k] << 1)) + np.int16(right[k] - np.int16(2040)))
            size = np.int16(-off) if off < 0 else off
            # Halves are rounded away from the middle, so that an inverted image gives the inverted values.
            far = np.int16(np.int16(size + np.int16(4)) >> 3)
            ready[k] = far if off >= 0 else np.int16(-far)
    else:
        line[:] = 0
        for t in range(taps):
            row, weight = smooth[(i * step + t) % taps], np.int32(step - abs(t - step + 1))
            for k in range(inner):
                line[k] += weight * np.int32(row[k])
        for k in range(inner - 2 * channels * (step - 1)):
            total = 0
            for t in range(taps):
                total += (step - abs(t - step + 1)) * line[k + channels * t]
            centred = 2 * total - 255 * whole
            level = (2 * abs(centred) + whole) // (2 * whole)
            ready[k] = level if centred >= 0 else -level


@njit(cache=True, error_model="numpy")
def read_samples(
    image: UInt8, x0: int, y0: int, step: int, median: bool, columns: int, blocks: Int32, values: Int16
) -> None:
    """Write the image's values at all samples of a band's blocks.

    A sample is a mean over the pixels nearer than a step, weighted like a tent, so that its value shows which share of
    its surroundings is inside. Before that, a median over three rows and columns removes single wrong pixels.

    Args:
        image: (h, w, channels) uint8.
        x0, y0: the pixel of the first sample, padding included, which may lie beyond the image.
        step: distance between samples [px].
        median: whether the median is applied.
        columns: number of columns of the window, padding included.
        blocks: (blocks, 2) of `lay_out`.
        values: (channels, blocks, size) int16 written, in half grey levels: grey level g is 2g − 255.
    """
    height, width, channels = image.shape
    taps, size = 2 * step - 1, values.shape[2]
    border = 1 if median else 0
    first_x, first_y = x0 - step + 1, y0 - step + 1
    wide = (columns - 1) * step + taps  # pixels of a row, after the median
    inner, broad = channels * wide, channels * (wide + 2 * border)
    flat = image.reshape(-1)
    ring = np.empty((3, broad), np.uint8)  # rows of the image
    middle = np.empty(broad, np.uint8)
    smooth = np.empty((taps, inner), np.uint8)
    line, small, ready = np.empty(inner, np.int32), np.empty(inner, np.int16), np.zeros(inner, np.int16)
    begin = first_x - border
    end = begin + wide + 2 * border
    copied, done, block = 0, 0, 0
    while block < len(blocks):
        i = blocks[block, 0]
        if done < i * step:
            done = i * step
            copied = max(copied, done)
        while done < i * step + taps:  # one more row after the median
            while copied < done + 1 + 2 * border:
                y = min(max(first_y - border + copied, 0), height - 1)
                row = flat[channels * y * width : channels * (y + 1) * width]
                _copy_row(row, begin, end, channels, ring[copied % 3])
                copied += 1
            if median:
                _median_row(ring, channels, middle, smooth[done % taps])
            else:
                smooth[done % taps] = ring[done % 3]
            done += 1
        _tent_row(smooth, i, step, channels, small, line, ready)
        while block < len(blocks) and blocks[block, 0] == i:
            first, apart = np.uint64(channels * step * size * blocks[block, 1]), np.uint64(channels * step)
            for c in range(channels):
                for j in range(size):
                    values[c, block, j] = ready[first + np.uint64(c) + apart * np.uint64(j)]
            block += 1


@njit(cache=True)
def forget(ignore: Bool, x0: int, y0: int, step: int, reach: int, blocks: Int32, known: UInt8) -> None:
    """Mark samples as unknown that have an ignored pixel near them.

    Args:
        ignore: (h, w) bool, True for pixels without information.
        x0, y0, step: pixel of the first sample, padding included, and distance between samples [px].
        reach: largest distance of such a pixel along either axis [px].
        blocks, known: (blocks, 2) and (blocks, size) of `lay_out`; known is updated.
    """
    height, width = ignore.shape
    size = known.shape[1]
    for n in range(len(blocks)):
        for j in range(size):
            if not known[n, j]:
                continue
            x, y = x0 + (blocks[n, 1] * size + j) * step, y0 + blocks[n, 0] * step
            for b in range(max(y - reach, 0), min(y + reach + 1, height)):
                for a in range(max(x - reach, 0), min(x + reach + 1, width)):
                    if ignore[b, a]:
                        known[n, j] = 0


@njit(cache=True, error_model="numpy")
def read(
    image: UInt8, phi: Float32, start: UInt8, band_px: float, guided: bool, median: bool, layout: WindowLayout,
    ignore: Bool,
) -> tuple[np.float32, Float32, UInt8, UInt8, UInt8, Int32, Int16]:  # fmt: skip
    """Lay out a window and read the image in it.

    Args:
        image: (h, w, channels) uint8.
        phi, start, layout: (rows, columns) signed distance [px], (rows, columns) initial mask or (0, 0), and layout, as
            in `lay_out`.
        band_px: samples farther from the prior's contour cannot change sides, if ``guided`` [px].
        guided: whether only samples near the prior's contour may change sides.
        median: whether single wrong pixels are removed by a median.
        ignore: (h, w) bool, True for pixels without information; or (0, 0).

    Returns:
        The largest |phi| [px]; wide, inside: (rows, padded) phi, and the initial contour's mask; active, known:
            (blocks, size) uint8, whether a sample may change sides, and whether the image shows it, too; (blocks, 2)
            int32 row and number of each block; (channels, blocks, size) int16 values [half grey levels].
    """
    rows, (height, width, channels), far = len(phi), image.shape, farthest(phi)
    x0, y0, step, pad, padded, size = layout
    # Where phi is cut off, the distance is unknown.
    within = min(np.float32(band_px), np.nextafter(far, _0F))
    room = rows * (padded // size)
    wide, inside = np.empty((rows, padded), np.float32), np.empty((rows, padded), np.uint8)
    active, known = np.empty((room, size), np.uint8), np.empty((room, size), np.uint8)
    blocks = np.empty((room, 2), np.int32)
    count = lay_out(phi, start, within, not guided, layout, (width, height), wide, inside, active, known, blocks)
    blocks, active, known = blocks[:count], active[:count], known[:count]
    values = np.empty((channels, count, size), np.int16)
    read_samples(image, x0 - pad * step, y0, step, median, padded, blocks, values)
    if ignore.size > 0:
        forget(ignore, x0 - pad * step, y0, step, step - 1 + median, blocks, known)
    return far, wide, inside, active, known, blocks, values
