"""Kernels of `mocapella.smoothing.kalman`, in place; importing this module imports numba.

Predict and update steps of a constant-velocity Kalman filter for each point; its covariance is shared by the three
axes.

Points are positions and velocities (points, 3), variances (points, 3) and times of the last measurement (points,).
"""

# ruff: noqa: PLR0917 - kernels take arrays by position
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Float64 = NDArray[np.float64]

_AXES = 3.0


@njit(cache=True)
def predict(
    positions: Float64, velocities: Float64, variances: Float64, seen_s: Float64, dt: float, at_s: float,
    density: float, forget_after_s: float,
) -> None:  # fmt: skip
    """Kalman prediction at constant velocity with white-noise acceleration, for all points, in place.

    Args:
        positions, velocities, variances, seen_s: (points, 3) [m], (points, 3) [m/s], (points, 3), (points,) [s] of
            `kalman.Points`; the first three are changed.
        dt: time from their present instant to the later one [s].
        at_s: the later instant, on the clock of ``seen_s`` [s].
        density: power spectral density of the acceleration along an axis [m²/s³].
        forget_after_s: points unseen for longer become NaN [s].
    """
    for j in range(len(seen_s)):
        if at_s - seen_s[j] > forget_after_s:
            positions[j] = np.nan
            velocities[j] = np.nan
            variances[j] = np.nan
            continue
        for k in range(3):
            positions[j, k] += dt * velocities[j, k]
        p, c, v = variances[j, 0], variances[j, 1], variances[j, 2]
        variances[j, 0] = p + 2 * dt * c + dt * dt * v + density * dt**3 / 3
        variances[j, 1] = c + dt * v + density * dt * dt / 2
        variances[j, 2] = v + density * dt


@njit(cache=True)
def correct(
    positions: Float64, velocities: Float64, variances: Float64, seen_s: Float64, at_s: float, measured: Float64,
    measured_variance: Float64, scale: float, nu: float, speed_variance: float,
) -> None:  # fmt: skip
    """Kalman update of predicted points by measurements with Student-t weights, in place.

    Args:
        positions, velocities, variances, seen_s: (points, 3) [m], (points, 3) [m/s], (points, 3), (points,) [s] of
            `kalman.Points`; all are changed.
        at_s: capture time of the measurements [s].
        measured: (points, 3) [m]; NaN where not seen.
        measured_variance: (points,) variance of a measured coordinate, before multiplication by ``scale`` [m²].
        scale: factor of ``measured_variance`` for all points.
        nu: degrees of freedom of the Student-t weight.
        speed_variance: variance of a new point's speed along an axis [m²/s²].
    """
    for j in range(len(seen_s)):
        if not (np.isfinite(measured[j, 0]) and np.isfinite(measured[j, 1]) and np.isfinite(measured[j, 2])):
            continue
        seen_s[j] = at_s
        r = scale * measured_variance[j]
        if not np.isfinite(positions[j, 0]):
            for k in range(3):
                positions[j, k], velocities[j, k] = measured[j, k], 0.0
            variances[j, 0], variances[j, 1], variances[j, 2] = r, 0.0, speed_variance
            continue
        p, c, v = variances[j, 0], variances[j, 1], variances[j, 2]
        if np.isfinite(nu):
            surprise = 0.0
            for k in range(3):
                surprise += (measured[j, k] - positions[j, k]) ** 2
            r *= max(1.0, (nu + surprise / (p + r)) / (nu + _AXES))
        gain_p, gain_v = p / (p + r), c / (p + r)
        for k in range(3):
            innovation = measured[j, k] - positions[j, k]
            positions[j, k] += gain_p * innovation
            velocities[j, k] += gain_v * innovation
        variances[j, 0] = p - gain_p * p
        variances[j, 1] = c - gain_p * c
        variances[j, 2] = v - gain_v * c
