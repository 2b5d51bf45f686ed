"""Paths of joints, smoothed alike on both sides, with their velocities at any time.

Two recordings of one motion have different rates and noises. A local line with Gaussian weights (W. Cleveland, S.
Devlin, J. Am. Stat. Assoc. 83, 1988, 596) of the same width on both sides makes them comparable: it leaves the noise's
variance nearly independent of the time between samples, where linear interpolation would favour half a sample.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]

_REACH: Final = 3.0
"""Reach of a Gaussian weight, in its standard deviations."""
_STEPS: Final = 2
"""Number of grid steps in a standard deviation."""
SYMMETRIC: Final = 0.2
"""Largest distance of the samples' mean time from the time that is asked for, in the width: the noises of position and
velocity from one-sided samples are correlated, which would shift the time that is estimated."""
_ROWS: Final = 1024
"""Number of times that are smoothed at once, so that memory stays small."""
_HALF: Final = 3
"""Number of samples before and after one that its spike is measured against."""
SPIKE: Final = 6.0
"""Distance from the median of its neighbours at which a sample is a spike, in robust standard deviations."""
_LEAST_SPIKE_M: Final = 0.005
_FEWEST_OF_SENSOR: Final = 16
"""Least number of a sensor's results from which its own path is smoothed."""


@dataclass(frozen=True, eq=False)
class SmoothPaths:
    """Smoothed positions and velocities on a regular grid of times.

    Attributes:
        begin_s, step_s: time of the first point of the grid, and its step [s].
        positions: (steps, joints, 3) [m]; NaN where too few samples are near.
        velocities: (steps, joints, 3) [m/s].
        noise_m: median distance of the samples from the smooth paths; NaN without any [m].
    """

    begin_s: float
    step_s: float
    positions: Float64
    velocities: Float64
    noise_m: float = math.nan

    @property
    def times_s(self) -> Float64:
        """(steps,) times of the grid [s]."""
        return np.asarray(self.begin_s + self.step_s * np.arange(len(self.positions)), dtype=np.float64)

    def at(self, times_s: Float64) -> tuple[Float64, Float64]:
        """Return positions and velocities (times, joints, 3) by cubic Hermite interpolation; NaN outside."""
        place = (times_s - self.begin_s) / self.step_s
        outside = ~((place >= 0) & (place <= len(self.positions) - 1))
        k = np.clip(np.nan_to_num(np.floor(place)).astype(np.int64), 0, max(0, len(self.positions) - 2))
        u = (place - k)[:, None, None]
        k1 = np.minimum(k + 1, len(self.positions) - 1)
        p, q = self.positions[k], self.positions[k1]
        v, w = self.step_s * self.velocities[k], self.step_s * self.velocities[k1]
        cubic, square = 2 * (p - q) + v + w, 3 * (q - p) - 2 * v - w
        value = ((cubic * u + square) * u + v) * u + p
        slope = ((3 * cubic * u + 2 * square) * u + v) / self.step_s
        value[outside], slope[outside] = np.nan, np.nan
        return value, slope


def smooth_paths(times_s: Float64, positions: Float64, width_s: float) -> SmoothPaths:
    """Smooth the paths of joints by a local line with Gaussian weights.

    Args:
        times_s: (frames,) rising [s].
        positions: (frames, joints, 3); NaN where unknown [m].
        width_s: standard deviation of the weights [s].
    """
    step = width_s / _STEPS
    at = times_s[0] + step * np.arange(int((times_s[-1] - times_s[0]) / step) + 1)
    known = np.all(np.isfinite(positions), axis=2)
    filled = np.where(known[..., None], positions, 0.0)
    density = _REACH * width_s * (len(times_s) - 1) / max(times_s[-1] - times_s[0], 1e-9)
    least = 0.25 * density / _REACH * np.sqrt(2 * np.pi)
    out, slopes = (np.full((len(at), *positions.shape[1:]), np.nan) for _ in range(2))
    for begin in range(0, len(at), _ROWS):
        rows = slice(begin, begin + _ROWS)
        first = np.searchsorted(times_s, at[rows] - _REACH * width_s)
        count = int((np.searchsorted(times_s, at[rows] + _REACH * width_s) - first).max(initial=1))
        near = np.minimum(first[:, None] + np.arange(max(1, count)), len(times_s) - 1)
        dt = times_s[near] - at[rows][:, None]
        weight = np.exp(-0.5 * (dt / width_s) ** 2) * (np.abs(dt) <= _REACH * width_s)
        weight *= np.diff(near, axis=1, prepend=-1) > 0  # the last sample once
        mass, own = known[near].astype(np.float64), filled[near]
        s0, s1, s2 = (np.einsum("tk,tkj->tj", weight * dt**power, mass) for power in range(3))
        p0, p1 = (np.einsum("tk,tkjc->tjc", weight * dt**power, own) for power in range(2))
        det = s0 * s2 - s1 * s1
        usable = (s0 > least) & (np.abs(s1) < SYMMETRIC * width_s * s0) & (det > 1e-3 * (s0 * width_s) ** 2)
        det = np.where(usable, det, np.nan)[..., None]
        out[rows] = (s2[..., None] * p0 - s1[..., None] * p1) / det
        slopes[rows] = (s0[..., None] * p1 - s1[..., None] * p0) / det
    found = SmoothPaths(float(times_s[0]), step, out, slopes)
    off = np.linalg.norm(positions - found.at(times_s)[0], axis=2)
    some = off[np.isfinite(off)]
    return replace(found, noise_m=float(np.median(some)) if len(some) else math.nan)


