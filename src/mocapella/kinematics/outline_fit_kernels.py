"""Kernels that match a body's outline with an image's, as point-to-plane constraints.

The camera centre and the tangent of the image's outline at a point span a plane that touches the body, and so
constrains the matched surface point. The point may slide along the outline, which does not show its position there.

Importing this module imports numba.
"""

# ruff: noqa: PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.geometry.lens_kernels import distort, undistorted_all

Float32 = NDArray[np.float32]
Int32 = NDArray[np.int32]
Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

BIN_PX = 8.0
"""Height of the horizontal bands into which an outline's points are sorted for the search of the nearest [px]."""


HIT = 6
"""Number of values of a match.

They are x and y of the point on the image's outline [px], the signed distance's derivatives by x and y there, the
length of outline that it represents, times its certainty [px], and the distance of the matched points [px].
"""


# Small functions go into their callers' loops: handed on, an array's references are counted.
@njit(cache=True, error_model="numpy", forceinline=True)
def _level(phi: Float32, x0: float, y0: float, per_px: float, x: float, y: float) -> tuple[float, float, float]:
    """Return phi (rows, columns) and its derivatives by x and y at an image point (x, y), bilinear; NaN outside.

    ``x0``, ``y0`` is the first sample's image point [px], and ``per_px`` the inverse of the sampling step.
    """
    u, v = per_px * (x - x0), per_px * (y - y0)
    rows, columns = phi.shape
    if not (0.0 <= u <= columns - 1.0 and 0.0 <= v <= rows - 1.0):
        return math.nan, 0.0, 0.0
    i, j = min(int(v), rows - 2), min(int(u), columns - 2)
    s, t = u - j, v - i
    a, b, c, d = phi[i, j], phi[i, j + 1], phi[i + 1, j], phi[i + 1, j + 1]
    value = (1.0 - t) * ((1.0 - s) * a + s * b) + t * ((1.0 - s) * c + s * d)
    return value, per_px * ((1.0 - t) * (b - a) + t * (d - c)), per_px * ((1.0 - s) * (c - a) + s * (d - b))


@njit(cache=True, error_model="numpy")
def _constraints(
    hits: Float64, which: Int64, k: int, points: Float64, bone: Int32, far: Float64, soft_px: float, sd_px: float,
    R: Float64, t: Float64, lens: Float64, farthest_r2: float, T: Float64,
) -> tuple[Int64, Float64, Float64, Float64]:  # fmt: skip
    """Convert k matches to the planes that `touching` returns, which describes the arguments.

    A match is a row of ``hits`` (k, HIT) with the surface point ``which`` (k,). The plane n·x = d contains the camera
    centre and the tangent of the image's outline at the match. Matches whose pixel the lens model cannot undistort are
    left out.
    """
    part, rest, planes, weights = np.empty(k, np.int64), np.empty((k, 3)), np.empty((k, 4)), np.empty(k)
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    k1, k2, p1, p2, k3 = lens[4], lens[5], lens[6], lens[7], lens[8]
    per_fx, per_fy, per_soft, per_m = 1.0 / fx, 1.0 / fy, 1.0 / soft_px, fx / sd_px
    seen, straight = np.empty((2, k)), np.empty((2, k))
    for h in range(k):
        seen[0, h], seen[1, h] = per_fx * (hits[h, 0] - cx), per_fy * (hits[h, 1] - cy)
    undistorted_all(seen[0], seen[1], k1, k2, p1, p2, k3, farthest_r2, straight[0], straight[1])
    n = 0
    for h in range(k):
        gx, gy, length, miss, u, v = hits[h, 2], hits[h, 3], hits[h, 4], hits[h, 5], straight[0, h], straight[1, h]
        if not math.isfinite(u + v):
            continue
        _, _, uu, uv, vv = distort(u, v, k1, k2, p1, p2, k3)
        a, b = fx * uu * gx + fy * uv * gy, fx * uv * gx + fy * vv * gy
        c = -(a * u + b * v)
        f = 1.0 / math.sqrt(a * a + b * b + c * c)
        a, b, c = f * a, f * b, f * c
        for d in range(3):
            planes[n, d] = T[0, d] * a + T[1, d] * b + T[2, d] * c
        planes[n, 3] = -(a * T[0, 3] + b * T[1, 3] + c * T[2, 3])
        i = which[h]
        p = np.int64(bone[i])
        a, b, c = points[i, 0] - t[p, 0], points[i, 1] - t[p, 1], points[i, 2] - t[p, 2]
        for d in range(3):
            rest[n, d] = R[p, d] * a + R[p, 3 + d] * b + R[p, 6 + d] * c
        m = miss * per_soft
        sure = per_m / ((1.0 + m * m) * far[i])  # the square root of a robust weight, over an outline's deviation [m]
        part[n] = p
        weights[n] = length * sure * sure
        n += 1
    return part[:n], rest[:n], planes[:n], weights[:n]


