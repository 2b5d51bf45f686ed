"""Kernels that track markers from image to image; importing this module imports numba.

A marker's prediction is at constant velocity in the image. Its candidates are the connected components of its colour
(`marker_piece_kernels`).
"""

# ruff: noqa: PLR0912, PLR0917 - compiled: arrays come by position, and loops are written out
from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.sensing.marker_centre_kernels import centre
from mocapella.sensing.marker_memory import (
    AREA,
    CANDIDATES,
    CONFIDENCE,
    ELONGATION,
    FOUND,
    MERGED,
    NEAR,
    OUT,
    REJECTED_BIG,
    REJECTED_SHAPE,
    REJECTED_SMALL,
    SD,
    SEEN_S,
    USUAL,
    VX,
    VY,
    X,
    Y,
)  # fmt: skip
from mocapella.sensing.marker_piece_kernels import (
    LABEL,
    PIECE,
    SIZE,
    SYY,
    X0,
    X1,
    Y0,
    Y1,
    PieceBuffers,
    fill,
    pieces,
    shape_of,
)

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]

SEED_PX = 4.0
"""Least number of connected pixels of a marker's colour around which it is searched for by the colours of a window."""
# Literals 0 and True at a call would be other types, for which numba would compile the kernel once more.
_0, _YES = np.int64(0), np.bool_(True)


class MarkerColours(NamedTuple):
    """Tables of the markers' colours, made from a colour profile.

    Attributes:
        table: (32768,) uint8 label of a colour cell, 0 for none; marker k has the label k + 1.
        near: the same for a window about a marker's predicted position, where the background counts less.
        light: (256,) linear light of a pixel value.
    """

    table: UInt8
    near: UInt8
    light: Float64


class MarkerLimits(NamedTuple):
    """Limits and scales of marker detection, see `mocapella.sensing.markers.MarkerSettings`.

    Attributes:
        least_px, most_px: smallest and largest area of a marker [px²].
        elongation: largest elongation, as in `marker_piece_kernels.shape_of`.
        fill: smallest fill, as in `marker_piece_kernels.shape_of`.
        window_px: side of the search window about the predicted position [px].
        sd_floor_px, sd_scale: standard deviation of a centre: √(floor² + (scale·roughness of `centre`)²) [px].
        area_range: largest factor between the area and the learnt one, in either direction.
        acceleration_px_s2: unmodelled acceleration of a marker, which widens the window [px/s²].
        forget_s: time since a marker's last detection after which there is no prediction [s].
        near_change: largest factor between the area and the last one of a marker found with `MarkerColours.near`.
    """

    least_px: float
    most_px: float
    elongation: float
    fill: float
    window_px: float
    sd_floor_px: float
    sd_scale: float
    area_range: float
    acceleration_px_s2: float
    forget_s: float
    near_change: float


class MarkerRows(NamedTuple):
    """State and results, a row for each marker; columns as in `mocapella.sensing.marker_memory`.

    Attributes:
        memory: (markers, `MEMORY`) state that is kept from image to image.
        out: (markers, `OUT`) results of the present image.
        sums: (markers, `OUT`) sums of the results over all images; column `CANDIDATES` counts images with more than
            one.
        reported: (markers, `OUT`) float32, as ``out``, candidates up to 255; for a marker that is not found, position,
            standard deviation, elongation and `FOUND` are NaN.
    """

    memory: Float64
    out: Float64
    sums: Float64
    reported: Float32


@njit(cache=True, error_model="numpy")
def choose(
    found: Float64, count: int, label: int, x0: int, y0: int, predicted: bool, px: float, py: float,
    area_before: float, usual: float, limits: MarkerLimits, shape: Float64, mine: Float64, counts: Float64,
) -> int:  # fmt: skip
    """Associate a marker with one of its colour's connected components (data association); return its index, or −1.

    Args:
        found: (capacity, `PIECE`) pieces of `marker_piece_kernels.pieces`, with sums relative to (x0, y0).
        count: their number.
        label: the marker's label.
        x0, y0: origin of the sums [px].
        predicted: whether there is a prediction.
        px, py: predicted position [px].
        area_before: area in the last detection [px²], or 0.
        usual: area when its colour was learnt [px²].
        limits: limits and scales.
        shape: (7,) workspace.
        mine: (11,) written: the piece, joined with the parts that a highlight cut off.
        counts: (`OUT`,) numbers of candidates, merged and rejected pieces are added to its columns.
    """
    best, best_score, plausible = -1, -1e300, 0.0
    least, most = max(limits.least_px, usual / limits.area_range), min(limits.most_px, usual * limits.area_range)
    for turn in range(2):
        for p in range(count):
            if found[p, LABEL] != label:
                continue
            n = found[p, SIZE]
            if n < least or n > most:
                if turn == 0:
                    counts[REJECTED_SMALL if n < least else REJECTED_BIG] += 1.0
                continue
            shape_of(found[p], shape)
            if shape[5] > limits.elongation or shape[6] < limits.fill:
                if turn == 0:
                    counts[REJECTED_SHAPE] += 1.0
                continue
            if turn == 1:
                if n >= plausible:
                    counts[CANDIDATES] += 1.0
                continue
            score = math.log(shape[6]) - abs(math.log(n / (area_before if area_before > 0.0 else usual)))
            if predicted:
                score -= math.hypot(shape[0] + x0 - px, shape[1] + y0 - py) / limits.window_px
            if score > best_score:
                best, best_score = p, score
        if best < 0:
            return best
        plausible = max(0.25 * found[best, SIZE], least)
    _join_cut_off(found, count, label, best, plausible, mine, counts)
    counts[CANDIDATES] = max(counts[CANDIDATES], 1.0)
    return best


