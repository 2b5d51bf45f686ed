"""Kernels that let a body model yield to measurements that contradict it for long: joint limits and bone lengths.

A limit is a prior, and some people, postures and sensors are outside it. Each frame tells the angle that the limits
held a joint back. Where that lasts, the joint's limits widen until the measurement is reached; they narrow again as the
joint returns. A bone whose measured length deviates to the same side for long forgets for how long it was learnt.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.kinematics import articulated_memory as at
from mocapella.kinematics.articulated_model import BodyArrays
from mocapella.kinematics.articulated_pose_kernels import beyond_limits

Float64 = NDArray[np.float64]

DEMAND_S = 0.3
"""Time constant of a joint's demand: the average angle that its limits hold it back [s]."""
LEAST_DEMAND = math.radians(3.0)
"""Average above which limits widen [rad]; noise about a limit is below it."""
WIDEN_S = 0.1
"""Time constant of widening limits by the present excess [s]."""
NARROW_S = 1.0
"""Time constant of narrowing limits that are not used [s]."""
STRAIN_S = 1.0
"""Time constant of the average deviation of a measured length [s]."""
MOST_STRAIN = 1.5
"""Average deviation of a measured length above which it is learnt anew [standard deviations]."""
FORGET_S = 0.3
"""Time constant of forgetting how long such a length was learnt [s]."""


@njit(cache=True, error_model="numpy")
def yield_limits(model: BodyArrays, row: Float64, dt: float, excess: Float64) -> None:
    """Widen the limits of joints that they have held back for long, and narrow those that are not used.

    While the whole body is too far from its measurements, it is wrong rather than a limit: all demands are 0.

    Args:
        model: the body model.
        row: (memory_size,) a body's memory after a fit; demands and slack are changed.
        dt: time since the last update [s].
        excess: (joints,) angle that the limits held each joint back in this frame [rad].
    """
    layout = model.layout
    lost = not math.isnan(row[at.LOST_SINCE])
    average, widen, narrow = -math.expm1(-dt / DEMAND_S), -math.expm1(-dt / WIDEN_S), -math.expm1(-dt / NARROW_S)
    for j in range(layout.joints):
        if model.joint_values[j, 12] > 0.0:
            continue
        d, s = layout.demands + j, layout.slack + j
        row[d] += average * (excess[j] - row[d])
        if lost:
            row[d] = 0.0
        elif row[d] > LEAST_DEMAND:
            row[s] = min(row[s] + widen * excess[j], math.pi)
        elif row[s] > 0.0:
            row[s] -= narrow * max(row[s] - beyond_limits(model, row, j), 0.0)


@njit(cache=True, error_model="numpy")
def yield_length(row: Float64, strain: int, learnt: int, deviation: float, dt: float) -> None:
    """Forget for how long a bone length was learnt, if measured lengths deviate to the same side for long.

    Args:
        row: (memory_size,) a body's memory, changed.
        strain, learnt: indices of the length's average deviation, and of the time over which it was learnt.
        deviation: measured minus learnt length, in standard deviations, limited to ±2.
        dt: time since the last update [s].
    """
    row[strain] -= math.expm1(-dt / STRAIN_S) * (deviation - row[strain])
    if abs(row[strain]) > MOST_STRAIN:
        row[learnt] *= math.exp(-dt / FORGET_S)
