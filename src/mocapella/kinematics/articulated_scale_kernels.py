"""Kernels that follow the size of a sensor's skeletons: one factor of all bone lengths of a body.

Some sensors report one skeleton at different sizes: of an Azure Kinect's, all bones are an eighth shorter in a squat
than upright. With fixed lengths, the knees would bend too far or too little. The factor is an Ornstein–Uhlenbeck
process about 1 (G. E. Uhlenbeck, L. S. Ornstein, On the Theory of the Brownian Motion, Physical Review 36, 1930) that
is measured as the mean ratio of measured to learnt lengths. The scatter of the bones' ratios gives the variance of that
mean: a change of single bones hardly moves the factor. Importing this module imports numba.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.kinematics import articulated_memory as at
from mocapella.kinematics.articulated_memory import Measurements, MemoryLayout
from mocapella.kinematics.articulated_model import BodyArrays
from mocapella.kinematics.articulated_start_kernels import is_measured

Float64 = NDArray[np.float64]

LEAST_BONES = 6
"""Least number of measured bones that correct the factor."""
LEAST_VARIANCE = 1e-4
"""Least variance of the mean ratio."""
NU = 5.0
"""Degrees of freedom of the Student-t weight of a bone."""


@njit(cache=True, error_model="numpy")
def predicted_scale(row: Float64, dt: float, scale_s: float) -> float:
    """Predict the common factor of a body's bone lengths: it decays exponentially to 1. An unknown factor counts as 1.

    Args:
        row: (memory_size,) the body's memory, with the factor at its last update.
        dt: time since then [s].
        scale_s: time constant [s].
    """
    scale: float = 1.0 + math.exp(-max(dt, 0.0) / scale_s) * (row[at.SCALE] - 1.0)
    return scale if scale > 0.0 else 1.0


@njit(cache=True, error_model="numpy")
def scale_bones(layout: MemoryLayout, row: Float64, scale: float) -> None:
    """Multiply the bone lengths of a memory row by ``scale``, in place."""
    for i in range(layout.bones, layout.bones + layout.lengths):
        row[i] *= scale


@njit(cache=True, error_model="numpy")
def restart_scale(row: Float64, scale_sd: float) -> float:
    """Set the common factor of the bone lengths in a memory row to 1, with its prior; return the factor."""
    row[at.SCALE], row[at.SCALE_VARIANCE] = 1.0, scale_sd**2
    return 1.0


@njit(cache=True, error_model="numpy")
def follow_scale(model: BodyArrays, row: Float64, dt: float, frame: Measurements, scale_sd: float) -> float:
    """Predict the common factor of the bone lengths, correct it by measured joints, and return it.

    The bone lengths in ``row`` do not change, see `scale_bones`.

    Args:
        model: the body model.
        row: (memory_size,) the body's memory; the factor is changed.
        dt: time since the last update [s].
        frame: the measured joints.
        scale_sd: standard deviation of the factor; 0: it is not measured, and returns to 1 [ratio].
    """
    parameters, largest, measured, variances = model.parameters, scale_sd**2, frame.positions, frame.variances
    fade = math.exp(-dt / parameters.scale_s)
    scale: float = predicted_scale(row, dt, parameters.scale_s)
    if largest == 0.0:
        row[at.SCALE], row[at.SCALE_VARIANCE] = scale, 0.0
        return scale
    variance = fade * fade * min(row[at.SCALE_VARIANCE], largest) + (1.0 - fade * fade) * largest
    total, squares, mean, spread, bones = 0.0, 0.0, 0.0, 0.0, 0
    for j in range(model.layout.joints):
        parent = model.joint_table[j, 0]
        if parent < 0 or not (is_measured(measured, variances, j) and is_measured(measured, variances, parent)):
            continue
        s = 0.0
        for k in range(3):
            s += (measured[j, k] - measured[parent, k]) ** 2
        length = row[model.layout.bones + model.joint_table[j, 4]]
        misfit = model.joint_values[j, 11] + model.joint_values[parent, 11]
        information = length * length / (variances[j] + variances[parent] + misfit + 1e-12)
        off = math.sqrt(s) / length - scale
        weight = information * (NU + 1.0) / (NU + off * off / (1.0 / information + variance))
        total += weight
        squares += weight * weight
        mean += weight * off
        spread += weight * off * off
        bones += 1
    if bones >= LEAST_BONES:
        mean /= total
        spread = max(spread / total - mean * mean, 0.0)
        of_mean = max(spread * squares / (total * total) * bones / (bones - 1), LEAST_VARIANCE)
        gain = variance / (variance + of_mean)
        scale += gain * mean
        variance *= 1.0 - gain
    row[at.SCALE], row[at.SCALE_VARIANCE] = scale, variance
    return scale
