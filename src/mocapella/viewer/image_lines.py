"""Lines over a camera image: a body model's outline, and the sections of the silhouette's contour that deviate from it.

Several closed lines are stored in one array (n, 2) of pixels, with rows of NaN between the lines.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

Bool = NDArray[np.bool_]
Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

_FINEST: Final = 320
"""Largest number of samples along the longer side of an outline's mask."""
_SMOOTHED: Final = 5
"""Number of contour points around a point whose majority decides on which side of the outline it is."""
MOST_POINTS: Final = 160
"""Largest number of points of a drawn line; more would not be visible."""


def closed_lines(points_px: Float32) -> Iterator[Float64]:
    """Split points (n, 2), x and y [px], at rows of NaN; yield each closed line (k, 2) of two or more points.

    The last point of a line is not the first one again. Lines of one point are left out.
    """
    points = np.asarray(points_px, np.float64).reshape(-1, 2)
    gaps = np.flatnonzero(~np.isfinite(points).all(axis=1))
    for part in np.split(points, gaps):
        line = part[np.isfinite(part).all(axis=1)]
        if len(line) >= 2:
            yield line


def pieces(points_px: Float32) -> Float32:
    """Return the segments (m, 2, 2) of closed lines, as start and end points [px].

    A line of more than `MOST_POINTS` points is thinned to at most so many. Without lines, m is 0.

    Args:
        points_px: (n, 2) points of the lines, x and y [px], with rows of NaN between the lines.
    """
    lines = [line[:: _every(line)] for line in closed_lines(points_px)]
    made = [np.stack([line, np.roll(line, -1, axis=0)], axis=1) for line in lines]
    return np.concatenate([np.zeros((0, 2, 2)), *made]).astype(np.float32)


def deviations(outline_px: Float32, contour_px: Float32) -> tuple[Float32, Float32]:
    """Find the sections of an image's contour that deviate visibly from the model's outline.

    Visible is one sample or more: 1 px, or 1/320 of the outline's longer side if that is more.

    Args:
        outline_px: (n, 2) outline of the model, x and y [px], closed lines with rows of NaN between.
        contour_px: (m, 2) contour of the image's silhouette [px], in the same form.

    Returns:
        Segments (a, 2, 2) of the contour outside the model, and (b, 2, 2) inside it, start and end points [px]. Without
        an outline, the whole contour is outside.
    """
    outlines = list(closed_lines(outline_px))
    if not outlines:
        return pieces(contour_px), np.zeros((0, 2, 2), np.float32)
    low, step, mask = _filled(outlines)
    moved = [np.roll(mask, by, axis) for by in (-1, 1) for axis in (0, 1)]
    within, about = np.logical_and.reduce([mask, *moved]), np.logical_or.reduce([mask, *moved])
    outside: list[Float64] = [np.zeros((0, 2, 2))]
    inside: list[Float64] = [np.zeros((0, 2, 2))]
    for line in closed_lines(contour_px):
        x, y = np.floor((line - low) / step).astype(np.int64).T
        there = (x >= 0) & (y >= 0) & (x < mask.shape[1]) & (y < mask.shape[0])
        x, y = np.where(there, x, 0), np.where(there, y, 0)
        every = _every(line)
        thin = line[::every]
        ends = np.stack([thin, np.roll(thin, -1, axis=0)], axis=1)
        outside.append(ends[_most(~(there & about[y, x]))[::every]])
        inside.append(ends[_most(there & within[y, x])[::every]])
    return np.concatenate(outside).astype(np.float32), np.concatenate(inside).astype(np.float32)


def _filled(lines: list[Float64]) -> tuple[Float64, float, Bool]:
    """Fill closed lines: return the mask's corner (2,) [px], the size of a sample [px], and the mask, lines included.

    A sample is inside if an odd number of lines is to the left of it.
    """
    every = np.concatenate(lines)
    extent = every.max(axis=0) - every.min(axis=0)
    step = max(1.0, float(extent.max()) / _FINEST)
    low = every.min(axis=0) - 2.5 * step
    width, height = np.ceil((extent + 5 * step) / step).astype(np.int64) + 1
    crossings = np.zeros((height, width + 1), np.int32)
    border = np.zeros((height, width), np.bool_)
    for line in lines:
        a = (line - low) / step - 0.5  # whole numbers are the middles of the mask's cells
        b = np.roll(a, -1, axis=0)
        first = np.ceil(np.minimum(a[:, 1], b[:, 1])).astype(np.int64)
        count = np.ceil(np.maximum(a[:, 1], b[:, 1])).astype(np.int64) - first
        of = np.repeat(np.arange(len(a)), count)
        row = first[of] + np.arange(len(of)) - np.repeat(np.cumsum(count) - count, count)
        share = (row - a[of, 1]) / (b[of, 1] - a[of, 1])
        column = np.ceil(a[of, 0] + share * (b[of, 0] - a[of, 0])).astype(np.int64)
        np.add.at(crossings, (row, np.clip(column, 0, width)), 1)
        samples = np.maximum(np.ceil(np.abs(b - a).max(axis=1)).astype(np.int64), 1)
        of = np.repeat(np.arange(len(a)), samples)
        along = (np.arange(len(of)) - np.repeat(np.cumsum(samples) - samples, samples)) / samples[of]
        x, y = np.round(a[of] + along[:, None] * (b - a)[of]).astype(np.int64).T
        border[y, x] = True
    return low, step, border | (np.cumsum(crossings[:, :-1], axis=1) % 2 == 1)


def _most(flags: Bool) -> Bool:
    """Return the majority of the flags around each point (n,) of a closed line."""
    half = _SMOOTHED // 2
    around = np.pad(flags.astype(np.int64), half, mode="wrap")
    return np.asarray(2 * np.convolve(around, np.ones(_SMOOTHED, np.int64), "valid") > _SMOOTHED)


def _every(line: Float64) -> int:
    return max(1, -(-len(line) // MOST_POINTS))
