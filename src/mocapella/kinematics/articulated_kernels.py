"""An articulated body followed through time, compiled; `docs/methods/articulated.md` says what is estimated and why.

A person's memory is one row of numbers (`articulated_memory`), NaN or 0 where nothing is known. The first arguments of
every function here are `ArticulatedModel.arrays`; all arrays are contiguous. Importing this module imports numba.
"""

# ruff: noqa: PLR0912, PLR0915, PLR0917 - compiled: arrays come by position, and loops are written out
from __future__ import annotations

import numpy as np

from mocapella.compiled import njit
from mocapella.geometry.alignment_kernels import accumulate, align
from mocapella.geometry.turn_kernels import orthonormal, turn_between, turned
from mocapella.kinematics import articulated_memory as at
from mocapella.kinematics.articulated_model import OF_BALL, ROOT_DOFS
from mocapella.kinematics.chain_kernels import (
    forward,
    independent,
    limited,
    marginals,
    solve,
    swing,
)

PINNED = 1e12
"""Information that holds a degree of freedom at its limit [1/rad²]."""
LARGE_STEP = 0.5
"""After a step with a larger angle the linearisation is made anew [rad]."""
FIRST_STEPS = 12
"""Gauss–Newton steps that a body is begun with."""
FIRST_SD = 0.5
"""Of every angle, when a body is begun, and of the root's position [rad, m]."""
FIRST_SPEED_SD = 2.0
"""Of every velocity then [rad/s, m/s]."""
CONTACT_S = 0.1
"""Time constant of the velocity that says whether a foot stands [s]."""
CALMING = 3
"""The power of the surprise with which the densities of acceleration fall."""
MOST_SURPRISE = 1.0
"""That one joint counts with."""
MEAN_DISTANCE = 1.6
"""Of a point with normal noise from where it is, over the standard deviation of a coordinate: 2 √(2/π)."""
AGREES = 0.5
"""Robust weight from which a joint counts as measured where it is."""
LEAST_TORSO = 4


@njit(cache=True)
def _advance(layout, dof_kind, dof_values, joint_table, config, row, at_s):
    """Predict a memory row to a later instant, in place: a velocity that fades, moved by white acceleration.

    Every degree of freedom is an integrated Ornstein–Uhlenbeck process, with its exact covariance.
    """
    n, dt = layout[at.DOFS], at_s - row[at.AT]
    if not dt > 0.0:
        return
    row[at.AT] = at_s
    angles, velocities = row[layout[at.ANGLES] :], row[layout[at.VELOCITIES] :]
    p, c, v = row[layout[at.VARIANCE] :], row[layout[at.COVARIANCE] :], row[layout[at.SPEED_VARIANCE] :]
    tau = config[at.VELOCITY_MEMORY]
    b = dt / tau
    e = np.exp(-b)
    f = tau * (1.0 - e)
    if b > 1e-2:
        qp = tau * tau * (dt - 2.0 * f + 0.5 * tau * (1.0 - e * e))
        qv = 0.5 * tau * (1.0 - e * e)
    else:
        qp, qv = dt * dt * dt / 3.0, dt
    qc = 0.5 * f * f
    scale = min(max((row[at.RESTLESS] / config[at.FULL_SURPRISE]) ** CALMING, config[at.CALM]), 1.0)
    for i in range(n):
        q = dof_values[i, 3] * scale
        p[i] = min(p[i] + 2.0 * f * c[i] + f * f * v[i] + q * qp, dof_values[i, 4])
        c[i] = e * (c[i] + f * v[i]) + q * qc
        v[i] = e * e * v[i] + q * qv
        c[i] = min(c[i], np.sqrt(p[i] * v[i]))
        if dof_kind[i] < OF_BALL:
            angles[i] += f * velocities[i]
            if angles[i] < dof_values[i, 0]:
                angles[i], velocities[i] = dof_values[i, 0], 0.0
            elif angles[i] > dof_values[i, 1]:
                angles[i], velocities[i] = dof_values[i, 1], 0.0
    R = np.empty(9)
    for j in range(layout[at.JOINTS]):
        if joint_table[j, 3] >= 0:
            o, b = _ball(layout, joint_table, j)
            turned(row, b, f * velocities[o], f * velocities[o + 1], f * velocities[o + 2], R)
            for k in range(9):
                row[b + k] = R[k]
    for i in range(n):
        velocities[i] *= e


