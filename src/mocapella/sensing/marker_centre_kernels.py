"""The centre of a marker, from its edge; compiled. Importing this module imports numba.

Sub-pixel refinement: the edge is located along radial rays by the mixture of colours in a pixel.
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.sensing.marker_piece_kernels import table_label

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]

RAYS, SAMPLES, STEP_PX, REACH_PX = 18, 7, 1.0, 3.0
_COS = np.cos(2 * np.pi * np.arange(RAYS) / RAYS)
_SIN = np.sin(2 * np.pi * np.arange(RAYS) / RAYS)


@njit(cache=True, error_model="numpy")
def _edge_on_ray(
    image: UInt8, table: UInt8, label: int, light: Float64, x: float, y: float, u: float, v: float, begin: float,
    line: Float64,
) -> float:  # fmt: skip
    """Return the distance from (x, y) in direction (u, v) at which the marker ends [px]; NaN where no edge is seen.

    Args:
        image, table, label, light, x, y: as in `centre`.
        u, v: direction, of length 1.
        begin: distance of the first sample [px].
        line: (`SAMPLES`, 3) scratch.
    """
    h, w, _ = image.shape
    px, py = x + u * (begin + STEP_PX * (SAMPLES - 1)), y + v * (begin + STEP_PX * (SAMPLES - 1))
    if not (0.0 <= px < w - 1 and 0.0 <= py < h - 1 and 0.0 <= x + u * begin < w - 1 and 0.0 <= y + v * begin < h - 1):
        return math.nan
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
    if table_label(image, table, m, j) != label:  # starts in a reflection, whose white is not the marker's colour
        return math.nan
    contrast = inside = 0.0
    for q in range(3):
        d = 0.5 * (line[0, q] + line[1, q] - line[SAMPLES - 1, q] - line[SAMPLES - 2, q])
        contrast += d * d
        inside += line[0, q] + line[SAMPLES - 1, q]
    if contrast < (0.03 * inside) ** 2 or contrast < 1e-5:
        return math.nan
    part = 0.0
    for k in range(SAMPLES):
        s = 0.0
        for q in range(3):
            end = 0.5 * (line[SAMPLES - 1, q] + line[SAMPLES - 2, q])
            s += (line[k, q] - end) * (0.5 * (line[0, q] + line[1, q]) - end)
        part += min(max(s / contrast, 0.0), 1.0)
    return begin + STEP_PX * (part - 0.5)


@njit(cache=True, error_model="numpy")
def centre(
    image: UInt8, table: UInt8, label: int, light: Float64, x: float, y: float, xx: float, xy: float, yy: float,
    out: Float64,
) -> None:  # fmt: skip
    """Refine a marker's centre from the edge around it, to a fraction of a pixel.

    On a ray from the middle outwards, the edge is where a pixel mixes marker and surroundings in equal parts: a pixel
    is α·inside + (1 − α)·outside in linear light, whatever the blur. α is the projection on the line between the
    colours at the ray's own ends, so that neither shading nor the background shifts the edge. The centre is that of
    the area within the edges.

    Args:
        image: (h, w, 3) uint8.
        table: (32768,) uint8 label of a colour cell, 0 for none.
        label: the marker's label in the table.
        light: (256,) linear light of a pixel value.
        x, y: mean of the pixels with the marker's colour [px].
        xx, xy, yy: their variances and covariance [px²].
        out: (4,) written: refined x and y [px]; the roughness of the edge, which is the standard deviation of its
            distance on a single ray [px]; and the share of rays with an edge, 0 to 1. If fewer than half of the rays
            have an edge, x and y are the given ones, and the roughness is 1.
    """
    det = xx * yy - xy * xy
    a, b, c = yy / det, -xy / det, xx / det
    edge, hard, good = np.empty(RAYS), np.empty(RAYS), np.zeros(RAYS, np.bool_)
    line, seen = np.empty((SAMPLES, 3)), 0
    for i in range(RAYS):
        u, v = _COS[i], _SIN[i]
        r = 2.0 / math.sqrt(a * u * u + 2.0 * b * u * v + c * v * v)
        hard[i] = edge[i] = r
        found = _edge_on_ray(image, table, label, light, x, y, u, v, max(r - REACH_PX, 0.0), line)
        if abs(found - r) < 2.2:  # not where NaN
            edge[i], good[i] = found, True
            seen += 1
    grown = 0.0  # mean shift of the edge, which rays without an edge get
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
    rough = 0.0  # second differences: the part that neighbours do not share
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
