"""Kernels of a filter for an articulated body that cameras see along rays.

The estimator is that of `articulated_kernels`, with other measurements: a ray tells where a joint is across itself and
nothing along itself (`docs/methods/webcams-body.md` derives it). So joints that one camera sees contribute what it
knows of them, and several cameras triangulate within the estimate. A body's memory is one row (`articulated_memory`),
NaN for a new body. All arrays are contiguous. Importing this module imports numba.
"""

# ruff: noqa: PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.kinematics import articulated_memory as at
from mocapella.kinematics.articulated_kernels import learn_motion, move, place
from mocapella.kinematics.articulated_memory import MemoryLayout
from mocapella.kinematics.articulated_model import ROOT_DOFS, BodyArrays
from mocapella.kinematics.articulated_pose_kernels import advance, apply_motion, away_from_rest, pin
from mocapella.kinematics.articulated_start_kernels import initialise
from mocapella.kinematics.articulated_yield_kernels import yield_limits
from mocapella.kinematics.chain_kernels import Elimination, independent, marginals, solve
from mocapella.kinematics.ray_exchange_kernels import exchange_limbs
from mocapella.kinematics.ray_learning_kernels import (
    AGING,
    MOST_AGED,
    add_age,
    age_joints,
    aged_variance,
    follow_restlessness,
    judge,
    learn_lengths,
    learn_offsets,
    resize,
    turn_offsets,
)
from mocapella.kinematics.ray_point_kernels import RAY, agree
from mocapella.kinematics.ray_sight_kernels import (
    Sight,
    aim,
    crossed,
    inform,
    reweigh,
    shift_origin,
    sort_rays,
    supporting,
    triangulated,
    weigh,
)
from mocapella.kinematics.ray_start_kernels import bend_limbs

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
UInt8 = NDArray[np.uint8]

__all__ = ["correct_by_rays", "move", "predict_body"]


LARGE_STEP = 0.2
"""Largest change of a degree of freedom in a step; after a larger one, another step follows [m, rad]."""
MOST_STEP = 0.5
"""Largest change of a degree of freedom in one step; a larger step is shortened [m, rad]."""
STEPS = 5
"""Most Gauss–Newton steps in a frame."""
FIRST_STEPS = 15
"""Gauss–Newton steps in a body's first frame."""
VIRTUAL_SD = 0.04
"""Standard deviation of a joint halfway between two mirrored ones, where it is not measured itself [m]."""
START_SD = 0.15
"""Largest standard deviation of a coordinate of a triangulated joint that initialises a body [m]."""
ONE_RESTLESS = 0.5
"""Factor of the surprise that sets the densities of acceleration while one camera alone sees the body [ratio]."""
ONE_DIFFUSION = 0.02
"""Growth of the variance of the root's position in that time [m²/s]."""
REWEIGHED = (5, 10)
"""Steps of a body's first frame before which its rays are weighted anew, by their misfits to the pose so far."""


@njit(cache=True, error_model="numpy")
def predict_body(model: BodyArrays, row: Float64, at_s: float, positions: Float64, covariances: Float64) -> bool:
    """Extrapolate a body and its uncertainty to an instant, without changing its memory.

    Args:
        model: the body model.
        row: (memory_size,) the body's memory.
        at_s: the instant, on the clock of earlier calls [s]; a time before the memory's counts as the memory's.
        positions: (joints, 3) written: world [m]; NaN where the body is not known.
        covariances: (joints, 3, 3) written: [m²]; NaN where the body is not known.

    Returns:
        Whether the body is known.
    """
    layout, joints, n = model.layout, model.layout.joints, model.layout.dofs
    if not (row[at.STARTED] == 1.0 and at_s - row[at.SEEN] <= model.parameters.forget_after_s):
        _unknown(positions, covariances)
        return False
    work, R, xi, origin = np.empty(layout.size), np.empty((joints, 9)), np.empty((n, 6)), np.empty(3)
    for i in range(layout.size):
        work[i] = row[i]
    advance(model, work, at_s)
    place(model, work, origin, positions, R, xi)
    U, d, C = np.zeros((n, 6)), np.empty(n), np.empty((joints, 21))
    for i in range(n):
        d[i] = 1.0 / work[layout.variance + i]
    marginals(model.joint_table, model.order, xi, U, d, positions, C, np.empty(n), np.empty(joints))
    offsets = np.empty((joints, 4))
    turn_offsets(model, work, at_s - row[at.AT], R, offsets)
    for j in range(joints):
        _write_covariance(C, j, positions, covariances)
        for k in range(3):
            positions[j, k] += origin[k] + offsets[j, k]
            covariances[j, k, k] += offsets[j, 3] + aged_variance(work[layout.ages + 4 * j])
    return True


