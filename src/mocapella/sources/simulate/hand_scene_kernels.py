"""The loops of `mocapella.sources.simulate.hand_scene`, compiled; importing this module imports numba.

A part of the hand is a capsule, a row of 13 numbers in the camera's space: ends a and b [m], radius [m]; what it
reflects of red, green, blue; gloss; exponent of the highlight; which marker it is, or -1.
"""

# ruff: noqa: PLR0912, PLR0917 - compiled: arrays come by position, and loops are written out
from __future__ import annotations

import math

import numpy as np

from mocapella.compiled import njit

SAMPLES = 4
"""Rays of a pixel, 2 × 2, each at another instant of the exposure; which one has which changes from pixel to pixel."""


@njit(cache=True, nogil=True)
def hit(ax, ay, az, bx, by, bz, radius, dx, dy):
    """Depth z at which the ray (dx, dy, 1)·z meets a capsule first, and how far along it; infinite for never."""
    ux, uy, uz = bx - ax, by - ay, bz - az
    uu = ux * ux + uy * uy + uz * uz
    dd = dx * dx + dy * dy + 1.0
    ud, ua, da = ux * dx + uy * dy + uz, ux * ax + uy * ay + uz * az, dx * ax + dy * ay + az
    aa = ax * ax + ay * ay + az * az
    # |p - axis|² = radius² with p = z·d: a quadratic equation in z.
    A, B = uu * dd - ud * ud, uu * da - ud * ua
    if 1e-12 * uu < A:
        root = B * B - A * (uu * (aa - radius * radius) - ua * ua)
        if root < 0.0:
            return math.inf, 0.0
        z = (B - math.sqrt(root)) / A
        along = z * ud - ua
        if 0.0 < along < uu:
            return z, along / uu
        end = 0.0 if along <= 0.0 else 1.0
    else:
        end = 0.0
    ex, ey, ez = ax + end * ux, ay + end * uy, az + end * uz
    de, ee = dx * ex + dy * ey + ez, ex * ex + ey * ey + ez * ez
    root = de * de - dd * (ee - radius * radius)
    return ((de - math.sqrt(root)) / dd, end) if root >= 0.0 else (math.inf, 0.0)


@njit(cache=True, nogil=True)
def spans(parts, rates, pixel_of, reach, h, w, out):
    """Rows and columns (n, 4) that a part can be in; ``pixel_of``: fx, fy, cx, cy; ``reach``: largest time [s]."""
    for i in range(len(parts)):
        x0, x1, y0, y1 = float(w), -1.0, float(h), -1.0
        for end in range(2):
            for sign in (-1.0, 1.0):
                t = sign * reach
                px = parts[i, 3 * end] + t * rates[i, 3 * end]
                py = parts[i, 3 * end + 1] + t * rates[i, 3 * end + 1]
                pz = parts[i, 3 * end + 2] + t * rates[i, 3 * end + 2]
                near = max(pz - parts[i, 6], 0.02)
                fx, fy = pixel_of[0], pixel_of[1]
                r = 1.08 * parts[i, 6] / near + 0.02 * (abs(px) + abs(py)) / near  # the lens' distortion is small
                x0, x1 = min(x0, pixel_of[2] + fx * (px / near - r)), max(x1, pixel_of[2] + fx * (px / near + r))
                y0, y1 = min(y0, pixel_of[3] + fy * (py / near - r)), max(y1, pixel_of[3] + fy * (py / near + r))
                far = pz + parts[i, 6]
                x0, x1 = min(x0, pixel_of[2] + fx * (px / far - r)), max(x1, pixel_of[2] + fx * (px / far + r))
                y0, y1 = min(y0, pixel_of[3] + fy * (py / far - r)), max(y1, pixel_of[3] + fy * (py / far + r))
        out[i, 0], out[i, 1] = max(math.floor(y0) - 2, 0), min(math.ceil(y1) + 3, h)
        out[i, 2], out[i, 3] = max(math.floor(x0) - 2, 0), min(math.ceil(x1) + 3, w)


