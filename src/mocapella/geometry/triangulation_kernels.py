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

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.geometry.lens_kernels import distort
from mocapella.geometry.lens_kernels import undistort as undistort_fully
from mocapella.geometry.triangulation_lane_kernels import (
    AGREED,
    COMPILED,
    INLINED,
    fit_agreeing,
    fit_most,
    inverse,
    linearised,
    numbers_of,
    offset,
)  # fmt: skip

Bool = NDArray[np.bool_]
Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]

SEEN, ONE_VIEW, PARALLEL, BEHIND, INCONSISTENT = 0, 1, 2, 3, 4
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
                du, dv, px, py, pz, qx, qy, qz = linearised(
                    numbers_of(views, k), X, Y, Z, pixels[at, k, 0], pixels[at, k, 1]
                )
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
            du, dv = offset(numbers_of(views, k), X, Y, Z, pixels[at, k, 0], pixels[at, k, 1])
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
def triangulate(  # noqa: PLR0912 - loops over points and views
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
    fitted = np.empty(len(pixels), dtype=np.uint8)
    gate2 = gate * gate
    fit_most(views, pixels, sd, gate2, points, covariances, residuals, fitted)
    fit_agreeing(views, pixels, sd, gate2, least_sin2, points, covariances, residuals, used, fitted)
    for i in range(len(pixels)):
        if fitted[i]:
            if fitted[i] != AGREED:
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
            du, dv = offset(numbers_of(views, k), X, Y, Z, pixels[at, k, 0], pixels[at, k, 1])
            residuals[at, k] = math.sqrt(du * du + dv * dv)
