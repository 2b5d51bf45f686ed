"""Kernels of what a body that is seen along rays learns between frames: lengths, offsets, ages, and whether it is lost.

Importing this module imports numba.
"""

# ruff: noqa: PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.kinematics import articulated_memory as at
from mocapella.kinematics.articulated_memory import MemoryLayout
from mocapella.kinematics.articulated_model import BodyArrays
from mocapella.kinematics.articulated_pose_kernels import CALMING
from mocapella.kinematics.articulated_yield_kernels import yield_length
from mocapella.kinematics.ray_point_kernels import GATE, NU, SLACK_M, invert, student
from mocapella.kinematics.ray_sight_kernels import UNSURE_SPEED, Sight, gather

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]


LEAST_LENGTH_SD = 0.06
"""Largest standard deviation of a bone's length in one frame that is learnt from [m]."""
LENGTH_PRIOR_S = 0.1
"""Weight of the template's proportions in a bone's length, as a duration of measurement [s]."""
LENGTH_SD = 0.03
"""Standard deviation of a measured length that counts in full for learning [m]."""
LONG_BONE = 0.14
"""Least length of a bone that tells the size of the body, as a fraction of stature."""
LEAST_LONG = 3
"""Least number of such bones."""
WRONG_SIZE = 0.1
"""Logarithm of the ratio of measured and modelled lengths beyond which the size of the body is wrong."""
RESIZING_S = 0.2
"""Time constant of the correction of a wrong size by exact joints [s]."""
NOISY_SHARE = 0.01
"""Variance of a measured length, relative to the squared length, that doubles this time constant."""
OFFSET_S = 1.0
"""Time constant of the offset of a keypoint from its joint of the chain [s]."""
MEAN_DISTANCE = 1.6
"""Mean distance of a point with normal noise from its mean, over the standard deviation of a coordinate: 2 √(2/π)."""
MOST_LOST = 5.0
"""Largest distance of one joint that counts for a lost body, over `ArticulatedSettings.lost_m`."""
WHITENING = 0.3
"""Change of the logarithm of the restlessness in a frame, over the correlation of successive innovations."""
WAKING = 1.0
"""Change of the logarithm of the restlessness in a frame, over the surprise above 1."""
AGREES = 0.5
"""Least robust weight of a ray that agrees with the estimate."""
AGING = 0.04
"""Growth of a joint's variance along the ray of its only camera, and along each axis if no camera sees it [m²/s]."""
MOST_AGED = 0.16
"""Largest such variance [m²]."""
LEAST_CROSSING = 0.25
"""Least squared sine of the angle between two rays of different instants that triangulate a joint together."""


@njit(cache=True, error_model="numpy")
def turn_offsets(model: BodyArrays, row: Float64, dt: float, R: Float64, offsets: Float64) -> None:
    """Predict the offsets in a memory row by dt [s] and write them, turned to the world's axes, and their variances.

    Each coordinate is an Ornstein–Uhlenbeck process about 0 in the frame of its bone, with the variance of
    `Bone.misfit_m`. Offsets change with the pose: their time constant `OFFSET_S` is longer for a body that moves less.
    """
    pace = row[at.RESTLESS] * row[at.RESTLESS]
    fade = math.exp(-max(dt, 0.0) * pace / OFFSET_S)
    for j in range(len(offsets)):
        o, whole = model.layout.jumps + 4 * j, model.joint_values[j, 11]
        for k in range(3):
            offsets[j, k] = fade * (R[j, 3 * k] * row[o] + R[j, 3 * k + 1] * row[o + 1] + R[j, 3 * k + 2] * row[o + 2])
        offsets[j, 3] = whole + fade * fade * (row[o + 3] - whole)


