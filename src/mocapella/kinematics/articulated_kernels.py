"""Kernels of a filter for an articulated body: predict its motion, and correct it by measured joints.

The estimator is an iterated extended Kalman filter in joint space with joint limits, Student-t weights and learnt bone
lengths; `docs/methods/articulated.md` derives it. The normal equations are solved in linear time (`chain_kernels`).
A body's memory is one row of numbers (`articulated_memory`), NaN or 0 where nothing is known. All arrays are
contiguous. Importing this module imports numba.
"""

# ruff: noqa: PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.kinematics import articulated_memory as at
from mocapella.kinematics.articulated_memory import Measurements, MemoryLayout, Rigidity
from mocapella.kinematics.articulated_model import ROOT_DOFS, BodyArrays
from mocapella.kinematics.articulated_pose_kernels import advance, apply_motion, away_from_rest, pin
from mocapella.kinematics.articulated_scale_kernels import follow_scale, predicted_scale, restart_scale, scale_bones
from mocapella.kinematics.articulated_start_kernels import initialise, is_measured
from mocapella.kinematics.articulated_yield_kernels import yield_length, yield_limits
from mocapella.kinematics.chain_kernels import Elimination, forward, independent, marginals, solve

Float64 = NDArray[np.float64]

__all__ = ["correct", "forward", "learn_motion", "move", "place", "predict"]

LARGE_STEP = 0.5
"""Largest change of a degree of freedom in the first step; after a larger one, a second step follows [m, rad]."""
FIRST_STEPS = 12
"""Gauss–Newton steps in a body's first frame."""
CONTACT_S = 0.1
"""Time constant of the smoothing of a foot's velocity, which weights its contact [s]."""
CONTACT_HZ = 60.0
"""Factor from a foot's measured displacement since the last frame to that velocity, at any frame rate [Hz]."""
MOST_SURPRISE = 1.0
"""Limit of one joint's surprise (`ArticulatedSettings.surprise_s`)."""
MEAN_DISTANCE = 1.6
"""Mean distance of a point with normal noise from its mean, over the standard deviation of a coordinate: 2 √(2/π)."""
AGREES = 0.5
"""Least robust weight of the two joints of a bone for learning its length."""
LENGTH_PRIOR_S = 0.05
"""Weight of the initial bone lengths, as a duration of measurement [s]."""
FIRST_VARIANCE = 0.0025
"""Variance of a joint about the estimate while a body is initialised [m²]."""


@njit(cache=True, error_model="numpy")
def predict(model: BodyArrays, row: Float64, at_s: float, positions: Float64, variances: Float64) -> bool:
    """Extrapolate a body and its uncertainty to an instant, without changing its memory.

    Args:
        model: the body model.
        row: (memory_size,) the body's memory.
        at_s: the instant, on the clock of earlier calls [s]; a time before the memory's counts as the memory's.
        positions: (joints, 3) written: world [m]; NaN where the body is not known.
        variances: (joints,) written: variance of a coordinate [m²]; NaN where the body is not known.

    Returns:
        Whether the body is known.
    """
    layout = model.layout
    if not (row[at.STARTED] == 1.0 and at_s - row[at.SEEN] <= model.parameters.forget_after_s):
        for j in range(layout.joints):
            variances[j] = math.nan
            for k in range(3):
                positions[j, k] = math.nan
        return False
    work, R, xi, origin = np.empty(layout.size), np.empty((layout.joints, 9)), np.empty((layout.dofs, 6)), np.empty(3)
    for i in range(layout.size):
        work[i] = row[i]
    scale_bones(layout, work, predicted_scale(work, at_s - row[at.AT], model.parameters.scale_s))
    advance(model, work, at_s)
    place(model, work, origin, positions, R, xi)
    independent(
        model.joint_table, model.order, xi, work, layout.variance, positions, np.empty((layout.joints, 10)), variances
    )
    for j in range(layout.joints):
        for k in range(3):
            positions[j, k] += origin[k]
    return True