@njit(cache=True, error_model="numpy")
def _to_image(
    phi: Float32, surety: Float32, x0: int, y0: int, step: int, reach_px: float, at: Float64, normals: Float64,
    full: float, hits: Float64, which: Int64,
) -> int:  # fmt: skip
    """Match the body's outline with the nearest point of the image's, along the gradient of its level set.

    `touching` describes the arguments; ``hits`` (room, HIT) and ``which`` (room,) are written. Returns their number.
    """
    k, per_px, per_full = 0, 1.0 / step, 1.0 / full
    for i in range(len(at)):
        x, y = at[i, 0], at[i, 1]
        value, gx, gy = _level(phi, x0, y0, per_px, x, y)
        slope2 = gx * gx + gy * gy
        if not (abs(value) < reach_px and slope2 > 0.09):
            continue
        length = math.sqrt(normals[i, 0] ** 2 + normals[i, 1] ** 2)
        if -(gx * normals[i, 0] + gy * normals[i, 1]) < 0.5 * length * math.sqrt(slope2):
            continue
        f = value / slope2
        u, v = x - f * gx, y - f * gy
        again, hx, hy = _level(phi, x0, y0, per_px, u, v)
        slope2 = hx * hx + hy * hy
        if not slope2 > 0.09:
            continue
        f = again / slope2
        u, v = u - f * hx, v - f * hy
        miss = math.sqrt((u - x) ** 2 + (v - y) ** 2)
        if miss > reach_px:
            continue
        row, column = round(per_px * (v - y0)), round(per_px * (u - x0))
        if not (0 <= row < phi.shape[0] and 0 <= column < phi.shape[1]):
            continue
        sure = min(max(per_full * surety[row, column], 0.0), 1.0)
        hits[k, 0], hits[k, 1], hits[k, 2], hits[k, 3], hits[k, 4], hits[k, 5] = u, v, hx, hy, sure * length, miss
        which[k] = i
        k += 1
    return k


