"""How `mocapella.sensing.region_contour` reads an image about an outline; compiled. Importing this imports numba.

A window is padded to whole blocks of samples of a row. Of the blocks that the band touches all samples are read, and
kept one block after another: what is done with all of them is done in long loops.
"""

# ruff: noqa: PLR0912, PLR0915, PLR0917 - compiled: arrays come by position, loops are written out
from __future__ import annotations

import numpy as np

from mocapella.compiled import njit

_0F, _0B, _1B = np.float32(0.0), np.uint8(0), np.uint8(1)


@njit(cache=True, error_model="numpy")
def farthest(phi):
    """The largest distance (rows, columns) float32; NaN where one is none."""
    # As whole numbers, bits of numbers above 0 are in the same order, infinite ones and then NaN last.
    bits, most = phi.view(np.int32), np.zeros(1, np.int32)
    for i in range(len(bits)):
        row, largest = bits[i], most[0]
        for j in range(len(row)):
            far = np.int32(row[j] & np.int32(0x7FFFFFFF))
            largest = far if far > largest else largest
        most[0] = largest
    return most.view(np.float32)[0]


@njit(cache=True, error_model="numpy")
def lay_out(phi, start, band, unguided, pad, size, size_px, x0, y0, step, wide, inside, active, known, blocks):
    """Write a window with its padding, and which of its blocks have anything undecided.

    Args:
        phi: (rows, columns) float32 the prior's signed distance [px]; start: (rows, columns) uint8, 1 inside, or
            (0, 0): where the prior is.
        band: [px] farther from the outline nothing moves, unless ``unguided``.
        pad: columns of padding before the first; size: of a block [samples], a multiple of 8.
        size_px: (width, height) of the image; x0, y0: the first sample's pixel, which may lie beyond it; step: [px].
        wide: (rows, padded) float32 phi, far outside in the padding; inside: (rows, padded) uint8 where to begin.
        active, known: (capacity, size) uint8 of the blocks, 1 where a sample is undecided, and where the image says
            anything of it.
        blocks: (capacity, 2) int32 row and block.

    Returns:
        How many blocks.
    """
    rows, columns = phi.shape
    padded = wide.shape[1]
    width, height = size_px
    first, last = min(max((-x0 + step - 1) // step, 0), columns), min(max((width - x0 + step - 1) // step, 0), columns)
    count, words = 0, size // 8
    on, told, seen = np.zeros(padded, np.uint8), np.zeros(padded, np.uint8), np.zeros(padded, np.uint8)
    seen[pad + first : pad + last] = _1B
    undecided, on_by_8, told_by_8 = on[pad : pad + columns], on.view(np.uint64), told.view(np.uint64)
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
            told[j] = on[j] & seen[j] if in_image else _0B
        for b in range(0, len(on_by_8), words):
            some = np.uint64(0)
            for m in range(b, b + words):
                some |= on_by_8[m]
            if some:
                blocks[count, 0], blocks[count, 1] = i, b // words
                for m in range(words):
                    active_by_8[count * words + m], known_by_8[count * words + m] = on_by_8[b + m], told_by_8[b + m]
                count += 1
    return count


@njit(cache=True, error_model="numpy")
def read_samples(image, x0, y0, step, median, columns, blocks, values):
    """Write what the image is like about every sample of the blocks of a band.

    A sample is a mean over what lies nearer than a step, weighted like a tent, so that how much of its surroundings is
    inside shows in its value; before that, a median over three rows and columns takes away single wrong pixels.

    Args:
        image: (h, w, channels) uint8.
        x0, y0: the pixel of the first sample, padding included, which may lie beyond the image.
        step: [px]; median: whether there is one.
        blocks: of `lay_out`.
        columns: of the window, padding included.
        values: (channels, blocks, size) int16 half grey levels, 0 the middle of the scale.
    """
    height, width, channels = image.shape
    taps = 2 * step - 1
    border = 1 if median else 0
    first_x, first_y = x0 - step + 1, y0 - step + 1
    wide = (columns - 1) * step + taps  # pixels that are looked at in a row, after the median
    inner, broad = channels * wide, channels * (wide + 2 * border)
    flat = image.reshape(-1)
    ring = np.empty((3, broad), np.uint8)  # rows of the image
    middle = np.empty(broad, np.uint8)
    smooth = np.empty((taps, inner), np.uint8)
    line, small, ready = np.empty(inner, np.int32), np.empty(inner, np.int16), np.zeros(inner, np.int16)
    begin = first_x - border
    end = begin + wide + 2 * border
    low, high = min(max(begin, 0), width), max(min(end, width), 0)
    whole = step**4
    copied, done, block = 0, 0, 0
    while block < len(blocks):
        i = blocks[block, 0]
        if done < i * step:
            done = i * step
            copied = max(copied, done)
        while done < i * step + taps:  # one more row of what is smoothed
            to = smooth[done % taps]
            while copied < done + 1 + 2 * border:
                y = min(max(first_y - border + copied, 0), height - 1)
                source, target = flat[channels * y * width : channels * (y + 1) * width], ring[copied % 3]
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
                copied += 1
            if median:
                a, b, d = ring[0], ring[1], ring[2]
                for k in range(broad):
                    p, q, r = a[k], b[k], d[k]
                    less, more = (p if p < q else q), (q if p < q else p)
                    more = more if more < r else r
                    middle[k] = less if less > more else more
                left, centre, right = middle[:inner], middle[channels:], middle[2 * channels :]
                for k in range(inner):
                    p, q, r = left[k], centre[k], right[k]
                    less, more = (p if p < q else q), (q if p < q else p)
                    more = more if more < r else r
                    to[k] = less if less > more else more
            else:
                source = ring[done % 3]
                for k in range(inner):
                    to[k] = source[k]
            done += 1
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
                far = np.int16(
                    np.int16(size + np.int16(4)) >> 3
                )  # halves away from the middle, as inverted images have
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
                off = 2 * total - 255 * whole
                far = (2 * abs(off) + whole) // (2 * whole)
                ready[k] = far if off >= 0 else -far
        while block < len(blocks) and blocks[block, 0] == i:
            size = values.shape[2]
            first, apart = np.uint64(channels * step * size * blocks[block, 1]), np.uint64(channels * step)
            for c in range(channels):
                for j in range(size):
                    values[c, block, j] = ready[first + np.uint64(c) + apart * np.uint64(j)]
            block += 1


@njit(cache=True)
def forget(ignore, x0, y0, step, reach, blocks, known):
    """Samples whose value comes in part of pixels that tell nothing, at most ``reach`` [px] away, are not known.

    Args:
        ignore: (h, w) bool.
        x0, y0, step: as in `read_samples`.
        blocks, known: of `lay_out`.
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
def read(image, phi, start, band_px, guided, median, pad, padded, size, x0, y0, step, ignore):
    """All of this, one after the other.

    Args:
        image: of `read_samples`.
        phi, start, pad, size, x0, y0, step: of `lay_out`; padded: columns with their padding.
        band_px: farther from the outline nothing moves, if ``guided`` [px]; median: whether there is one.
        ignore: of `forget`, or (0, 0).

    Returns:
        `farthest`, then wide, inside, active, known, blocks of `lay_out` and values of `read_samples`.
    """
    rows, (height, width, channels), far = len(phi), image.shape, farthest(phi)
    # Where phi is cut off, nobody knows how far it is.
    within = min(np.float32(band_px), np.nextafter(far, _0F))
    room = rows * (padded // size)
    wide, inside = np.empty((rows, padded), np.float32), np.empty((rows, padded), np.uint8)
    active, known = np.empty((room, size), np.uint8), np.empty((room, size), np.uint8)
    blocks = np.empty((room, 2), np.int32)
    count = lay_out(
        phi, start, within, not guided, pad, size, (width, height), x0, y0, step, wide, inside, active, known, blocks
    )
    blocks, active, known = blocks[:count], active[:count], known[:count]
    values = np.empty((channels, count, size), np.int16)
    read_samples(image, x0 - pad * step, y0, step, median, padded, blocks, values)
    if ignore.size > 0:
        forget(ignore, x0 - pad * step, y0, step, step - 1 + median, blocks, known)
    return far, wide, inside, active, known, blocks, values