@dataclass(frozen=True, eq=False)
class SensorPaths:
    """Smoothed paths from the results of one sensor, beside the paths of all sensors.

    Attributes:
        share: the sensor's share of the results.
        own, whole: the paths by its results, and by the results of all sensors, smoothed alike.
    """

    share: float
    own: SmoothPaths
    whole: SmoothPaths

    def deviations(self, times_s: Float64) -> Float64:
        """Return the sensor's positions minus all sensors' (times, joints, 3) [m]; NaN where unknown."""
        return np.asarray(self.own.at(times_s)[0] - self.whole.at(times_s)[0])


def paths_of_sensors(
    times_s: Float64, positions: Float64, sensors: NDArray[np.int64], width_s: float
) -> tuple[SensorPaths, ...]:
    """Smooth the results of each sensor alone; none if they are of one sensor, or of unknown ones.

    Args:
        times_s, positions: as in `smooth_paths`.
        sensors: (frames,) number of each result's sensor; empty if unknown.
        width_s: least standard deviation of the weights; a slower sensor's is its own step [s].
    """
    numbers, counts = np.unique(sensors, return_counts=True)
    numbers = numbers[counts >= _FEWEST_OF_SENSOR]
    if len(numbers) < 2:
        return ()
    chosen = [sensors == number for number in numbers]
    width = max(width_s, *(float(np.median(np.diff(times_s[some]))) for some in chosen))
    whole = smooth_paths(times_s, positions, width)
    return tuple(
        SensorPaths(float(some.mean()), smooth_paths(times_s[some], positions[some], width), whole) for some in chosen
    )


def without_spikes(positions: Float64) -> Float64:
    """Replace spikes by NaN: samples far from the median of their neighbours, by the neighbours' own scatter.

    F. Hampel's identifier (L. Davies, U. Gather, J. Am. Stat. Assoc. 88, 1993, 782); a fast motion scatters, too, and
    is kept.

    Args:
        positions: (frames, joints, 3); NaN where unknown [m].
    """
    return np.stack([_without_spikes(positions[:, k]) for k in range(positions.shape[1])], axis=1)


def _without_spikes(positions: Float64) -> Float64:
    """Replace the spikes of one joint (frames, 3)."""
    padded = np.pad(positions, ((_HALF, _HALF), (0, 0)), constant_values=np.nan)
    windows = np.stack([padded[k : k + len(positions)] for k in range(2 * _HALF + 1)])
    distances = np.linalg.norm(windows - _middle(windows), axis=2)
    scatter, far = _middle(distances), distances[_HALF]
    known = scatter[np.isfinite(scatter)]
    usual = np.median(known) if len(known) else 0.0
    limit = SPIKE * np.maximum(np.maximum(scatter, usual), _LEAST_SPIKE_M / SPIKE)
    return np.where((far > limit)[:, None], np.nan, positions)


def _middle(windows: Float64) -> Float64:
    """Return the lower median over the first axis without NaN; NaN where there is nothing else."""
    ordered = np.sort(windows, axis=0)  # NaN comes last
    place = np.maximum(np.isfinite(windows).sum(axis=0) - 1, 0) // 2
    return np.asarray(np.take_along_axis(ordered, place[None], axis=0)[0])
