"""Describe the quality of a calibration in words.

The figures are standard deviations from the estimate's covariance.
"""

from __future__ import annotations

import numpy as np

from mocapella.calibration.pair_calibration import PairEstimate


def pair_quality(a: str, b: str, estimate: PairEstimate) -> str:
    """Describe a pair: ``front–side: 8 s of shared motion, 12 mm, 0.4°``, or ``front–side: walk a few steps``.

    With an estimate that is not trusted yet, its figures follow the problem in brackets.

    Millimetres are the standard deviation of one sensor's view of a person in the other's frame; degrees that of the
    angle between the sensors.
    """
    name = f"{a}–{b}"
    if estimate.problem and not np.isfinite(estimate.residual):
        return f"{name}: {estimate.problem}"
    known = f"{seconds(estimate.motion_s)} of shared motion, {figures(estimate.position_sd, estimate.rotation_sd)}"
    return f"{name}: {estimate.problem} ({known})" if estimate.problem else f"{name}: {known}"


def figures(position_sd: float, rotation_sd: float) -> str:
    """Format the standard deviations of position [m] and rotation [rad] as ``12 mm, 0.4°``."""
    return f"{1e3 * position_sd:.0f} mm, {np.degrees(rotation_sd):.1f}°"


def seconds(value: float) -> str:
    """Format a duration [s] as ``8 s``, ``4 min`` or ``2 h``."""
    if value < 120:
        return f"{value:.0f} s"
    return f"{value / 60:.0f} min" if value < 7200 else f"{value / 3600:.0f} h"