@njit(cache=True)
def _ball(layout, joint_table, j):
    """The first of a ball's three degrees of freedom, and where its rotation is in the memory."""
    return joint_table[j, 1] + (3 if joint_table[j, 0] < 0 else 0), layout[at.ROTATIONS] + 9 * joint_table[j, 3]


@njit(cache=True)
def _forward(layout, dof_kind, joint_table, joint_values, order, row, origin, x, R, xi):
    """Forward kinematics of a memory row about its root, whose position is written into origin (3,)."""
    a = layout[at.ANGLES]
    for k in range(3):
        origin[k] = row[a + k]
    balls = row[layout[at.ROTATIONS] : layout[at.BONES]].reshape((layout[at.BALLS], 9))
    forward(
        dof_kind, joint_table, joint_values, order, row[a : a + layout[at.DOFS]], balls,
        row[layout[at.BONES] : layout[at.LEARNT]], origin, x, R, xi,
    )  # fmt: skip


@njit(cache=True)
def _rest(layout, dof_kind, dof_values, joint_table, row, out):
    """Write how far every angle is from its rest, (dofs,); 0 for the root, and the sine of the turn for balls."""
    angles = row[layout[at.ANGLES] :]
    for i in range(layout[at.DOFS]):
        out[i] = dof_values[i, 2] - angles[i] if i >= ROOT_DOFS else 0.0
    for j in range(layout[at.JOINTS]):
        if joint_table[j, 3] > 0:
            o, b = _ball(layout, joint_table, j)
            out[o] = 0.5 * (row[b + 5] - row[b + 7])
            out[o + 1] = 0.5 * (row[b + 6] - row[b + 2])
            out[o + 2] = 0.5 * (row[b + 1] - row[b + 3])


@njit(cache=True)
def _pin(layout, dof_kind, dof_values, joint_table, joint_values, row, delta, D, e):
    """Hold what delta would move beyond its limits at them, in D and e (dofs,); whether there was any."""
    angles, pinned = row[layout[at.ANGLES] :], False
    for i in range(ROOT_DOFS, layout[at.DOFS]):
        if dof_kind[i] < OF_BALL:
            goal = angles[i] + delta[i]
            if goal < dof_values[i, 0]:
                D[i], e[i], pinned = PINNED, dof_values[i, 0] - angles[i], True
            elif goal > dof_values[i, 1]:
                D[i], e[i], pinned = PINNED, dof_values[i, 1] - angles[i], True
    R, within = np.empty(9), np.empty(9)
    for j in range(layout[at.JOINTS]):
        if joint_table[j, 3] > 0:
            o, b = _ball(layout, joint_table, j)
            turned(row, b, delta[o], delta[o + 1], delta[o + 2], R)
            if limited(joint_values[j], R, within):
                e[o], e[o + 1], e[o + 2] = turn_between(row, b, within)
                D[o] = D[o + 1] = D[o + 2] = PINNED
                pinned = True
    return pinned


@njit(cache=True)
def _move(layout, dof_kind, dof_values, joint_table, joint_values, row, delta):
    """Apply a small motion (dofs,) to the pose of a memory row, and keep it within its limits."""
    angles, b = row[layout[at.ANGLES] :], layout[at.ROTATIONS]
    for k in range(3):
        angles[k] += row[b + 3 * k] * delta[0] + row[b + 3 * k + 1] * delta[1] + row[b + 3 * k + 2] * delta[2]
    for i in range(ROOT_DOFS, layout[at.DOFS]):
        if dof_kind[i] < OF_BALL:
            angles[i] = min(max(angles[i] + delta[i], dof_values[i, 0]), dof_values[i, 1])
    R, within = np.empty(9), np.empty(9)
    for j in range(layout[at.JOINTS]):
        if joint_table[j, 3] >= 0:
            o, b = _ball(layout, joint_table, j)
            turned(row, b, delta[o], delta[o + 1], delta[o + 2], R)
            limited(joint_values[j], R, within)
            orthonormal(within)
            for k in range(9):
                row[b + k] = within[k]


