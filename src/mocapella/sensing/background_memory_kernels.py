"""Learn and apply the background model of `background_memory`; compiled. Importing this module imports numba.

A sample is the mean of an odd square of pixels, at every ``step``-th row and column of the image.
"""

# ruff: noqa: PLR0912, PLR0917 - compiled: arrays come by position, and loops are written out
from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Bool = NDArray[np.bool_]
Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int16 = NDArray[np.int16]
Int32 = NDArray[np.int32]
UInt8 = NDArray[np.uint8]

MIDDLE = 127.5
"""Middle of the 8-bit scale [grey levels]."""
SD_OF_FIFTH = 1.0 / 0.25335
"""Ratio of a normal distribution's standard deviation to the 20th percentile of its absolute deviations."""
WIDE = 1.5
"""Deviations are clipped to this many standard deviations before they update mean and variance: so few that one outlier
in six does not make the variance diverge (P. Huber, Robust Statistics, 1981, section 6.4)."""
OF_CUT = 1.0 / 0.77846
"""Ratio of a normal distribution's variance to its variance after clipping to `WIDE`."""


class BackgroundSamples(NamedTuple):
    """The learnt background model, one row and column per sample.

    Attributes:
        mean: (rows, columns, channels) float32 [grey levels].
        variance: (rows, columns) float32 mean of the channels' variances [grey levels²].
        images: (rows, columns) uint8 number of images that a sample was learnt from, at most 255; 0: unknown.
    """

    mean: Float32
    variance: Float32
    images: UInt8


class PersonWindow(NamedTuple):
    """A rectangle of samples with the signed distance to a person's outline.

    Attributes:
        phi: (rows, columns) float32, above 0 inside [px]; (0, 0): no person.
        left, top: column and row of its first sample in the image's grid of samples.
        guard: samples nearer than this to the person are not background [px].
    """

    phi: Float32
    left: int
    top: int
    guard: float


class ForegroundBounds(NamedTuple):
    """Bounds between background, shadow and foreground.

    Attributes:
        most: squared deviation from the mean, summed over channels, above which a sample has changed [variances].
        least: lower bound of the variance that deviations are compared with [grey levels²].
        darkest: least brightness of a sample in shadow, as a share of its usual one.
        chroma2: greatest squared distance of a sample in shadow from its darkened colour [grey levels²].
    """

    most: float
    least: float
    darkest: float
    chroma2: float


@njit(cache=True)
def _mean(image: UInt8, step: int, i: int, j: int, out: Float64) -> None:
    """Write the mean of an odd square of pixels about a sample [grey levels], clipped to the image."""
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
def _nine(image: UInt8, step: int, top: int, left: int, out: Float64) -> None:
    """Write the mean of 3 × 3 colour pixels, all in the image; for a step of 1 the middle one."""
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
def _usual(shape: tuple[int, int, int], step: int, i: int, j: int) -> bool:
    """Return whether `_nine` equals `_mean` for sample (i, j) of an image of that shape.

    Callers choose between the two, instead of one function that calls both: passing an array on counts its references,
    which takes longer than nine pixels.
    """
    top, left = i * step - 1, j * step - 1
    inner = top >= 0 and left >= 0 and top + 2 < shape[0] and left + 2 < shape[1]
    return inner and shape[2] == 3 and 1 <= step <= 3


@njit(cache=True, forceinline=True)
def _free(phi: Float32, left: int, top: int, i: int, j: int, guard: float) -> bool:
    """Return whether no person is near sample (i, j) of the whole image."""
    a, b = i - top, j - left
    return not (0 <= a < phi.shape[0] and 0 <= b < phi.shape[1]) or phi[a, b] < -guard


@njit(cache=True)
def unlike(
    image: UInt8, step: int, window: PersonWindow, every: int, least_sd: float, cut_sd: float,
    learnt: BackgroundSamples,
) -> tuple[int, int, float]:  # fmt: skip
    """Compare an image with the background at every ``every``-th sample away from people, and estimate its noise.

    Args:
        image: (height, width, channels) uint8.
        step: distance between samples [px].
        window: the person.
        every: stride between compared samples.
        least_sd: least standard deviation of a sample [grey levels].
        cut_sd: a sample farther than this from its mean has changed [standard deviations].
        learnt: the background model.

    Returns:
        The number of changed samples, the number of known ones, and the standard deviation of a sample's noise [grey
        levels]. The noise is estimated from differences to neighbouring samples, the smallest fifth of them, because
        larger ones may be texture.
    """
    phi, left, top, guard = window
    mean, variance, count = learnt
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
    image: UInt8, step: int, window: PersonWindow, covered: UInt8, others: Bool, begin: int, end: int, every: int,
    rate: float, least_sd: float, learnt: BackgroundSamples,
) -> None:  # fmt: skip
    """Update means and variances away from people (exponential averages), in some rows, more often beside the person.

    Args:
        image: (height, width, channels) uint8.
        step: distance between samples [px].
        window: the person.
        covered: (rows, columns) of the window, another mask of the person, not 0 inside; or (0, 0).
        others: (height, width) bool, True on other people; or (0, 0).
        begin, end: rows of samples that are updated in full width, the end exclusive.
        every: outside of them, every ``every``-th row of the person's window is updated, within the window only.
        rate: least weight of an image in the running means, 0 to 1.
        least_sd: initial standard deviation of a sample [grey levels].
        learnt: the background model, updated.
    """
    phi, left, top, guard = window
    mean, variance, count = learnt
    rows, columns, channels = mean.shape
    here, least, per_channel = np.empty(channels), least_sd * least_sd, OF_CUT / channels
    rates = np.maximum(1.0 / np.arange(1, 257), rate)  # of a sample's first image, its second one, …
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
                    if d * d > most:  # rare, so that few roots are taken
                        d = math.copysign(math.sqrt(most), d)
                    mean[i, j, c] += r * d
                    squares += d * d
                variance[i, j] += r * (per_channel * squares - variance[i, j])
            if n < 255:
                count[i, j] = n + 1


