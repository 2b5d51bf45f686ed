"""What a camera that stands still sees behind people, learnt while they are there; compiled.

Arrays are those of `background_memory`. Importing this module imports numba.
"""

# ruff: noqa: PLR0912, PLR0917 - compiled: arrays come by position, and loops are written out
from __future__ import annotations

import math

import numpy as np

from mocapella.compiled import njit

MIDDLE = 127.5
"""Of the scale [grey levels]."""
SD_OF_FIFTH = 1.0 / 0.25335
"""Of a normal distribution: over what a fifth of all deviations is below."""
WIDE = 1.5
"""What is farther from the mean than so many standard deviations moves it no more than that, and its variance neither:
so little that one wrong value in six does not make the variance grow without end (P. Huber, Robust Statistics, 1981,
section 6.4)."""
OF_CUT = 1.0 / 0.77846
"""Of a normal distribution: its variance over that of what is cut off there."""


@njit(cache=True)
def _mean(image, step, i, j, out):
    """Write the mean of an odd square of pixels about a sample [grey levels], of what there is of it in the image."""
    half, channels = step // 2, image.shape[2]
    top, bottom = max(i * step - half, 0), min(i * step + half + 1, image.shape[0])
    left, right = max(j * step - half, 0), min(j * step + half + 1, image.shape[1])
    f = 1.0 / ((bottom - top) * (right - left))
    for c in range(channels):
        total = np.int64(0)
        for y in range(top, bottom):
            for x in range(left, right):
                total += np.int64(image[y, x, c])
        out[c] = f * total


@njit(cache=True, forceinline=True)
def _nine(image, step, top, left, out):
    """Write the mean of 3 × 3 pixels in colour, all of which there are; for a step of 1 that in their middle."""
    if step == 1:
        y, x = np.uint64(top + 1), np.uint64(left + 1)
        out[0], out[1], out[2] = image[y, x, 0], image[y, x, 1], image[y, x, 2]
        return
    a, b, c = np.uint64(left), np.uint64(left + 1), np.uint64(left + 2)
    p = q = r = np.int64(0)
    for down in range(3):
        y = np.uint64(top + down)
        p += np.int64(image[y, a, 0]) + np.int64(image[y, b, 0]) + np.int64(image[y, c, 0])
        q += np.int64(image[y, a, 1]) + np.int64(image[y, b, 1]) + np.int64(image[y, c, 1])
        r += np.int64(image[y, a, 2]) + np.int64(image[y, b, 2]) + np.int64(image[y, c, 2])
    f = 1.0 / 9
    out[0], out[1], out[2] = f * p, f * q, f * r


@njit(cache=True, forceinline=True)
def _usual(shape, step, i, j):
    """Whether `_nine` is `_mean` of a sample (i, j) of an image of that shape.

    Callers ask, not one function that calls both: where an array is handed on, its references are counted, which takes
    longer than nine pixels do.
    """
    top, left = i * step - 1, j * step - 1
    inner = top >= 0 and left >= 0 and top + 2 < shape[0] and left + 2 < shape[1]
    return inner and shape[2] == 3 and 1 <= step <= 3


@njit(cache=True, forceinline=True)
def _free(phi, left, top, i, j, guard):
    """Whether no person is near a sample of the whole image."""
    a, b = i - top, j - left
    return not (0 <= a < phi.shape[0] and 0 <= b < phi.shape[1]) or phi[a, b] < -guard