@njit(cache=True, error_model="numpy")
def _unknown(positions: Float64, covariances: Float64) -> None:
    """Write NaN to positions (joints, 3) and covariances (joints, 3, 3)."""
    for j in range(len(positions)):
        for k in range(3):
            positions[j, k] = math.nan
            for i in range(3):
                covariances[j, k, i] = math.nan


@njit(cache=True, error_model="numpy")
def _write_covariance(C: Float64, j: int, x: Float64, out: Float64) -> None:
    """Write the covariance (3, 3) of joint j at x (joints, 3): J C Jᵀ, with C (joints, 21) and J = (−[x]×, I)."""
    f, g, h = x[j, 0], x[j, 1], x[j, 2]
    c00, c01, c02, c11, c12, c22 = C[j, 0], C[j, 1], C[j, 2], C[j, 6], C[j, 7], C[j, 11]
    # Rows of [x]× C_ωω, and of [x]× C_ωv.
    p00, p01, p02 = g * c02 - h * c01, g * c12 - h * c11, g * c22 - h * c12
    p10, p11, p12 = h * c00 - f * c02, h * c01 - f * c12, h * c02 - f * c22
    p20, p21 = f * c01 - g * c00, f * c11 - g * c01
    q00, q01, q02 = g * C[j, 12] - h * C[j, 8], g * C[j, 13] - h * C[j, 9], g * C[j, 14] - h * C[j, 10]
    q10, q11, q12 = h * C[j, 3] - f * C[j, 12], h * C[j, 4] - f * C[j, 13], h * C[j, 5] - f * C[j, 14]
    q20, q21, q22 = f * C[j, 8] - g * C[j, 3], f * C[j, 9] - g * C[j, 4], f * C[j, 10] - g * C[j, 5]
    out[j, 0, 0] = C[j, 15] - 2.0 * q00 + g * p02 - h * p01
    out[j, 1, 1] = C[j, 18] - 2.0 * q11 + h * p10 - f * p12
    out[j, 2, 2] = C[j, 20] - 2.0 * q22 + f * p21 - g * p20
    out[j, 0, 1] = out[j, 1, 0] = C[j, 16] - q01 - q10 + h * p00 - f * p02
    out[j, 0, 2] = out[j, 2, 0] = C[j, 17] - q02 - q20 + f * p01 - g * p00
    out[j, 1, 2] = out[j, 2, 1] = C[j, 19] - q12 - q21 + f * p11 - g * p10


