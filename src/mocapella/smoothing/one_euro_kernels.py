"""The hot step of `mocapella.smoothing.one_euro`, compiled and in place; importing this module imports numba."""

# ruff: noqa: PLR0917 - compiled: arrays come by position
from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True)
def gain(cutoff_hz, dt):
    """The weight α of the new value in a first-order low pass after ``dt`` seconds (the paper's equations 4 and 5)."""
    r = 2.0 * math.pi * cutoff_hz * dt
    return r / (r + 1.0)


@njit(cache=True)
def smooth(positions, velocities, seen_s, measured, at_s, min_cutoff_hz, beta_per_m, speed_cutoff_hz, forget_after_s):
    """`OneEuro.update` of (points, 3); what is not seen stays as it was."""
    for j in range(len(seen_s)):
        if not (np.isfinite(measured[j, 0]) and np.isfinite(measured[j, 1]) and np.isfinite(measured[j, 2])):
            continue
        dt = at_s - seen_s[j]
        if dt > forget_after_s:  # the first time, too
            positions[j] = measured[j]
            velocities[j] = 0.0
        elif dt > 0.0:
            part, speed = gain(speed_cutoff_hz, dt), 0.0
            for k in range(3):
                velocities[j, k] += part * ((measured[j, k] - positions[j, k]) / dt - velocities[j, k])
                speed += velocities[j, k] ** 2
            part = gain(min_cutoff_hz + beta_per_m * math.sqrt(speed), dt)
            for k in range(3):
                positions[j, k] += part * (measured[j, k] - positions[j, k])
        seen_s[j] = at_s