@njit(cache=True, nogil=True)
def photograph(wall, rays, parts, rates, pixel_of, exposure_s, readout_s, light, towards, shading, linear, seen, whole):
    """Write the picture (h, w, 3) float32, and count each marker's rays: ``seen``, and ``whole`` if nothing hid it.

    Args:
        wall: (h, w, 3) float32 what is behind.
        rays: (h, w, SAMPLES, 2) float32 directions x/z, y/z of each pixel's rays.
        parts: (n, 13) at the time of the first row's middle; rates: (n, 6) of their ends [m/s].
        exposure_s, readout_s: see `HandSceneSettings`.
        light: (3,) red, green, blue; towards: (3,) unit vector to it, camera space; shading: the part of it that has
            a direction.
    """
    h, w, _ = wall.shape
    n = len(parts)
    area = np.empty((n, 4), np.int64)
    spans(parts, rates, pixel_of, exposure_s + readout_s, h, w, area)
    depth, which, along = np.empty((w, SAMPLES)), np.empty((w, SAMPLES), np.int64), np.empty((w, SAMPLES))
    ends, moved = np.empty((SAMPLES, n, 6)), np.empty(SAMPLES)
    flat = (1.0 - shading) - shading * min(towards[2], 0.0)
    for y in range(h):
        for s in range(SAMPLES):
            moved[s] = readout_s * y / h + exposure_s * ((s + 0.5) / SAMPLES - 0.5)
        x0, x1 = w, 0
        for i in range(n):
            if area[i, 0] <= y < area[i, 1]:
                x0, x1 = min(x0, area[i, 2]), max(x1, area[i, 3])
                for s in range(SAMPLES):
                    for k in range(6):
                        ends[s, i, k] = parts[i, k] + moved[s] * rates[i, k]
        if x0 < x1:
            depth[x0:x1] = math.inf
        for i in range(n):
            if not area[i, 0] <= y < area[i, 1]:
                continue
            marker = int(parts[i, 12])
            for x in range(area[i, 2], area[i, 3]):
                for s in range(SAMPLES):
                    e = ends[(s + x + 2 * y) % SAMPLES, i]
                    z, u = hit(
                        e[0],
                        e[1],
                        e[2],
                        e[3],
                        e[4],
                        e[5],
                        parts[i, 6],
                        float(rays[y, x, s, 0]),
                        float(rays[y, x, s, 1]),
                    )
                    if not 0.0 < z < math.inf:
                        continue
                    if marker >= 0:
                        whole[marker] += 1.0
                    if z < depth[x, s]:
                        depth[x, s], which[x, s], along[x, s] = z, i, u
        for x in range(w):
            for k in range(3):
                linear[y, x, k] = flat * light[k] * wall[y, x, k]
        for x in range(x0, x1):
            for s in range(SAMPLES):
                z = depth[x, s]
                if not z < math.inf:
                    continue
                i, u = which[x, s], along[x, s]
                p, e = parts[i], ends[(s + x + 2 * y) % SAMPLES, i]
                dx, dy = float(rays[y, x, s, 0]), float(rays[y, x, s, 1])
                nx = (z * dx - e[0] - u * (e[3] - e[0])) / p[6]
                ny = (z * dy - e[1] - u * (e[4] - e[1])) / p[6]
                nz = (z - e[2] - u * (e[5] - e[2])) / p[6]
                size = 1.0 / math.sqrt(dx * dx + dy * dy + 1.0)
                hx, hy, hz = towards[0] - size * dx, towards[1] - size * dy, towards[2] - size  # half way to the eye
                half = math.sqrt(hx * hx + hy * hy + hz * hz)
                lit = (1.0 - shading) + shading * max(nx * towards[0] + ny * towards[1] + nz * towards[2], 0.0)
                glance = max((nx * hx + ny * hy + nz * hz) / max(half, 1e-9), 0.0)
                glance = p[10] * shading * glance ** p[11]
                grain = 1.0
                if p[12] < 0:  # skin is not of one colour; the pattern goes with the hand
                    grain += 0.05 * math.sin(900.0 * u * p[6] + 5.0 * nx + i) * math.sin(7.0 * ny + 300.0 * u * p[6])
                for k in range(3):
                    linear[y, x, k] += (
                        light[k] * (lit * grain * p[7 + k] + glance) - flat * light[k] * wall[y, x, k]
                    ) / SAMPLES
                if p[12] >= 0:
                    seen[int(p[12])] += 1.0
