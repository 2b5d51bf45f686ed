"""The loops of `mocapella.sensing.markers`, compiled; importing this module imports numba.

Pieces of an image are found by runs: a row's neighbouring pixels of one label are a run, runs of one label that touch
(at corners, too) in neighbouring rows are joined by union-find, and a piece's moments are sums over its runs in closed
form (run-based two-scan labelling: L. He, Y. Chao, K. Suzuki, A Run-Based Two-Scan Labeling Algorithm, IEEE
Transactions on Image Processing 17, 2008, sections II and III).
"""

# ruff: noqa: PLR0912, PLR1714, PLR0915, PLR0917 - compiled: arrays come by position, and loops are written out
from __future__ import annotations

import math

import numpy as np

from mocapella.compiled import njit
from mocapella.sensing.marker_memory import (
    AREA,
    CANDIDATES,
    CONFIDENCE,
    ELONGATION,
    FOUND,
    MERGED,
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

LABEL, SIZE, SX, SY, SXX, SXY, SYY, X0, Y0, X1, Y1 = range(11)
PIECE = 11
RAYS, SAMPLES, STEP_PX, REACH_PX = 18, 7, 1.0, 3.0
_COS = np.cos(2 * np.pi * np.arange(RAYS) / RAYS)
_SIN = np.sin(2 * np.pi * np.arange(RAYS) / RAYS)


# What is written as 0 or True where a kernel is called would be another type, and the kernel compiled once more for it.
_0, _YES = np.int64(0), np.bool_(True)
_2, _3, _7, _248 = np.uint16(2), np.uint16(3), np.uint16(7), np.uint16(248)


@njit(cache=True)
def _root(parent, i):
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True, error_model="numpy")
def pieces(image, table, x0, y0, x1, y1, only, index, labels, runs, parent, found):
    """The connected pieces of every label in image[y0:y1, x0:x1]: write (pieces, 11) into found and give their number.

    Args:
        image: (h, w, 3) uint8; table: (32768,) uint8 label of a cell, 0 for none; only: a label, or 0 for all.
        index, labels: (w,) uint16 and (w + 8,) uint8 of a row.
        runs: (capacity, 4) int64 row, begin, end, label; parent: (capacity,) int64.
        found: (capacity, 11) label, pixels, sums of x, y, xx, xy, yy from (x0, y0), bounds x0, y0, x1, y1 (inclusive).

    Returns:
        How many; -1 - how many where there are more runs than room, the rest of the image not being looked at.
    """
    width, count, full, stride, flat = x1 - x0, 0, False, image.shape[1], image.reshape(-1)
    words = labels.view(np.uint64)
    before, before_end = 0, 0
    for y in range(y0, y1):
        line = flat[3 * (y * stride + x0) : 3 * (y * stride + x1)]
        for i in range(width):  # apart from the look-up, so that the compiler makes vectors of it: 16-bit numbers only
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
            runs[i, 3] = -1 - p  # from here on: which piece
            found[p, LABEL] = 0.0
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
def table_label(image, table, y, x):
    """The label of one pixel."""
    b, g, r = image[y, x, 0], image[y, x, 1], image[y, x, 2]
    return table[(b >> 3) | ((g & 248) << 2) | ((r & 248) << 7)]