@njit(cache=True, error_model="numpy", forceinline=True)
def place(model: BodyArrays, row: Float64, origin: Float64, x: Float64, R: Float64, xi: Float64) -> None:
    """Compute joints, frames and twists of a memory row about its root, whose position is written into origin (3,)."""
    for k in range(3):
        origin[k] = row[model.layout.angles + k]
    forward(model, row, origin, x, R, xi)


@njit(cache=True, error_model="numpy")
def correct(
    model: BodyArrays, row: Float64, at_s: float, measured: Float64, measured_variances: Float64, rigidity: Rigidity,
    positions: Float64, variances: Float64,
) -> bool:  # fmt: skip
    """Predict a body to the time of measured joints, and correct it by them; the memory is then at that time.

    A new, forgotten or lost body is initialised from the joints instead, if they suffice
    (`articulated_start_kernels.initialise`).

    Args:
        model: the body model.
        row: (memory_size,) the body's memory, changed; NaN or 0 for a new body.
        at_s: capture time [s]; a time before the memory's instant counts as that instant.
        measured: (joints, 3) world [m]; NaN where not measured.
        measured_variances: (joints,) variance of a coordinate [m²]; not finite where not measured.
        rigidity: of the measured skeleton.
        positions: (joints, 3) written: world [m]; NaN while the body is not known.
        variances: (joints,) written: variance of a coordinate [m²]; NaN while the body is not known.

    Returns:
        Whether the body is known.
    """
    layout, joints = model.layout, model.layout.joints
    known = row[at.STARTED] == 1.0 and at_s - row[at.SEEN] <= model.parameters.forget_after_s
    dt = max(0.0, at_s - row[at.AT])
    if known and at_s - row[at.LOST_SINCE] > model.parameters.lost_s:
        known = False
    if not known:
        dt = 0.0
        if not initialise(model, row, at_s, measured, measured_variances):
            return bool(predict(model, row, at_s, positions, variances))
    advance(model, row, at_s)
    share = rigidity.noise * rigidity.noise
    frame = Measurements(measured, measured_variances, share, np.empty((joints, 3)), np.zeros(joints), np.zeros(joints))
    R, total, posterior = np.empty((joints, 9)), np.zeros(layout.dofs), np.empty(layout.dofs)
    excess = np.zeros(joints)
    body, origin = np.empty(9), np.empty(3)
    for k in range(9):
        body[k] = row[layout.rotations + k]
    scale = follow_scale(model, row, dt, frame, rigidity.scale_sd) if known else restart_scale(row, rigidity.scale_sd)
    scale_bones(layout, row, scale)
    surprise, seen = _fit(model, row, frame, known, dt, origin, positions, variances, R, total, posterior, excess)
    scale_bones(layout, row, 1.0 / scale)
    if seen > 0:
        if known:
            learn_motion(layout, row, total, posterior, body)
            forget = math.expm1(-dt / model.parameters.surprise_s)
            row[at.RESTLESS] -= forget * (surprise / seen - row[at.RESTLESS])
            _learn_lengths(model, row, dt, R, frame)
        else:
            for i in range(layout.dofs):
                row[layout.variance + i] = posterior[i]
        row[at.SEEN] = row[at.AT]
        _judge(model.parameters.lost_m, row, measured, measured_variances, origin, positions)
        yield_limits(model, row, dt, excess)
    for j in range(joints):
        for k in range(3):
            positions[j, k] += origin[k]
        if model.joint_table[j, 5] >= 0:
            follow_dt = dt if known else -1.0
            near = measured if is_measured(measured, measured_variances, j) else positions
            _follow_contact(row, layout.contacts + 6 * model.joint_table[j, 5], follow_dt, positions, near, j)
    return True


