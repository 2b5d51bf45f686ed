"""Compiled kernels of `mocapella.sources.simulate.hand_scene`; importing this module imports numba.

A part of the hand is a capsule, a row of 13 numbers in the camera frame: ends a and b [m], radius [m], reflectance of
red, green and blue, gloss, exponent of the highlight, index of the marker or -1.
"""

# ruff: noqa: PLR0912, PLR0915, PLR0917 - compiled: loops are written out
from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

SAMPLES = 4
"""Number of rays per pixel, 2 × 2, each at its own instant of the exposure, which alternates from pixel to pixel."""


class HandCamera(NamedTuple):
    """The camera that photographs a hand.

    Attributes:
        pinhole: (4,) fx, fy, cx, cy [px].
        exposure_s: exposure time of a row [s].
        readout_s: readout time from the first row to the last [s].
    """

    pinhole: Float64
    exposure_s: float
    readout_s: float


class HandLight(NamedTuple):
    """The light on a hand.

    Attributes:
        colour: (3,) strength in red, green, blue.
        towards: (3,) unit vector towards the light, camera frame.
        shading: fraction of the light that is directed, 0 to 1; the rest is ambient.
    """

    colour: Float64
    towards: Float64
    shading: float


@njit(cache=True, nogil=True)
def hit(
    ax: float, ay: float, az: float, bx: float, by: float, bz: float, radius: float, dx: float, dy: float
) -> tuple[float, float]:
    """Intersect the ray z · (dx, dy, 1) from the camera with a capsule.

    Args:
        ax, ay, az, bx, by, bz: ends of the capsule's axis in the camera frame [m].
        radius: radius of the capsule [m].
        dx, dy: direction x/z, y/z of the ray.

    Returns:
        Depth z of the first intersection [m], infinite without one; and its place along the axis, from 0 to 1.
    """
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
def spans(parts: Float64, rates: Float64, pinhole: Float64, reach: float, h: int, w: int, out: Int64) -> None:
    """Compute the range of rows and columns that each part can cover around the middle of the first row's exposure.

    Args:
        parts: (n, 13) capsules in the camera frame: ends (3 + 3) and radius [m], then six numbers of their look.
        rates: (n, 6) velocities of their ends [m/s].
        pinhole: (4,) fx, fy, cx, cy [px].
        reach: greatest distance in time from that middle, before or after [s].
        h, w: size of the image [px].
        out: (n, 4) written: first row, end row, first column, end column; the ends are excluded.
    """
    for i in range(len(parts)):
        x0, x1, y0, y1 = float(w), -1.0, float(h), -1.0
        for end in range(2):
            for sign in (-1.0, 1.0):
                t = sign * reach
                px = parts[i, 3 * end] + t * rates[i, 3 * end]
                py = parts[i, 3 * end + 1] + t * rates[i, 3 * end + 1]
                pz = parts[i, 3 * end + 2] + t * rates[i, 3 * end + 2]
                near = max(pz - parts[i, 6], 0.02)
                fx, fy = pinhole[0], pinhole[1]
                r = 1.08 * parts[i, 6] / near + 0.02 * (abs(px) + abs(py)) / near  # margin for the small distortion
                x0, x1 = min(x0, pinhole[2] + fx * (px / near - r)), max(x1, pinhole[2] + fx * (px / near + r))
                y0, y1 = min(y0, pinhole[3] + fy * (py / near - r)), max(y1, pinhole[3] + fy * (py / near + r))
                far = pz + parts[i, 6]
                x0, x1 = min(x0, pinhole[2] + fx * (px / far - r)), max(x1, pinhole[2] + fx * (px / far + r))
                y0, y1 = min(y0, pinhole[3] + fy * (py / far - r)), max(y1, pinhole[3] + fy * (py / far + r))
        out[i, 0], out[i, 1] = max(math.floor(y0) - 2, 0), min(math.ceil(y1) + 3, h)
        out[i, 2], out[i, 3] = max(math.floor(x0) - 2, 0), min(math.ceil(x1) + 3, w)


@njit(cache=True, nogil=True)
def photograph(
    wall: Float32, rays: Float32, parts: Float64, rates: Float64, camera: HandCamera, lighting: HandLight,
    linear: Float32, seen: Float64, whole: Float64,
) -> None:  # fmt: skip
    """Render the linear light of an image, and count each marker's rays.

    Args:
        wall: (h, w, 3) float32 reflectance of the background.
        rays: (h, w, SAMPLES, 2) float32 directions x/z, y/z of each pixel's rays.
        parts: (n, 13) capsules in the camera frame at the middle of the first row's exposure: ends (3 + 3) and radius
            [m], reflectance of red, green and blue, gloss, exponent of the highlight, index of the marker or -1.
        rates: (n, 6) velocities of their ends [m/s].
        camera, lighting: the camera, and the light on the hand.
        linear: (h, w, 3) float32, written: red, green, blue.
        seen, whole: (markers,) counts of the visible rays, and of all rays as if nothing occluded them; added to.
    """
    h, w, _ = wall.shape
    n = len(parts)
    exposure_s, readout_s = camera.exposure_s, camera.readout_s
    light, towards, shading = lighting.colour, lighting.towards, lighting.shading
    area = np.empty((n, 4), np.int64)
    spans(parts, rates, camera.pinhole, exposure_s + readout_s, h, w, area)
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
                    dx, dy = float(rays[y, x, s, 0]), float(rays[y, x, s, 1])
                    z, u = hit(e[0], e[1], e[2], e[3], e[4], e[5], parts[i, 6], dx, dy)
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
                hx, hy, hz = towards[0] - size * dx, towards[1] - size * dy, towards[2] - size  # halfway vector
                half = math.sqrt(hx * hx + hy * hy + hz * hz)
                lit = (1.0 - shading) + shading * max(nx * towards[0] + ny * towards[1] + nz * towards[2], 0.0)
                glance = max((nx * hx + ny * hy + nz * hz) / max(half, 1e-9), 0.0)
                glance = p[10] * shading * glance ** p[11]
                grain = 1.0
                if p[12] < 0:  # skin has a pattern that moves with the hand
                    grain += 0.05 * math.sin(900.0 * u * p[6] + 5.0 * nx + i) * math.sin(7.0 * ny + 300.0 * u * p[6])
                for k in range(3):
                    linear[y, x, k] += (
                        light[k] * (lit * grain * p[7 + k] + glance) - flat * light[k] * wall[y, x, k]
                    ) / SAMPLES
                if p[12] >= 0:
                    seen[int(p[12])] += 1.0