@njit(cache=True, error_model="numpy")
def correct_by_rays(
    model: BodyArrays, row: Float64, at_s: float, joints: Int64, origins: Float64, directions: Float64,
    sds_rad: Float64, after_s: Float64, weights: Float64, positions: Float64, covariances: Float64, support: UInt8,
) -> bool:  # fmt: skip
    """Predict a body to an instant and correct it by the rays of that instant; the memory is then at that time.

    A new, forgotten or lost body is initialised from the joints that two rays or more triangulate, if they suffice
    (`articulated_start_kernels.initialise`). A ray is used if its joint exists, its direction has length 1, and its
    standard deviation is above 0 and below 1.

    Args:
        model: the body model.
        row: (memory_size,) the body's memory, changed; NaN for a new body.
        at_s: the instant [s]; a time before the memory's counts as the memory's.
        joints: (n,) the joint that each ray sees; a camera has at most one ray to a joint.
        origins: (n, 3) centres of the rays' cameras, world [m].
        directions: (n, 3) unit directions, world.
        sds_rad: (n,) standard deviation of each direction, of one angle across [rad].
        after_s: (n,) how much later than ``at_s`` each ray is [s].
        weights: (n,) written: robust weight of each ray, from 0 to 1.
        positions: (joints, 3) written: world [m]; NaN while the body is not known.
        covariances: (joints, 3, 3) written: [m²]; NaN while the body is not known.
        support: (joints,) written: number of rays that agree with the estimate.

    Returns:
        Whether the body is known.
    """
    layout, n = model.layout, model.layout.joints
    known = row[at.STARTED] == 1.0 and at_s - row[at.SEEN] <= model.parameters.forget_after_s
    dt = max(0.0, at_s - row[at.AT])
    if known and at_s - row[at.LOST_SINCE] > model.parameters.lost_s:
        known = False
    for j in range(n):
        support[j] = 0
    sight = Sight(
        np.empty((len(joints), RAY)), np.empty(len(joints), np.int64), np.zeros(n + 1, np.int64), weights,
        np.zeros(n, np.int64), np.empty((n, 9)), np.empty((n, 6)), np.empty((n, 3)), np.zeros((n, 4)),
    )  # fmt: skip
    sort_rays(sight, joints, origins, directions, sds_rad)
    if not known:
        dt = 0.0
        if not _begin(model, row, at_s, sight, joints, origins, directions, sds_rad, after_s):
            return bool(predict_body(model, row, at_s, positions, covariances))
    _advance_by_few(model, row, at_s, known and not crossed(sight))
    R, total, posterior = np.empty((n, 9)), np.zeros(layout.dofs), np.empty(layout.dofs)
    excess, body, origin, C = np.zeros(n), np.empty(9), np.empty(3), np.empty((n, 21))
    for k in range(9):
        body[k] = row[layout.rotations + k]
    dofs = layout.dofs
    work = Elimination(np.empty((n, 27)), np.empty((dofs, 6)), np.empty(dofs), np.empty(dofs), np.empty((n, 6)))
    surprise, seen = _fit(
        model, row, sight, known, dt, joints, origins, directions, sds_rad, after_s, origin, positions, R, total,
        posterior, excess, C, work,
    )  # fmt: skip
    if seen > 0:
        _learn(model, row, dt, known, surprise / seen, 2 * triangulated(sight) > seen, R, work, total, posterior, body)
        row[at.SEEN] = row[at.AT]
        if known:
            resize(model, row, dt, sight)
        judge(model.parameters.lost_m, row, sight, positions)
        yield_limits(model, row, dt, excess)
    if not _is_finite(layout, row, posterior):
        row[at.STARTED] = math.nan  # as a new body: rays that contradict each other numerically have spoilt this one
        _unknown(positions, covariances)
        return False
    if known:
        learn_offsets(model, row, R, sight, positions)
    age_joints(layout, row, dt, sight, positions)
    for j in range(n):
        _write_covariance(C, j, positions, covariances)
        for k in range(3):
            covariances[j, k, k] += sight.offsets[j, 3]
        add_age(sight, j, positions, row[layout.ages + 4 * j], covariances)
        support[j] = supporting(sight, j, positions, covariances)
        for k in range(3):
            positions[j, k] += origin[k] + sight.offsets[j, k]
    return True


@njit(cache=True, error_model="numpy")
def _is_finite(layout: MemoryLayout, row: Float64, posterior: Float64) -> bool:
    """Return whether a memory row's pose, velocities and variances, and a fit's (dofs,), are numbers."""
    total = 0.0
    for i in range(layout.angles, layout.slack):
        total += row[i]
    for i in range(layout.dofs):
        total += posterior[i]
    return math.isfinite(total)


@njit(cache=True, error_model="numpy")
def _learn(
    model: BodyArrays, row: Float64, dt: float, known: bool, surprise: float, sized: bool, R: Float64,
    work: Elimination, total: Float64, posterior: Float64, body: Float64,
) -> None:  # fmt: skip
    """Update velocities, variances and surprise after a fit, and bone lengths if the rays show them (``sized``)."""
    layout = model.layout
    if not known:
        for i in range(layout.dofs):
            row[layout.variance + i] = posterior[i]
        return
    learn_motion(layout, row, total, posterior, body)
    if sized:
        learn_lengths(model, row, dt, R, work.M, work.a)


@njit(cache=True, error_model="numpy")
def _advance_by_few(model: BodyArrays, row: Float64, at_s: float, one: bool) -> None:
    """Predict a memory row to a later instant, as `advance`; before rays of ``one`` camera, free its distance.

    One camera sees the distance of a body by its size in the image, and hardly sees the bones' angles towards it. Both
    explain a smaller image: so the angles are held firmer, and the root is held less.
    """
    restless, dt = row[at.RESTLESS], max(0.0, at_s - row[at.AT])
    if one:
        row[at.RESTLESS] = ONE_RESTLESS * min(restless, model.dof_values[0, 5])
    advance(model, row, at_s)
    row[at.RESTLESS] = restless
    if one:
        for i in range(3):
            row[model.layout.variance + i] += ONE_DIFFUSION * dt


