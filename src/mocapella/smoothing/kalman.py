"""Kalman filters of points, one for each: constant velocity with white-noise acceleration, causal.

Source: Bar-Shalom, Li, Kirubarajan: Estimation with Applications to Tracking and Navigation (2001), section 6.2.2
(continuous white noise acceleration). A point's three coordinates share one 2 × 2 covariance of position and velocity,
because neither its motion nor its measurement prefers an axis; so the result does not depend on where the axes lie.
A measurement far from the prediction counts less, by the weight of a Student-t distribution (Lange, Little, Taylor:
Robust Statistical Modeling Using the t Distribution, 1989).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.settings import check

Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class KalmanSettings:
    """Process model of moving points, and robustness of the filter.

    Attributes:
        acceleration_density: power spectral density of the white-noise acceleration along an axis; a larger one means
            less lag and more jitter [m²/s³].
        speed_sd: standard deviation of a new point's speed along an axis; larger: its motion is followed sooner, with
            more jitter at first [m/s].
        degrees_of_freedom: parameter of the Student-t weight of a measurement; smaller: outliers count less; infinity
            disables the weight [degrees of freedom].
        forget_after_s: time without a measurement after which a point is no longer predicted [s].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
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
    """State of the Kalman filters of all points at an instant: the argument and result of `predict` and `correct`.

    Attributes:
        at_s: the instant, on the clock of the capture times [s].
        positions: (points, 3) [m]; NaN for an unknown point: not measured yet, or forgotten.
        velocities: (points, 3) [m/s]; NaN where the position is.
        variances: (points, 3), the same for each coordinate of a point: variance of the position [m²], its covariance
            with the velocity [m²/s], variance of the velocity [m²/s²]; NaN where the position is.
        seen_s: (points,) capture time of the point's last measurement [s]; −inf where never measured.
    """

    at_s: float
    positions: Float64
    velocities: Float64
    variances: Float64
    seen_s: Float64


def unknown(count: int, at_s: float) -> Points:
    """Return the state of ``count`` unknown points at an instant, on the clock of the capture times [s]."""
    nan = np.full((3, count, 3), np.nan)
    return Points(at_s, nan[0], nan[1], nan[2], np.full(count, -np.inf))


def predict(points: Points, at_s: float, settings: KalmanSettings) -> Points:
    """Predict the points at a later instant, at constant velocity and with larger variances.

    A point whose last measurement is then more than ``forget_after_s`` old becomes unknown (NaN).

    Args:
        points: the present state; not changed.
        at_s: the later instant, on the clock of the capture times [s]; not before ``points.at_s``.
        settings: process model, and time after which points are forgotten.

    Returns:
        A new state, at ``at_s``.
    """
    later = _copy(points, at_s)
    _kernels().predict(
        *_arrays(later), at_s - points.at_s, at_s, settings.acceleration_density, settings.forget_after_s
    )
    return later


def correct(points: Points, measured: Float64, variance: Float64, settings: KalmanSettings) -> Points:
    """Update predicted points with measurements at the same instant.

    A point without a measurement stays as predicted. An unknown point begins at its measurement, with velocity 0.

    Args:
        points: the points, predicted to the time of the measurements; not changed.
        measured: (points, 3) [m]; NaN where not seen.
        variance: (points,) variance of a measured coordinate [m²]; not read where not seen.
        settings: Student-t weight, and initial speed.

    Returns:
        A new state, at the same instant.
    """
    after = _copy(points, points.at_s)
    nu = float(settings.degrees_of_freedom)
    _kernels().correct(*_arrays(after), after.at_s, measured, variance, 1.0, nu, settings.speed_sd**2)
    return after


def _copy(points: Points, at_s: float) -> Points:
    return Points(at_s, *(values.copy() for values in _arrays(points)))


def _arrays(points: Points) -> tuple[Float64, Float64, Float64, Float64]:
    return points.positions, points.velocities, points.variances, points.seen_s


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.smoothing import kalman_kernels

    return kalman_kernels
