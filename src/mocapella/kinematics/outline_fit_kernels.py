"""Which point of a body's outline belongs to which point of an image's, and the plane it is to lie in; compiled.

The eye, a point of the image's outline and the direction of the outline there make a plane that touches the body: the
surface's point is to lie in it. How far along the outline it lies is left open, because the outline does not say it.

Importing this module imports numba.
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position, and loops are written out
from __future__ import annotations

import math

import numpy as np

from mocapella.compiled import njit
from mocapella.geometry.lens_kernels import distort, undistort

BIN_PX = 8.0
"""Points of an outline are looked up by rows so high."""


@njit(cache=True, error_model="numpy")
def level(phi, x0, y0, step, x, y):
    """phi (rows, columns) at the image's point (x, y), and its slopes along x and y: bilinear; NaN outside."""
    u, v = (x - x0) / step, (y - y0) / step
    rows, columns = phi.shape
    if not (0.0 <= u <= columns - 1.0 and 0.0 <= v <= rows - 1.0):
        return math.nan, 0.0, 0.0
    i, j = min(int(v), rows - 2), min(int(u), columns - 2)
    s, t = u - j, v - i
    a, b, c, d = phi[i, j], phi[i, j + 1], phi[i + 1, j], phi[i + 1, j + 1]
    value = (1.0 - t) * ((1.0 - s) * a + s * b) + t * ((1.0 - s) * c + s * d)
    return value, ((1.0 - t) * (b - a) + t * (d - c)) / step, ((1.0 - s) * (c - a) + s * (d - b)) / step


@njit(cache=True, error_model="numpy")
def touching_plane(lens, farthest_r2, T_camera_world, x, y, nx, ny, plane):
    """Write n·x = d (4,) in the world: through the eye and the line through the pixel (x, y) across (nx, ny).

    Returns whether the lens shows such a direction.
    """
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    k1, k2, p1, p2, k3 = lens[4], lens[5], lens[6], lens[7], lens[8]
    u, v = undistort((x - cx) / fx, (y - cy) / fy, k1, k2, p1, p2, k3, farthest_r2)
    if not math.isfinite(u + v):
        return False
    _, _, uu, uv, vv = distort(u, v, k1, k2, p1, p2, k3)
    a, b = fx * uu * nx + fy * uv * ny, fx * uv * nx + fy * vv * ny
    c = -(a * u + b * v)
    f = 1.0 / math.sqrt(a * a + b * b + c * c)
    a, b, c = f * a, f * b, f * c
    T = T_camera_world
    for d in range(3):
        plane[d] = T[0, d] * a + T[1, d] * b + T[2, d] * c
    plane[3] = -(a * T[0, 3] + b * T[1, 3] + c * T[2, 3])
    return True


@njit(cache=True, error_model="numpy")
def _add(
    k,
    x,
    y,
    gx,
    gy,
    far,
    point,
    bone,
    length,
    miss,
    soft_px,
    sd_px,
    R,
    t,
    lens,
    farthest_r2,
    T,
    part,
    rest,
    planes,
    weights,
):
    """One constraint: the surface's point ``point`` of ``bone`` is to be seen on the line through (x, y) across g."""
    if not touching_plane(lens, farthest_r2, T, x, y, gx, gy, planes[k]):
        return k
    A, o = R[bone], t[bone]
    a, b, c = point[0] - o[0], point[1] - o[1], point[2] - o[2]
    for d in range(3):
        rest[k, d] = A[d] * a + A[3 + d] * b + A[6 + d] * c
    m = miss / soft_px
    robust = 1.0 / (1.0 + m * m)
    size = sd_px * far / lens[0]
    part[k] = bone
    weights[k] = length * robust * robust / (size * size)
    return k + 1


