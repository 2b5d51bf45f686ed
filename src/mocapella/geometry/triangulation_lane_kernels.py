"""Kernels that triangulate many points at a time, in lanes; importing this module imports numba.

The loops over ``m``, a point's lane, have no branches but choices of values, so that the compiler vectorises them. The
operations of a lane do not depend on the others, so a point alone is the same to the bit. Arguments are those of
`mocapella.geometry.triangulation_kernels`, whose scalar kernels take the points that are left.
"""

# ruff: noqa: PLR0912, PLR0915, PLR0917 - kernels take arrays by position; one function, so rows do not overlap
from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.geometry.lens_kernels import distort

Bool = NDArray[np.bool_]
Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]
Numbers = tuple[float, ...]

COMPILED: Final[dict[str, Any]] = {"cache": True, "error_model": "numpy"}
INLINED: Final[dict[str, Any]] = {**COMPILED, "forceinline": True}
LANES = 32
STEP = 8
"""The loops run over a multiple of this many lanes, or a compiled loop takes the rest one by one."""
LEFT, ALL, AGREED = np.uint8(0), np.uint8(1), np.uint8(2)
"""Whether a point is left to others, fitted to all its views, or to the views that agree."""


@njit(**INLINED)
def numbers_of(views: Float64, n: int) -> Numbers:
    """Return the first 22 numbers of view n of views (views, 25) as values: a loop over lanes that reads the array
    instead is not vectorised: its results might be written into that array."""
    return (
        views[n, 0], views[n, 1], views[n, 2], views[n, 3], views[n, 4], views[n, 5], views[n, 6], views[n, 7],
        views[n, 8], views[n, 9], views[n, 10], views[n, 11], views[n, 12], views[n, 13], views[n, 14], views[n, 15],
        views[n, 16], views[n, 17], views[n, 18], views[n, 19], views[n, 20], views[n, 21],
    )  # fmt: skip


@njit(**INLINED)
def offset(N: Numbers, X: float, Y: float, Z: float, u: float, v: float) -> tuple[float, float]:
    """Return the reprojection error (du, dv) of a world point in a view: measured minus projected [px].

    Args:
        N: `numbers_of` the view.
        X, Y, Z: the point [m].
        u, v: its measured pixel [px].

    Returns:
        The error; infinite where the point is behind the camera or outside the lens model.
    """
    z = N[16] * X + N[17] * Y + N[18] * Z + N[21]
    w = 1.0 / z
    x = (N[10] * X + N[11] * Y + N[12] * Z + N[19]) * w
    y = (N[13] * X + N[14] * Y + N[15] * Z + N[20]) * w
    r2 = x * x + y * y
    radial = 1.0 + r2 * (N[4] + r2 * (N[5] + r2 * N[8]))
    at_u = x * radial + 2.0 * N[6] * x * y + N[7] * (r2 + 2.0 * x * x)
    at_v = y * radial + N[6] * (r2 + 2.0 * y * y) + 2.0 * N[7] * x * y
    shown = 0.0 if z > 0.0 and r2 <= N[9] else math.inf
    return u - (N[0] * at_u + N[2]) + shown, v - (N[1] * at_v + N[3]) + shown


@njit(**INLINED)
def linearised(
    N: Numbers, X: float, Y: float, Z: float, u: float, v: float
) -> tuple[float, float, float, float, float, float, float, float]:
    """Return the reprojection error of a world point in a view, as `offset`, and the derivatives of its projection.

    Args:
        N, X, Y, Z, u, v: `numbers_of` the view, world point [m] and measured pixel [px], as in `offset`.

    Returns:
        du and dv, measured minus projected [px], infinite where the point is behind the camera or outside the lens
        model; then the derivatives of the projected u (3) and v (3) by X, Y, Z [px/m].
    """
    z = N[16] * X + N[17] * Y + N[18] * Z + N[21]
    w = 1.0 / z
    x = (N[10] * X + N[11] * Y + N[12] * Z + N[19]) * w
    y = (N[13] * X + N[14] * Y + N[15] * Z + N[20]) * w
    shown = 0.0 if z > 0.0 and x * x + y * y <= N[9] else math.inf
    at_u, at_v, uu, uv, vv = distort(x, y, N[4], N[5], N[6], N[7], N[8])
    ax, ay, az = N[10] - x * N[16], N[11] - x * N[17], N[12] - x * N[18]
    bx, by, bz = N[13] - y * N[16], N[14] - y * N[17], N[15] - y * N[18]
    fu, fv = N[0] * w, N[1] * w
    ux, uy, vx, vy = fu * uu, fu * uv, fv * uv, fv * vv
    return (
        u - (N[0] * at_u + N[2]) + shown, v - (N[1] * at_v + N[3]) + shown,
        ux * ax + uy * bx, ux * ay + uy * by, ux * az + uy * bz,
        vx * ax + vy * bx, vx * ay + vy * by, vx * az + vy * bz,
    )  # fmt: skip


