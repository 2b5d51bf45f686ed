"""The hot steps of `mocapella.fusion.marker_rays`, compiled and in place; importing this module imports numba.

Arrays are as `MarkerRays` describes them.
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position
from __future__ import annotations

import math

import numpy as np

from mocapella.compiled import njit
from mocapella.geometry.triangulation_kernels import linearised, triangulate

TRACKED, INFERRED, LOST = 0, 1, 2
IN, USED, REFUSED, LATE, BEGUN, FORGOTTEN = range(6)
POSITION_SD_M = 1.0
"""Of what is known of a new point before its first observation is used again, by the filter."""
REFUSED_IN_A_ROW = 6


@njit(cache=True, error_model="numpy")
def predict(x, P, dt, acceleration_density):
    """`smoothing.kalman`'s motion with a full covariance (6, 6); ``dt`` may be negative."""
    for i in range(3):
        x[i] += dt * x[3 + i]
    for i in range(6):
        for j in range(3):
            P[i, j] += dt * P[i, 3 + j]
    for i in range(3):
        for j in range(6):
            P[i, j] += dt * P[3 + i, j]
    a, q = abs(dt), acceleration_density
    for i in range(3):
        P[i, i] += q * a * a * a / 3.0
        P[i, 3 + i] += q * dt * a / 2.0
        P[3 + i, i] += q * dt * a / 2.0
        P[3 + i, 3 + i] += q * a


@njit(cache=True, error_model="numpy")
def correct(x, P, views, k, u, v, variance, gate2):
    """A pixel of camera k, by the extended Kalman filter; False where it is beyond the gate and changes nothing."""
    du, dv, ax, ay, az, bx, by, bz = linearised(views, k, x[0], x[1], x[2], u, v)
    if not math.isfinite(du + dv):
        return False
    PA, PB = np.empty(6), np.empty(6)
    for i in range(6):
        PA[i] = P[i, 0] * ax + P[i, 1] * ay + P[i, 2] * az
        PB[i] = P[i, 0] * bx + P[i, 1] * by + P[i, 2] * bz
    s = ax * PA[0] + ay * PA[1] + az * PA[2] + variance
    t = ax * PB[0] + ay * PB[1] + az * PB[2]
    w = bx * PB[0] + by * PB[1] + bz * PB[2] + variance
    scale = 1.0 / (s * w - t * t)
    g, h = scale * (w * du - t * dv), scale * (s * dv - t * du)
    if du * g + dv * h > gate2:
        return False
    for i in range(6):
        x[i] += PA[i] * g + PB[i] * h
    for i in range(6):
        p, q = scale * (w * PA[i] - t * PB[i]), scale * (s * PB[i] - t * PA[i])
        for j in range(i + 1):
            P[i, j] -= p * PA[j] + q * PB[j]
            P[j, i] = P[i, j]
    return True


@njit(cache=True, error_model="numpy")
def absorb(j, states, covariances, begins, counts, times, cameras, pixels, variances, used_s, views, q, gate2):
    """Take the oldest observation of point j out of its memory and into what is known at that instant."""
    if not math.isnan(begins[j]):
        predict(states[j], covariances[j], times[j, 0] - begins[j], q)
        k = cameras[j, 0]
        if correct(states[j], covariances[j], views, k, pixels[j, 0, 0], pixels[j, 0, 1], variances[j, 0], gate2):
            used_s[j, k] = max(used_s[j, k], times[j, 0])
        begins[j] = times[j, 0]
    counts[j] -= 1
    for i in range(counts[j]):
        times[j, i], cameras[j, i], variances[j, i] = times[j, i + 1], cameras[j, i + 1], variances[j, i + 1]
        pixels[j, i, 0], pixels[j, i, 1] = pixels[j, i + 1, 0], pixels[j, i + 1, 1]


@njit(cache=True, error_model="numpy")
def begin(
    j, states, covariances, begins, counts, times, cameras, pixels, variances, views,
    together_s, image_speed_px, speed_sd, gate, least_sin2,
):  # fmt: skip
    """Where the newest observations of two cameras or more meet; whether they do."""
    count, newest = len(views), times[j, counts[j] - 1]
    seen, sd = np.full((1, count, 2), np.nan), np.full((1, count), np.nan)
    for i in range(counts[j]):  # the newest of each camera comes last
        gap, k = newest - times[j, i], cameras[j, i]
        if gap <= together_s:
            seen[0, k, 0], seen[0, k, 1] = pixels[j, i, 0], pixels[j, i, 1]
            sd[0, k] = math.sqrt(variances[j, i] + (image_speed_px * gap) ** 2)
    point, covariance, residuals = np.empty((1, 3)), np.empty((1, 3, 3)), np.empty((1, count))
    used, state = np.empty((1, count), dtype=np.bool_), np.empty(1, dtype=np.uint8)
    triangulate(views, seen, sd, gate, least_sin2, point, covariance, residuals, used, state)
    if state[0] != 0:
        return False
    covariances[j] = 0.0
    for i in range(3):
        states[j, i], states[j, 3 + i] = point[0, i], 0.0
        covariances[j, i, i] = POSITION_SD_M**2
        covariances[j, 3 + i, 3 + i] = speed_sd**2
    begins[j] = times[j, 0]
    return True


