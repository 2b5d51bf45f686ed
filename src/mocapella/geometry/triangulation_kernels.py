"""The hot steps of `mocapella.geometry.triangulation`, compiled, a point at a time; importing this imports numba.

A view is one row of numbers, in the order of `triangulation.Views`: the lens (9), the squared radius where its model
ends, the rotation R_camera_world by rows (9), the translation (3), and the camera's centre in the world (3).
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position
from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numba import njit

from mocapella.geometry.lens_kernels import distort
from mocapella.geometry.lens_kernels import undistort as undistort_fully

COMPILED: Final[dict[str, Any]] = {"cache": True, "error_model": "numpy", "fastmath": {"contract", "nsz", "arcp"}}
SEEN, ONE_VIEW, PARALLEL, BEHIND, INCONSISTENT = 0, 1, 2, 3, 4
STEPS = 12
"""Gauss–Newton needs two or three; what takes more is not a point."""
REFITS = 4


@njit(**COMPILED)
def undistort(views, n, u, v):
    """The direction (x, y) of a normalised pixel: two Newton steps, which do for a start, or as many as it takes."""
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
    return undistort_fully(u, v, k1, k2, p1, p2, k3, views[n, 9])


@njit(**COMPILED)
def offset(views, n, X, Y, Z, u, v):
    """(dx, dy) [px] from where a point is seen to the pixel (u, v); infinite where it is not seen."""
    z = views[n, 16] * X + views[n, 17] * Y + views[n, 18] * Z + views[n, 21]
    x = (views[n, 10] * X + views[n, 11] * Y + views[n, 12] * Z + views[n, 19]) / z
    y = (views[n, 13] * X + views[n, 14] * Y + views[n, 15] * Z + views[n, 20]) / z
    r2 = x * x + y * y
    if not (z > 0.0 and r2 <= views[n, 9]):
        return math.inf, math.inf
    radial = 1.0 + r2 * (views[n, 4] + r2 * (views[n, 5] + r2 * views[n, 8]))
    at_u = x * radial + 2.0 * views[n, 6] * x * y + views[n, 7] * (r2 + 2.0 * x * x)
    at_v = y * radial + views[n, 6] * (r2 + 2.0 * y * y) + 2.0 * views[n, 7] * x * y
    return u - (views[n, 0] * at_u + views[n, 2]), v - (views[n, 1] * at_v + views[n, 3])


@njit(**COMPILED)
def linearised(views, n, X, Y, Z, u, v):
    """`offset`, and the derivatives by X, Y, Z of where the point is seen: of its column (3) and its row (3)."""
    z = views[n, 16] * X + views[n, 17] * Y + views[n, 18] * Z + views[n, 21]
    w = 1.0 / z
    x = (views[n, 10] * X + views[n, 11] * Y + views[n, 12] * Z + views[n, 19]) * w
    y = (views[n, 13] * X + views[n, 14] * Y + views[n, 15] * Z + views[n, 20]) * w
    if not (z > 0.0 and x * x + y * y <= views[n, 9]):
        return math.inf, math.inf, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    at_u, at_v, uu, uv, vv = distort(x, y, views[n, 4], views[n, 5], views[n, 6], views[n, 7], views[n, 8])
    ax, ay, az = views[n, 10] - x * views[n, 16], views[n, 11] - x * views[n, 17], views[n, 12] - x * views[n, 18]
    bx, by, bz = views[n, 13] - y * views[n, 16], views[n, 14] - y * views[n, 17], views[n, 15] - y * views[n, 18]
    fu, fv = views[n, 0] * w, views[n, 1] * w
    return (
        u - (views[n, 0] * at_u + views[n, 2]), v - (views[n, 1] * at_v + views[n, 3]),
        fu * (uu * ax + uv * bx), fu * (uu * ay + uv * by), fu * (uu * az + uv * bz),
        fv * (uv * ax + vv * bx), fv * (uv * ay + vv * by), fv * (uv * az + vv * bz),
    )  # fmt: skip


@njit(**COMPILED)
def inverse(a, b, c, d, e, f):
    """Of the symmetric [[a, b, c], [b, d, e], [c, e, f]], its six numbers in the same order."""
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d
    scale = 1.0 / (a * A + b * B + c * C)
    return scale * A, scale * B, scale * C, scale * (a * f - c * c), scale * (b * c - a * e), scale * (a * d - b * b)


@njit(**COMPILED)
def linear(views, rays, weights):
    """Where the rays of the views with a weight meet, in the least squares of x·z' − x' (and y) [m]: a start."""
    a = b = c = d = e = f = gx = gy = gz = 0.0
    for n in range(len(weights)):
        if not weights[n] > 0.0:
            continue
        x, y = rays[n, 0], rays[n, 1]
        w = weights[n] * views[n, 0] * views[n, 1]
        px, py, pz = views[n, 10] - x * views[n, 16], views[n, 11] - x * views[n, 17], views[n, 12] - x * views[n, 18]
        qx, qy, qz = views[n, 13] - y * views[n, 16], views[n, 14] - y * views[n, 17], views[n, 15] - y * views[n, 18]
        p, q = w * (x * views[n, 21] - views[n, 19]), w * (y * views[n, 21] - views[n, 20])
        a += w * (px * px + qx * qx)
        b += w * (px * py + qx * qy)
        c += w * (px * pz + qx * qz)
        d += w * (py * py + qy * qy)
        e += w * (py * pz + qy * qz)
        f += w * (pz * pz + qz * qz)
        gx += px * p + qx * q
        gy += py * p + qy * q
        gz += pz * p + qz * q
    A, B, C, D, E, F = inverse(a, b, c, d, e, f)
    return A * gx + B * gy + C * gz, B * gx + D * gy + E * gz, C * gx + E * gy + F * gz


@njit(**COMPILED)
def refine(views, pixels, at, weights, X, Y, Z, give_up):
    """Gauss–Newton on the distorted pixels of the views with a weight 1/sd²; halved steps where one leads uphill.

    It gives up where the sum of squares [sd²] begins above 16 times ``give_up``, or is above 4 times that after a step.

    Returns:
        X, Y, Z, whether they are where it is least, and the six numbers of the covariance there.
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
        if step == 0 and not cost <= 16.0 * give_up:
            break
        if not cost <= before * (1.0 + 1e-9) + 1e-9:
            sx, sy, sz = 0.5 * sx, 0.5 * sy, 0.5 * sz
            X, Y, Z = X - sx, Y - sy, Z - sz
            continue
        if step >= 1 and cost > 4.0 * give_up:
            break
        before = cost
        A, B, C, D, E, F = inverse(a, b, c, d, e, f)
        sx, sy, sz = A * gx + B * gy + C * gz, B * gx + D * gy + E * gz, C * gx + E * gy + F * gz
        X, Y, Z = X + sx, Y + sy, Z + sz
        if gx * sx + gy * sy + gz * sz < 1e-5:  # the square of the step in units of its own uncertainty
            return X, Y, Z, True, A, B, C, D, E, F
    return X, Y, Z, False, A, B, C, D, E, F