@njit(cache=True, error_model="numpy")
def _by_rows(at: Float64) -> tuple[float, int, Int64, Int64]:
    """Sort points into bands of `BIN_PX`: top [px], number of bands, their starts (bands + 1,) in the order (n,)."""
    count = len(at)
    if count == 0:
        return 0.0, 0, np.zeros(1, np.int64), np.zeros(0, np.int64)
    top, bottom = at[:, 1].min(), at[:, 1].max()
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
def _to_body(
    phi: Float32, surety: Float32, x0: int, y0: int, step: int, every: int, reach_px: float, at: Float64,
    normals: Float64, full: float, hits: Float64, which: Int64, k: int,
) -> int:  # fmt: skip
    """Match samples of the image's outline with the nearest point of the body's that has a similar direction.

    `touching` describes the arguments; ``hits`` and ``which`` are written from ``k`` on. Returns the next free index.
    """
    seen = 0
    rows, columns = phi.shape
    top, bins, starts, order = _by_rows(at)
    beside = np.zeros((columns + 7) // 8 * 8, np.uint8)
    by_eight = beside.view(np.uint64)
    for i in range(1, rows - 1):
        above, here, below, to = phi[i - 1, 1:], phi[i], phi[i + 1, 1:], beside[1 : columns - 1]
        left, right, middle = here, here[2:], here[1:]
        for j in range(len(to)):
            least = left[j] if left[j] < right[j] else right[j]
            least = above[j] if above[j] < least else least
            least = below[j] if below[j] < least else least
            to[j] = (middle[j] > 0) & (least <= 0)
        for n in range(len(by_eight)):
            if by_eight[n] == 0:
                continue
            for j in range(8 * n, min(8 * n + 8, columns)):
                if not beside[j]:
                    continue
                seen += 1
                if seen % every != 0:
                    continue
                value = phi[i, j]
                gx, gy = 0.5 * (phi[i, j + 1] - phi[i, j - 1]) / step, 0.5 * (phi[i + 1, j] - phi[i - 1, j]) / step
                slope2 = gx * gx + gy * gy
                if not slope2 > 0.09:
                    continue
                u, v = x0 + step * j - value * gx / slope2, y0 + step * i - value * gy / slope2
                best, nearest = reach_px * reach_px, -1
                low = max(int((v - reach_px - top) / BIN_PX), 0)
                high = min(int((v + reach_px - top) / BIN_PX) + 1, bins)
                for q in range(starts[low] if low < bins else 0, starts[high] if low < bins and high > low else 0):
                    m = order[q]
                    du, dv = at[m, 0] - u, at[m, 1] - v
                    d2 = du * du + dv * dv
                    if d2 < best:
                        n2 = normals[m, 0] ** 2 + normals[m, 1] ** 2
                        across = -(gx * normals[m, 0] + gy * normals[m, 1])
                        if across > 0.0 and across * across > 0.25 * slope2 * n2:
                            best, nearest = d2, m
                if nearest < 0:
                    continue
                sure = min(max(surety[i, j] / full, 0.0), 1.0) * step * every
                hits[k, 0], hits[k, 1], hits[k, 2], hits[k, 3], hits[k, 4] = u, v, gx, gy, sure
                hits[k, 5] = math.sqrt(best)
                which[k] = nearest
                k += 1
    return k


@njit(cache=True, error_model="numpy")
def touching(
    phi: Float32, surety: Float32, x0: int, y0: int, step: int, every: int, reach_px: float, at: Float64,
    normals: Float64, points: Float64, bone: Int32, far: Float64, soft_px: float, sd_px: float, full: float,
    R: Float64, t: Float64, lens: Float64, farthest_r2: float, T: Float64,
) -> tuple[Int64, Float64, Float64, Float64]:  # fmt: skip
    """Match a body's outline with an image's, in both directions; return the planes that constrain the body's points.

    Args:
        phi: (rows, columns) signed distance to the image's outline, positive inside, valid up to ``reach_px`` [px].
        surety: (rows, columns) log-likelihood ratio of the side on which a sample lies against the other side [nats].
        x0, y0, step: pixel of the first sample, and distance between samples [px].
        every: stride between samples of the image's outline.
        reach_px: largest distance of a match [px].
        at, normals, points, bone, far: (n, 2) outline points [px], (n, 2) outward normals [px], (n, 3) positions in the
            world [m], (n,) parts and (n,) depths [m], of `outline_kernels.outline`.
        soft_px: scale of the robust loss: at this residual the weight is a quarter (Geman and McClure).
        sd_px: standard deviation of the image outline's position, for one pixel of its length [px].
        full: least ``surety`` of a match with full weight [nats].
        R, t: (parts, 9), (parts, 3) the parts' motions from rest: rotations row by row, translations [m].
        lens, farthest_r2, T: lens and its range as in `outline_kernels.see`, and ``T_camera_world`` (4, 4).

    Returns:
        (n,) part, (n, 3) points at rest [m], (n, 4) planes in the world (unit normal, offset [m]) and (n,) weights
        [1/m²].
    """
    room = len(at) + phi.size // every
    hits, which = np.empty((room, HIT)), np.empty(room, np.int64)
    k = _to_image(phi, surety, x0, y0, step, reach_px, at, normals, full, hits, which)
    k = _to_body(phi, surety, x0, y0, step, every, reach_px, at, normals, full, hits, which, k)
    part, rest, planes, weight = _constraints(
        hits, which, k, points, bone, far, soft_px, sd_px, R, t, lens, farthest_r2, T
    )
    return part, rest, planes, weight