@njit(cache=True, error_model="numpy")
def learn_offsets(model: BodyArrays, row: Float64, R: Float64, sight: Sight, positions: Float64) -> None:
    """Correct the offsets of the keypoints by what the fit leaves of the rays, and store them in the memory row.

    About the fitted joint, rays of information Λ and force f move an offset of variance p by (I + p Λ)⁻¹ p f. The
    offsets in ``sight`` are changed, too, and the rays and points are moved by these corrections.
    """
    layout, offsets = model.layout, sight.offsets
    inverse, A, step = np.empty(6), np.empty(9), np.empty(3)
    for j in range(layout.joints):
        gather(sight, j, positions, A)
        p = offsets[j, 3]
        invert(1.0 + p * A[0], p * A[1], p * A[2], 1.0 + p * A[3], p * A[4], 1.0 + p * A[5], inverse, 0)
        step[0] = p * (inverse[0] * A[6] + inverse[1] * A[7] + inverse[2] * A[8])
        step[1] = p * (inverse[1] * A[6] + inverse[3] * A[7] + inverse[4] * A[8])
        step[2] = p * (inverse[2] * A[6] + inverse[4] * A[7] + inverse[5] * A[8])
        chi2 = step[0] * step[0] + step[1] * step[1] + step[2] * step[2]
        trust = student(chi2 / p, 3.0, NU) if p > 0.0 else 0.0
        offsets[j, 3] = p * (inverse[0] + inverse[3] + inverse[5]) / 3.0
        for k in range(3):
            step[k] *= trust
            offsets[j, k] += step[k]
            if sight.agreeing[j] >= 2:
                sight.points[j, k] -= step[k]
        for i in range(sight.first[j], sight.first[j + 1]):
            for k in range(3):
                sight.rays[sight.order[i], k] -= step[k]
        o = layout.jumps + 4 * j
        for k in range(3):
            row[o + k] = R[j, k] * offsets[j, 0] + R[j, 3 + k] * offsets[j, 1] + R[j, 6 + k] * offsets[j, 2]
        row[o + 3] = offsets[j, 3]


@njit(cache=True, error_model="numpy")
def learn_lengths(model: BodyArrays, row: Float64, dt: float, R: Float64, M: Float64, a: Float64) -> None:
    """Move bone lengths along the forces that the rays leave on them, by bounded steps.

    A longer bone moves its whole subtree along the bone b. The subtree's articulated inertia M (joints, 27), whose own
    joints are free to follow, and the bone's small motion a (joints, 6) of `chain_kernels.solve` give the information
    bᵀ M b about the length, and the correction bᵀ (q − M a) / bᵀ M b with the bias force q. So a length is also learnt
    where the joint at its beginning is not measured, such as the neck. Lengths without any measurement follow the
    stature.
    """
    layout, joint_table, joint_values = model.layout, model.joint_table, model.joint_values
    information, forces = np.zeros(layout.lengths), np.zeros(layout.lengths)
    r = np.empty(3)
    for j in range(layout.joints):
        if joint_table[j, 0] < 0:
            continue
        for k in range(3):
            r[k] = R[j, 3 * k] * joint_values[j, 0] + R[j, 3 * k + 1] * joint_values[j, 1]
            r[k] += R[j, 3 * k + 2] * joint_values[j, 2]
        left = M[j, 24] - (M[j, 3] * a[j, 0] + M[j, 8] * a[j, 1] + M[j, 12] * a[j, 2])
        left -= M[j, 15] * a[j, 3] + M[j, 16] * a[j, 4] + M[j, 17] * a[j, 5]
        up = M[j, 25] - (M[j, 4] * a[j, 0] + M[j, 9] * a[j, 1] + M[j, 13] * a[j, 2])
        up -= M[j, 16] * a[j, 3] + M[j, 18] * a[j, 4] + M[j, 19] * a[j, 5]
        ahead = M[j, 26] - (M[j, 5] * a[j, 0] + M[j, 10] * a[j, 1] + M[j, 14] * a[j, 2])
        ahead -= M[j, 17] * a[j, 3] + M[j, 19] * a[j, 4] + M[j, 20] * a[j, 5]
        square = r[0] * r[0] * M[j, 15] + r[1] * r[1] * M[j, 18] + r[2] * r[2] * M[j, 20]
        square += 2.0 * (r[0] * r[1] * M[j, 16] + r[0] * r[2] * M[j, 17] + r[1] * r[2] * M[j, 19])
        information[joint_table[j, 4]] += square
        forces[joint_table[j, 4]] += r[0] * left + r[1] * up + r[2] * ahead
    for length in range(layout.lengths):
        if not information[length] > 1.0 / (LEAST_LENGTH_SD * LEAST_LENGTH_SD):
            continue
        i, learnt, sd = layout.bones + length, layout.learnt + length, 1.0 / math.sqrt(information[length])
        counts = dt * min(1.0, LENGTH_SD * LENGTH_SD / (sd * sd))
        row[learnt] = min(row[learnt] + counts, model.parameters.length_memory_s)
        deviation = min(max(forces[length] / information[length], -2.0 * sd), 2.0 * sd)
        yield_length(row, layout.strains + length, learnt, deviation / sd, dt)
        row[i] = max(row[i] + counts / (row[learnt] + LENGTH_PRIOR_S) * deviation, 1e-3)
    _keep_proportions(layout, joint_table, joint_values, row)


