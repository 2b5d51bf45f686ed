"""A Kalman filter for every point: constant velocity, white acceleration, past frames only.

Source: Bar-Shalom, Li, Kirubarajan: Estimation with Applications to Tracking and Navigation (2001), section 6.2.2
(continuous white noise acceleration). A point's three coordinates share one 2 × 2 covariance of position and velocity,
because neither its motion nor its measurement prefers an axis; so the result does not depend on where the axes lie.
A measurement far from the prediction counts less, by the weight of a Student-t distribution (Lange, Little, Taylor:
Robust Statistical Modeling Using the t Distribution, 1989).
"""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.settings import check

Float64 = NDArray[np.float64]

_AXES = 3


@dataclass(frozen=True)
class KalmanSettings:
    """How people move.

    Attributes:
        acceleration_density: of the white acceleration [m²/s³]; higher follows faster and is less steady.
        speed_sd: standard deviation of a new point's speed along an axis [m/s].
        degrees_of_freedom: of the Student-t weight; infinity trusts every measurement as it says.
        forget_after_s: a point that was not seen for longer is no longer predicted.
    """

    acceleration_density: float = 8.0
    speed_sd: float = 1.0
    degrees_of_freedom: float = 5.0
    forget_after_s: float = 1.0

    def __post_init__(self) -> None:
        check(0 < self.acceleration_density < 1e9, "acceleration_density", self.acceleration_density, "above 0 m²/s³")
        check(0 < self.speed_sd < 1e6, "speed_sd", self.speed_sd, "above 0 m/s")
        check(self.degrees_of_freedom > 0, "degrees_of_freedom", self.degrees_of_freedom, "above 0")
        check(0 <= self.forget_after_s < 1e6, "forget_after_s", self.forget_after_s, "0 s or more")


class Points(msgspec.Struct, frozen=True, eq=False):
    """What a filter believes at an instant.

    Attributes:
        at_s: the instant [s].
        positions: (..., 3) [m]; NaN where it does not know.
        velocities: (..., 3) [m/s].
        variances: (..., 3): of a coordinate [m²], its covariance with its velocity [m²/s], of the velocity [m²/s²].
        seen_s: (...,) when the point was last measured; −inf where never.
    """

    at_s: float
    positions: Float64
    velocities: Float64
    variances: Float64
    seen_s: Float64


def unknown(shape: tuple[int, ...], at_s: float) -> Points:
    """Points of which nothing is known."""
    nan = np.full((*shape, 3), np.nan)
    return Points(at_s, nan, nan, nan, np.full(shape, -np.inf))


def predict(points: Points, at_s: float, settings: KalmanSettings) -> Points:
    """The points at a later instant, less certain; forgotten where they were not seen for too long."""
    dt = at_s - points.at_s
    p, c, v = np.moveaxis(points.variances, -1, 0)
    q = settings.acceleration_density
    variances = np.stack(
        [p + 2 * dt * c + dt * dt * v + q * dt**3 / 3, c + dt * v + q * dt * dt / 2, v + q * dt], axis=-1
    )
    positions = points.positions + dt * points.velocities
    velocities = points.velocities.copy()
    forgotten = at_s - points.seen_s > settings.forget_after_s
    positions[forgotten], velocities[forgotten], variances[forgotten] = np.nan, np.nan, np.nan
    return Points(at_s, positions, velocities, variances, points.seen_s)


def correct(points: Points, measured: Float64, variance: Float64, settings: KalmanSettings) -> Points:
    """The points after a measurement at their instant.

    Args:
        points: as predicted.
        measured: (..., 3) [m]; NaN where not seen.
        variance: (...,) of a measured coordinate [m²].
        settings: as for the prediction.
    """
    seen = np.isfinite(measured).all(axis=-1)
    new = seen & ~np.isfinite(points.positions[..., 0])
    known = seen & ~new
    p, c, v = np.moveaxis(points.variances, -1, 0)
    innovation = np.where(known[..., None], measured - points.positions, 0.0)
    expected = p + variance
    nu = settings.degrees_of_freedom
    if np.isfinite(nu):
        surprise = (innovation**2).sum(axis=-1) / expected
        variance = np.where(known, variance * np.maximum(1.0, (nu + surprise) / (nu + _AXES)), variance)
        expected = p + variance
    gain_p, gain_v = p / expected, c / expected
    positions = np.where(known[..., None], points.positions + gain_p[..., None] * innovation, points.positions)
    velocities = np.where(known[..., None], points.velocities + gain_v[..., None] * innovation, points.velocities)
    updated = np.stack([p - gain_p * p, c - gain_p * c, v - gain_v * c], axis=-1)
    variances = np.where(known[..., None], updated, points.variances)
    positions[new], velocities[new] = measured[new], 0.0
    start = np.stack([variance, np.zeros_like(variance), np.full_like(variance, settings.speed_sd**2)], axis=-1)
    variances[new] = start[new]
    return Points(points.at_s, positions, velocities, variances, np.where(seen, points.at_s, points.seen_s))
