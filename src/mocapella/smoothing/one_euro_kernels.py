"""Kernels of `mocapella.smoothing.one_euro`, in place; importing this module imports numba.

Common arguments::

    positions, velocities (points, dimensions)   the filter's state [m], [m/s], or in pixels; changed
    seen_s (points,)                             capture time of each point's last measurement [s], −inf for none;
                                                 changed
    measured (points, dimensions)                measurements; NaN where not seen
    out (points, dimensions)                     filtered points, written; NaN where not seen
    at_s                                         capture time of the measurements [s]

`one_euro.OneEuroSettings` describes the other arguments.
"""

# ruff: noqa: PLR0917 - kernels take arrays by position
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Float64 = NDArray[np.float64]


@njit(cache=True)
def gain(cutoff_hz: float, dt: float) -> float:
    """Return the weight α, 0 to 1, of a new value in a first-order low pass of a cutoff [Hz], after ``dt`` [s].

    Source: the paper's equations 4 and 5.
    """
    r = 2.0 * math.pi * cutoff_hz * dt
    return r / (r + 1.0)


@njit(cache=True)
def seen(measured: Float64, j: int) -> bool:
    """Return whether all coordinates of point j of measured (points, dimensions) are finite."""
    there = True
    for k in range(measured.shape[1]):
        there &= np.isfinite(measured[j, k])
    return there


@njit(cache=True)
def smooth(
    positions: Float64, velocities: Float64, seen_s: Float64, measured: Float64, at_s: float, min_cutoff_hz: float,
    beta_per_m: float, speed_cutoff_hz: float, forget_after_s: float,
) -> None:  # fmt: skip
    """Update the filter's state, in place, with a cutoff by each point's speed; unmeasured points do not change.

    Args:
        positions, velocities: (points, dimensions) the filter's state [m], [m/s], or in pixels; updated.
        seen_s: (points,) capture time of each point's last measurement, −inf for none [s]; updated.
        measured: (points, dimensions) measurements in the same unit; a point with a NaN coordinate is not seen.
        at_s: capture time of the measurements [s].
        min_cutoff_hz, beta_per_m, speed_cutoff_hz, forget_after_s: cutoff at rest [Hz], its increase per speed
            [Hz/(m/s)], cutoff of the velocity's low pass [Hz], and gap that restarts the filter [s].
    """
    dimensions = positions.shape[1]
    for j in range(len(seen_s)):
        if not seen(measured, j):
            continue
        dt = at_s - seen_s[j]
        if dt > forget_after_s:  # the first time, too
            positions[j] = measured[j]
            velocities[j] = 0.0
        elif dt > 0.0:
            part, speed = gain(speed_cutoff_hz, dt), 0.0
            for k in range(dimensions):
                velocities[j, k] += part * ((measured[j, k] - positions[j, k]) / dt - velocities[j, k])
                speed += velocities[j, k] ** 2
            part = gain(min_cutoff_hz + beta_per_m * math.sqrt(speed), dt)
            for k in range(dimensions):
                positions[j, k] += part * (measured[j, k] - positions[j, k])
        seen_s[j] = at_s


@njit(cache=True)
def smooth_points(
    positions: Float64, velocities: Float64, seen_s: Float64, measured: Float64, out: Float64, at_s: float,
    min_cutoff_hz: float, beta_per_m: float, speed_cutoff_hz: float, forget_after_s: float,
) -> None:  # fmt: skip
    """Update the filter's state as `smooth` does, and write the filtered points into ``out``.

    Args:
        positions, velocities, seen_s, measured, at_s: see `smooth`.
        out: (points, dimensions) written: the filtered points; NaN where not seen.
        min_cutoff_hz, beta_per_m, speed_cutoff_hz, forget_after_s: cutoff at rest [Hz], its increase per speed
            [Hz/(m/s)], cutoff of the velocity's low pass [Hz], and gap that restarts the filter [s].
    """
    smooth(positions, velocities, seen_s, measured, at_s, min_cutoff_hz, beta_per_m, speed_cutoff_hz, forget_after_s)
    for j in range(len(seen_s)):
        there = seen(measured, j)
        for k in range(positions.shape[1]):
            out[j, k] = positions[j, k] if there else math.nan