@njit(**INLINED)
def inverse(
    a: float, b: float, c: float, d: float, e: float, f: float
) -> tuple[float, float, float, float, float, float]:
    """Invert the symmetric matrix [[a, b, c], [b, d, e], [c, e, f]]; return its six numbers in the same order."""
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d
    scale = 1.0 / (a * A + b * B + c * C)
    return scale * A, scale * B, scale * C, scale * (a * f - c * c), scale * (b * c - a * e), scale * (a * d - b * b)


@njit(**INLINED)
def newton(
    u: float, v: float, x: float, y: float, k1: float, k2: float, p1: float, p2: float, k3: float
) -> tuple[float, float, float, float]:
    """Take a Newton step from (x, y) towards the solution of distort(x, y) = (u, v).

    Args:
        u, v: distorted normalised coordinates.
        x, y: the present estimate of the undistorted ones.
        k1, k2, p1, p2, k3: distortion coefficients.

    Returns:
        The new x and y, then the step's two components.
    """
    at_u, at_v, uu, uv, vv = distort(x, y, k1, k2, p1, p2, k3)
    du, dv, scale = u - at_u, v - at_v, 1.0 / (uu * vv - uv * uv)
    dx, dy = scale * (vv * du - uv * dv), scale * (uu * dv - uv * du)
    return x + dx, y + dy, dx, dy


@njit(**INLINED)
def add_to_system(
    S: Float64, m: int, w: float, px: float, py: float, pz: float, qx: float, qy: float, qz: float, du: float, dv: float
) -> None:
    """Add two equations p·x = du and q·x = dv of weight w to the normal equations of lane m, rows 0 to 8 of S."""
    wpx, wpy, wpz, wqx, wqy, wqz = w * px, w * py, w * pz, w * qx, w * qy, w * qz
    S[0, m] += wpx * px + wqx * qx
    S[1, m] += wpx * py + wqx * qy
    S[2, m] += wpx * pz + wqx * qz
    S[3, m] += wpy * py + wqy * qy
    S[4, m] += wpy * pz + wqy * qz
    S[5, m] += wpz * pz + wqz * qz
    S[6, m] += wpx * du + wqx * dv
    S[7, m] += wpy * du + wqy * dv
    S[8, m] += wpz * du + wqz * dv


