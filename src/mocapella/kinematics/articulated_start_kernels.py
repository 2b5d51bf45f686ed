"""Kernels that initialise an articulated body from measured joints. Importing this module imports numba.

The torso is aligned as a rigid body by least squares (`mocapella.geometry.alignment`). From the root outwards, each
ball joint is turned to point its bone along the measured one; hinges start away from their limits. Covariances start
wide.
"""

# ruff: noqa: PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.geometry.alignment_kernels import accumulate, align
from mocapella.kinematics import articulated_memory as at
from mocapella.kinematics.articulated_memory import MemoryLayout
from mocapella.kinematics.articulated_model import OF_BALL, ROOT_DOFS, BodyArrays
from mocapella.kinematics.chain_kernels import forward, limited, swing

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

FIRST_SD = 0.5
"""Initial standard deviation of every angle and of the root's position [rad, m]."""
FIRST_SPEED_SD = 2.0
"""Initial standard deviation of every velocity [rad/s, m/s]."""
FIRST_NOISE_SD = 0.01
"""Standard deviation of a joint's noise until it is learnt [m]."""
LEAST_TORSO = 4
"""Least number of measured joints of the torso for initialising a body."""
STATURE, LEAST_STATURE, MOST_STATURE = 1.7, 0.5, 2.5
"""Stature that is assumed if no bone is measured, and the limits of the measured stature [m]."""


@njit(cache=True, error_model="numpy")
def initialise(model: BodyArrays, row: Float64, at_s: float, measured: Float64, variances: Float64) -> bool:
    """Initialise a body's memory row from measured joints; known bone lengths stay.

    Args:
        model: the body model.
        row: (memory_size,) the body's memory, changed.
        at_s: capture time [s].
        measured: (joints, 3) world [m]; NaN where not measured.
        variances: (joints,) variance of a coordinate [m²]; not finite where not measured.

    Returns:
        Whether enough joints are measured; if not, the row is not changed.
    """
    layout = model.layout
    seen, torso = 0, 0
    for j in range(layout.joints):
        if is_measured(measured, variances, j):
            seen += 1
            if model.joint_values[j, 10] > 0.0:
                torso += 1
    if seen < model.parameters.least_joints or torso < LEAST_TORSO:
        return False
    if row[at.STARTED] != 1.0:
        _first_lengths(layout, model.joint_table, model.joint_values, measured, variances, row)
        _fill(row, layout.learnt, layout.contacts, 0.0)
    _fill(row, layout.angles, layout.bones, 0.0)
    for b in range(layout.rotations, layout.bones, 9):
        row[b] = row[b + 4] = row[b + 8] = 1.0
    _align_torso(model, row, measured, variances)
    _point_bones(model, row, measured, variances)
    for i in range(ROOT_DOFS, layout.dofs):
        if model.dof_kind[i] < OF_BALL:  # away from the limits, where the gradient does not show a hinge's direction
            row[layout.angles + i] = 0.25 * (model.dof_values[i, 0] + model.dof_values[i, 1])
    _fill(row, layout.velocities, layout.variance, 0.0)
    _fill(row, layout.variance, layout.covariance, FIRST_SD**2)
    _fill(row, layout.covariance, layout.speed_variance, 0.0)
    _fill(row, layout.speed_variance, layout.rotations, FIRST_SPEED_SD**2)
    row[at.AT] = row[at.SEEN] = at_s
    row[at.RESTLESS] = 1.0
    for c in range(layout.jumps, layout.size, 4):
        row[c], row[c + 3] = math.nan, FIRST_NOISE_SD**2
    row[at.STARTED], row[at.LOST_SINCE] = 1.0, math.nan
    return True