@njit(cache=True)
def unlike(image, step, phi, left, top, guard, every, least_sd, cut_sd, mean, variance, count):
    """What samples where nobody is, at every so manieth row and column, say of an image: those beside are asked, too.

    Returns:
        How many are not as they were, of how many that are known, and the standard deviation of samples [grey levels],
        of what neighbours do not explain: of the smallest fifth, for the larger ones may be the room's texture.
    """
    rows, columns, channels = mean.shape
    differ = known = n = 0
    rest = np.empty((rows // every + 1) * (columns // every + 1) * channels)
    before, here, after = np.empty(channels), np.empty(channels), np.empty(channels)
    for i in range(every // 2, rows, every):
        for j in range(every // 2, columns, every):
            if not _free(phi, left, top, i, j, guard):
                continue
            if _usual(image.shape, step, i, j):
                _nine(image, step, i * step - 1, j * step - 1, here)
            else:
                _mean(image, step, i, j, here)
            if count[i, j] > 0:
                known += 1
                squares = 0.0
                for c in range(channels):
                    d = here[c] - mean[i, j, c]
                    squares += d * d
                if squares > cut_sd * cut_sd * max(variance[i, j], least_sd * least_sd) * channels:
                    differ += 1
            if 0 < j < columns - 1:
                if _usual(image.shape, step, i, j - 1):
                    _nine(image, step, i * step - 1, (j - 1) * step - 1, before)
                else:
                    _mean(image, step, i, j - 1, before)
                if _usual(image.shape, step, i, j + 1):
                    _nine(image, step, i * step - 1, (j + 1) * step - 1, after)
                else:
                    _mean(image, step, i, j + 1, after)
                for c in range(channels):
                    rest[n] = abs(here[c] - 0.5 * (before[c] + after[c]))
                    n += 1
    noise = SD_OF_FIFTH * np.partition(rest[:n], n // 5)[n // 5] / math.sqrt(1.5) if n else 0.0
    return differ, known, noise


@njit(cache=True)
def learn(
    image, step, phi, left, top, guard, covered, others, begin, end, every, rate, least_sd, mean, variance, count
):
    """Take in the rows from ``begin`` to ``end`` of samples, and every so manieth of the window, where nobody is.

    ``covered`` is (rows, columns) of the window, not 0 where the person is, too, and ``others`` (height, width) where
    others are; or (0, 0).
    """
    rows, columns, channels = mean.shape
    here, least, per_channel = np.empty(channels), least_sd * least_sd, OF_CUT / channels
    rates = np.maximum(1.0 / np.arange(1, 257), rate)  # of the first image that a sample was in, the second one, …
    for i in range(rows):
        whole = begin <= i < end
        if not whole and (not top <= i < top + phi.shape[0] or (i - begin) % every != 0):
            continue
        first, last = (0, columns) if whole else (max(left, 0), min(left + phi.shape[1], columns))
        for j in range(first, last):
            if not _free(phi, left, top, i, j, guard) or (others.size and others[i * step, j * step]):
                continue
            a, b = i - top, j - left
            if 0 <= a < covered.shape[0] and 0 <= b < covered.shape[1] and covered[a, b]:
                continue
            n = count[i, j]
            if _usual(image.shape, step, i, j):
                _nine(image, step, i * step - 1, j * step - 1, here)
            else:
                _mean(image, step, i, j, here)
            if n == 0:
                for c in range(channels):
                    mean[i, j, c] = here[c]
                variance[i, j] = least
            else:
                r, most, squares = rates[n], WIDE * WIDE * variance[i, j], 0.0
                for c in range(channels):
                    d = here[c] - mean[i, j, c]
                    if d * d > most:  # seldom: there is no root of the others
                        d = math.copysign(math.sqrt(most), d)
                    mean[i, j, c] += r * d
                    squares += d * d
                variance[i, j] += r * (per_channel * squares - variance[i, j])
            if n < 255:
                count[i, j] = n + 1


@njit(cache=True, forceinline=True)
def _vote(image, step, i, j, most, least, darkest, chroma2, mean, variance, count, here):
    """Of a sample and the four about it the share that is not as it was, 1 for all and −1 for none; 0 where less than
    three are known. Whether a sample is one that a shadow may have fallen on is not known.

    A shadow takes some of the light and leaves its colour (T. Horprasert, D. Harwood, L. S. Davis, "A statistical
    approach for real-time robust background subtraction and shadow detection", ICCV Frame-Rate Workshop 1999, section
    2): what is nearest to `here` on the line from black to the sample's colour is at ``f`` of it, and near.
    """
    known = differ = 0
    channels = mean.shape[2]
    for v in range(5):
        a, b = i + (1 if v == 1 else -1 if v == 2 else 0), j + (1 if v == 3 else -1 if v == 4 else 0)
        if not (0 <= a < mean.shape[0] and 0 <= b < mean.shape[1]) or count[a, b] == 0:
            continue
        if _usual(image.shape, step, a, b):
            _nine(image, step, a * step - 1, b * step - 1, here)
        else:
            _mean(image, step, a, b, here)
        squares = along = length2 = 0.0
        for c in range(channels):
            m = mean[a, b, c]
            d = here[c] - m
            squares += d * d
            along += here[c] * m
            length2 += m * m
        if squares > most * max(variance[a, b], least):
            if along < length2 and along >= darkest * length2:
                f, aside = along / length2, 0.0
                for c in range(channels):
                    d = here[c] - f * mean[a, b, c]
                    aside += d * d
                if aside < chroma2:
                    continue
            differ += 1
        known += 1
    return 2.0 * differ / known - 1.0 if known >= 3 else 0.0


@njit(cache=True)
def strange(image, step, left, top, every, bounds, mean, variance, count, out):
    """Write out (rows, columns) of every so manieth sample from (left, top): see `_vote`.

    ``bounds`` are its four numbers: how far away is not as it was, the least variance, how dark a shadow is, and how
    far aside of a colour, each but the third squared.
    """
    here = np.empty(mean.shape[2])
    most, least, darkest, chroma2 = bounds
    for a in range(out.shape[0]):
        for b in range(out.shape[1]):
            i, j = top + a * every, left + b * every
            out[a, b] = _vote(image, step, i, j, most, least, darkest, chroma2, mean, variance, count, here)


@njit(cache=True)
def strange_at(image, step, pixels, bounds, mean, variance, count, out):
    """Write out (n,) of the samples at points (n, 2) [px]: see `strange`."""
    here = np.empty(mean.shape[2])
    most, least, darkest, chroma2 = bounds
    for k in range(len(pixels)):
        i, j = round(pixels[k, 1] / step), round(pixels[k, 0] / step)
        if 0 <= i < mean.shape[0] and 0 <= j < mean.shape[1]:
            out[k] = _vote(image, step, i, j, most, least, darkest, chroma2, mean, variance, count, here)


@njit(cache=True, error_model="numpy")
def costs(values, blocks, left, top, least_sd, mean, variance, count, out):
    """Write −log p [nats] of values being background, as of three channels; NaN: not known.

    Args:
        values: (channels, blocks, size) int16 half grey levels from the middle of the scale.
        blocks: (blocks, 2) int32 row and number of each.
        left, top: the first sample's column and row.
        out: (blocks, size) float32; the log 2π/2 of every channel is left out.
    """
    channels, least, size = mean.shape[2], least_sd * least_sd, values.shape[2]
    f, of_least = 1.5 / channels, 1.5 * math.log(4.0 * least)
    for n in range(len(blocks)):
        i, first = blocks[n, 0] + top, blocks[n, 1] * size + left
        for b in range(size):
            j = b + first
            if not (0 <= i < mean.shape[0] and 0 <= j < mean.shape[1]) or count[i, j] == 0:
                out[n, b] = math.nan
                continue
            v = max(variance[i, j], least)
            squares = 0.0
            for c in range(channels):
                d = 0.5 * values[c, n, b] - (mean[i, j, c] - MIDDLE)
                squares += d * d
            # Most samples have the least variance: no logarithm of theirs is taken.
            out[n, b] = f * squares / v + (of_least if v == least else 1.5 * math.log(4.0 * v))
