"""Kernels of `mocapella.geometry.triangulation`; importing this module imports numba.

A view is one camera, as a row of 25 numbers in the order of `triangulation.Views`: the lens (9), the squared radius
where its model ends, the rotation R_camera_world by rows (9), the translation of T_camera_world (3), and the camera's
centre in the world (3). Common arguments:

    views (views, 25)           the cameras
    pixels (points, views, 2)   measured pixels [px]; NaN where not seen
    at, n                       index of a point, index of a view
    weights (views,)            1/variance of a pixel's coordinates [1/px²]; 0 for a view that is not used
    X, Y, Z                     a point in the world [m]
    gate2                       square of the outlier gate, in standard deviations
    least_sin2                  squared sine of the least angle between rays
    rays (views, 6)             of `keep_ray`

Six numbers a to f are a symmetric matrix [[a, b, c], [b, d, e], [c, e, f]], such as a covariance [m²].
"""

# ruff: noqa: PLR0917 - kernels take arrays by position
from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.geometry.lens_kernels import distort
from mocapella.geometry.lens_kernels import undistort as undistort_fully

Bool = NDArray[np.bool_]
Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]

COMPILED: Final[dict[str, Any]] = {"cache": True, "error_model": "numpy"}
INLINED: Final[dict[str, Any]] = {**COMPILED, "forceinline": True}
SEEN, ONE_VIEW, PARALLEL, BEHIND, INCONSISTENT = 0, 1, 2, 3, 4
LANES = 32
STEPS = 12
"""Largest number of Gauss–Newton steps; two or three suffice where they converge."""
REFITS = 4


@njit(**INLINED)
def undistort(views: Float64, n: int, u: float, v: float) -> tuple[float, float]:
    """Undistort normalised coordinates (u, v) of view n to (x, y); NaN outside the lens model.

    Two Newton steps are taken where these suffice, else all of `lens_kernels.undistort`.

    Args:
        views: (views, 25) the cameras, see `geometry.triangulation.Views`.
        n: index of the view.
        u, v: distorted x/z and y/z in the camera frame.
    """
    k1, k2, p1, p2, k3 = views[n, 4], views[n, 5], views[n, 6], views[n, 7], views[n, 8]
    if k1 == 0.0 and k2 == 0.0 and p1 == 0.0 and p2 == 0.0 and k3 == 0.0:
        return u, v
    x, y, dx, dy = u, v, 1.0, 1.0
    for _ in range(2):
        at_u, at_v, uu, uv, vv = distort(x, y, k1, k2, p1, p2, k3)
        du, dv = u - at_u, v - at_v
        scale = 1.0 / (uu * vv - uv * uv)
        dx, dy = scale * (vv * du - uv * dv), scale * (uu * dv - uv * du)
        x, y = x + dx, y + dy
    if abs(dx) < 1e-2 and abs(dy) < 1e-2 and x * x + y * y <= views[n, 9]:
        return x, y
    x, y = undistort_fully(u, v, k1, k2, p1, p2, k3, views[n, 9])
    return x, y


@njit(**INLINED)
def offset(views: Float64, n: int, X: float, Y: float, Z: float, u: float, v: float) -> tuple[float, float]:
    """Return the reprojection error (du, dv) of a world point in view n: measured minus projected [px].

    Args:
        views, n: (views, 25) the cameras, and the index of one.
        X, Y, Z: the point [m].
        u, v: its measured pixel [px].

    Returns:
        The error; infinite where the point is behind the camera or outside the lens model.
    """
    z = views[n, 16] * X + views[n, 17] * Y + views[n, 18] * Z + views[n, 21]
    w = 1.0 / z
    x = (views[n, 10] * X + views[n, 11] * Y + views[n, 12] * Z + views[n, 19]) * w
    y = (views[n, 13] * X + views[n, 14] * Y + views[n, 15] * Z + views[n, 20]) * w
    r2 = x * x + y * y
    radial = 1.0 + r2 * (views[n, 4] + r2 * (views[n, 5] + r2 * views[n, 8]))
    at_u = x * radial + 2.0 * views[n, 6] * x * y + views[n, 7] * (r2 + 2.0 * x * x)
    at_v = y * radial + views[n, 6] * (r2 + 2.0 * y * y) + 2.0 * views[n, 7] * x * y
    shown = 0.0 if z > 0.0 and r2 <= views[n, 9] else math.inf
    return u - (views[n, 0] * at_u + views[n, 2]) + shown, v - (views[n, 1] * at_v + views[n, 3]) + shown