@njit(cache=True, error_model="numpy")
def shape_of(piece, shape):
    """Write of a piece: x, y (from its origin), variances xx, xy, yy, elongation, fill into shape (7,).

    The variances have 1/12 added, of a pixel's own extent. Fill is the area over that of the ellipse of those moments:
    1 for a solid ellipse, 0.95 for a rectangle, less for what has holes or arms.
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
def centre(image, table, label, light, x, y, xx, xy, yy, out):
    """Write a better x, y, its standard deviation and the part of rays that saw an edge into out (4,).

    Along rays from the middle outwards the edge lies where the mixture of marker and surroundings is half and half: a
    pixel is α·inside + (1 − α)·outside in linear light, whatever the blur, and α is found by projection with each
    ray's own ends, so that neither shading nor what is behind moves it. The centre is the area's within the edges.

    Args:
        image: (h, w, 3) uint8; table: labels of cells; label: of the marker; light: (256,) linear light of a value.
        x, y: of the piece's pixels; xx, xy, yy: their variances.
    """
    h, w, _ = image.shape
    det = xx * yy - xy * xy
    a, b, c = yy / det, -xy / det, xx / det
    edge, hard, good = np.empty(RAYS), np.empty(RAYS), np.zeros(RAYS, np.bool_)
    line, seen = np.empty((SAMPLES, 3)), 0
    for i in range(RAYS):
        u, v = _COS[i], _SIN[i]
        r = 2.0 / math.sqrt(a * u * u + 2.0 * b * u * v + c * v * v)
        hard[i] = edge[i] = r
        begin = max(r - REACH_PX, 0.0)
        px, py = x + u * (begin + STEP_PX * (SAMPLES - 1)), y + v * (begin + STEP_PX * (SAMPLES - 1))
        if not (
            0.0 <= px < w - 1 and 0.0 <= py < h - 1 and 0.0 <= x + u * begin < w - 1 and 0.0 <= y + v * begin < h - 1
        ):
            continue
        for k in range(SAMPLES):
            px, py = x + u * (begin + STEP_PX * k), y + v * (begin + STEP_PX * k)
            j, m = int(px), int(py)
            f, g = px - j, py - m
            w0, w1, w2, w3 = (1.0 - f) * (1.0 - g), f * (1.0 - g), (1.0 - f) * g, f * g
            for q in range(3):
                line[k, q] = (
                    w0 * light[image[m, j, q]]
                    + w1 * light[image[m, j + 1, q]]
                    + w2 * light[image[m + 1, j, q]]
                    + w3 * light[image[m + 1, j + 1, q]]
                )
        j, m = int(x + u * (begin + STEP_PX) + 0.5), int(y + v * (begin + STEP_PX) + 0.5)
        if table_label(image, table, m, j) != label:  # begins in a reflection, whose white is not the marker's
            continue
        contrast = inside = 0.0
        for q in range(3):
            d = 0.5 * (line[0, q] + line[1, q] - line[SAMPLES - 1, q] - line[SAMPLES - 2, q])
            contrast += d * d
            inside += line[0, q] + line[SAMPLES - 1, q]
        if contrast < (0.03 * inside) ** 2 or contrast < 1e-5:
            continue
        part = 0.0
        for k in range(SAMPLES):
            s = 0.0
            for q in range(3):
                end = 0.5 * (line[SAMPLES - 1, q] + line[SAMPLES - 2, q])
                s += (line[k, q] - end) * (0.5 * (line[0, q] + line[1, q]) - end)
            part += min(max(s / contrast, 0.0), 1.0)
        found = begin + STEP_PX * (part - 0.5)
        if abs(found - r) < 2.2:
            edge[i], good[i] = found, True
            seen += 1
    grown = 0.0  # rays without an edge: as far out as the others are
    for i in range(RAYS):
        if good[i]:
            grown += (edge[i] - hard[i]) / max(seen, 1)
    area = mx = my = 0.0
    for i in range(RAYS):
        r = edge[i] if good[i] else hard[i] + grown
        edge[i] = r
        area += 0.5 * r * r
        mx += r * r * r * _COS[i] / 3.0
        my += r * r * r * _SIN[i] / 3.0
    rough = 0.0  # third differences: what neighbours do not share
    for i in range(RAYS):
        d = edge[i] - hard[i]
        e = edge[(i + 1) % RAYS] - hard[(i + 1) % RAYS]
        f = edge[i - 1] - hard[i - 1]
        rough += (d - 0.5 * (e + f)) ** 2 / 1.5
    out[3] = seen / RAYS
    if 2 * seen < RAYS:
        out[0], out[1], out[2] = x, y, 1.0
    else:
        out[0], out[1] = x + mx / area, y + my / area
        out[2] = math.sqrt(rough / RAYS)


@njit(cache=True, error_model="numpy")
def choose(found, count, label, x0, y0, predicted, px, py, area_before, usual, limits, shape, mine, counts):
    """Which piece is the marker: its number, or -1.

    Args:
        found, count: pieces whose sums are from (x0, y0).
        predicted: whether (px, py) is where it should be; area_before: its area when last seen, or 0;
            usual: when it was learnt.
        limits: least area, greatest area, greatest elongation, least fill, window [px], two of `tell`, how many times
            smaller or larger than usual it may be.
        shape: (7,) scratch; mine: (11,) the piece with what a highlight cut from it.
        counts: (OUT,) numbers of candidates and rejected.
    """
    best, best_score, plausible = -1, -1e300, 0.0
    least, most = max(limits[0], usual / limits[7]), min(limits[1], usual * limits[7])
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
            if shape[5] > limits[2] or shape[6] < limits[3]:
                if turn == 0:
                    counts[REJECTED_SHAPE] += 1.0
                continue
            if turn == 1:
                if n >= plausible:
                    counts[CANDIDATES] += 1.0
                continue
            score = math.log(shape[6]) - abs(math.log(n / (area_before if area_before > 0.0 else usual)))
            if predicted:
                score -= math.hypot(shape[0] + x0 - px, shape[1] + y0 - py) / limits[4]
            if score > best_score:
                best, best_score = p, score
        if best < 0:
            return best
        plausible = max(0.25 * found[best, SIZE], least)
    for k in range(PIECE):
        mine[k] = found[best, k]
    for p in range(count):  # pieces a highlight has cut off
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
    counts[CANDIDATES] = max(counts[CANDIDATES], 1.0)
    return best


@njit(cache=True, error_model="numpy")
def fill(image, table, label, mine, x0, y0):
    """Moments of a piece with its holes and notches, made by reflections: all between its pixels in a row or column."""
    left, top = int(mine[X0]), int(mine[Y0])
    w, h = int(mine[X1]) - left + 1, int(mine[Y1]) - top + 1
    high, low = np.full(w, h), np.full(w, -1)
    for x in range(w):  # from both ends, so that what lies inside is not looked at
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
def add(mine, x, y):
    """One pixel to the sums of a piece."""
    mine[SIZE] += 1.0
    mine[SX] += x
    mine[SY] += y
    mine[SXX] += x * x
    mine[SXY] += x * y
    mine[SYY] += y * y


@njit(cache=True)
def add_run(mine, left, right, row):
    """The pixels from left to before right of a row to the sums of a piece."""
    n = right - left
    sx = 0.5 * n * (left + right - 1.0)
    mine[SIZE] += n
    mine[SX] += sx
    mine[SY] += n * row
    mine[SXX] += ((right - 1.0) * right * (2.0 * right - 1.0) - (left - 1.0) * left * (2.0 * left - 1.0)) / 6.0
    mine[SXY] += sx * row
    mine[SYY] += n * row * row


@njit(cache=True, error_model="numpy")
def tell(image, table, light, mine, x0, y0, area_before, limits, shape, out):
    """Write what is told of a chosen piece into out (OUT,)."""
    h, w, _ = image.shape
    fill(image, table, mine[LABEL], mine, x0, y0)
    shape_of(mine, shape)
    sub = np.empty(4)
    x, y = shape[0] + x0, shape[1] + y0
    centre(image, table, mine[LABEL], light, x, y, shape[2], shape[3], shape[4], sub)
    cut = mine[X0] <= 0 or mine[Y0] <= 0 or mine[X1] >= w - 1 or mine[Y1] >= h - 1
    out[FOUND], out[X], out[Y], out[AREA], out[ELONGATION] = 1.0, sub[0], sub[1], mine[SIZE], shape[5]
    radius = math.sqrt(mine[SIZE] / math.pi)
    out[SD] = radius / 3.0 if cut else math.sqrt(limits[5] ** 2 + (limits[6] * sub[2]) ** 2)
    sure = min(shape[6] / 0.9, 1.0) * (0.25 + 0.75 * sub[3]) * min(mine[SIZE] / (3.0 * limits[0]), 1.0)
    if area_before > 0.0:
        sure *= math.exp(-max(abs(math.log(mine[SIZE] / area_before)) - 0.4, 0.0))
    if out[CANDIDATES] > 1.5:
        sure *= 0.5
    out[CONFIDENCE] = 0.5 * sure if cut else sure


@njit(cache=True, error_model="numpy")
def follow(
    image,
    table,
    light,
    memory,
    at_s,
    whole,
    limits,
    grow_px_s2,
    forget_s,
    index,
    labels,
    runs,
    parent,
    found,
    out,
    sums,
    told,
):
    """One image: write (markers, OUT) into out and told, and go on in memory (markers, MEMORY).

    Args:
        whole: whether the whole image is looked at anyway.
        limits: (8,) of `choose`; the sixth and seventh are floor and scale of a centre's standard deviation.
        grow_px_s2: the acceleration by which a prediction can be wrong [px/s²]; forget_s: after which it is none.

        out, sums: float64 of this image, and over all; in sums, CANDIDATES counts images with more than one.
        told: float32 the same as out, NaN where a marker is not found.

    Returns:
        Bits: 1 the whole image was looked at, 2 there were more runs than room.
    """
    h, w, _ = image.shape
    shape, mine, said, lost = np.empty(7), np.empty(PIECE), 0, whole
    out[:] = 0.0
    for k in range(len(out)):
        age = at_s - memory[k, SEEN_S]
        if not (age <= forget_s):
            lost = True
    if not lost:
        for k in range(len(out)):
            age = max(at_s - memory[k, SEEN_S], 0.0)
            px, py = memory[k, X] + age * memory[k, VX], memory[k, Y] + age * memory[k, VY]
            half = 0.5 * limits[4] + min(0.5 * grow_px_s2 * age * age, limits[4])
            for _ in range(3):
                x0, x1 = max(int(px - half), 0), min(int(px + half) + 1, w)
                y0, y1 = max(int(py - half), 0), min(int(py + half) + 1, h)
                if x1 - x0 < 2 or y1 - y0 < 2:
                    break
                count = pieces(image, table, x0, y0, x1, y1, k + 1, index, labels, runs, parent, found)
                out[k] = 0.0
                if count < 0:
                    break
                best = choose(
                    found,
                    count,
                    k + 1,
                    x0,
                    y0,
                    _YES,
                    px,
                    py,
                    memory[k, AREA],
                    memory[k, USUAL],
                    limits,
                    shape,
                    mine,
                    out[k],
                )
                if best < 0:
                    half *= 2.0
                    continue
                inner = (mine[X0] > x0 or x0 == 0) and (mine[X1] < x1 - 1 or x1 == w)
                if inner and (mine[Y0] > y0 or y0 == 0) and (mine[Y1] < y1 - 1 or y1 == h):
                    tell(image, table, light, mine, x0, y0, memory[k, AREA], limits, shape, out[k])
                    break
                half *= 2.0
            if out[k, FOUND] == 0.0:
                lost = True
    if lost:
        said = 1
        count = pieces(image, table, _0, _0, w, h, _0, index, labels, runs, parent, found)
        if count < 0:
            count, said = -1 - count, 3
        for k in range(len(out)):
            if out[k, FOUND] > 0.0:
                continue
            age = at_s - memory[k, SEEN_S]
            known = age <= forget_s
            px = py = area = 0.0
            if known:
                px, py, area = memory[k, X] + age * memory[k, VX], memory[k, Y] + age * memory[k, VY], memory[k, AREA]
            out[k] = 0.0
            if (
                choose(found, count, k + 1, _0, _0, known, px, py, area, memory[k, USUAL], limits, shape, mine, out[k])
                >= 0
            ):
                tell(image, table, light, mine, _0, _0, area, limits, shape, out[k])
    for k in range(len(out)):
        if out[k, FOUND] > 0.0:
            age = at_s - memory[k, SEEN_S]
            if 0.0 < age <= forget_s:
                memory[k, VX], memory[k, VY] = (out[k, X] - memory[k, X]) / age, (out[k, Y] - memory[k, Y]) / age
            elif age != 0.0:
                memory[k, VX] = memory[k, VY] = 0.0
            memory[k, X], memory[k, Y], memory[k, AREA], memory[k, SEEN_S] = out[k, X], out[k, Y], out[k, AREA], at_s
    for k in range(len(out)):
        for i in range(OUT):
            if i != CANDIDATES:
                sums[k, i] += out[k, i]
            told[k, i] = out[k, i] if out[k, FOUND] > 0.0 or i > ELONGATION else np.nan
        sums[k, CANDIDATES] += 1.0 if out[k, CANDIDATES] > 1.5 else 0.0
        told[k, CANDIDATES] = min(out[k, CANDIDATES], 255.0)
    return said