@njit(cache=True, error_model="numpy")
def _join_cut_off(
    found: Float64, count: int, label: int, best: int, plausible: float, mine: Float64, counts: Float64
) -> None:
    """Write the chosen piece, joined with smaller ones within 3 px, into ``mine``; arguments of `choose`.

    ``plausible`` is the least area of a piece that `choose` counted as a candidate; joined ones are subtracted again.
    """
    for k in range(PIECE):
        mine[k] = found[best, k]
    for p in range(count):  # pieces that a highlight has cut off
        if p == best or found[p, LABEL] != label or found[p, SIZE] > found[best, SIZE]:
            continue
        gap_x = max(found[p, X0] - found[best, X1], found[best, X0] - found[p, X1])
        gap_y = max(found[p, Y0] - found[best, Y1], found[best, Y0] - found[p, Y1])
        if max(gap_x, gap_y) <= 3.0:
            if found[p, SIZE] >= plausible:
                counts[CANDIDATES] -= 1.0
            counts[MERGED] += 1.0
            for k in range(SIZE, SYY + 1):
                mine[k] += found[p, k]
            mine[X0], mine[Y0] = min(mine[X0], found[p, X0]), min(mine[Y0], found[p, Y0])
            mine[X1], mine[Y1] = max(mine[X1], found[p, X1]), max(mine[Y1], found[p, Y1])


@njit(cache=True, error_model="numpy")
def measure(
    image: UInt8, c: MarkerColours, mine: Float64, x0: int, y0: int, area_before: float, limits: MarkerLimits,
    shape: Float64, out: Float64,
) -> None:  # fmt: skip
    """Measure the chosen component: sub-pixel centre, standard deviation, area, shape and confidence of the marker.

    Args:
        image: (h, w, 3) uint8.
        c: the colours.
        mine: (11,) the piece of `choose`; its holes are filled in place.
        x0, y0: origin of its sums [px].
        area_before: area in the last detection [px²], or 0.
        limits: limits and scales.
        shape: (7,) workspace.
        out: (`OUT`,) written: position, area, elongation, standard deviation and confidence; its candidates are read.
    """
    h, w, _ = image.shape
    fill(image, c.table, mine[LABEL], mine, x0, y0)
    shape_of(mine, shape)
    sub = np.empty(4)
    x, y = shape[0] + x0, shape[1] + y0
    centre(image, c.table, mine[LABEL], c.light, x, y, shape[2], shape[3], shape[4], sub)
    cut = mine[X0] <= 0 or mine[Y0] <= 0 or mine[X1] >= w - 1 or mine[Y1] >= h - 1
    out[FOUND], out[X], out[Y], out[AREA], out[ELONGATION] = 1.0, sub[0], sub[1], mine[SIZE], shape[5]
    radius = math.sqrt(mine[SIZE] / math.pi)
    out[SD] = radius / 3.0 if cut else math.sqrt(limits.sd_floor_px**2 + (limits.sd_scale * sub[2]) ** 2)
    sure = min(shape[6] / 0.9, 1.0) * (0.25 + 0.75 * sub[3]) * min(mine[SIZE] / (3.0 * limits.least_px), 1.0)
    if area_before > 0.0:
        sure *= math.exp(-max(abs(math.log(mine[SIZE] / area_before)) - 0.4, 0.0))
    if out[CANDIDATES] > 1.5:
        sure *= 0.5
    out[CONFIDENCE] = 0.5 * sure if cut else sure