@njit(cache=True, error_model="numpy", forceinline=True)
def _fit(
    model: BodyArrays, row: Float64, frame: Measurements, known: bool, dt: float, origin: Float64, positions: Float64,
    variances: Float64, R: Float64, total: Float64, posterior: Float64, excess: Float64,
) -> tuple[float, int]:  # fmt: skip
    """Fit the pose to a frame by Gauss–Newton steps about the prediction.

    Args:
        model, row, frame: as in `correct`; the row's pose is changed, residuals and weights are written.
        known: whether the row was predicted, rather than initialised from this frame.
        dt: time since the last update [s].
        origin, positions, variances, R: the fitted pose, written.
        total: (dofs,) sum of all steps; 0 at the beginning.
        posterior: (dofs,) variances, written.
        excess: (joints,) angle that the limits held each joint back [rad]; 0 at the beginning.

    Returns:
        The sum of the joints' surprises, and the number of measured joints.
    """
    layout, joint_table, order = model.layout, model.joint_table, model.order
    n, joints = layout.dofs, layout.joints
    work = Elimination(np.empty((joints, 27)), np.empty((n, 6)), np.empty(n), np.empty(n), np.empty((joints, 6)))
    xi, C, D, e, delta = np.empty((n, 6)), np.empty((joints, 21)), np.empty(n), np.empty(n), np.empty(n)
    x, residuals, weights = positions, frame.residuals, frame.weights
    pull, surprise, seen = 1.0 / model.parameters.rest_sd**2 * dt, 0.0, 0
    steps = 2 if known else FIRST_STEPS
    place(model, row, origin, x, R, xi)
    independent(joint_table, order, xi, row, layout.variance, x, C, variances)
    for step in range(steps):
        surprise, seen = _weigh(model, row, frame, step, known, dt, origin, x, variances, surprise)
        if seen == 0:
            break
        away_from_rest(layout, model.dof_values, joint_table, row, posterior)
        for i in range(n):
            D[i] = 1.0 / row[layout.variance + i]
            e[i] = -total[i] if known else 0.0
            if i >= ROOT_DOFS and pull > 0.0:
                e[i] = (D[i] * e[i] + pull * posterior[i]) / (D[i] + pull)
                D[i] += pull
        solve(joint_table, order, xi, D, e, x, residuals, weights, work, delta)
        marginals(joint_table, order, xi, work.U, work.d, x, C, posterior, variances)
        pinned = pin(model, row, delta, posterior, D, e, excess)
        if pinned:
            solve(joint_table, order, xi, D, e, x, residuals, weights, work, delta)
        apply_motion(model, row, delta, pinned)
        largest = 0.0
        for i in range(n):
            total[i] += delta[i]
            largest = max(largest, abs(delta[i]))
        done = step + 1 == steps or (known and largest < LARGE_STEP)
        place(model, row, origin, x, R, xi[:0] if done else xi)
        if done:
            break
    return surprise, seen