@njit(cache=True)
def _begin(
    layout, dof_kind, dof_values, joint_table, joint_values, order, config, row, at_s, measured, variances
):  # fmt: skip
    """Begin a body from measured joints; whether there are enough. Bone lengths that are known stay."""
    n, joints = layout[at.DOFS], layout[at.JOINTS]
    seen, torso = 0, 0
    for j in range(joints):
        if _is_measured(measured, variances, j):
            seen += 1
            if joint_values[j, 10] > 0.0:
                torso += 1
    if seen < config[at.LEAST_JOINTS] or torso < LEAST_TORSO:
        return False
    lengths = row[layout[at.BONES] :]
    if row[at.STARTED] != 1.0:
        _first_lengths(joint_table, joint_values, measured, variances, lengths)
        _fill(row, layout[at.LEARNT], layout[at.CONTACTS], 0.0)
    _fill(row, layout[at.ANGLES], layout[at.BONES], 0.0)
    root = layout[at.ROTATIONS]
    for b in range(root, layout[at.BONES], 9):
        row[b] = row[b + 4] = row[b + 8] = 1.0
    x, R, xi, origin = np.empty((joints, 3)), np.empty((joints, 9)), np.empty((n, 6)), np.empty(3)
    _forward(layout, dof_kind, joint_table, joint_values, order, row, origin, x, R, xi)
    # The torso as it is at rest, turned and moved to where it was measured; then each bone, from the root outwards.
    moments, T, w = np.zeros(50), np.empty((4, 4)), np.zeros(joints)
    filled = np.zeros((joints, 3))
    for j in range(joints):
        if joint_values[j, 10] > 0.0 and _is_measured(measured, variances, j):
            w[j] = 1.0
            for k in range(3):
                filled[j, k] = measured[j, k]
    accumulate(moments, filled, x, np.zeros((joints, 3)), w, np.arange(joints))
    align(moments, 0.0, T)
    for k in range(3):
        row[layout[at.ANGLES] + k] = T[k, 3]
        for i in range(3):
            row[root + 3 * k + i] = T[k, i]
    d, S, within = np.empty(3), np.empty(9), np.empty(9)
    for j in order:
        ball, parent = joint_table[j, 3], joint_table[j, 0]
        if ball > 0 and _is_measured(measured, variances, j) and _is_measured(measured, variances, parent):
            _forward(layout, dof_kind, joint_table, joint_values, order, row, origin, x, R, xi)
            for r in range(3):
                d[r] = 0.0
                for c in range(3):
                    d[r] += R[parent, 3 * c + r] * (measured[j, c] - measured[parent, c])
            length = np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
            if length > 0.0:
                swing(
                    joint_values[j, 0],
                    joint_values[j, 1],
                    joint_values[j, 2],
                    d[0] / length,
                    d[1] / length,
                    d[2] / length,
                    S,
                )
                limited(joint_values[j], S, within)
                for k in range(9):
                    row[root + 9 * ball + k] = within[k]
    angles = row[layout[at.ANGLES] :]
    for i in range(ROOT_DOFS, n):
        if dof_kind[i] < OF_BALL:  # away from the limits, where a hinge's sense is not to be seen
            angles[i] = 0.25 * (dof_values[i, 0] + dof_values[i, 1])
    _fill(row, layout[at.VELOCITIES], layout[at.VARIANCE], 0.0)
    _fill(row, layout[at.VARIANCE], layout[at.COVARIANCE], FIRST_SD**2)
    _fill(row, layout[at.COVARIANCE], layout[at.SPEED_VARIANCE], 0.0)
    _fill(row, layout[at.SPEED_VARIANCE], layout[at.ROTATIONS], FIRST_SPEED_SD**2)
    row[at.AT] = row[at.SEEN] = at_s
    row[at.RESTLESS] = 1.0
    for c in range(layout[at.JUMPS], layout[at.SIZE], 4):
        row[c], row[c + 3] = np.nan, 0.0
    row[at.STARTED], row[at.LOST_SINCE] = 1.0, np.nan
    return True