@njit(cache=True, forceinline=True)
def _vote(
    image: UInt8, step: int, i: int, j: int, bounds: ForegroundBounds, mean: Float32, variance: Float32, count: UInt8,
    here: Float64,
) -> float:  # fmt: skip
    """Return the share of changed samples among a sample and its four neighbours, scaled to −1 (none) to 1 (all).

    It is 0 if fewer than three are known. A sample that may lie in shadow counts as unknown. A shadow darkens a surface
    and keeps its colour (T. Horprasert, D. Harwood, L. S. Davis, "A statistical approach for real-time robust
    background subtraction and shadow detection", ICCV Frame-Rate Workshop 1999, section 2): the point nearest to
    ``here`` (scratch) on the line from black to the sample's colour is at the fraction ``f`` of it, and near.
    """
    most, least, darkest, chroma2 = bounds
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
def strange(
    image: UInt8, step: int, left: int, top: int, every: int, bounds: ForegroundBounds, learnt: BackgroundSamples,
    out: Float32,
) -> None:  # fmt: skip
    """Write the foreground score of a grid of samples: from −1, background, to 1, foreground.

    It is the share of changed samples among a sample and its four neighbours, scaled. Samples that may be in shadow
    count as unknown; the score is 0 if fewer than three of the five are known.

    Args:
        image: (height, width, channels) uint8.
        step: distance between the model's samples [px].
        left, top: column and row of the first sample.
        every: stride between scored samples.
        bounds: bounds of background and shadow.
        learnt: the background model.
        out: (rows, columns) float32, written.
    """
    mean, variance, count = learnt
    here = np.empty(mean.shape[2])
    for a in range(out.shape[0]):
        for b in range(out.shape[1]):
            i, j = top + a * every, left + b * every
            out[a, b] = _vote(image, step, i, j, bounds, mean, variance, count, here)


@njit(cache=True)
def strange_at(
    image: UInt8, step: int, pixels: Float64, bounds: ForegroundBounds, learnt: BackgroundSamples, out: Float32
) -> None:
    """Write the foreground score, −1 (background) to 1, of the sample nearest to each given pixel.

    Args:
        image, step, bounds, learnt: (height, width, channels) uint8, stride [px], bounds and model, as in `strange`.
        pixels: (n, 2) x, y [px].
        out: (n,) float32, written; left unchanged outside of the image.
    """
    mean, variance, count = learnt
    here = np.empty(mean.shape[2])
    for k in range(len(pixels)):
        i, j = round(pixels[k, 1] / step), round(pixels[k, 0] / step)
        if 0 <= i < mean.shape[0] and 0 <= j < mean.shape[1]:
            out[k] = _vote(image, step, i, j, bounds, mean, variance, count, here)


@njit(cache=True, error_model="numpy")
def costs(
    values: Int16, blocks: Int32, left: int, top: int, least_sd: float, learnt: BackgroundSamples, out: Float32
) -> None:
    """Write the cost −log p of each sample's value under the background model [nats]; NaN where the model is unknown.

    The cost is scaled to three channels, whatever their number; the log 2π/2 of every channel is left out.

    Args:
        values: (channels, blocks, size) int16 values in half grey levels: grey level g is 2g − 255; a block is
            ``size`` consecutive samples of a row.
        blocks: (blocks, 2) int32 row of each block, and its number in the row.
        left, top: column and row of the first sample of row 0, block 0.
        least_sd: least standard deviation [grey levels].
        learnt: the background model.
        out: (blocks, size) float32, written.
    """
    mean, variance, count = learnt
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
            # Most samples have the least variance, whose logarithm is computed once.
            out[n, b] = f * squares / v + (of_least if v == least else 1.5 * math.log(4.0 * v))