@njit(cache=True, error_model="numpy")
def resize(model: BodyArrays, row: Float64, dt: float, sight: Sight) -> None:
    """Scale all bone lengths together if the triangulated joints show a body of another size.

    A body that began from wrong rays has a wrong size. Its joints then bend until they fit the rays, and leave hardly
    any force on the bones, so `learn_lengths` corrects the size slowly. The median over the long bones, whose two ends
    are triangulated, of the logarithm of measured over modelled length is not affected by the pose.

    Args:
        model: the body model.
        row: (memory_size,) the body's memory; the lengths are changed.
        dt: time since the last update [s].
        sight: the frame's rays.
    """
    layout, joint_table, points = model.layout, model.joint_table, sight.points
    ratios, noises, count = np.empty(layout.joints), np.empty(layout.joints), 0
    for j in range(layout.joints):
        parent = joint_table[j, 0]
        if parent < 0 or joint_table[j, 4] < 0 or model.joint_values[j, 3] < LONG_BONE:
            continue
        if sight.agreeing[j] < 2 or sight.agreeing[parent] < 2:
            continue
        square, length = 0.0, row[layout.bones + joint_table[j, 4]]
        for k in range(3):
            square += (points[j, k] - points[parent, k]) ** 2
        noise = points[j, 3] + points[j, 6] + points[j, 8] + points[parent, 3] + points[parent, 6] + points[parent, 8]
        square = max(square - noise, 0.01 * length * length)  # noise makes measured bones longer
        ratios[count] = 0.5 * math.log(square / (length * length))
        noises[count] = noise / (3.0 * length * length)
        count += 1
    if count < LEAST_LONG:
        return
    values, spreads = np.sort(ratios[:count]), np.sort(noises[:count])
    ratio = 0.5 * (values[(count - 1) // 2] + values[count // 2])
    if abs(ratio) > WRONG_SIZE:
        slow = RESIZING_S * (1.0 + spreads[count // 2] / NOISY_SHARE)
        scale = math.exp(ratio * (1.0 - math.exp(-dt / slow)))
        for i in range(layout.lengths):
            row[layout.bones + i] *= scale


@njit(cache=True, error_model="numpy")
def _keep_proportions(layout: MemoryLayout, joint_table: Int64, joint_values: Float64, row: Float64) -> None:
    """Scale the lengths that are hardly learnt to the stature of the learnt ones."""
    total = stature = 0.0
    for j in range(layout.joints):
        if joint_table[j, 4] >= 0:
            learnt, share = row[layout.learnt + joint_table[j, 4]], joint_values[j, 3]
            w = learnt / (learnt + 1.0) * share
            total += w
            stature += w * row[layout.bones + joint_table[j, 4]] / share
    if not total > 0.0:
        return
    stature /= total
    for j in range(layout.joints):
        if joint_table[j, 4] >= 0 and row[layout.learnt + joint_table[j, 4]] == 0.0:
            row[layout.bones + joint_table[j, 4]] = stature * joint_values[j, 3]


@njit(cache=True, error_model="numpy")
def follow_restlessness(
    model: BodyArrays, row: Float64, sight: Sight, positions: Float64, variances: Float64, surprise: float
) -> None:
    """Raise or lower the body's restlessness, which sets its densities of acceleration, by how its innovations follow.

    Innovations of a filter with the right densities are white (R. K. Mehra, On the Identification of Variances and
    Adaptive Kalman Filtering, IEEE Transactions on Automatic Control 15, 1970): successive ones that point to the same
    side say that it lags, to opposite sides that it follows noise. Innovations larger than expected raise it, too.

    Args:
        model: the body model.
        row: (memory_size,) the body's memory; the restlessness and the joints' last innovations are changed.
        sight: the frame's rays.
        positions: (joints, 3) the predicted joints about the root [m].
        variances: (joints,) variances of their coordinates [m²].
        surprise: mean squared innovation over the expected one.
    """
    layout, points = model.layout, sight.points
    product, squares = 0.0, 0.0
    for j in range(layout.joints):
        o = layout.ages + 4 * j + 1
        expected = variances[j] + (points[j, 3] + points[j, 6] + points[j, 8]) / 3.0 + sight.offsets[j, 3]
        scale, square = 1.0 / math.sqrt(expected) if sight.agreeing[j] >= 2 else 0.0, 0.0
        for k in range(3):
            square += (scale * (points[j, k] - positions[j, k])) ** 2 if scale > 0.0 else 0.0
        scale *= math.sqrt(student(square, 3.0, NU))
        last, both, now = 0.0, 0.0, 0.0
        for k in range(3):
            r = scale * (points[j, k] - positions[j, k]) if scale > 0.0 else 0.0
            both += r * row[o + k]
            last += row[o + k] ** 2
            now += r * r
            row[o + k] = r
        if last > 0.0 and now > 0.0:
            product += both
            squares += 0.5 * (last + now)
    change = WHITENING * product / squares if squares > 0.0 else 0.0
    change += WAKING * max(surprise - 1.0, 0.0)
    least = model.parameters.calm ** (1.0 / CALMING)
    row[at.RESTLESS] = min(max(row[at.RESTLESS] * math.exp(change), least), 1.0)


@njit(cache=True, error_model="numpy")
def judge(lost_m: float, row: Float64, sight: Sight, positions: Float64) -> None:
    """Update since when the body is lost: triangulated joints farther from it than ``lost_m`` on average."""
    far, seen, points = 0.0, 0, sight.points
    for j in range(len(positions)):
        if sight.agreeing[j] >= 2:
            s = 0.0
            for k in range(3):
                s += (points[j, k] - positions[j, k]) ** 2
            far += min(math.sqrt(s), MOST_LOST * lost_m) - MEAN_DISTANCE * math.sqrt(
                (points[j, 3] + points[j, 6] + points[j, 8]) / 3.0
            )
            seen += 1
    if seen == 0:
        return
    if far <= lost_m * seen:
        row[at.LOST_SINCE] = math.nan
    elif not row[at.LOST_SINCE] <= row[at.AT]:
        row[at.LOST_SINCE] = row[at.AT]


@njit(cache=True, error_model="numpy")
def aged_variance(age: float) -> float:
    """Return by how much a joint's variance grows in the time since it was triangulated [m²]; 0 for an unknown time.

    For a short time it is the error of the predicted speed that counts, as of rays of another instant.
    """
    if not age > 0.0:
        return 0.0
    return min((UNSURE_SPEED * age) ** 2, AGING * age, MOST_AGED)


@njit(cache=True, error_model="numpy")
def age_joints(layout: MemoryLayout, row: Float64, dt: float, sight: Sight, positions: Float64) -> None:
    """Update in a memory row for how long each joint has not been triangulated.

    Rays that agree with each other triangulate a joint only if the fitted joint, of positions (joints, 3) about the
    root, is near their point. Two rays of different instants triangulate a joint, too, if they cross
    (`LEAST_CROSSING`): cameras that see a body in turn. The joint is then as old as the earlier ray.
    """
    for j in range(layout.joints):
        age, view = layout.ages + 4 * j, layout.ages + 4 * (layout.joints + j)
        row[age] += dt
        row[view] += dt
        if sight.agreeing[j] >= 2:
            apart, variance = 0.0, (sight.points[j, 3] + sight.points[j, 6] + sight.points[j, 8]) / 3.0
            for m in range(3):
                apart += (sight.points[j, m] - positions[j, m]) ** 2
            if apart < GATE * (variance + SLACK_M * SLACK_M):
                row[age] = 0.0
            row[view] = math.nan
            continue
        for i in range(sight.first[j], sight.first[j + 1]):
            k, cosine = sight.order[i], 0.0
            if not sight.weights[k] > AGREES:
                continue
            for m in range(3):
                cosine += sight.rays[k, 3 + m] * row[view + 1 + m]
            if row[view] >= 0.0 and 1.0 - cosine * cosine >= LEAST_CROSSING:
                row[age] = min(row[age], row[view])
            row[view] = 0.0
            for m in range(3):
                row[view + 1 + m] = sight.rays[k, 3 + m]
            break


@njit(cache=True, error_model="numpy")
def add_age(sight: Sight, j: int, positions: Float64, age: float, covariances: Float64) -> None:
    """Add to a joint's covariance the variance that it has gained since it was last triangulated.

    The covariances of the filter do not know it: correlations of the degrees of freedom are lost between frames, so the
    same ray seems to tell something new each time. Across a ray that agrees, the joint stays as sure.
    """
    extra = aged_variance(age)
    if not extra > 0.0:
        return
    for i in range(3):
        covariances[j, i, i] += extra
    for i in range(sight.first[j], sight.first[j + 1]):
        k = sight.order[i]
        if not sight.weights[k] > AGREES:
            continue
        # One ray alone: take the growth across it back.
        for a in range(3):
            covariances[j, a, a] -= extra
            for b in range(3):
                covariances[j, a, b] += extra * sight.rays[k, 3 + a] * sight.rays[k, 3 + b]
        break