@njit(**COMPILED)
def direction(views, n, x, y):
    """Of a ray in the world, not normalised: R_world_camera (x, y, 1)."""
    return (
        views[n, 10] * x + views[n, 13] * y + views[n, 16],
        views[n, 11] * x + views[n, 14] * y + views[n, 17],
        views[n, 12] * x + views[n, 15] * y + views[n, 18],
    )


@njit(**COMPILED)
def wide(views, rays, weights, least_sin2):
    """Whether two rays of the views with a weight meet at an angle that is large enough."""
    for i in range(len(weights)):
        if not weights[i] > 0.0:
            continue
        ax, ay, az = direction(views, i, rays[i, 0], rays[i, 1])
        for j in range(i):
            if weights[j] > 0.0:
                bx, by, bz = direction(views, j, rays[j, 0], rays[j, 1])
                x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
                aa, bb = ax * ax + ay * ay + az * az, bx * bx + by * by + bz * bz
                if x * x + y * y + z * z >= least_sin2 * aa * bb:
                    return True
    return False


@njit(**COMPILED)
def meeting(views, rays, weights, m, n, gate2, least_sin2):
    """Where two rays are nearest, by the sd of each at its distance; a state, and the point.

    Source: Hartley and Sturm: Triangulation (CVIU 68(2), 1997), section 3 for the midpoint of the common normal.
    """
    ax, ay, az = direction(views, m, rays[m, 0], rays[m, 1])
    bx, by, bz = direction(views, n, rays[n, 0], rays[n, 1])
    dx, dy, dz = views[n, 22] - views[m, 22], views[n, 23] - views[m, 23], views[n, 24] - views[m, 24]
    aa, bb, ab = ax * ax + ay * ay + az * az, bx * bx + by * by + bz * bz, ax * bx + ay * by + az * bz
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