@njit(cache=True, error_model="numpy")
def _begin(
    model: BodyArrays, row: Float64, at_s: float, sight: Sight, joints: Int64, origins: Float64, directions: Float64,
    sds_rad: Float64, after_s: Float64,
) -> bool:  # fmt: skip
    """Initialise a memory row from the joints that rays triangulate; return whether they suffice."""
    n, nowhere, nothing = model.layout.joints, np.zeros(3), np.zeros((model.layout.joints, 3))
    for j in range(n):
        sight.offsets[j, 3] = model.joint_values[j, 11]
    aim(sight, joints, origins, directions, sds_rad, after_s, nowhere, nothing)
    measured, variances = np.empty((n, 3)), np.empty(n)
    for j in range(n):
        point, first, last = sight.points[j], sight.first[j], sight.first[j + 1]
        variances[j] = math.nan
        for k in range(3):
            measured[j, k] = math.nan
        if agree(sight.rays, sight.order, first, last, math.inf, nowhere, sight.weights, point) < 2:
            continue
        variance = (point[3] + point[6] + point[8]) / 3.0
        if variance < START_SD * START_SD:
            variances[j] = variance
            for k in range(3):
                measured[j, k] = point[k]
    _complete(model.joint_table, measured, variances)
    if not initialise(model, row, at_s, measured, variances):
        return False
    bend_limbs(model, row, measured, variances)
    for j in range(n):
        o = model.layout.jumps + 4 * j
        row[o] = row[o + 1] = row[o + 2] = 0.0
        row[o + 3] = model.joint_values[j, 11]
        row[model.layout.ages + 4 * (n + j)] = math.nan
    return True


@njit(cache=True, error_model="numpy")
def _complete(joint_table: Int64, measured: Float64, variances: Float64) -> None:
    """Put unmeasured joints halfway between two mirrored ones that hang at them, such as neck and hip."""
    for a in range(len(variances)):
        for b in range(a + 1, len(variances)):
            j = joint_table[a, 0]
            paired = j >= 0 and joint_table[b, 0] == j and joint_table[a, 4] == joint_table[b, 4]
            if paired and math.isnan(variances[j]) and math.isfinite(variances[a] + variances[b]):
                variances[j] = 0.25 * (variances[a] + variances[b]) + VIRTUAL_SD * VIRTUAL_SD
                for k in range(3):
                    measured[j, k] = 0.5 * (measured[a, k] + measured[b, k])


@njit(cache=True, error_model="numpy")
def _speeds(joint_table: Int64, order: Int64, layout: MemoryLayout, row: Float64, xi: Float64, x: Float64) -> Float64:
    """Return the joints' speeds (joints, 3) by the velocities in a memory row, with the world's axes [m/s]."""
    V, speeds = np.empty((len(order), 6)), np.empty((len(order), 3))
    v = layout.velocities
    for o in range(len(order)):
        j = order[o]
        parent, begin = joint_table[j, 0], joint_table[j, 1]
        for k in range(6):
            V[j, k] = V[parent, k] if parent >= 0 else (row[v + k - 3] if k >= 3 else 0.0)
        if parent < 0:
            begin = 3
        for i in range(begin, joint_table[j, 1] + joint_table[j, 2]):
            for k in range(6):
                V[j, k] += xi[i, k] * row[v + i]
        speeds[j, 0] = V[j, 3] + V[j, 1] * x[j, 2] - V[j, 2] * x[j, 1]
        speeds[j, 1] = V[j, 4] + V[j, 2] * x[j, 0] - V[j, 0] * x[j, 2]
        speeds[j, 2] = V[j, 5] + V[j, 0] * x[j, 1] - V[j, 1] * x[j, 0]
    return speeds


@njit(cache=True, error_model="numpy")
def _write_prior(
    model: BodyArrays, row: Float64, total: Float64, rest: Float64, pull: float, D: Float64, e: Float64
) -> None:
    """Write prior information D and mean e (dofs,) of a step: the prediction's, and the pull towards the rest pose."""
    layout = model.layout
    for i in range(layout.dofs):
        D[i] = 1.0 / row[layout.variance + i]
        e[i] = -total[i]
        if i >= ROOT_DOFS and pull > 0.0:
            stiff = pull * model.dof_values[i, 6]
            e[i] = (D[i] * e[i] + stiff * rest[i]) / (D[i] + stiff)
            D[i] += stiff