@njit(cache=True, error_model="numpy")
def observe(
    camera, pixels_now, variances_now, at_s,
    states, covariances, begins, counts, times, cameras, pixels, variances, used_s, refused, views, report,
    q, gate, keep_s, together_s, image_speed_px, speed_sd, least_sin2,
):  # fmt: skip
    """Put a camera's pixels (points, 2) of the times (points,) into the memories."""
    room = times.shape[1]
    for j in range(len(at_s)):
        t = at_s[j]
        if not (math.isfinite(pixels_now[j, 0] + pixels_now[j, 1] + t) and 0.0 < variances_now[j] < math.inf):
            continue
        report[IN] += 1
        if t < begins[j]:
            report[LATE] += 1
            continue
        while counts[j] == room or (counts[j] > 0 and times[j, 0] < t - keep_s):
            absorb(j, states, covariances, begins, counts, times, cameras, pixels, variances, used_s, views, q, gate**2)
        if t < begins[j]:
            report[LATE] += 1
            continue
        i = counts[j]
        while i > 0 and times[j, i - 1] > t:
            times[j, i], cameras[j, i], variances[j, i] = times[j, i - 1], cameras[j, i - 1], variances[j, i - 1]
            pixels[j, i, 0], pixels[j, i, 1] = pixels[j, i - 1, 0], pixels[j, i - 1, 1]
            i -= 1
        times[j, i], cameras[j, i], variances[j, i] = t, camera, variances_now[j]
        pixels[j, i, 0], pixels[j, i, 1] = pixels_now[j, 0], pixels_now[j, 1]
        counts[j] += 1
        if math.isnan(begins[j]):
            if begin(
                j, states, covariances, begins, counts, times, cameras, pixels, variances, views,
                together_s, image_speed_px, speed_sd, gate, least_sin2,
            ):  # fmt: skip
                report[BEGUN] += 1
                report[USED] += 1
                refused[j] = 0
            continue
        x, P = states[j].copy(), covariances[j].copy()
        if follow(j, x, P, begins[j], i + 1, times, cameras, pixels, variances, used_s, views, q, gate**2):
            report[USED] += 1
            refused[j] = 0
        else:
            report[REFUSED] += 1
            refused[j] += 1
            if refused[j] >= REFUSED_IN_A_ROW:  # what is known is wrong; it begins anew
                forget(j, begins, counts, used_s, refused, report)


@njit(cache=True, error_model="numpy")
def follow(j, x, P, since, count, times, cameras, pixels, variances, used_s, views, q, gate2):
    """Bring a state over the first observations of point j; whether the last of them was used."""
    used = False
    for i in range(count):
        predict(x, P, times[j, i] - since, q)
        since, k = times[j, i], cameras[j, i]
        used = correct(x, P, views, k, pixels[j, i, 0], pixels[j, i, 1], variances[j, i], gate2)
        if used:
            used_s[j, k] = max(used_s[j, k], since)
    return used


@njit(cache=True, error_model="numpy")
def forget(j, begins, counts, used_s, refused, report):
    """Nothing is known of point j."""
    begins[j], counts[j], refused[j] = math.nan, 0, 0
    used_s[j] = -math.inf
    report[FORGOTTEN] += 1


@njit(cache=True, error_model="numpy")
def tell(
    at_s, states, covariances, begins, counts, times, cameras, pixels, variances, used_s, refused, views, report,
    q, gate, alone_s, forget_after_s, largest_sd_m, positions, velocities, uncertain, kinds,
):  # fmt: skip
    """Every point at one instant: positions and velocities (points, 3), covariances (points, 3, 3), kinds."""
    for j in range(len(begins)):
        kinds[j] = LOST
        positions[j], velocities[j], uncertain[j] = math.nan, math.nan, math.nan
        if math.isnan(begins[j]):
            continue
        x, P = states[j].copy(), covariances[j].copy()
        follow(j, x, P, begins[j], counts[j], times, cameras, pixels, variances, used_s, views, q, gate**2)
        last = times[j, counts[j] - 1] if counts[j] else begins[j]
        predict(x, P, at_s - last, q)
        variance = max(P[0, 0], P[1, 1], P[2, 2])
        recently, seen_s = 0, -math.inf
        for k in range(len(views)):
            if used_s[j, k] >= at_s - alone_s:
                recently += 1
            seen_s = max(seen_s, used_s[j, k])
        if at_s - seen_s > forget_after_s or (recently < 2 and not variance <= largest_sd_m**2):
            forget(j, begins, counts, used_s, refused, report)
            continue
        kinds[j] = TRACKED if recently >= 2 else INFERRED
        for i in range(3):
            positions[j, i], velocities[j, i] = x[i], x[3 + i]
            for c in range(3):
                uncertain[j, i, c] = P[i, c]