@njit(cache=True)
def _is_measured(measured, variances, j):
    return (
        np.isfinite(measured[j, 0]) and np.isfinite(measured[j, 1]) and np.isfinite(measured[j, 2])
        and np.isfinite(variances[j])
    )  # fmt: skip


@njit(cache=True)
def _median(values, count):
    """The lower median of the first so many values, which are sorted in place; numpy's takes seconds to compile."""
    for i in range(1, count):
        k = i
        while k > 0 and values[k - 1] > values[k]:
            values[k - 1], values[k] = values[k], values[k - 1]
            k -= 1
    return values[(count - 1) // 2]


@njit(cache=True)
def _fill(values, begin, end, value):
    for i in range(begin, end):
        values[i] = value


@njit(cache=True)
def _first_lengths(joint_table, joint_values, measured, variances, lengths):
    """The template's bones, scaled by the median of those that are measured."""
    ratios, seen = np.empty(len(joint_table)), 0
    for j in range(len(joint_table)):
        parent = joint_table[j, 0]
        if parent >= 0 and _is_measured(measured, variances, j) and _is_measured(measured, variances, parent):
            s = 0.0
            for k in range(3):
                s += (measured[j, k] - measured[parent, k]) ** 2
            ratios[seen] = np.sqrt(s) / joint_values[j, 3]
            seen += 1
    stature = 1.7
    if seen > 0:
        stature = min(max(_median(ratios, seen), 0.5), 2.5)
    for j in range(len(joint_table)):
        if joint_table[j, 4] >= 0:
            lengths[joint_table[j, 4]] = stature * joint_values[j, 3]


@njit(cache=True)
def _learn_lengths(layout, joint_table, config, row, dt, R, joint_values, measured, variances, robust):
    """Move bone lengths towards what is measured along the bones, by bounded steps: robust, and slow."""
    memory = config[at.LENGTH_MEMORY]
    lengths, learnt = row[layout[at.BONES] :], row[layout[at.LEARNT] :]
    for j in range(len(joint_table)):
        parent = joint_table[j, 0]
        if parent < 0 or robust[j] < AGREES or robust[parent] < AGREES:
            continue
        along = 0.0
        for k in range(3):
            bone = (
                R[j, 3 * k] * joint_values[j, 0]
                + R[j, 3 * k + 1] * joint_values[j, 1]
                + R[j, 3 * k + 2] * joint_values[j, 2]
            )
            along += bone * (measured[j, k] - measured[parent, k])
        i = joint_table[j, 4]
        sd = np.sqrt(variances[j] + variances[parent] + joint_values[j, 11] + joint_values[parent, 11])
        counts = dt * min(1.0, 0.0009 / (sd * sd + 1e-12))
        learnt[i] = min(learnt[i] + counts, memory)
        gain = counts / (learnt[i] + LENGTH_PRIOR_S)
        lengths[i] += gain * min(max(along - lengths[i], -2.0 * sd), 2.0 * sd)
        lengths[i] = max(lengths[i], 1e-3)


LENGTH_PRIOR_S = 0.05
"""For how long the template's bones count as measured [s]."""


@njit(cache=True)
def _nowhere(positions, variances):
    for j in range(len(variances)):
        variances[j] = np.nan
        for k in range(3):
            positions[j, k] = np.nan


@njit(cache=True)
def predict(
    layout, dof_kind, dof_values, joint_table, joint_values, order, config, row, at_s, positions, variances
):  # fmt: skip
    """Where a body is at an instant; whether it is known.

    Args:
        layout … config: `ArticulatedModel.arrays`.
        row: (memory_size,) a person's memory; not changed.
        at_s: not before the memory's instant; where it is, the memory's instant is taken [s].
        positions: (joints, 3) [m], written; NaN where the body is not known.
        variances: (joints,) of a coordinate [m²], written.
    """
    if not (row[at.STARTED] == 1.0 and at_s - row[at.SEEN] <= config[at.FORGET_AFTER]):
        _nowhere(positions, variances)
        return False
    n, joints = layout[at.DOFS], layout[at.JOINTS]
    work = row.copy()
    _advance(layout, dof_kind, dof_values, joint_table, config, work, at_s)
    R, xi, origin, C = np.empty((joints, 9)), np.empty((n, 6)), np.empty(3), np.empty((joints, 10))
    _forward(layout, dof_kind, joint_table, joint_values, order, work, origin, positions, R, xi)
    P = work[layout[at.VARIANCE] : layout[at.COVARIANCE]]
    independent(joint_table, order, xi, P, positions, C, variances)
    for j in range(joints):
        for k in range(3):
            positions[j, k] += origin[k]
    return True


@njit(cache=True)
def correct(
    layout, dof_kind, dof_values, joint_table, joint_values, order, config, row, at_s, measured,
    measured_variances, positions, variances,
):  # fmt: skip
    """Take in measured joints: the memory is at their instant afterwards; whether the body is known.

    Args:
        layout … config: `ArticulatedModel.arrays`.
        row: (memory_size,) a person's memory; changed. NaN or 0: somebody new.
        at_s: [s]; where it is before the memory's instant, that is taken.
        measured: (joints, 3) [m]; NaN where not measured.
        measured_variances: (joints,) of a coordinate [m²]; not finite where not measured.
        positions: (joints, 3) [m], written; NaN while the body is not known.
        variances: (joints,) of a coordinate [m²], written.
    """
    n, joints = layout[at.DOFS], layout[at.JOINTS]
    known = row[at.STARTED] == 1.0 and at_s - row[at.SEEN] <= config[at.FORGET_AFTER]
    steps, dt = 2, max(0.0, at_s - row[at.AT])
    if known and at_s - row[at.LOST_SINCE] > config[at.LOST_S]:
        known = False
    if not known:
        steps, dt = FIRST_STEPS, 0.0
        if not _begin(
            layout, dof_kind, dof_values, joint_table, joint_values, order, config, row, at_s, measured,
            measured_variances,
        ):  # fmt: skip
            if row[at.STARTED] == 1.0:
                return predict(
                    layout, dof_kind, dof_values, joint_table, joint_values, order, config, row, at_s,
                    positions, variances,
                )  # fmt: skip
            _nowhere(positions, variances)
            return False
    _advance(layout, dof_kind, dof_values, joint_table, config, row, at_s)
    R, xi, origin, C = np.empty((joints, 9)), np.empty((n, 6)), np.empty(3), np.empty((joints, 21))
    M, U, a = np.empty((joints, 27)), np.empty((n, 6)), np.empty((joints, 6))
    D, e, d, u, delta = np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    total, pull, pulled = np.zeros(n), 1.0 / config[at.REST_SD] ** 2 * dt, np.empty(n)
    residuals, weights, robust = np.empty((joints, 3)), np.zeros(joints), np.zeros(joints)
    P = row[layout[at.VARIANCE] : layout[at.COVARIANCE]]
    nu = config[at.NU]
    body = row[layout[at.ROTATIONS] : layout[at.ROTATIONS] + 9].copy()
    _forward(layout, dof_kind, joint_table, joint_values, order, row, origin, positions, R, xi)
    independent(joint_table, order, xi, P, positions, C, variances)
    surprise = 0.0
    for step in range(steps):
        seen = 0
        for j in range(joints):
            if not _is_measured(measured, measured_variances, j):
                row[layout[at.JUMPS] + 4 * j] = np.nan
                continue
            seen += 1
            s = 0.0
            for k in range(3):
                residuals[j, k] = measured[j, k] - origin[k] - positions[j, k]
                s += residuals[j, k] ** 2
            jumps = layout[at.JUMPS] + 4 * j
            if step == 0 and known:
                _learn_noise(row, jumps, residuals, j, -np.expm1(-dt / config[at.NOISE_S]))
            r = measured_variances[j] + joint_values[j, 11] + row[jumps + 3]
            if step == 0 or not known:
                # Student's t about the prediction; about the estimate itself while the body is begun.
                expected = r + (variances[j] if known else 0.0025)
                surprise += min(s / (3.0 * expected), MOST_SURPRISE)
                robust[j] = min(1.0, (nu + 3.0) / (nu + s / expected)) if np.isfinite(nu) else 1.0
            weights[j] = robust[j] / r
            if known and joint_table[j, 5] >= 0 and dt > 0.0:
                _stand(layout, config, row, joint_table[j, 5], j, dt, origin, positions, residuals, weights)
        if seen == 0:
            break
        _rest(layout, dof_kind, dof_values, joint_table, row, pulled)
        for i in range(n):
            D[i] = 1.0 / P[i]
            e[i] = -total[i] if known else 0.0
            if i >= ROOT_DOFS and pull > 0.0:
                e[i] = (D[i] * e[i] + pull * pulled[i]) / (D[i] + pull)
                D[i] += pull
        solve(joint_table, order, xi, D, e, positions, residuals, weights, M, U, d, u, a, delta)
        marginals(joint_table, order, xi, U, d, positions, C, pulled, variances)
        if _pin(layout, dof_kind, dof_values, joint_table, joint_values, row, delta, D, e):
            solve(joint_table, order, xi, D, e, positions, residuals, weights, M, U, d, u, a, delta)
        _move(layout, dof_kind, dof_values, joint_table, joint_values, row, delta)
        largest = 0.0
        for i in range(n):
            total[i] += delta[i]
            largest = max(largest, abs(delta[i]))
        _forward(layout, dof_kind, joint_table, joint_values, order, row, origin, positions, R, xi)
        if largest < LARGE_STEP and known:
            break
    if seen > 0:
        if known:
            _learn(layout, row, total, pulled, body)
            row[at.RESTLESS] -= np.expm1(-dt / config[at.SURPRISE_S]) * (surprise / seen - row[at.RESTLESS])
            _learn_lengths(layout, joint_table, config, row, dt, R, joint_values, measured, measured_variances, robust)
        else:
            for i in range(n):
                P[i] = pulled[i]
        row[at.SEEN] = row[at.AT]
        _judge(config, row, measured, measured_variances, origin, positions)
    for j in range(joints):
        for k in range(3):
            positions[j, k] += origin[k]
        if joint_table[j, 5] >= 0:
            _follow_contact(
                row, layout[at.CONTACTS] + 6 * joint_table[j, 5], dt if known else -1.0, positions[j],
                measured[j] if _is_measured(measured, measured_variances, j) else positions[j],
            )  # fmt: skip
    return True


@njit(cache=True)
def _learn_noise(row, jumps, residuals, j, forget):
    """A joint's noise from the successive differences of its innovations.

    Half their mean square is the variance of what is white in them, whatever changes slowly (J. von Neumann et al.,
    The Mean Square Successive Difference, Annals of Mathematical Statistics 12, 1941).
    """
    if np.isfinite(row[jumps]):
        s = 0.0
        for k in range(3):
            s += (residuals[j, k] - row[jumps + k]) ** 2
        row[jumps + 3] += forget * (s / 6.0 - row[jumps + 3])
    for k in range(3):
        row[jumps + k] = residuals[j, k]


@njit(cache=True)
def _stand(layout, config, row, contact, j, dt, origin, positions, residuals, weights):
    """Add to a joint's measurement that it stays where it was, as surely as it has been slow."""
    c = layout[at.CONTACTS] + 6 * contact
    speed = row[c + 3] * row[c + 3] + row[c + 4] * row[c + 4] + row[c + 5] * row[c + 5]
    loose = 1.0 + speed / (config[at.STAND_SPEED] * config[at.STAND_SPEED])
    still = 1.0 / (config[at.STAND_DIFFUSION] * dt * loose * loose)
    w = weights[j]
    weights[j] = w + still
    for k in range(3):
        stays = row[c + k] - origin[k] - positions[j, k]
        residuals[j, k] = (w * residuals[j, k] + still * stays) / (w + still)


@njit(cache=True)
def _follow_contact(row, c, dt, position, measured):
    """Remember where a joint is, and its velocity: as measured against where it was estimated, over `CONTACT_S`."""
    forget = 1.0 - np.exp(-dt / CONTACT_S) if dt > 0.0 else 0.0
    for k in range(3):
        if dt > 0.0:
            row[c + 3 + k] += forget * ((measured[k] - row[c + k]) / dt - row[c + 3 + k])
        elif dt < 0.0:
            row[c + 3 + k] = 0.0
        row[c + k] = position[k]


@njit(cache=True)
def _learn(layout, row, total, posterior, body):
    """Velocities and variances after a step: every degree of freedom's velocity by its covariance with it."""
    velocities = row[layout[at.VELOCITIES] :]
    p, c, v = row[layout[at.VARIANCE] :], row[layout[at.COVARIANCE] :], row[layout[at.SPEED_VARIANCE] :]
    for i in range(layout[at.DOFS]):
        gain = c[i] / p[i]
        if i < 3:
            for k in range(3):
                velocities[k] += body[3 * k + i] * gain * total[i]
        else:
            velocities[i] += gain * total[i]
        v[i] = v[i] - gain * c[i] + gain * gain * posterior[i]
        c[i] = gain * posterior[i]
        p[i] = posterior[i]


@njit(cache=True)
def _judge(config, row, measured, variances, origin, positions):
    """Remember since when the measured joints have been too far from the body."""
    far, seen = 0.0, 0
    for j in range(len(variances)):
        if _is_measured(measured, variances, j):
            s = 0.0
            for k in range(3):
                s += (measured[j, k] - origin[k] - positions[j, k]) ** 2
            far += np.sqrt(s) - MEAN_DISTANCE * np.sqrt(variances[j])
            seen += 1
    if seen == 0:
        return
    if far <= config[at.LOST_M] * seen:
        row[at.LOST_SINCE] = np.nan
    elif not row[at.LOST_SINCE] <= row[at.AT]:
        row[at.LOST_SINCE] = row[at.AT]


@njit(cache=True)
def move(layout, memory, T):
    """Tell every body in another frame from now on.

    Args:
        layout: of `ArticulatedModel`.
        memory: (people, memory_size), changed.
        T: (4, 4) `T_new_old`, rigid.
    """
    b = layout[at.ROTATIONS]
    for row in memory:
        for k in range(b, b + 3):
            _turn(T, row, k, 3, 0.0)
        _turn(T, row, layout[at.ANGLES], 1, 1.0)
        _turn(T, row, layout[at.VELOCITIES], 1, 0.0)
        for c in range(layout[at.CONTACTS], layout[at.JUMPS], 6):
            _turn(T, row, c, 1, 1.0)
            _turn(T, row, c + 3, 1, 0.0)
        for c in range(layout[at.JUMPS], layout[at.SIZE], 4):
            _turn(T, row, c, 1, 0.0)


@njit(cache=True)
def _turn(T, row, first, step, shift):
    """Three numbers of a row, turned and shifted."""
    x, y, z = row[first], row[first + step], row[first + 2 * step]
    for i in range(3):
        row[first + i * step] = T[i, 0] * x + T[i, 1] * y + T[i, 2] * z + shift * T[i, 3]