@njit(cache=True, error_model="numpy")
def _search_near(
    image: UInt8, c: MarkerColours, rows: MarkerRows, k: int, at_s: float, limits: MarkerLimits,
    buffers: PieceBuffers, shape: Float64, mine: Float64,
) -> None:  # fmt: skip
    """Search for marker k near its prediction, in a window that is doubled up to two times, and write its row."""
    h, w, _ = image.shape
    memory, out, found = rows.memory, rows.out, buffers.found
    age = max(at_s - memory[k, SEEN_S], 0.0)
    px, py = memory[k, X] + age * memory[k, VX], memory[k, Y] + age * memory[k, VY]
    half = 0.5 * limits.window_px + min(0.5 * limits.acceleration_px_s2 * age * age, limits.window_px)
    for _ in range(3):
        x0, x1 = max(int(px - half), 0), min(int(px + half) + 1, w)
        y0, y1 = max(int(py - half), 0), min(int(py + half) + 1, h)
        if x1 - x0 < 2 or y1 - y0 < 2:
            break
        count = pieces(image, c.table, x0, y0, x1, y1, k + 1, buffers)
        out[k] = 0.0
        if count < 0:
            break
        best = choose(
            found, count, k + 1, x0, y0, _YES, px, py, memory[k, AREA], memory[k, USUAL], limits, shape, mine, out[k]
        )  # fmt: skip
        if best < 0:
            half *= 2.0
            continue
        inner = (mine[X0] > x0 or x0 == 0) and (mine[X1] < x1 - 1 or x1 == w)
        if inner and (mine[Y0] > y0 or y0 == 0) and (mine[Y1] < y1 - 1 or y1 == h):
            measure(image, c, mine, x0, y0, memory[k, AREA], limits, shape, out[k])
            break
        half *= 2.0


@njit(cache=True, error_model="numpy")
def _search_by_near_colours(
    image: UInt8, c: MarkerColours, rows: MarkerRows, k: int, at_s: float, limits: MarkerLimits,
    buffers: PieceBuffers, shape: Float64, mine: Float64,
) -> None:  # fmt: skip
    """Search for marker k near its prediction by `MarkerColours.near`, and write its row if a piece is like the last.

    Its area must differ from the last by at most ``near_change``.
    """
    memory = rows.memory
    age = at_s - memory[k, SEEN_S]
    px, py = memory[k, X] + age * memory[k, VX], memory[k, Y] + age * memory[k, VY]
    half = 0.5 * limits.window_px + min(0.5 * limits.acceleration_px_s2 * age * age, limits.window_px)
    half += math.sqrt(memory[k, AREA] / math.pi)
    _by_near_colours(
        image, c, px, py, half, memory[k, AREA], memory[k, USUAL], k + 1, limits, buffers, shape, mine, rows.out[k]
    )


@njit(cache=True, error_model="numpy")
def _by_near_colours(
    image: UInt8, c: MarkerColours, px: float, py: float, half: float, area: float, usual: float, label: int,
    limits: MarkerLimits, buffers: PieceBuffers, shape: Float64, mine: Float64, out: Float64,
) -> None:  # fmt: skip
    """Search by `MarkerColours.near` within ``half`` px of (px, py); write ``out`` (`OUT`,) if a piece is plausible.

    The piece must lie within the window as a whole. ``area`` is compared with it [px²], ``usual`` is the area
    when the colour was learnt, and the other arguments are those of `choose` and `measure`.
    """
    h, w, _ = image.shape
    x0, x1 = max(int(px - half), 0), min(int(px + half) + 1, w)
    y0, y1 = max(int(py - half), 0), min(int(py + half) + 1, h)
    if x1 - x0 < 2 or y1 - y0 < 2:
        return
    count = pieces(image, c.near, x0, y0, x1, y1, label, buffers)
    if count < 0:
        return
    counts = np.zeros(OUT)
    best = choose(buffers.found, count, label, x0, y0, _YES, px, py, area, usual, limits, shape, mine, counts)
    if best < 0 or not (mine[X0] > x0 and mine[X1] < x1 - 1 and mine[Y0] > y0 and mine[Y1] < y1 - 1):
        return
    change = mine[SIZE] / area
    if limits.near_change > change > 1.0 / limits.near_change:
        out[CANDIDATES] = counts[CANDIDATES]
        measure(image, MarkerColours(c.near, c.near, c.light), mine, x0, y0, area, limits, shape, out)
        out[CONFIDENCE] *= 0.5
        out[NEAR] = 1.0