@njit(**INLINED)
def solved(S: Float64, m: int) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Return the inverse (6, as `inverse`) of the normal equations of lane m, and their solution (3)."""
    A, B, C, D, E, F = inverse(S[0, m], S[1, m], S[2, m], S[3, m], S[4, m], S[5, m])
    x = A * S[6, m] + B * S[7, m] + C * S[8, m]
    y = B * S[6, m] + D * S[7, m] + E * S[8, m]
    z = C * S[6, m] + E * S[7, m] + F * S[8, m]
    return A, B, C, D, E, F, x, y, z


@njit(**INLINED)
def keep_inverse(
    S: Float64, m: int, now: bool, A: float, B: float, C: float, D: float, E: float, F: float
) -> None:  # fmt: skip
    """Write the inverse (6) of lane m to rows 18 to 23 of S, if ``now``."""
    S[18, m] = A if now else S[18, m]
    S[19, m] = B if now else S[19, m]
    S[20, m] = C if now else S[20, m]
    S[21, m] = D if now else S[21, m]
    S[22, m] = E if now else S[22, m]
    S[23, m] = F if now else S[23, m]


@njit(**INLINED)
def write_point(S: Float64, m: int, i: int, points: Float64, covariances: Float64) -> None:
    """Write the point of lane m (rows 10 to 12 of S) and its covariance (rows 18 to 23) to row i of the results."""
    points[i, 0], points[i, 1], points[i, 2] = S[10, m], S[11, m], S[12, m]
    A, B, C, D, E, F = S[18, m], S[19, m], S[20, m], S[21, m], S[22, m], S[23, m]
    covariances[i, 0, 0], covariances[i, 0, 1], covariances[i, 0, 2] = A, B, C
    covariances[i, 1, 0], covariances[i, 1, 1], covariances[i, 1, 2] = B, D, E
    covariances[i, 2, 0], covariances[i, 2, 1], covariances[i, 2, 2] = C, E, F


@njit(**COMPILED)
def fit_most(
    views: Float64, pixels: Float64, sd: Float64, gate2: float, points: Float64, covariances: Float64,
    residuals: Float64, fitted: Bool,
) -> None:  # fmt: skip
    """Triangulate the points whose views all agree, many at a time; leave the others.

    The initial point is the linear least-squares solution of x·z' − x' and y·z' − y' over the views. The steps of
    `refine` follow. The loops over ``m`` have no branches, so that the compiler vectorises them over points.

    Args:
        views, pixels: (views, 25) the cameras, see `geometry.triangulation.Views`, and (points, views, 2) [px].
        sd: (points, views) standard deviation of a pixel's coordinates [px].
        gate2: square of the largest reprojection error of an inlier view [sd²].
        points, covariances, residuals: (points, 3) [m], (points, 3, 3) [m²], (points, views) [px]; rows of fitted
            points are written.
        fitted: (points,) written: `ALL` for a fitted point, `LEFT` for another.
    """
    count = pixels.shape[1]
    P, S = np.empty((3 * count, LANES)), np.empty((24, LANES))
    for begin in range(0, len(pixels), LANES):
        given = min(LANES, len(pixels) - begin)
        lanes = (given + STEP - 1) // STEP * STEP
        S[:] = 0.0
        for m in range(given, lanes):
            S[13, m] = 1.0
            for k in range(count):
                P[3 * k, m], P[3 * k + 1, m], P[3 * k + 2, m] = views[k, 2], views[k, 3], 0.0
        for m in range(given):
            for k in range(count):
                u, v, s = pixels[begin + m, k, 0], pixels[begin + m, k, 1], sd[begin + m, k]
                seen = s > 0.0 and math.isfinite(u + v + s)
                P[3 * k, m] = u if seen else views[k, 2]
                P[3 * k + 1, m] = v if seen else views[k, 3]
                P[3 * k + 2, m] = 1.0 / (s * s) if seen else 0.0
                S[16, m] += 1.0 if seen else 0.0
        for k in range(count):
            fx, fy, cx, cy, farthest = views[k, 0], views[k, 1], views[k, 2], views[k, 3], views[k, 9]
            k1, k2, p1, p2, k3 = views[k, 4], views[k, 5], views[k, 6], views[k, 7], views[k, 8]
            per_fx, per_fy, area = 1.0 / fx, 1.0 / fy, fx * fy
            tx, ty, tz = views[k, 19], views[k, 20], views[k, 21]
            R0, R1, R2 = views[k, 10], views[k, 11], views[k, 12]
            R3, R4, R5 = views[k, 13], views[k, 14], views[k, 15]
            R6, R7, R8 = views[k, 16], views[k, 17], views[k, 18]
            for m in range(lanes):
                u, v, w = (P[3 * k, m] - cx) * per_fx, (P[3 * k + 1, m] - cy) * per_fy, P[3 * k + 2, m] * area
                x, y, dx, dy = newton(u, v, u, v, k1, k2, p1, p2, k3)
                x, y, dx, dy = newton(u, v, x, y, k1, k2, p1, p2, k3)
                S[17, m] += 0.0 if dx * dx + dy * dy < 1e-4 and x * x + y * y <= farthest else 1.0
                px, py, pz = R0 - x * R6, R1 - x * R7, R2 - x * R8
                qx, qy, qz = R3 - y * R6, R4 - y * R7, R5 - y * R8
                p, q = x * tz - tx, y * tz - ty
                add_to_system(S, m, w, px, py, pz, qx, qy, qz, p, q)
        for m in range(lanes):
            _, _, _, _, _, _, S[10, m], S[11, m], S[12, m] = solved(S, m)
        for _ in range(4):
            S[:10] = 0.0
            for k in range(count):
                N = numbers_of(views, k)
                for m in range(lanes):
                    w = P[3 * k + 2, m]
                    du, dv, px, py, pz, qx, qy, qz = linearised(
                        N, S[10, m], S[11, m], S[12, m], P[3 * k, m], P[3 * k + 1, m]
                    )
                    S[9, m] += w * (du * du + dv * dv)
                    add_to_system(S, m, w, px, py, pz, qx, qy, qz, du, dv)
            open_ = 0.0
            for m in range(lanes):
                A, B, C, D, E, F, sx, sy, sz = solved(S, m)
                now = 1.0 if S[13, m] == 0.0 else 0.0  # 0 once converged
                S[10, m] += now * sx
                S[11, m] += now * sy
                S[12, m] += now * sz
                keep_inverse(S, m, now == 1.0, A, B, C, D, E, F)
                done = S[6, m] * sx + S[7, m] * sy + S[8, m] * sz < 1e-5
                hopeless = not S[9, m] <= 16.0 * gate2 * S[16, m]
                S[17, m] += 1.0 if hopeless else 0.0
                S[13, m] = 1.0 if done or hopeless or S[13, m] == 1.0 else 0.0
                open_ += 1.0 - S[13, m]
            if open_ == 0.0:
                break
        for k in range(count):
            N = numbers_of(views, k)
            for m in range(lanes):
                du, dv = offset(N, S[10, m], S[11, m], S[12, m], P[3 * k, m], P[3 * k + 1, m])
                square = du * du + dv * dv
                P[3 * k, m] = math.sqrt(square)
                S[17, m] += 0.0 if P[3 * k + 2, m] * square <= gate2 or P[3 * k + 2, m] == 0.0 else 1.0
        for m in range(given):
            i = begin + m
            fitted[i] = ALL if S[16, m] >= 2.0 and S[13, m] == 1.0 and S[17, m] == 0.0 else LEFT
            if fitted[i] == ALL:
                write_point(S, m, i, points, covariances)
                for k in range(count):
                    residuals[i, k] = P[3 * k, m] if P[3 * k + 2, m] > 0.0 else math.nan


@njit(**COMPILED)
def fit_agreeing(
    views: Float64, pixels: Float64, sd: Float64, gate2: float, least_sin2: float, points: Float64,
    covariances: Float64, residuals: Float64, used: Bool, fitted: UInt8,
) -> None:  # fmt: skip
    """Triangulate the points that `fit_most` left and where some views agree, many at a time; leave the others.

    These are the steps of `triangulation_kernels.consensus`: the point of each pair of views, the truncated error of
    each, and a refit of the best on the views within the gate. Points whose refit changes these views are left.

    Args:
        views, pixels: (views, 25) the cameras, see `geometry.triangulation.Views`, and (points, views, 2) [px].
        sd: (points, views) standard deviation of a pixel's coordinates [px].
        gate2: square of the largest reprojection error of an inlier view [sd²].
        least_sin2: squared sine of the least angle between the rays of a pair.
        points, covariances, residuals, used: (points, 3) [m], (points, 3, 3) [m²], (points, views) [px] and
            (points, views); rows of fitted points are written.
        fitted: (points,) read and written: `LEFT` becomes `AGREED` where a point is fitted.
    """
    count = pixels.shape[1]
    P, kept, tried = np.empty((8 * count, LANES)), np.empty((count, LANES)), np.empty((count, LANES))
    S, at = np.empty((24, LANES)), np.empty(LANES, np.int64)
    begin = 0
    while gate2 < math.inf:
        given = 0
        while begin < len(pixels) and given < LANES:
            if fitted[begin] == LEFT:
                at[given] = begin
                given += 1
            begin += 1
        if given == 0:
            break
        lanes = (given + STEP - 1) // STEP * STEP
        S[:] = 0.0
        S[14] = math.inf  # the least error so far
        for m in range(given, lanes):
            for k in range(count):
                P[8 * k, m], P[8 * k + 1, m], P[8 * k + 2, m] = views[k, 2], views[k, 3], 0.0
        for m in range(given):
            for k in range(count):
                u, v, s = pixels[at[m], k, 0], pixels[at[m], k, 1], sd[at[m], k]
                seen = s > 0.0 and math.isfinite(u + v + s)
                P[8 * k, m] = u if seen else views[k, 2]
                P[8 * k + 1, m] = v if seen else views[k, 3]
                P[8 * k + 2, m] = 1.0 / (s * s) if seen else 0.0
        for k in range(count):
            for m in range(lanes):
                kept[k, m] = 0.0
        for k in range(count):
            fx, fy, cx, cy, farthest = views[k, 0], views[k, 1], views[k, 2], views[k, 3], views[k, 9]
            k1, k2, p1, p2, k3 = views[k, 4], views[k, 5], views[k, 6], views[k, 7], views[k, 8]
            per_fx, per_fy = 1.0 / fx, 1.0 / fy
            R0, R1, R2 = views[k, 10], views[k, 11], views[k, 12]
            R3, R4, R5 = views[k, 13], views[k, 14], views[k, 15]
            R6, R7, R8 = views[k, 16], views[k, 17], views[k, 18]
            for m in range(lanes):
                u, v = (P[8 * k, m] - cx) * per_fx, (P[8 * k + 1, m] - cy) * per_fy
                x, y, dx, dy = newton(u, v, u, v, k1, k2, p1, p2, k3)
                x, y, dx, dy = newton(u, v, x, y, k1, k2, p1, p2, k3)
                S[17, m] += 0.0 if dx * dx + dy * dy < 1e-4 and x * x + y * y <= farthest else 1.0
                a, b, c = R0 * x + R3 * y + R6, R1 * x + R4 * y + R7, R2 * x + R5 * y + R8
                P[8 * k + 3, m], P[8 * k + 4, m], P[8 * k + 5, m] = a, b, c
                P[8 * k + 6, m] = a * a + b * b + c * c
                P[8 * k + 7, m] = math.sqrt(P[8 * k + 6, m] / P[8 * k + 2, m]) * per_fx  # infinite where not seen
        for i in range(count):
            for j in range(i):
                ix, iy, iz = views[i, 22], views[i, 23], views[i, 24]
                ox, oy, oz = views[j, 22], views[j, 23], views[j, 24]
                dx, dy, dz = ox - ix, oy - iy, oz - iz
                for m in range(lanes):
                    ax, ay, az, aa = P[8 * i + 3, m], P[8 * i + 4, m], P[8 * i + 5, m], P[8 * i + 6, m]
                    bx, by, bz, bb = P[8 * j + 3, m], P[8 * j + 4, m], P[8 * j + 5, m], P[8 * j + 6, m]
                    wi, wj = P[8 * i + 2, m], P[8 * j + 2, m]
                    ab = ax * bx + ay * by + az * bz
                    sin2 = aa * bb - ab * ab
                    da, db = dx * ax + dy * ay + dz * az, dx * bx + dy * by + dz * bz
                    s, t = (da * bb - db * ab) / sin2, (da * ab - db * aa) / sin2
                    gx, gy, gz = dx - s * ax + t * bx, dy - s * ay + t * by, dz - s * az + t * bz
                    reach = s * P[8 * i + 7, m] + t * P[8 * j + 7, m]
                    p, q = wi / (s * s), wj / (t * t)
                    p = p / (p + q)
                    q = 1.0 - p
                    S[10, m] = p * (ix + s * ax) + q * (ox + t * bx)
                    S[11, m] = p * (iy + s * ay) + q * (oy + t * by)
                    S[12, m] = p * (iz + s * az) + q * (oz + t * bz)
                    meets = sin2 >= least_sin2 * aa * bb and s > 0.0 and t > 0.0 and wi > 0.0 and wj > 0.0
                    near = gx * gx + gy * gy + gz * gz <= 9.0 * gate2 * reach * reach
                    S[15, m] = 0.0 if meets and near else math.inf
                    S[16, m] = 0.0
                for k in range(count):
                    N = numbers_of(views, k)
                    for m in range(lanes):
                        w = P[8 * k + 2, m]
                        du, dv = offset(N, S[10, m], S[11, m], S[12, m], P[8 * k, m], P[8 * k + 1, m])
                        square = w * (du * du + dv * dv)
                        inlier = 1.0 if w > 0.0 and square <= gate2 else 0.0
                        S[15, m] += square if inlier == 1.0 else (gate2 if w > 0.0 else 0.0)
                        S[16, m] += inlier
                        tried[k, m] = w if inlier == 1.0 else 0.0
                for m in range(lanes):
                    better = S[15, m] < S[14, m] and S[16, m] >= 2.0
                    S[13, m] = 1.0 if better else 0.0
                    S[14, m] = S[15, m] if better else S[14, m]
                    S[18, m] = S[10, m] if better else S[18, m]
                    S[19, m] = S[11, m] if better else S[19, m]
                    S[20, m] = S[12, m] if better else S[20, m]
                for k in range(count):
                    for m in range(lanes):
                        kept[k, m] = tried[k, m] if S[13, m] == 1.0 else kept[k, m]
        for m in range(lanes):
            S[10, m], S[11, m], S[12, m] = S[18, m], S[19, m], S[20, m]
            S[13, m] = 0.0 if S[14, m] < math.inf and S[17, m] == 0.0 else 1.0  # 1 once converged, or hopeless
            S[17, m] = S[13, m]
        for _ in range(4):
            S[:10] = 0.0
            for k in range(count):
                N = numbers_of(views, k)
                for m in range(lanes):
                    w = kept[k, m]
                    du, dv, px, py, pz, qx, qy, qz = linearised(
                        N, S[10, m], S[11, m], S[12, m], P[8 * k, m], P[8 * k + 1, m]
                    )
                    du, dv = du if w > 0.0 else 0.0, dv if w > 0.0 else 0.0
                    add_to_system(S, m, w, px, py, pz, qx, qy, qz, du, dv)
            open_ = 0.0
            for m in range(lanes):
                A, B, C, D, E, F, sx, sy, sz = solved(S, m)
                now = S[13, m] == 0.0
                S[10, m] = S[10, m] + sx if now else S[10, m]
                S[11, m] = S[11, m] + sy if now else S[11, m]
                S[12, m] = S[12, m] + sz if now else S[12, m]
                keep_inverse(S, m, now, A, B, C, D, E, F)
                done = S[6, m] * sx + S[7, m] * sy + S[8, m] * sz < 1e-5
                S[13, m] = 1.0 if done or not now else 0.0
                open_ += 1.0 - S[13, m]
            if open_ == 0.0:
                break
        for k in range(count):
            N = numbers_of(views, k)
            for m in range(lanes):
                w = P[8 * k + 2, m]
                du, dv = offset(N, S[10, m], S[11, m], S[12, m], P[8 * k, m], P[8 * k + 1, m])
                square = du * du + dv * dv
                tried[k, m] = math.sqrt(square)
                inlier = w > 0.0 and w * square <= gate2
                S[17, m] += 0.0 if inlier == (kept[k, m] > 0.0) else 1.0
        for m in range(given):
            i = at[m]
            if S[13, m] == 1.0 and S[17, m] == 0.0:
                fitted[i] = AGREED
                write_point(S, m, i, points, covariances)
                for k in range(count):
                    residuals[i, k] = tried[k, m] if P[8 * k + 2, m] > 0.0 else math.nan
                    used[i, k] = kept[k, m] > 0.0