@njit(**INLINED)
def linearised(
    views: Float64, n: int, X: float, Y: float, Z: float, u: float, v: float
) -> tuple[float, float, float, float, float, float, float, float]:
    """Return the reprojection error of a world point in a view, as `offset`, and the derivatives of its projection.

    Args:
        views, n, X, Y, Z, u, v: (views, 25) cameras, index of one, world point [m] and measured pixel [px], as in
            `offset`.

    Returns:
        du and dv, measured minus projected [px], infinite where the point is behind the camera or outside the lens
        model; then the derivatives of the projected u (3) and v (3) by X, Y, Z [px/m].
    """
    z = views[n, 16] * X + views[n, 17] * Y + views[n, 18] * Z + views[n, 21]
    w = 1.0 / z
    x = (views[n, 10] * X + views[n, 11] * Y + views[n, 12] * Z + views[n, 19]) * w
    y = (views[n, 13] * X + views[n, 14] * Y + views[n, 15] * Z + views[n, 20]) * w
    shown = 0.0 if z > 0.0 and x * x + y * y <= views[n, 9] else math.inf
    at_u, at_v, uu, uv, vv = distort(x, y, views[n, 4], views[n, 5], views[n, 6], views[n, 7], views[n, 8])
    ax, ay, az = views[n, 10] - x * views[n, 16], views[n, 11] - x * views[n, 17], views[n, 12] - x * views[n, 18]
    bx, by, bz = views[n, 13] - y * views[n, 16], views[n, 14] - y * views[n, 17], views[n, 15] - y * views[n, 18]
    fu, fv = views[n, 0] * w, views[n, 1] * w
    ux, uy, vx, vy = fu * uu, fu * uv, fv * uv, fv * vv
    return (
        u - (views[n, 0] * at_u + views[n, 2]) + shown, v - (views[n, 1] * at_v + views[n, 3]) + shown,
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
def refine(
    views: Float64, pixels: Float64, at: int, weights: Float64, X: float, Y: float, Z: float
) -> tuple[float, float, float, bool, float, float, float, float, float, float]:
    """Minimise a point's weighted reprojection errors by Gauss–Newton steps, halved where the cost rises.

    Args:
        views: (views, 25) the cameras, see `geometry.triangulation.Views`.
        pixels: (points, views, 2) [px].
        at: index of the point.
        weights: (views,) 1/variance of a pixel's coordinates [1/px²]; 0 for a view that is not used.
        X, Y, Z: initial point, world [m].

    Returns:
        X, Y, Z [m], whether the fit converged, and the six numbers of the point's covariance, its upper triangle [m²].
    """
    before, sx, sy, sz = math.inf, 0.0, 0.0, 0.0
    A = B = C = D = E = F = 0.0
    for step in range(STEPS):
        a = b = c = d = e = f = gx = gy = gz = cost = 0.0
        for k in range(len(weights)):
            w = weights[k]
            if w > 0.0:
                du, dv, px, py, pz, qx, qy, qz = linearised(views, k, X, Y, Z, pixels[at, k, 0], pixels[at, k, 1])
                cost += w * (du * du + dv * dv)
                a += w * (px * px + qx * qx)
                b += w * (px * py + qx * qy)
                c += w * (px * pz + qx * qz)
                d += w * (py * py + qy * qy)
                e += w * (py * pz + qy * qz)
                f += w * (pz * pz + qz * qz)
                gx += w * (px * du + qx * dv)
                gy += w * (py * du + qy * dv)
                gz += w * (pz * du + qz * dv)
        if step == 0 and not cost < math.inf:
            break
        if not cost <= before * (1.0 + 1e-9) + 1e-9:
            sx, sy, sz = 0.5 * sx, 0.5 * sy, 0.5 * sz
            X, Y, Z = X - sx, Y - sy, Z - sz
            continue
        before = cost
        A, B, C, D, E, F = inverse(a, b, c, d, e, f)
        sx, sy, sz = A * gx + B * gy + C * gz, B * gx + D * gy + E * gz, C * gx + E * gy + F * gz
        X, Y, Z = X + sx, Y + sy, Z + sz
        if gx * sx + gy * sy + gz * sz < 1e-5:  # the square of the step in units of its own uncertainty
            return X, Y, Z, True, A, B, C, D, E, F
    return X, Y, Z, False, A, B, C, D, E, F


@njit(**INLINED)
def keep_ray(views: Float64, n: int, x: float, y: float, rays: Float64) -> None:
    """Write the ray of view n into ``rays`` (views, 6).

    Args:
        views: (views, 25), see `triangulation.Views`.
        n: index of the view.
        x, y: undistorted point in normalised image coordinates.
        rays: row n is written: x, y, the direction R_world_camera (x, y, 1), and the direction's squared length.
    """
    dx = views[n, 10] * x + views[n, 13] * y + views[n, 16]
    dy = views[n, 11] * x + views[n, 14] * y + views[n, 17]
    dz = views[n, 12] * x + views[n, 15] * y + views[n, 18]
    rays[n, 0], rays[n, 1], rays[n, 2], rays[n, 3], rays[n, 4] = x, y, dx, dy, dz
    rays[n, 5] = dx * dx + dy * dy + dz * dz


@njit(**INLINED)
def wide(views: Float64, used: Bool, at: int, X: float, Y: float, Z: float, least_sin2: float) -> bool:
    """Return whether the rays of at least two used views meet in the point (X, Y, Z) at a sufficient angle.

    Args:
        views: (views, 25) the cameras, see `geometry.triangulation.Views`.
        used: (points, views); row ``at`` is read.
        at: index of the point.
        X, Y, Z: the point [m].
        least_sin2: squared sine of the least angle.
    """
    for i in range(len(views)):
        if not used[at, i]:
            continue
        ax, ay, az = X - views[i, 22], Y - views[i, 23], Z - views[i, 24]
        aa = ax * ax + ay * ay + az * az
        for j in range(i):
            if used[at, j]:
                bx, by, bz = X - views[j, 22], Y - views[j, 23], Z - views[j, 24]
                ab, bb = ax * bx + ay * by + az * bz, bx * bx + by * by + bz * bz
                if aa * bb - ab * ab >= least_sin2 * aa * bb:
                    return True
    return False


@njit(**INLINED)
def meeting(
    views: Float64, rays: Float64, weights: Float64, m: int, n: int, gate2: float, least_sin2: float
) -> tuple[int, float, float, float]:
    """Intersect the rays of views m and n: the mean of their nearest points, by inverse variance at each one's depth.

    Source: Hartley and Sturm: Triangulation (CVIU 68(2), 1997), section 3 for the midpoint of the common normal.

    Args:
        views: (views, 25) the cameras, see `geometry.triangulation.Views`.
        rays: (views, 6) of `keep_ray`.
        weights: (views,) 1/variance of a pixel's coordinates [1/px²].
        m, n: indices of the views.
        gate2: square of the outlier gate [sd²].
        least_sin2: squared sine of the least angle between the rays.

    Returns:
        `SEEN` or the reason of failure, then the point X, Y, Z in the world [m], 0 if it failed.
    """
    ax, ay, az, aa = rays[m, 2], rays[m, 3], rays[m, 4], rays[m, 5]
    bx, by, bz, bb = rays[n, 2], rays[n, 3], rays[n, 4], rays[n, 5]
    dx, dy, dz = views[n, 22] - views[m, 22], views[n, 23] - views[m, 23], views[n, 24] - views[m, 24]
    ab = ax * bx + ay * by + az * bz
    sin2 = aa * bb - ab * ab
    if not sin2 >= least_sin2 * aa * bb:
        return PARALLEL, 0.0, 0.0, 0.0
    da, db = dx * ax + dy * ay + dz * az, dx * bx + dy * by + dz * bz
    s, t = (da * bb - db * ab) / sin2, (da * ab - db * aa) / sin2
    if not (s > 0.0 and t > 0.0):  # a ray's third number in its camera's space is 1, so these are depths
        return BEHIND, 0.0, 0.0, 0.0
    gx, gy, gz = dx - s * ax + t * bx, dy - s * ay + t * by, dz - s * az + t * bz
    reach = s * math.sqrt(aa / weights[m]) / views[m, 0] + t * math.sqrt(bb / weights[n]) / views[n, 0]
    if gx * gx + gy * gy + gz * gz > 9.0 * gate2 * reach * reach:  # a lens may magnify, hence the 3 standing for 1
        return INCONSISTENT, 0.0, 0.0, 0.0
    p, q = weights[m] / (s * s), weights[n] / (t * t)
    p, q = p / (p + q), q / (p + q)
    return (
        SEEN,
        p * (views[m, 22] + s * ax) + q * (views[n, 22] + t * bx),
        p * (views[m, 23] + s * ay) + q * (views[n, 23] + t * by),
        p * (views[m, 24] + s * az) + q * (views[n, 24] + t * bz),
    )


@njit(**INLINED)
def truncated(
    views: Float64, pixels: Float64, at: int, weights: Float64, X: float, Y: float, Z: float, gate2: float,
    best: float, kept: Float64,
) -> float:  # fmt: skip
    """Return the sum over views of a point's squared reprojection errors [sd²], each truncated at the gate.

    Args:
        views: (views, 25) the cameras, see `geometry.triangulation.Views`.
        pixels: (points, views, 2) [px].
        at: index of the point.
        weights: (views,) 1/variance of a pixel's coordinates [1/px²]; 0 for a view that is not used.
        X, Y, Z: the point, world [m].
        gate2: largest value of one view [sd²].
        best: the sum is infinite once it exceeds this.
        kept: (views,) written: the weights of views within the gate, 0 for the others; incomplete if the sum is
            infinite.
    """
    total = 0.0
    for k in range(len(weights)):
        kept[k] = 0.0
        if weights[k] > 0.0:
            du, dv = offset(views, k, X, Y, Z, pixels[at, k, 0], pixels[at, k, 1])
            square = weights[k] * (du * du + dv * dv)
            if square <= gate2:
                kept[k] = weights[k]
                total += square
            else:
                total += gate2
            if total > best:
                return math.inf
    return total


@njit(**INLINED)
def two_or_more(kept: Float64) -> bool:
    """Return whether two views or more have a weight above 0 in kept (views,)."""
    count = 0
    for k in range(len(kept)):
        if kept[k] > 0.0:
            count += 1
    return count >= 2


@njit(**COMPILED)
def consensus(
    views: Float64, pixels: Float64, at: int, rays: Float64, weights: Float64, gate2: float, least_sin2: float,
    kept: Float64, tried: Float64,
) -> tuple[int, float, float, float, float, float, float, float, float, float]:  # fmt: skip
    """Triangulate a point with rejection of outlier views: refit the pair of views with the least `truncated` error.

    All pairs are tried, so nothing is random. The best pair's point is refitted on its inliers while the error falls:
    Chum, Matas, Kittler: Locally Optimized RANSAC (DAGM 2003), section 2.

    Args:
        views: (views, 25) the cameras, see `geometry.triangulation.Views`.
        pixels: (points, views, 2) [px].
        at: index of the point.
        rays: (views, 6) of `keep_ray`.
        weights: (views,) 1/variance of a pixel's coordinates [1/px²]; 0 for a view that does not see the point.
        gate2, least_sin2: squared outlier gate [sd²], and squared sine of the least angle between rays.
        kept: (views,) written: weights of the inlier views, 0 for the others.
        tried: (views,) workspace.

    Returns:
        `SEEN` or the reason of failure; X, Y, Z, world [m] and the six numbers of the covariance, its upper triangle
        [m²].
    """
    best, state = math.inf, PARALLEL
    X = Y = Z = A = B = C = D = E = F = math.nan
    for i in range(len(weights)):
        for j in range(i):
            if not (weights[i] > 0.0 and weights[j] > 0.0):
                continue
            why, x, y, z = meeting(views, rays, weights, i, j, gate2, least_sin2)
            if why != SEEN:
                state = max(state, why)
                continue
            state = INCONSISTENT
            score = truncated(views, pixels, at, weights, x, y, z, gate2, best, tried)
            if score < best and two_or_more(tried):
                best, X, Y, Z = score, x, y, z
                keep(kept, tried)
    if not best < math.inf:
        return state, X, Y, Z, A, B, C, D, E, F
    best, state = math.inf, INCONSISTENT
    for _ in range(REFITS):
        x, y, z, well, a, b, c, d, e, f = refine(views, pixels, at, kept, X, Y, Z)
        if not well:
            break
        score = truncated(views, pixels, at, weights, x, y, z, gate2, math.inf, tried)
        if not (score < best and two_or_more(tried)):
            break
        best, state, X, Y, Z, A, B, C, D, E, F = score, SEEN, x, y, z, a, b, c, d, e, f
        if same(kept, tried):
            break
        keep(kept, tried)
    return state, X, Y, Z, A, B, C, D, E, F


@njit(**INLINED)
def same(kept: Float64, tried: Float64) -> bool:
    """Return whether the same views have a weight above 0 in kept and in tried, (views,) each."""
    equal = True
    for k in range(len(kept)):
        equal &= (kept[k] > 0.0) == (tried[k] > 0.0)
    return equal


@njit(**INLINED)
def keep(kept: Float64, tried: Float64) -> None:
    """Copy the weights ``tried`` (views,) over ``kept`` (views,)."""
    for k in range(len(kept)):
        kept[k] = tried[k]


@njit(**COMPILED)
def fit_most(  # noqa: PLR0912, PLR0915 - one function, so that the compiler knows that the rows do not overlap
    views: Float64, pixels: Float64, sd: Float64, gate2: float, points: Float64, covariances: Float64,
    residuals: Float64, fitted: Bool,
) -> None:  # fmt: skip
    """Triangulate the points whose views all agree, many at a time; leave the others to `consensus`.

    The initial point is the linear least-squares solution of x·z' − x' and y·z' − y' over the views. Then the steps are
    those of `refine`. The loops over ``m`` have no branches, so that the compiler vectorises them over points.

    Args:
        views, pixels: (views, 25) the cameras, see `geometry.triangulation.Views`, and (points, views, 2) [px].
        sd: (points, views) standard deviation of a pixel's coordinates [px].
        gate2: square of the largest reprojection error of an inlier view [sd²].
        points, covariances, residuals: (points, 3) [m], (points, 3, 3) [m²], (points, views) [px]; rows of fitted
            points are written.
        fitted: (points,) written.
    """
    count = pixels.shape[1]
    P, S = np.empty((3 * count, LANES)), np.empty((24, LANES))
    for begin in range(0, len(pixels), LANES):
        lanes = min(LANES, len(pixels) - begin)
        S[:] = 0.0
        for m in range(lanes):
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
                wpx, wpy, wpz, wqx, wqy, wqz = w * px, w * py, w * pz, w * qx, w * qy, w * qz
                S[0, m] += wpx * px + wqx * qx
                S[1, m] += wpx * py + wqx * qy
                S[2, m] += wpx * pz + wqx * qz
                S[3, m] += wpy * py + wqy * qy
                S[4, m] += wpy * pz + wqy * qz
                S[5, m] += wpz * pz + wqz * qz
                S[6, m] += wpx * p + wqx * q
                S[7, m] += wpy * p + wqy * q
                S[8, m] += wpz * p + wqz * q
        for m in range(lanes):
            A, B, C, D, E, F = inverse(S[0, m], S[1, m], S[2, m], S[3, m], S[4, m], S[5, m])
            S[10, m] = A * S[6, m] + B * S[7, m] + C * S[8, m]
            S[11, m] = B * S[6, m] + D * S[7, m] + E * S[8, m]
            S[12, m] = C * S[6, m] + E * S[7, m] + F * S[8, m]
        for _ in range(4):
            S[:10] = 0.0
            for k in range(count):
                for m in range(lanes):
                    w = P[3 * k + 2, m]
                    du, dv, px, py, pz, qx, qy, qz = linearised(
                        views, k, S[10, m], S[11, m], S[12, m], P[3 * k, m], P[3 * k + 1, m]
                    )
                    S[9, m] += w * (du * du + dv * dv)
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
            open_ = 0.0
            for m in range(lanes):
                A, B, C, D, E, F = inverse(S[0, m], S[1, m], S[2, m], S[3, m], S[4, m], S[5, m])
                sx = A * S[6, m] + B * S[7, m] + C * S[8, m]
                sy = B * S[6, m] + D * S[7, m] + E * S[8, m]
                sz = C * S[6, m] + E * S[7, m] + F * S[8, m]
                now = 1.0 if S[13, m] == 0.0 else 0.0  # 0 once converged
                S[10, m] += now * sx
                S[11, m] += now * sy
                S[12, m] += now * sz
                S[18, m] = A if now == 1.0 else S[18, m]
                S[19, m] = B if now == 1.0 else S[19, m]
                S[20, m] = C if now == 1.0 else S[20, m]
                S[21, m] = D if now == 1.0 else S[21, m]
                S[22, m] = E if now == 1.0 else S[22, m]
                S[23, m] = F if now == 1.0 else S[23, m]
                done = S[6, m] * sx + S[7, m] * sy + S[8, m] * sz < 1e-5
                hopeless = not S[9, m] <= 16.0 * gate2 * S[16, m]
                S[17, m] += 1.0 if hopeless else 0.0
                S[13, m] = 1.0 if done or hopeless or S[13, m] == 1.0 else 0.0
                open_ += 1.0 - S[13, m]
            if open_ == 0.0:
                break
        for k in range(count):
            for m in range(lanes):
                du, dv = offset(views, k, S[10, m], S[11, m], S[12, m], P[3 * k, m], P[3 * k + 1, m])
                square = du * du + dv * dv
                P[3 * k, m] = math.sqrt(square)
                S[17, m] += 0.0 if P[3 * k + 2, m] * square <= gate2 or P[3 * k + 2, m] == 0.0 else 1.0
        for m in range(lanes):
            i = begin + m
            fitted[i] = S[16, m] >= 2.0 and S[13, m] == 1.0 and S[17, m] == 0.0
            if fitted[i]:
                points[i, 0], points[i, 1], points[i, 2] = S[10, m], S[11, m], S[12, m]
                A, B, C, D, E, F = S[18, m], S[19, m], S[20, m], S[21, m], S[22, m], S[23, m]
                covariances[i, 0, 0], covariances[i, 0, 1], covariances[i, 0, 2] = A, B, C
                covariances[i, 1, 0], covariances[i, 1, 1], covariances[i, 1, 2] = B, D, E
                covariances[i, 2, 0], covariances[i, 2, 1], covariances[i, 2, 2] = C, E, F
                for k in range(count):
                    residuals[i, k] = P[3 * k, m] if P[3 * k + 2, m] > 0.0 else math.nan


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


@njit(**COMPILED)
def triangulate(
    views: Float64, pixels: Float64, sd: Float64, gate: float, least_sin2: float, points: Float64,
    covariances: Float64, residuals: Float64, used: Bool, states: UInt8,
) -> None:  # fmt: skip
    """Triangulate points from their pixels in several views: least reprojection error, with rejection of outlier views.

    Args:
        views: (views, 25) the cameras, see `geometry.triangulation.Views`.
        pixels: (points, views, 2) [px]; NaN where not seen.
        sd: (points, views) standard deviation of a pixel's coordinates [px].
        gate: largest reprojection error of an inlier view, in standard deviations.
        least_sin2: squared sine of the least angle between rays.
        points, covariances, residuals, used, states: (points, 3) [m], (points, 3, 3) [m²], (points, views) [px],
            (points, views) inliers and (points,) `PointState`, written.
    """
    count = pixels.shape[1]
    rays, weights, kept, tried = np.empty((count, 6)), np.empty(count), np.empty(count), np.empty(count)
    fitted = np.empty(len(pixels), dtype=np.bool_)
    gate2 = gate * gate
    fit_most(views, pixels, sd, gate2, points, covariances, residuals, fitted)
    for i in range(len(pixels)):
        if fitted[i]:
            for k in range(count):
                used[i, k] = not math.isnan(residuals[i, k])
            states[i] = SEEN
            if not wide(views, used, i, points[i, 0], points[i, 1], points[i, 2], least_sin2):
                nothing(i, PARALLEL, points, covariances, residuals, used, states)
            continue
        seen = 0
        for k in range(count):
            weights[k], residuals[i, k] = 0.0, math.nan
            u, v, s = pixels[i, k, 0], pixels[i, k, 1], sd[i, k]
            if s > 0.0 and math.isfinite(u + v + s):
                x, y = undistort(views, k, (u - views[k, 2]) / views[k, 0], (v - views[k, 3]) / views[k, 1])
                if not math.isnan(x):
                    keep_ray(views, k, x, y, rays)
                    weights[k] = 1.0 / (s * s)
                    seen += 1
        state = ONE_VIEW
        X = Y = Z = A = B = C = D = E = F = math.nan
        if seen >= 2:
            state, X, Y, Z, A, B, C, D, E, F = consensus(
                views, pixels, i, rays, weights, gate2, least_sin2, kept, tried
            )
        if state == SEEN:
            for k in range(count):
                used[i, k] = kept[k] > 0.0
            if not wide(views, used, i, X, Y, Z, least_sin2):
                state = PARALLEL
        if state != SEEN:
            nothing(i, state, points, covariances, residuals, used, states)
            continue
        states[i] = SEEN
        write_residuals(views, pixels, i, weights, X, Y, Z, residuals)
        points[i, 0], points[i, 1], points[i, 2] = X, Y, Z
        covariances[i, 0, 0], covariances[i, 0, 1], covariances[i, 0, 2] = A, B, C
        covariances[i, 1, 0], covariances[i, 1, 1], covariances[i, 1, 2] = B, D, E
        covariances[i, 2, 0], covariances[i, 2, 1], covariances[i, 2, 2] = C, E, F


@njit(**COMPILED)
def nothing(
    i: int, state: int, points: Float64, covariances: Float64, residuals: Float64, used: Bool, states: UInt8
) -> None:
    """Write a failure into row i of the results of `triangulate`: NaN, no used view, and the reason as state.

    Args:
        i: index of the point.
        state: the reason of failure, such as `PARALLEL`.
        points, covariances, residuals, used, states: the results of `triangulate`; row i is written.
    """
    states[i], points[i], covariances[i], residuals[i], used[i] = state, math.nan, math.nan, math.nan, False


@njit(**COMPILED)
def write_residuals(
    views: Float64, pixels: Float64, at: int, weights: Float64, X: float, Y: float, Z: float, residuals: Float64
) -> None:
    """Write a point's reprojection errors in the views with a weight above 0.

    Args:
        views, pixels: (views, 25) the cameras, see `geometry.triangulation.Views`, and (points, views, 2) [px].
        at: index of the point.
        weights: (views,).
        X, Y, Z: the point, world [m].
        residuals: (points, views) [px]; row ``at`` is written.
    """
    for k in range(len(weights)):
        if weights[k] > 0.0:
            du, dv = offset(views, k, X, Y, Z, pixels[at, k, 0], pixels[at, k, 1])
            residuals[at, k] = math.sqrt(du * du + dv * dv)