@njit(cache=True, error_model="numpy", forceinline=True)
def _weigh(
    model: BodyArrays, row: Float64, frame: Measurements, step: int, known: bool, dt: float, origin: Float64,
    positions: Float64, variances: Float64, surprise: float,
) -> tuple[float, int]:  # fmt: skip
    """Write residuals and weights of the measured joints; `_fit` describes the arguments.

    Arrays are taken out of their tuples once: numba counts references each time.

    Returns:
        ``surprise`` plus that of the joints in a first step, and the number of measured joints.
    """
    p, layout, joint_table, joint_values = model.parameters, model.layout, model.joint_table, model.joint_values
    measured, measured_variances = frame.positions, frame.variances
    residuals, weights, robust, share = frame.residuals, frame.weights, frame.robust, frame.share
    forget, nu, seen = -math.expm1(-dt / p.noise_s), p.degrees_of_freedom, 0
    for j in range(layout.joints):
        jumps = layout.jumps + 4 * j
        if not is_measured(measured, measured_variances, j):
            row[jumps] = math.nan
            continue
        seen += 1
        s = 0.0
        for k in range(3):
            residuals[j, k] = measured[j, k] - origin[k] - positions[j, k]
            s += residuals[j, k] ** 2
        if step == 0 and known:
            _learn_noise(row, jumps, residuals, j, forget)
        r = share * (measured_variances[j] + joint_values[j, 11]) + row[jumps + 3]
        if step == 0 or not known:
            # Student's t about the prediction; about the estimate itself while the body is initialised.
            expected = r + (variances[j] if known else FIRST_VARIANCE)
            surprise += min(s / (3.0 * expected), MOST_SURPRISE)
            robust[j] = min(1.0, (nu + 3.0) / (nu + s / expected)) if math.isfinite(nu) else 1.0
        weights[j] = robust[j] / r
        contact = joint_table[j, 5]
        if known and contact >= 0 and dt > 0.0:
            # A foot in contact stays where it was; the weight of that falls with its speed.
            c = layout.contacts + 6 * contact
            speed = row[c + 3] * row[c + 3] + row[c + 4] * row[c + 4] + row[c + 5] * row[c + 5]
            loose = 1.0 + speed / (p.stand_speed * p.stand_speed)
            still, w = 1.0 / (p.stand_diffusion * dt * loose * loose), weights[j]
            weights[j] = w + still
            for k in range(3):
                stays = row[c + k] - origin[k] - positions[j, k]
                residuals[j, k] = (w * residuals[j, k] + still * stays) / (w + still)
    return surprise, seen


@njit(cache=True, error_model="numpy")
def _learn_noise(row: Float64, jumps: int, residuals: Float64, j: int, forget: float) -> None:
    """Estimate a joint's noise from the successive differences of its innovations.

    Half their mean square is the variance of the innovations' white part, without slow changes (J. von Neumann et al.,
    The Mean Square Successive Difference, Annals of Mathematical Statistics 12, 1941).
    """
    if math.isfinite(row[jumps]):
        s = 0.0
        for k in range(3):
            s += (residuals[j, k] - row[jumps + k]) ** 2
        row[jumps + 3] += forget * (s / 6.0 - row[jumps + 3])
    for k in range(3):
        row[jumps + k] = residuals[j, k]


@njit(cache=True, error_model="numpy")
def learn_motion(layout: MemoryLayout, row: Float64, total: Float64, posterior: Float64, body: Float64) -> None:
    """Update velocities and variances after a step, by each velocity's covariance with its degree of freedom.

    Args:
        layout, row: layout of the memory, and its row, updated.
        total, posterior: (dofs,) the step, and the variances after it.
        body: (9,) the root's rotation before the step.
    """
    for i in range(layout.dofs):
        gain = row[layout.covariance + i] / row[layout.variance + i]
        if i < 3:
            for k in range(3):
                row[layout.velocities + k] += body[3 * k + i] * gain * total[i]
        else:
            row[layout.velocities + i] += gain * total[i]
        v = row[layout.speed_variance + i]
        row[layout.speed_variance + i] = v - gain * row[layout.covariance + i] + gain * gain * posterior[i]
        row[layout.covariance + i] = gain * posterior[i]
        row[layout.variance + i] = posterior[i]


