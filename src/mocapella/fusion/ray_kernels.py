"""Compiled steps of `mocapella.fusion.marker_rays`, in place; importing this module imports numba.

They are the predict and update steps of an extended Kalman filter for each marker, with χ² gating, initialisation by
triangulation, and re-filtering when a late observation is inserted.
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.fusion.marker_rays import CameraPixels, RayMemory, RayOutput, RayParameters
from mocapella.geometry.triangulation_kernels import triangulate
from mocapella.geometry.triangulation_lane_kernels import linearised, numbers_of

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

TRACKED, INFERRED, LOST = 0, 1, 2
IN, USED, REFUSED, LATE, BEGUN, FORGOTTEN = range(6)
POSITION_SD_M = 1.0
"""Prior standard deviation of a coordinate of a new marker, before the filter uses its first observations [m]."""
REFUSED_IN_A_ROW = 6
"""A marker is lost after this number of rejected observations in a row."""


@njit(cache=True, error_model="numpy")
def predict(x: Float64, P: Float64, dt: float, acceleration_density: float) -> None:
    """Predict a marker's state and covariance by a time step, in place.

    Args:
        x: (6,) position [m] and velocity [m/s]; updated.
        P: (6, 6) its covariance; updated.
        dt: time step [s]; it may be negative.
        acceleration_density: power spectral density of the white-noise acceleration along an axis [m²/s³].
    """
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
def correct(x: Float64, P: Float64, views: Float64, k: int, u: float, v: float, variance: float, gate2: float) -> bool:
    """Correct a marker's state by one pixel, in place (extended Kalman filter); return whether it was used.

    The pixel is rejected beyond the gate, or if the marker cannot be projected into the camera.

    Args:
        x, P: (6,), (6, 6) state and covariance, as in `predict`; unchanged by a rejected pixel.
        views: (cameras, 25) the rig's cameras, see `geometry.triangulation.Views`.
        k: index of the camera.
        u, v: the pixel [px].
        variance: variance of the pixel's coordinates [px²].
        gate2: largest squared Mahalanobis distance of the innovation.
    """
    du, dv, ax, ay, az, bx, by, bz = linearised(numbers_of(views, k), x[0], x[1], x[2], u, v)
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
def absorb(j: int, memory: RayMemory, views: Float64, q: float, gate2: float) -> None:
    """Apply point j's oldest stored observation to its filter for good, and remove it from the buffer, in place.

    Before the filter has begun, the observation is only removed.

    Args:
        j: index of the point.
        memory: state and observations of the points, updated.
        views: (cameras, 25) the rig's cameras, see `geometry.triangulation.Views`.
        q: acceleration density, as in `predict` [m²/s³].
        gate2: largest squared Mahalanobis distance of the innovation.
    """
    states, covariances, begins, counts = memory.states, memory.covariances, memory.begins, memory.counts
    times, cameras, pixels, variances = memory.times, memory.cameras, memory.pixels, memory.variances
    used_s = memory.used_s
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
def begin(j: int, memory: RayMemory, views: Float64, parameters: RayParameters) -> bool:
    """Initialise point j by triangulating each camera's newest observation, of two or more; return whether it worked.

    The observations must lie within ``together_s``. The point begins at rest there, at the time of its oldest stored
    observation, with wide priors.

    Args:
        j: index of the point, with at least one stored observation.
        memory: state and observations of the points, updated if it worked.
        views: (cameras, 25) the rig's cameras, see `geometry.triangulation.Views`.
        parameters: the settings.
    """
    states, covariances, begins, counts = memory.states, memory.covariances, memory.begins, memory.counts
    times, cameras, pixels, variances = memory.times, memory.cameras, memory.pixels, memory.variances
    count, newest = len(views), times[j, counts[j] - 1]
    seen, sd = np.full((1, count, 2), np.nan), np.full((1, count), np.nan)
    for i in range(counts[j]):  # in order of time, so the newest of each camera stays
        gap, k = newest - times[j, i], cameras[j, i]
        if gap <= parameters.together_s:
            seen[0, k, 0], seen[0, k, 1] = pixels[j, i, 0], pixels[j, i, 1]
            sd[0, k] = math.sqrt(variances[j, i] + (parameters.image_speed_px * gap) ** 2)
    point, covariance, residuals = np.empty((1, 3)), np.empty((1, 3, 3)), np.empty((1, count))
    used, state = np.empty((1, count), dtype=np.bool_), np.empty(1, dtype=np.uint8)
    triangulate(views, seen, sd, parameters.gate_sd, parameters.least_sin2, point, covariance, residuals, used, state)
    if state[0] != 0:
        return False
    covariances[j] = 0.0
    for i in range(3):
        states[j, i], states[j, 3 + i] = point[0, i], 0.0
        covariances[j, i, i] = POSITION_SD_M**2
        covariances[j, 3 + i, 3 + i] = parameters.speed_sd**2
    begins[j] = times[j, 0]
    return True


@njit(cache=True, error_model="numpy")
def observe(frame: CameraPixels, memory: RayMemory, views: Float64, report: Int64, parameters: RayParameters) -> None:
    """Insert a camera's pixels into the markers' observations, in order of time, and count the outcomes.

    A lost marker is initialised if possible. One with `REFUSED_IN_A_ROW` rejected observations is reset, so lost.

    Args:
        frame: the pixels.
        memory: state and observations of the points, updated.
        views: (cameras, 25) the rig's cameras, see `geometry.triangulation.Views`.
        report: (6,) counts of received, used, rejected and late observations, and of initialised and lost markers;
            updated.
        parameters: the settings.
    """
    states, covariances, begins, counts = memory.states, memory.covariances, memory.begins, memory.counts
    times, cameras, pixels, variances = memory.times, memory.cameras, memory.pixels, memory.variances
    refused, at_s, pixels_now, variances_now = memory.refused, frame.times, frame.pixels, frame.variances
    q, gate2 = parameters.acceleration_density, parameters.gate_sd**2
    room = times.shape[1]
    for j in range(len(at_s)):
        t = at_s[j]
        if not (math.isfinite(pixels_now[j, 0] + pixels_now[j, 1] + t) and 0.0 < variances_now[j] < math.inf):
            continue
        report[IN] += 1
        if t < begins[j]:
            report[LATE] += 1
            continue
        while counts[j] == room or (counts[j] > 0 and times[j, 0] < t - parameters.keep_s):
            absorb(j, memory, views, q, gate2)
        if t < begins[j]:
            report[LATE] += 1
            continue
        i = counts[j]
        while i > 0 and times[j, i - 1] > t:
            times[j, i], cameras[j, i], variances[j, i] = times[j, i - 1], cameras[j, i - 1], variances[j, i - 1]
            pixels[j, i, 0], pixels[j, i, 1] = pixels[j, i - 1, 0], pixels[j, i - 1, 1]
            i -= 1
        times[j, i], cameras[j, i], variances[j, i] = t, frame.camera, variances_now[j]
        pixels[j, i, 0], pixels[j, i, 1] = pixels_now[j, 0], pixels_now[j, 1]
        counts[j] += 1
        if math.isnan(begins[j]):
            if begin(j, memory, views, parameters):
                report[BEGUN] += 1
                report[USED] += 1
                refused[j] = 0
            continue
        x, P = states[j].copy(), covariances[j].copy()
        if follow(j, x, P, begins[j], i + 1, memory, views, q, gate2):
            report[USED] += 1
            refused[j] = 0
        else:
            report[REFUSED] += 1
            refused[j] += 1
            if refused[j] >= REFUSED_IN_A_ROW:  # the state is wrong: restart
                forget(j, memory, report)


@njit(cache=True, error_model="numpy")
def follow(
    j: int,
    x: Float64,
    P: Float64,
    since: float,
    count: int,
    memory: RayMemory,
    views: Float64,
    q: float,
    gate2: float,
) -> bool:
    """Filter a point's stored observations from the oldest on, in place; return whether the last one passed the gate.

    Args:
        j: index of the point.
        x, P: (6,), (6, 6) state and covariance at ``since``, as in `predict`; updated to the last observation's time.
        since: time of the state, on the rig's clock [s].
        count: number of observations to use, from the oldest.
        memory: the observations; only its ``used_s`` is updated.
        views: (cameras, 25) the rig's cameras, see `geometry.triangulation.Views`.
        q: acceleration density, as in `predict` [m²/s³].
        gate2: largest squared Mahalanobis distance of the innovation.
    """
    times, cameras, pixels, variances = memory.times, memory.cameras, memory.pixels, memory.variances
    used_s = memory.used_s
    used = False
    for i in range(count):
        predict(x, P, times[j, i] - since, q)
        since, k = times[j, i], cameras[j, i]
        used = correct(x, P, views, k, pixels[j, i, 0], pixels[j, i, 1], variances[j, i], gate2)
        if used:
            used_s[j, k] = max(used_s[j, k], since)
    return used


@njit(cache=True, error_model="numpy")
def forget(j: int, memory: RayMemory, report: Int64) -> None:
    """Reset point j in ``memory``, so that it is lost, and count that in ``report`` (6,)."""
    memory.begins[j], memory.counts[j], memory.refused[j] = math.nan, 0, 0
    memory.used_s[j] = -math.inf
    report[FORGOTTEN] += 1


@njit(cache=True, error_model="numpy")
def locate(
    at_s: float, memory: RayMemory, views: Float64, report: Int64, parameters: RayParameters, out: RayOutput
) -> None:
    """Predict every point to a time; points that are lost then are reset.

    Args:
        at_s: the time, on the rig's clock [s].
        memory: state of the points; lost ones are reset.
        views: (cameras, 25) the rig's cameras, see `geometry.triangulation.Views`.
        report: (6,) counts as in `observe`; updated.
        parameters: the settings.
        out: the predicted points, written; NaN where lost.
    """
    begins, counts, times, used_s = memory.begins, memory.counts, memory.times, memory.used_s
    positions, velocities, kinds = out.positions, out.velocities, out.states
    q, gate2 = parameters.acceleration_density, parameters.gate_sd**2
    for j in range(len(begins)):
        kinds[j] = LOST
        positions[j], velocities[j], out.covariances[j] = math.nan, math.nan, math.nan
        if math.isnan(begins[j]):
            continue
        x, P = memory.states[j].copy(), memory.covariances[j].copy()
        follow(j, x, P, begins[j], counts[j], memory, views, q, gate2)
        last = times[j, counts[j] - 1] if counts[j] else begins[j]
        predict(x, P, at_s - last, q)
        variance = max(P[0, 0], P[1, 1], P[2, 2])
        recently, seen_s = 0, -math.inf
        for k in range(len(views)):
            if used_s[j, k] >= at_s - parameters.alone_s:
                recently += 1
            seen_s = max(seen_s, used_s[j, k])
        uncertain = not variance <= parameters.largest_sd_m**2
        if at_s - seen_s > parameters.forget_after_s or (recently < 2 and uncertain):
            forget(j, memory, report)
            continue
        kinds[j] = TRACKED if recently >= 2 else INFERRED
        for i in range(3):
            positions[j, i], velocities[j, i] = x[i], x[3 + i]
            for c in range(3):
                out.covariances[j, i, c] = P[i, c]