@njit(cache=True, error_model="numpy")
def _search_all(
    image: UInt8, c: MarkerColours, rows: MarkerRows, at_s: float, limits: MarkerLimits, buffers: PieceBuffers,
    shape: Float64, mine: Float64,
) -> int:  # fmt: skip
    """Search the whole image for the markers that are not found yet; return 1, or 3 if there were too many runs.

    Where no piece of a marker's colour is plausible, the largest is a seed: around it, pieces by `MarkerColours.near`
    are considered, as the hysteresis of two thresholds (Canny 1986, section VIII) does along an edge.
    """
    h, w, _ = image.shape
    memory, out, found, flags = rows.memory, rows.out, buffers.found, 1
    count = pieces(image, c.table, _0, _0, w, h, _0, buffers)
    if count < 0:
        count, flags = -1 - count, 3
    for k in range(len(out)):
        if out[k, FOUND] > 0.0:
            continue
        age = at_s - memory[k, SEEN_S]
        known = age <= limits.forget_s
        px = py = area = 0.0
        if known:
            px, py, area = memory[k, X] + age * memory[k, VX], memory[k, Y] + age * memory[k, VY], memory[k, AREA]
        out[k] = 0.0
        best = choose(
            found, count, k + 1, _0, _0, known, px, py, area, memory[k, USUAL], limits, shape, mine, out[k]
        )  # fmt: skip
        if best >= 0:
            measure(image, c, mine, _0, _0, area, limits, shape, out[k])
    seeds = np.full((len(out), 3), -1.0)
    for p in range(count):
        k = int(found[p, LABEL]) - 1
        if out[k, FOUND] == 0.0 and found[p, SIZE] > max(seeds[k, 2], SEED_PX - 1.0):
            seeds[k, 0], seeds[k, 1] = 0.5 * (found[p, X0] + found[p, X1]), 0.5 * (found[p, Y0] + found[p, Y1])
            seeds[k, 2] = found[p, SIZE]
    for k in range(len(out)):
        usual = memory[k, USUAL]
        if out[k, FOUND] == 0.0 and 0.0 < seeds[k, 2] < usual * limits.area_range:
            half = 0.5 * limits.window_px + math.sqrt(usual)
            _by_near_colours(
                image, c, seeds[k, 0], seeds[k, 1], half, usual, usual, k + 1, limits, buffers, shape, mine, out[k]
            )
    return flags


@njit(cache=True, error_model="numpy")
def follow(
    image: UInt8, c: MarkerColours, rows: MarkerRows, at_s: float, whole: bool, limits: MarkerLimits,
    buffers: PieceBuffers,
) -> int:  # fmt: skip
    """Detect and track all markers in one image: predict, gate by a search window, associate, measure.

    Each marker is searched near its prediction, and in the whole image if any is lost.

    Args:
        image: (h, w, 3) uint8.
        c: the colours.
        rows: the markers' states and results, updated.
        at_s: the image's capture time, on the clock of earlier calls [s].
        whole: whether the whole image is searched even if no marker is lost.
        limits: limits and scales.
        buffers: workspace.

    Returns:
        Bits: 1 the whole image was searched, 2 there were more runs of pixels than ``buffers`` can hold.
    """
    memory, out, sums, reported = rows
    shape, mine, flags, lost = np.empty(7), np.empty(PIECE), 0, whole
    out[:] = 0.0
    for k in range(len(out)):
        age = at_s - memory[k, SEEN_S]
        if not (age <= limits.forget_s):
            lost = True
    if not lost:
        for k in range(len(out)):
            _search_near(image, c, rows, k, at_s, limits, buffers, shape, mine)
            if out[k, FOUND] == 0.0:
                _search_by_near_colours(image, c, rows, k, at_s, limits, buffers, shape, mine)
            if out[k, FOUND] == 0.0:
                lost = True
    if lost:
        flags = _search_all(image, c, rows, at_s, limits, buffers, shape, mine)
        for k in range(len(out)):
            if out[k, FOUND] == 0.0 and at_s - memory[k, SEEN_S] <= limits.forget_s:
                _search_by_near_colours(image, c, rows, k, at_s, limits, buffers, shape, mine)
    for k in range(len(out)):
        if out[k, FOUND] > 0.0:
            age = at_s - memory[k, SEEN_S]
            if 0.0 < age <= limits.forget_s:
                memory[k, VX], memory[k, VY] = (out[k, X] - memory[k, X]) / age, (out[k, Y] - memory[k, Y]) / age
            elif age != 0.0:
                memory[k, VX] = memory[k, VY] = 0.0
            memory[k, X], memory[k, Y], memory[k, AREA], memory[k, SEEN_S] = out[k, X], out[k, Y], out[k, AREA], at_s
    for k in range(len(out)):
        for i in range(OUT):
            if i != CANDIDATES:
                sums[k, i] += out[k, i]
            reported[k, i] = out[k, i] if out[k, FOUND] > 0.0 or i > ELONGATION else np.nan
        sums[k, CANDIDATES] += 1.0 if out[k, CANDIDATES] > 1.5 else 0.0
        reported[k, CANDIDATES] = min(out[k, CANDIDATES], 255.0)
    return flags
