"""The loops of `mocapella.sources.simulate.marker_scene`, compiled; importing this module imports numba.

A shape is a row of 13 numbers. A tapered capsule: x0, y0, x1, y1, r0, r1, 0. An ellipse: x, y, half axes a, b, the
angle of a from x, 0, 1. Then both: what is reflected of red, green, blue; gloss; exponent of the highlight; which
marker it is, or -1.
"""

# ruff: noqa: PLR0912, PLR0917 - compiled: arrays come by position, and loops are written out
from __future__ import annotations

import math

import numpy as np

from mocapella.compiled import njit


@njit(cache=True)
def surface(p, x, y, out):
    """Of shape p at the pixel (x, y): write coverage 0 … 1 and the unit normal's x, y, z into out (4,)."""
    if p[6] > 0.5:
        c, s = math.cos(p[4]), math.sin(p[4])
        u, v = c * (x - p[0]) + s * (y - p[1]), -s * (x - p[0]) + c * (y - p[1])
        a, b = p[2], p[3]
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
def photograph(wall, shapes, rates, sub_times, row_s, light, towards, shading, linear, seen):
    """Write the picture (h, w, 3) float32 and add each marker's visible area [px] to seen.

    Args:
        wall: (h, w, 3) float32 what is behind.
        shapes: (n, 13) at the time 0, back to front; rates: their change per second.
        sub_times: when the instants of an exposure are, from its middle [s]; row_s: how much later each row is.
        light: (3,) red, green, blue; towards: (3,) unit vector to it; shading: the part of it that has a direction.
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
    hx, hy, hz = towards[0], towards[1], towards[2] + 1.0  # half way to the eye
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
                    reach = max(p[2], p[3]) + 1.0
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
