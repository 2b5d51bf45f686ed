"""How good a calibration is, in words that a person can act on."""

from __future__ import annotations

import numpy as np

from mocapella.calibration.pair_calibration import PairEstimate


def pair_quality(a: str, b: str, estimate: PairEstimate) -> str:
    """``front–side: 8 s of shared motion, 12 mm, 0.4°``, or what is missing: ``front–side: walk a few steps``.

    The millimetres and degrees are standard deviations: of where one sensor's view of a person comes to lie in the
    other's, and of the angle between the sensors.
    """
    name = f"{a}–{b}"
    if estimate.problem and not np.isfinite(estimate.residual):
        return f"{name}: {estimate.problem}"
    known = f"{seconds(estimate.motion_s)} of shared motion, {figures(estimate.position_sd, estimate.rotation_sd)}"
    return f"{name}: {estimate.problem} ({known})" if estimate.problem else f"{name}: {known}"


def figures(position_sd: float, rotation_sd: float) -> str:
    """``12 mm, 0.4°`` of metres and radians."""
    return f"{1e3 * position_sd:.0f} mm, {np.degrees(rotation_sd):.1f}°"


def seconds(value: float) -> str:
    """``8 s``, ``4 min``, ``2 h``."""
    if value < 120:
        return f"{value:.0f} s"
    return f"{value / 60:.0f} min" if value < 7200 else f"{value / 3600:.0f} h"
