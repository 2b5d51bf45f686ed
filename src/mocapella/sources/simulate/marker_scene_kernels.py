"""Compiled kernels of `mocapella.sources.simulate.marker_scene`; importing this module imports numba.

A shape is a row of 13 numbers. The first seven are x0, y0, x1, y1, r0, r1, 0 of a tapered capsule, or x, y, half axes
a, b, angle of a from x, 0, 1 of an ellipse [px], or the same with 2 at the end of a tube: a rectangle that is round
across, along a. Then follow the reflectance of red, green and blue, gloss, exponent of
the highlight, and the index of the marker or -1.
"""

# ruff: noqa: PLR0912, PLR0917 - compiled: loops are written out
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]


@njit(cache=True)
def surface(p: Float64, x: float, y: float, out: Float64) -> None:
    """Compute how much of a pixel a shape covers, and the shape's normal there.

    Args:
        p: (13,) the shape: x0, y0, x1, y1, r0, r1, 0 of a tapered capsule, or x, y, half axes a, b, angle of a from x
            [rad], 0, and 1 of an ellipse or 2 of a tube [px]; the other six, its look, are not used.
        x, y: centre of the pixel [px].
        out: (4,) written: coverage from 0 to 1; x, y, z of the unit normal, z towards the camera.
    """
    if p[6] > 0.5:
        c, s = math.cos(p[4]), math.sin(p[4])
        u, v = c * (x - p[0]) + s * (y - p[1]), -s * (x - p[0]) + c * (y - p[1])
        a, b = p[2], p[3]
        if p[6] > 1.5:
            outside = max(abs(u) - a, abs(v) - b)
            nu, nv = 0.9 * u / a, 0.0
        else:
            q = math.sqrt((u / a) ** 2 + (v / b) ** 2)
            slope = math.sqrt((u / (a * a)) ** 2 + (v / (b * b)) ** 2) / max(q, 1e-9)  # of q, per pixel
            outside = (q - 1.0) / slope if q > 1e-3 else -min(a, b)
            nu, nv = 0.8 * u / a, 0.8 * v / b
        nx, ny = c * nu - s * nv, s * nu + c * nv
    else:
        dx, dy = p[2] - p[0], p[3] - p[1]
        along = min(max(((x - p[0]) * dx + (y - p[1]) * dy) / max(dx * dx + dy * dy, 1e-9), 0.0), 1.0)
        ex, ey, r = x - p[0] - along * dx, y - p[1] - along * dy, p[4] + along * (p[5] - p[4])
        distance = math.sqrt(ex * ex + ey * ey)
        outside = distance - r
        nx, ny = 0.9 * ex / r, 0.9 * ey / r
    square = nx * nx + ny * ny
    if square > 0.98:
        nx, ny, square = nx * math.sqrt(0.98 / square), ny * math.sqrt(0.98 / square), 0.98
    out[0], out[1], out[2], out[3] = min(max(0.5 - outside, 0.0), 1.0), nx, ny, math.sqrt(1.0 - square)


@njit(cache=True)
def photograph(
    wall: Float32, shapes: Float64, rates: Float64, sub_times: Float64, row_s: float, light: Float64, towards: Float64,
    shading: float, linear: Float32, seen: Float64,
) -> None:  # fmt: skip
    """Render the linear light of an image, and measure each marker's visible area.

    Args:
        wall: (h, w, 3) float32 reflectance of the background.
        shapes: (n, 13) at the middle of the first row's exposure, back to front, see the module.
        rates: (n, 13) change of ``shapes`` per second.
        sub_times: (k,) instants of an exposure, relative to its middle [s].
        row_s: delay from one row to the next [s].
        light: (3,) strength of the light in red, green, blue.
        towards: (3,) unit vector towards the light: x right, y down, z towards the camera.
        shading: fraction of the light that is directed, 0 to 1.
        linear: (h, w, 3) float32, written: red, green, blue.
        seen: (markers,) visible area of each marker [px²]; added to.
    """
    h, w, _ = wall.shape
    n, markers = len(shapes), len(seen)
    cover, left, begin, end = (
        np.empty(4),
        np.zeros((markers, w)),
        np.zeros(markers, np.int64),
        np.zeros(markers, np.int64),
    )
    p = np.empty(13)
    hx, hy, hz = towards[0], towards[1], towards[2] + 1.0  # halfway vector
    size = math.sqrt(hx * hx + hy * hy + hz * hz)
    hx, hy, hz = hx / size, hy / size, hz / size
    part = 1.0 / len(sub_times)
    row = np.empty((w, 3))
    flat = (1.0 - shading) + shading * towards[2]
    for y in range(h):
        linear[y] = 0.0
        for t in sub_times:
            for x in range(w):
                for k in range(3):
                    row[x, k] = flat * light[k] * wall[y, x, k]
            end[:] = 0
            begin[:] = 0
            for i in range(n):
                for k in range(13):
                    p[k] = shapes[i, k] + (t + row_s * y) * rates[i, k]
                if p[6] > 0.5:
                    reach = 1.0 + (max(p[2], p[3]) if p[6] < 1.5 else math.hypot(p[2], p[3]))
                    top, low, x0, x1 = p[1] - reach, p[1] + reach, p[0] - reach, p[0] + reach
                else:
                    reach = max(p[4], p[5]) + 1.0
                    top, low = min(p[1], p[3]) - reach, max(p[1], p[3]) + reach
                    x0, x1 = min(p[0], p[2]) - reach, max(p[0], p[2]) + reach
                if y < top or y > low or x1 < 0 or x0 > w - 1:
                    continue
                marker = round(p[12])
                a, b = max(int(x0), 0), min(int(x1) + 2, w)
                if marker >= 0:
                    begin[marker], end[marker] = a, b
                    left[marker, a:b] = 0.0
                for x in range(a, b):
                    surface(p, float(x), float(y), cover)
                    c = cover[0]
                    if c <= 0.0:
                        continue
                    lit = cover[1] * towards[0] + cover[2] * towards[1] + cover[3] * towards[2]
                    lit = (1.0 - shading) + shading * max(lit, 0.0)
                    glance = max(cover[1] * hx + cover[2] * hy + cover[3] * hz, 0.0)
                    glance = p[10] * shading * glance ** p[11]
                    for k in range(3):
                        row[x, k] += c * (light[k] * (lit * p[7 + k] + glance) - row[x, k])
                    for m in range(markers):
                        if begin[m] <= x < end[m]:
                            left[m, x] *= 1.0 - c
                    if marker >= 0:
                        left[marker, x] = c
            for m in range(markers):
                for x in range(begin[m], end[m]):
                    seen[m] += part * left[m, x]
            for x in range(w):
                for k in range(3):
                    linear[y, x, k] += part * row[x, k]