@njit(cache=True, error_model="numpy")
def _shorten(delta: Float64, most: float) -> float:
    """Scale a step (dofs,) so that no change exceeds ``most``; return the largest change before [m, rad]."""
    largest = 0.0
    for i in range(len(delta)):
        largest = max(largest, abs(delta[i]))
    if largest > most:
        for i in range(len(delta)):
            delta[i] *= most / largest
    return largest


@njit(cache=True, error_model="numpy")
def _fit(
    model: BodyArrays, row: Float64, sight: Sight, known: bool, dt: float, joints: Int64, origins: Float64,
    directions: Float64, sds_rad: Float64, after_s: Float64, origin: Float64, positions: Float64, R: Float64,
    total: Float64, posterior: Float64, excess: Float64, C: Float64, work: Elimination,
) -> tuple[float, int]:  # fmt: skip
    """Fit the pose to the rays by Gauss–Newton steps about the prediction.

    Args:
        model, row, joints, origins, directions, sds_rad, after_s: as in `correct_by_rays`; the row's pose is changed.
        sight: the rays; all but their order is written.
        known: whether the row was predicted, rather than initialised from this frame.
        dt: time since the last update [s].
        origin: (3,) written: the fitted root, world [m].
        positions, R: (joints, 3), (joints, 9) written: the fitted pose about that origin.
        total: (dofs,) sum of all steps from a prediction; 0 at the beginning.
        posterior: (dofs,) variances, written.
        excess: (joints,) angle that the limits held each joint back [rad]; 0 at the beginning.
        C: (joints, 21) written: covariances of the bones' small motions, of `marginals`.
        work: written: the last `solve`.

    Returns:
        The sum of the joints' surprises, and the number of joints that rays see.
    """
    layout, joint_table, order = model.layout, model.joint_table, model.order
    n, count = layout.dofs, layout.joints
    xi, D, e, delta = np.empty((n, 6)), np.empty(n), np.empty(n), np.empty(n)
    variances, aged = np.empty(count), np.empty(count)
    pull, shift = 1.0 / model.parameters.rest_sd**2 * dt, np.empty(3)
    steps = STEPS if known else FIRST_STEPS
    place(model, row, origin, positions, R, xi)
    independent(joint_table, order, xi, row, layout.variance, positions, C, variances)
    for j in range(count):
        aged[j] = variances[j]
        age = row[layout.ages + 4 * j]
        aged[j] += min(AGING * (age + dt), MOST_AGED) if age > 0.0 else 0.0
    speeds = _speeds(joint_table, order, layout, row, xi, positions)
    turn_offsets(model, row, dt, R, sight.offsets)
    aim(sight, joints, origins, directions, sds_rad, after_s, origin, speeds)
    if known:
        exchange_limbs(model, sight, joints, origins, positions, aged)
    surprise, seen = weigh(model, sight, known, positions, variances, aged)
    if known and seen > 0:
        follow_restlessness(model, row, sight, positions, variances, surprise / seen)
    for step in range(steps):
        if not known and (step == REWEIGHED[0] or step == REWEIGHED[1]):
            reweigh(sight, positions)
        inform(sight, positions)
        away_from_rest(layout, model.dof_values, joint_table, row, posterior)
        _write_prior(model, row, total, posterior, pull, D, e)
        solve(joint_table, order, xi, D, e, positions, sight.forces, sight.information, work, delta)
        marginals(joint_table, order, xi, work.U, work.d, positions, C, posterior, variances)
        if seen == 0:
            break
        pinned = pin(model, row, delta, posterior, D, e, excess)
        if pinned:
            solve(joint_table, order, xi, D, e, positions, sight.forces, sight.information, work, delta)
        largest = _shorten(delta, MOST_STEP if known else math.inf)
        apply_motion(model, row, delta, pinned)
        for i in range(n):
            total[i] += delta[i] if known else 0.0
        done = step + 1 == steps or (known and largest < LARGE_STEP)
        for k in range(3):
            shift[k] = -origin[k]
        place(model, row, origin, positions, R, xi[:0] if done else xi)
        for k in range(3):
            shift[k] += origin[k]
        shift_origin(sight, shift)
        if done:
            break
    return surprise, seen
