"""Kernels of the pose in a body's memory: prediction, distance from rest, joint limits, and small motions.

Importing this module imports numba.
"""

# ruff: noqa: PLR0917 - kernels take arrays by position
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.geometry.turn_kernels import orthonormal, turn_between, turned
from mocapella.kinematics import articulated_memory as at
from mocapella.kinematics.articulated_memory import MemoryLayout
from mocapella.kinematics.articulated_model import OF_BALL, ROOT_DOFS, BodyArrays
from mocapella.kinematics.chain_kernels import limited

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

PINNED = 1e12
"""Prior information that holds a degree of freedom at its limit [1/rad²]."""
SURE = 0.2
"""Largest standard deviation of an angle that counts as well measured [rad]."""
CALMING = 3
"""Exponent of the surprise in the factor of the densities of acceleration, see `ArticulatedSettings`."""
WAKING = math.radians(0.5)
"""Average angle that its limits hold a joint back in a frame, from which on its densities hold in full [rad]."""


@njit(cache=True, error_model="numpy")
def advance(model: BodyArrays, row: Float64, at_s: float) -> None:
    """Predict a memory row to a later instant, in place: decaying velocity, driven by white-noise acceleration.

    Every degree of freedom is an integrated Ornstein–Uhlenbeck process, with its exact covariance.

    Args:
        model: the body model.
        row: (memory_size,) a body's memory, changed.
        at_s: the later instant, on the memory's clock of capture times [s].
    """
    layout, parameters = model.layout, model.parameters
    dof_kind, dof_values, joint_table = model.dof_kind, model.dof_values, model.joint_table
    dt = at_s - row[at.AT]
    if not dt > 0.0:
        return
    row[at.AT] = at_s
    tau = parameters.velocity_memory_s
    b = dt / tau
    e = math.exp(-b)
    f = tau * (1.0 - e)
    if b > 1e-2:
        qp = tau * tau * (dt - 2.0 * f + 0.5 * tau * (1.0 - e * e))
        qv = 0.5 * tau * (1.0 - e * e)
    else:
        qp, qv = dt * dt * dt / 3.0, dt
    qc = 0.5 * f * f
    for j in range(layout.joints):
        least = max(parameters.calm, row[layout.demands + j] / WAKING)
        for i in range(joint_table[j, 1], joint_table[j, 1] + joint_table[j, 2]):
            q = dof_values[i, 3] * min(max((row[at.RESTLESS] / dof_values[i, 5]) ** CALMING, least), 1.0)
            p, c, v = row[layout.variance + i], row[layout.covariance + i], row[layout.speed_variance + i]
            p = min(p + 2.0 * f * c + f * f * v + q * qp, dof_values[i, 4])
            c = e * (c + f * v) + q * qc
            v = e * e * v + q * qv
            c = min(c, math.sqrt(p * v))
            row[layout.variance + i], row[layout.covariance + i], row[layout.speed_variance + i] = p, c, v
    R = np.empty(9)
    for j in range(layout.joints):
        slack = row[layout.slack + j]
        for i in range(joint_table[j, 1], joint_table[j, 1] + joint_table[j, 2]):
            if dof_kind[i] < OF_BALL:
                a = row[layout.angles + i] + f * row[layout.velocities + i]
                within = min(max(a, dof_values[i, 0] - slack), dof_values[i, 1] + slack)
                row[layout.angles + i] = within
                if within != a:
                    row[layout.velocities + i] = 0.0
        if joint_table[j, 3] >= 0:
            r, o = layout.rotations + 9 * joint_table[j, 3], layout.velocities + first_of_ball(joint_table, j)
            turned(row, r, f * row[o], f * row[o + 1], f * row[o + 2], R)
            for k in range(9):
                row[r + k] = R[k]
    for i in range(layout.velocities, layout.velocities + layout.dofs):
        row[i] *= e


@njit(cache=True, error_model="numpy")
def first_of_ball(joint_table: Int64, j: int) -> int:
    """Return the index of the first of the three degrees of freedom of the ball joint j.

    Args:
        joint_table: (joints, 6) of `ArticulatedModel`.
        j: the joint.
    """
    return int(joint_table[j, 1] + (3 if joint_table[j, 0] < 0 else 0))


@njit(cache=True, error_model="numpy")
def away_from_rest(layout: MemoryLayout, dof_values: Float64, joint_table: Int64, row: Float64, out: Float64) -> None:
    """Write into out (dofs,) the rotation of each degree of freedom to its rest angle [rad]; 0 for the root.

    For a ball joint, it is approximated by the sine of the angle times the rotation axis.

    Args:
        layout, dof_values, joint_table: layout of a memory, (dofs, 6) and (joints, 6) of `ArticulatedModel`.
        row: (memory_size,) a body's memory.
        out: (dofs,) written.
    """
    for i in range(layout.dofs):
        out[i] = dof_values[i, 2] - row[layout.angles + i] if i >= ROOT_DOFS else 0.0
    for j in range(layout.joints):
        if joint_table[j, 3] > 0:
            r, o = layout.rotations + 9 * joint_table[j, 3], first_of_ball(joint_table, j)
            out[o] = 0.5 * (row[r + 5] - row[r + 7])
            out[o + 1] = 0.5 * (row[r + 6] - row[r + 2])
            out[o + 2] = 0.5 * (row[r + 1] - row[r + 3])