@njit(cache=True, error_model="numpy")
def _align_torso(model: BodyArrays, row: Float64, measured: Float64, variances: Float64) -> None:
    """Move the root so that the torso at rest fits its measured joints."""
    layout, joints = model.layout, model.layout.joints
    x, R, xi, origin = np.empty((joints, 3)), np.empty((joints, 9)), np.empty((0, 6)), np.empty(3)
    moments, T = np.empty(50), np.empty((4, 4))
    p, still, w, order = np.empty((joints, 3)), np.empty((joints, 3)), np.empty(joints), np.empty(joints, np.int64)
    _fill(moments, 0, 50, 0.0)
    _fill(origin, 0, 3, 0.0)
    forward(model, row, origin, x, R, xi)
    for j in range(joints):
        used = model.joint_values[j, 10] > 0.0 and is_measured(measured, variances, j)
        w[j], order[j] = 1.0 if used else 0.0, j
        for k in range(3):
            p[j, k], still[j, k] = measured[j, k] if used else 0.0, 0.0
    accumulate(moments, p, x, still, w, order)
    align(moments, 0.0, T)
    for k in range(3):
        row[layout.angles + k] = T[k, 3]
        for i in range(3):
            row[layout.rotations + 3 * k + i] = T[k, i]


@njit(cache=True, error_model="numpy")
def _point_bones(model: BodyArrays, row: Float64, measured: Float64, variances: Float64) -> None:
    """Rotate the ball joints so that their bones point along the measured ones, from the root outwards."""
    layout, joints = model.layout, model.layout.joints
    x, R, xi, origin = np.empty((joints, 3)), np.empty((joints, 9)), np.empty((0, 6)), np.empty(3)
    d, S, within, rest = np.empty(3), np.empty(9), np.empty(9), model.joint_values
    _fill(origin, 0, 3, 0.0)
    for o in range(joints):
        j = model.order[o]
        ball, parent = model.joint_table[j, 3], model.joint_table[j, 0]
        if ball > 0 and is_measured(measured, variances, j) and is_measured(measured, variances, parent):
            forward(model, row, origin, x, R, xi)
            for r in range(3):
                d[r] = 0.0
                for c in range(3):
                    d[r] += R[parent, 3 * c + r] * (measured[j, c] - measured[parent, c])
            length = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
            if length > 0.0:
                swing(rest[j, 0], rest[j, 1], rest[j, 2], d[0] / length, d[1] / length, d[2] / length, S)
                limited(model.joint_values, j, row[layout.slack + j], S, within)
                for k in range(9):
                    row[layout.rotations + 9 * ball + k] = within[k]


@njit(cache=True, error_model="numpy")
def is_measured(measured: Float64, variances: Float64, j: int) -> bool:
    """Return whether joint j is measured: finite in measured (joints, 3) and variances (joints,)."""
    return math.isfinite(measured[j, 0] + measured[j, 1] + measured[j, 2] + variances[j])


@njit(cache=True, error_model="numpy")
def _median(values: Float64, count: int) -> float:
    """Return the lower median of the first ``count`` values, which are sorted in place; np.median compiles slowly."""
    for i in range(1, count):
        k = i
        while k > 0 and values[k - 1] > values[k]:
            values[k - 1], values[k] = values[k], values[k - 1]
            k -= 1
    return float(values[(count - 1) // 2])


@njit(cache=True, error_model="numpy")
def _fill(values: Float64, begin: int, end: int, value: float) -> None:
    """Set values[begin:end] to a value."""
    for i in range(begin, end):
        values[i] = value


@njit(cache=True, error_model="numpy")
def _first_lengths(
    layout: MemoryLayout, joint_table: Int64, joint_values: Float64, measured: Float64, variances: Float64,
    row: Float64,
) -> None:  # fmt: skip
    """Set the bone lengths to the template's, scaled by the median of the measured ratios."""
    ratios, seen = np.empty(layout.joints), 0
    for j in range(layout.joints):
        parent = joint_table[j, 0]
        if parent >= 0 and is_measured(measured, variances, j) and is_measured(measured, variances, parent):
            s = 0.0
            for k in range(3):
                s += (measured[j, k] - measured[parent, k]) ** 2
            ratios[seen] = math.sqrt(s) / joint_values[j, 3]
            seen += 1
    stature = STATURE
    if seen > 0:
        stature = min(max(_median(ratios, seen), LEAST_STATURE), MOST_STATURE)
    for j in range(layout.joints):
        if joint_table[j, 4] >= 0:
            row[layout.bones + joint_table[j, 4]] = stature * joint_values[j, 3]