@njit(cache=True, error_model="numpy")
def to_image(
    phi, surety, x0, y0, step, reach_px, at, normals, points, bone, far, count, soft_px, sd_px, full, R, t, lens,
    farthest_r2, T, part, rest, planes, weights,
):  # fmt: skip
    """From the body's outline to the nearest of the image's, along the slope of its level set.

    Args:
        phi, x0, y0, step: of `Silhouette`: signed distances up to ``reach_px``.
        surety: (rows, columns) how much the image says for an edge [nats]; from ``full`` on it counts in full.
        at, normals, points, bone, far, count: of `outline_kernels.outline`.
        soft_px: a miss of so much counts a quarter, and larger ones ever less (Geman and McClure).
        sd_px: of an outline [px].
        R, t: (parts, 9), (parts, 3) the parts' motions.
        lens, farthest_r2, T: of the camera.
        part, rest, planes, weights: written: `twist_fit.InPlanes`.

    Returns:
        How many.
    """
    k = 0
    for i in range(count):
        x, y = at[i, 0], at[i, 1]
        value, gx, gy = level(phi, x0, y0, step, x, y)
        slope2 = gx * gx + gy * gy
        if not (abs(value) < reach_px and slope2 > 0.09):
            continue
        length = math.sqrt(normals[i, 0] ** 2 + normals[i, 1] ** 2)
        if -(gx * normals[i, 0] + gy * normals[i, 1]) < 0.5 * length * math.sqrt(slope2):
            continue
        f = value / slope2
        u, v = x - f * gx, y - f * gy
        again, hx, hy = level(phi, x0, y0, step, u, v)
        slope2 = hx * hx + hy * hy
        if not slope2 > 0.09:
            continue
        f = again / slope2
        u, v = u - f * hx, v - f * hy
        miss = math.sqrt((u - x) ** 2 + (v - y) ** 2)
        if miss > reach_px:
            continue
        row, column = round((v - y0) / step), round((u - x0) / step)
        if not (0 <= row < phi.shape[0] and 0 <= column < phi.shape[1]):
            continue
        sure = min(max(surety[row, column] / full, 0.0), 1.0)
        k = _add(
            k, u, v, hx, hy, far[i], points[i], bone[i], sure * length, miss, soft_px, sd_px, R, t, lens, farthest_r2,
            T, part, rest, planes, weights,
        )  # fmt: skip
    return k


@njit(cache=True, error_model="numpy")
def _by_rows(at, count):
    """Where rows of `BIN_PX` begin: of the first one [px], how many, (bins + 1,) starts in the order (count,)."""
    if count == 0:
        return 0.0, 0, np.zeros(1, np.int64), np.zeros(0, np.int64)
    top, bottom = at[:count, 1].min(), at[:count, 1].max()
    bins = int((bottom - top) / BIN_PX) + 1
    starts, order = np.zeros(bins + 1, np.int64), np.empty(count, np.int64)
    for m in range(count):
        starts[int((at[m, 1] - top) / BIN_PX) + 1] += 1
    for b in range(bins):
        starts[b + 1] += starts[b]
    filled = starts[:-1].copy()
    for m in range(count):
        b = int((at[m, 1] - top) / BIN_PX)
        order[filled[b]] = m
        filled[b] += 1
    return top, bins, starts, order


@njit(cache=True, error_model="numpy")
def to_body(
    phi, surety, x0, y0, step, every, reach_px, at, normals, points, bone, far, count, soft_px, sd_px, full, R, t,
    lens, farthest_r2, T, part, rest, planes, weights,
):  # fmt: skip
    """From the image's outline, at every so many samples, to the nearest of the body's with a similar direction.

    Arguments and what is returned as of `to_image`.
    """
    k, seen = 0, 0
    rows, columns = phi.shape
    top, bins, starts, order = _by_rows(at, count)
    for i in range(1, rows - 1):
        for j in range(1, columns - 1):
            value = phi[i, j]
            if not value > 0.0:
                continue
            if phi[i, j + 1] > 0.0 and phi[i, j - 1] > 0.0 and phi[i + 1, j] > 0.0 and phi[i - 1, j] > 0.0:
                continue
            seen += 1
            if seen % every != 0:
                continue
            gx, gy = 0.5 * (phi[i, j + 1] - phi[i, j - 1]) / step, 0.5 * (phi[i + 1, j] - phi[i - 1, j]) / step
            slope2 = gx * gx + gy * gy
            if not slope2 > 0.09:
                continue
            u, v = x0 + step * j - value * gx / slope2, y0 + step * i - value * gy / slope2
            best, which = reach_px * reach_px, -1
            low = max(int((v - reach_px - top) / BIN_PX), 0)
            high = min(int((v + reach_px - top) / BIN_PX) + 1, bins)
            for n in range(starts[low] if low < bins else 0, starts[high] if low < bins and high > low else 0):
                m = order[n]
                du, dv = at[m, 0] - u, at[m, 1] - v
                d2 = du * du + dv * dv
                if d2 < best:
                    n2 = normals[m, 0] ** 2 + normals[m, 1] ** 2
                    across = -(gx * normals[m, 0] + gy * normals[m, 1])
                    if across > 0.0 and across * across > 0.25 * slope2 * n2:
                        best, which = d2, m
            if which < 0:
                continue
            sure = min(max(surety[i, j] / full, 0.0), 1.0) * step * every
            k = _add(
                k, u, v, gx, gy, far[which], points[which], bone[which], sure, math.sqrt(best), soft_px, sd_px, R, t,
                lens, farthest_r2, T, part, rest, planes, weights,
            )  # fmt: skip
    return k