@njit(cache=True, error_model="numpy")
def pin(
    model: BodyArrays, row: Float64, delta: Float64, posterior: Float64, D: Float64, e: Float64, excess: Float64
) -> bool:
    """Enforce joint limits (active set): hold degrees of freedom that a small motion would move beyond their limits.

    Args:
        model: the body model.
        row: (memory_size,) a body's memory; its pose is read.
        delta: (dofs,) the small motion [m, rad].
        posterior: (dofs,) variance of each degree of freedom after the motion [m² or rad²].
        D, e: (dofs,) prior information and prior mean of `chain_kernels.solve`; overwritten for the held ones.
        excess: (joints,) angle by which each joint would be beyond its limits, the largest of its degrees of freedom,
            less where it is not well measured (`SURE`) [rad]; written where it is larger.

    Returns:
        Whether any degree of freedom is held.
    """
    layout, dof_values, joint_table = model.layout, model.dof_values, model.joint_table
    pinned = False
    R, within = np.empty(9), np.empty(9)
    for j in range(layout.joints):
        if joint_table[j, 0] < 0:
            continue
        slack = row[layout.slack + j]
        for i in range(joint_table[j, 1], joint_table[j, 1] + joint_table[j, 2]):
            if model.dof_kind[i] < OF_BALL:
                angle = row[layout.angles + i]
                goal = angle + delta[i]
                held = min(max(goal, dof_values[i, 0] - slack), dof_values[i, 1] + slack)
                if held != goal:
                    D[i], e[i], pinned = PINNED, held - angle, True
                    excess[j] = max(excess[j], abs(goal - held) * _sureness(posterior[i]))
        if joint_table[j, 3] > 0:
            r, o = layout.rotations + 9 * joint_table[j, 3], first_of_ball(joint_table, j)
            turned(row, r, delta[o], delta[o + 1], delta[o + 2], R)
            if limited(model.joint_values, j, slack, R, within):
                e[o], e[o + 1], e[o + 2] = turn_between(row, r, within)
                x, y, z = turn_between(within, 0, R)
                x, y, z = x * _sureness(posterior[o]), y * _sureness(posterior[o + 1]), z * _sureness(posterior[o + 2])
                excess[j] = max(excess[j], math.sqrt(x * x + y * y + z * z))
                D[o] = D[o + 1] = D[o + 2] = PINNED
                pinned = True
    return pinned


@njit(cache=True, error_model="numpy")
def _sureness(variance: float) -> float:
    """Return 1 for a well measured angle, less for others, such as the turn of a straight arm about itself."""
    return min(1.0, SURE * SURE / variance)


@njit(cache=True, error_model="numpy")
def beyond_limits(model: BodyArrays, row: Float64, j: int) -> float:
    """Return how far a joint of a pose is beyond its limits without slack, the largest of its angles [rad]; 0 within.

    Args:
        model: the body model.
        row: (memory_size,) a body's memory; its pose is read.
        j: the joint.
    """
    layout, dof_values, joint_table, beyond = model.layout, model.dof_values, model.joint_table, 0.0
    if joint_table[j, 0] < 0:
        return beyond
    for i in range(joint_table[j, 1], joint_table[j, 1] + joint_table[j, 2]):
        if model.dof_kind[i] < OF_BALL:
            angle = row[layout.angles + i]
            beyond = max(beyond, dof_values[i, 0] - angle, angle - dof_values[i, 1])
    if joint_table[j, 3] > 0:
        R, within = np.empty(9), np.empty(9)
        r = layout.rotations + 9 * joint_table[j, 3]
        for k in range(9):
            R[k] = row[r + k]
        if limited(model.joint_values, j, 0.0, R, within):
            x, y, z = turn_between(within, 0, R)
            beyond = max(beyond, math.sqrt(x * x + y * y + z * z))
    return beyond


@njit(cache=True, error_model="numpy")
def apply_motion(model: BodyArrays, row: Float64, delta: Float64, clamp: bool) -> None:
    """Apply a small motion to the pose in a memory row, in place, and clamp the pose to its limits.

    Args:
        model: the body model.
        row: (memory_size,) a body's memory, changed.
        delta: (dofs,) the small motion [m, rad].
        clamp: whether it may go beyond a joint's limits; not if `pin` has found that it does not.
    """
    layout, dof_values, joint_table = model.layout, model.dof_values, model.joint_table
    r = layout.rotations
    for k in range(layout.angles, layout.angles + 3):
        row[k] += row[r] * delta[0] + row[r + 1] * delta[1] + row[r + 2] * delta[2]
        r += 3
    R, within = np.empty(9), np.empty(9)
    for j in range(layout.joints):
        slack = row[layout.slack + j]
        for i in range(joint_table[j, 1], joint_table[j, 1] + joint_table[j, 2]):
            if i >= ROOT_DOFS and model.dof_kind[i] < OF_BALL:
                goal = row[layout.angles + i] + delta[i]
                if clamp:
                    goal = min(max(goal, dof_values[i, 0] - slack), dof_values[i, 1] + slack)
                row[layout.angles + i] = goal
        if joint_table[j, 3] >= 0:
            r, o = layout.rotations + 9 * joint_table[j, 3], first_of_ball(joint_table, j)
            turned(row, r, delta[o], delta[o + 1], delta[o + 2], R)
            beyond = clamp and limited(model.joint_values, j, slack, R, within)
            made = within if beyond else R
            orthonormal(made)
            for k in range(9):
                row[r + k] = made[k]