@njit(cache=True, error_model="numpy")
def _learn_lengths(model: BodyArrays, row: Float64, dt: float, R: Float64, frame: Measurements) -> None:
    """Move bone lengths towards those measured along the bones, by bounded steps."""
    layout, joint_table, joint_values, x = model.layout, model.joint_table, model.joint_values, frame.positions
    for j in range(layout.joints):
        parent = joint_table[j, 0]
        if parent < 0 or frame.robust[j] < AGREES or frame.robust[parent] < AGREES:
            continue
        along = 0.0
        for k in range(3):
            bone = R[j, 3 * k] * joint_values[j, 0]
            bone = bone + R[j, 3 * k + 1] * joint_values[j, 1]
            bone = bone + R[j, 3 * k + 2] * joint_values[j, 2]
            along += bone * (x[j, k] - x[parent, k])
        i, learnt = layout.bones + joint_table[j, 4], layout.learnt + joint_table[j, 4]
        sd = math.sqrt(frame.variances[j] + frame.variances[parent] + joint_values[j, 11] + joint_values[parent, 11])
        counts = dt * min(1.0, 0.0009 / (sd * sd + 1e-12))
        row[learnt] = min(row[learnt] + counts, model.parameters.length_memory_s)
        gain = counts / (row[learnt] + LENGTH_PRIOR_S)
        deviation = min(max(along - row[i], -2.0 * sd), 2.0 * sd)
        if joint_values[j, 12] == 0.0:
            yield_length(row, layout.strains + joint_table[j, 4], learnt, deviation / sd, dt)
        row[i] += gain * deviation
        row[i] = max(row[i], 1e-3)


@njit(cache=True, error_model="numpy")
def _judge(
    lost_m: float, row: Float64, measured: Float64, variances: Float64, origin: Float64, positions: Float64
) -> None:
    """Update in the memory row since when the body is lost: measured joints farther away than ``lost_m`` on average."""
    far, seen = 0.0, 0
    for j in range(len(variances)):
        if is_measured(measured, variances, j):
            s = 0.0
            for k in range(3):
                s += (measured[j, k] - origin[k] - positions[j, k]) ** 2
            far += math.sqrt(s) - MEAN_DISTANCE * math.sqrt(variances[j])
            seen += 1
    if seen == 0:
        return
    if far <= lost_m * seen:
        row[at.LOST_SINCE] = math.nan
    elif not row[at.LOST_SINCE] <= row[at.AT]:
        row[at.LOST_SINCE] = row[at.AT]


@njit(cache=True, error_model="numpy")
def _follow_contact(row: Float64, c: int, dt: float, positions: Float64, measured: Float64, j: int) -> None:
    """Update the position of joint j in contact with the floor, and the smoothed velocity of its measurements."""
    forget = 1.0 - math.exp(-dt / CONTACT_S) if dt > 0.0 else 0.0
    for k in range(3):
        if dt > 0.0:
            row[c + 3 + k] += forget * ((measured[j, k] - row[c + k]) * CONTACT_HZ - row[c + 3 + k])
        elif dt < 0.0:
            row[c + 3 + k] = 0.0
        row[c + k] = positions[j, k]


@njit(cache=True, error_model="numpy")
def move(layout: MemoryLayout, memory: Float64, T: Float64) -> None:
    """Change the world frame of all bodies of a memory, in place.

    Args:
        layout: layout of a body's memory, of `ArticulatedModel`.
        memory: (people, memory_size) a state in each row, changed.
        T: (4, 4) rigid motion from the old to the new world frame.
    """
    for p in range(len(memory)):
        for k in range(3):
            _transform(T, memory, p, layout.rotations + k, 3, 0.0)
        _transform(T, memory, p, layout.angles, 1, 1.0)
        _transform(T, memory, p, layout.velocities, 1, 0.0)
        for c in range(layout.contacts, layout.jumps, 6):
            _transform(T, memory, p, c, 1, 1.0)
            _transform(T, memory, p, c + 3, 1, 0.0)
        for c in range(layout.jumps, layout.size, 4):
            _transform(T, memory, p, c, 1, 0.0)


@njit(cache=True, error_model="numpy")
def _transform(T: Float64, memory: Float64, p: int, first: int, step: int, shift: float) -> None:
    """Transform three numbers of row p: a point where shift is 1, a direction where it is 0."""
    x, y, z = memory[p, first], memory[p, first + step], memory[p, first + 2 * step]
    for i in range(3):
        memory[p, first + i * step] = T[i, 0] * x + T[i, 1] * y + T[i, 2] * z + shift * T[i, 3]