@njit(cache=True, error_model="numpy")
def smooth_components(
    positions: Float64, velocities: Float64, seen_s: Float64, measured: Float64, out: Float64, at_s: float,
    min_cutoff_hz: float, beta_per_m: float, speed_cutoff_hz: float, forget_after_s: float,
) -> None:  # fmt: skip
    """Update the filter's state with a cutoff by each coordinate's speed, as in the paper; write the filtered points.

    All arrays must be C-contiguous.

    Args:
        positions, velocities, seen_s: the state, as in `smooth`; updated.
        measured, at_s: as in `smooth`; a point with a NaN coordinate is not seen, and none of its coordinates changes.
        out: (points, dimensions) written: the filtered points; all coordinates NaN for a point that is not seen.
        min_cutoff_hz, beta_per_m, speed_cutoff_hz, forget_after_s: cutoff at rest [Hz], its increase per speed
            [Hz/(m/s)], cutoff of the velocity's low pass [Hz], and gap that restarts the filter [s].
    """
    dimensions, since, together = positions.shape[1], seen_s[0] if len(seen_s) else at_s, True
    for j in range(len(seen_s)):
        together &= seen_s[j] == since
    x, v, m, y = positions.ravel(), velocities.ravel(), measured.ravel(), out.ravel()
    sum_of_zeros = 0.0
    for i in range(len(m)):
        sum_of_zeros += 0.0 * m[i]  # NaN where one is not finite
    dt = at_s - since
    if together and sum_of_zeros == 0.0 and 0.0 < dt <= forget_after_s:
        # The usual case: equal times for all points, so that the compiler vectorises the loop.
        smooth_all(x, v, m, y, dt, min_cutoff_hz, beta_per_m, gain(speed_cutoff_hz, dt))
        seen_s[:] = at_s
        return
    for j in range(len(seen_s)):
        begin, end = j * dimensions, (j + 1) * dimensions
        if not seen(measured, j):
            y[begin:end] = math.nan
            continue
        dt = at_s - seen_s[j]
        if dt > forget_after_s:
            x[begin:end] = m[begin:end]
            v[begin:end] = 0.0
            y[begin:end] = m[begin:end]
        elif dt > 0.0:
            part = gain(speed_cutoff_hz, dt)
            smooth_all(x[begin:end], v[begin:end], m[begin:end], y[begin:end], dt, min_cutoff_hz, beta_per_m, part)
        else:
            y[begin:end] = x[begin:end]
        seen_s[j] = at_s


@njit(cache=True, error_model="numpy")
def smooth_all(
    x: Float64, v: Float64, m: Float64, y: Float64, dt: float, min_cutoff_hz: float, beta_per_m: float, part: float
) -> None:
    """Filter scalars that were all last measured at the same time, each with a cutoff by its own speed.

    Args:
        x, v: (n,) filtered values and their velocities, changed.
        m: (n,) measured values.
        y: (n,) written: the new x.
        dt: time since the last measurement [s].
        min_cutoff_hz, beta_per_m: cutoff at rest [Hz], and its increase per speed [Hz/(m/s)].
        part: gain α of the velocity's low pass.
    """
    rate, turn = 1.0 / dt, 2.0 * math.pi * dt
    for i in range(len(m)):
        moved = m[i] - x[i]
        speed = v[i] + part * (moved * rate - v[i])
        r = turn * (min_cutoff_hz + beta_per_m * abs(speed))
        place = x[i] + r / (r + 1.0) * moved
        v[i], x[i], y[i] = speed, place, place