@njit(**COMPILED)
def truncated(views, pixels, at, weights, X, Y, Z, gate2, best, kept):
    """The sum of the squared residuals [sd²], each at most the gate's; it ends where that is above ``best``.

    ``kept`` becomes the weights of the views within the gate, and 0 for others.
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


@njit(**COMPILED)
def two_or_more(kept):
    """Whether two views or more have a weight."""
    count = 0
    for k in range(len(kept)):
        if kept[k] > 0.0:
            count += 1
    return count >= 2


@njit(**COMPILED)
def consensus(views, pixels, at, rays, weights, gate2, least_sin2, kept, tried):
    """The point whose truncated error is least, of those that follow from any two views, refitted on what agrees.

    Every pair is tried, so nothing depends on chance. The best is refitted while that makes it better: Chum, Matas,
    Kittler: Locally Optimized RANSAC (DAGM 2003), section 2.

    Returns:
        Why there is none, or `SEEN`; X, Y, Z and the covariance; ``kept`` has the weights of the views that agree.
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
                kept[:] = tried
    if not best < math.inf:
        return state, X, Y, Z, A, B, C, D, E, F
    best, state = math.inf, INCONSISTENT
    for _ in range(REFITS):
        x, y, z, well, a, b, c, d, e, f = refine(views, pixels, at, kept, X, Y, Z, math.inf)
        if not well:
            break
        score = truncated(views, pixels, at, weights, x, y, z, gate2, math.inf, tried)
        if not (score < best and two_or_more(tried)):
            break
        best, state, X, Y, Z, A, B, C, D, E, F = score, SEEN, x, y, z, a, b, c, d, e, f
        if same(kept, tried):
            break
        kept[:] = tried
    return state, X, Y, Z, A, B, C, D, E, F


@njit(**COMPILED)
def same(kept, tried):
    """Whether the same views have a weight."""
    equal = True
    for k in range(len(kept)):
        equal &= (kept[k] > 0.0) == (tried[k] > 0.0)
    return equal


@njit(**COMPILED)
def triangulate(views, pixels, sd, gate, least_sin2, points, covariances, residuals, used, states):
    """`triangulation.triangulate`: pixels (points, views, 2), sd (points, views); writes the last five."""
    count = pixels.shape[1]
    rays, weights, kept, tried = np.empty((count, 2)), np.empty(count), np.empty(count), np.empty(count)
    gate2 = gate * gate
    for i in range(len(pixels)):
        seen = 0
        for k in range(count):
            weights[k], residuals[i, k] = 0.0, math.nan
            u, v, s = pixels[i, k, 0], pixels[i, k, 1], sd[i, k]
            if s > 0.0 and math.isfinite(u + v + s):
                x, y = undistort(views, k, (u - views[k, 2]) / views[k, 0], (v - views[k, 3]) / views[k, 1])
                if not math.isnan(x):
                    rays[k, 0], rays[k, 1], weights[k] = x, y, 1.0 / (s * s)
                    seen += 1
        X = Y = Z = A = B = C = D = E = F = math.nan
        state, well = ONE_VIEW, False
        if seen >= 2:
            X, Y, Z = linear(views, rays, weights)
            X, Y, Z, well, A, B, C, D, E, F = refine(views, pixels, i, weights, X, Y, Z, seen * gate2)
            state = SEEN
            well = well and squares(views, pixels, i, weights, X, Y, Z, residuals) <= gate2
            if not well:
                state, X, Y, Z, A, B, C, D, E, F = consensus(
                    views, pixels, i, rays, weights, gate2, least_sin2, kept, tried
                )
            else:
                kept[:] = weights
            if state == SEEN and not wide(views, rays, kept, least_sin2):
                state = PARALLEL
        states[i] = state
        if state != SEEN:
            X = Y = Z = A = B = C = D = E = F = math.nan
        elif not well:
            squares(views, pixels, i, weights, X, Y, Z, residuals)
        points[i, 0], points[i, 1], points[i, 2] = X, Y, Z
        covariances[i, 0, 0], covariances[i, 0, 1], covariances[i, 0, 2] = A, B, C
        covariances[i, 1, 0], covariances[i, 1, 1], covariances[i, 1, 2] = B, D, E
        covariances[i, 2, 0], covariances[i, 2, 1], covariances[i, 2, 2] = C, E, F
        for k in range(count):
            used[i, k] = state == SEEN and kept[k] > 0.0
            if state != SEEN:
                residuals[i, k] = math.nan


@njit(**COMPILED)
def squares(views, pixels, at, weights, X, Y, Z, residuals):
    """Write the residual of each view [px]; return the largest square of those with a weight [sd²]."""
    largest = 0.0
    for k in range(len(weights)):
        if weights[k] > 0.0:
            du, dv = offset(views, k, X, Y, Z, pixels[at, k, 0], pixels[at, k, 1])
            square = du * du + dv * dv
            residuals[at, k] = math.sqrt(square)
            largest = max(largest, weights[k] * square)
    return largest
