"""Compiled steps of `mocapella.tracker.people`, in place; importing this module imports numba.

The arrays are those of `mocapella.tracker.people_memory`; body ``b`` of a frame belongs to the person in row
``rows[b]``.
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position
from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocapella.association.track_kernels import measure
from mocapella.compiled import njit
from mocapella.fusion.facing_kernels import reported_yaw, view_worth, wrap
from mocapella.fusion.view_kernels import follow_offsets, fuse, joint_variances, sd_at
from mocapella.fusion.weighted_mean import FusionParameters
from mocapella.kinematics import articulated_kernels
from mocapella.kinematics.articulated_kernels import move
from mocapella.model.observations import JointState
from mocapella.smoothing.kalman_kernels import correct, predict
from mocapella.smoothing.one_euro_kernels import smooth
from mocapella.tracker.people_memory import (
    FacingResults,
    FrameViews,
    JointLayout,
    PeopleParameters,
    PointArrays,
    SkeletonArrays,
    ViewArrays,
)

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]
Bools = NDArray[np.bool_]
Int64 = NDArray[np.int64]

_LONGEST_STEP_S = 0.2
_NOT_TRACKED, _INFERRED = int(JointState.NOT_TRACKED), int(JointState.INFERRED)


__all__ = [
    "begin_offsets", "bring", "make", "move", "move_views", "observe", "pose_people", "prepare", "report",
    "smooth_people", "turn", "turn_views",
]  # fmt: skip


@njit(cache=True)
def move_points(T: Float64, points: Float64, out: Float64) -> None:
    """Transform points (n, 3) by T (4, 4) into ``out``."""
    for j in range(len(points)):
        x, y, z = points[j, 0], points[j, 1], points[j, 2]
        for k in range(3):
            out[j, k] = T[k, 0] * x + T[k, 1] * y + T[k, 2] * z + T[k, 3]


@njit(cache=True)
def prepare(
    T: Float64, bodies: Float64, ends: Int64, middle: Int64, now_s: float, forget_after_s: float, points: PointArrays,
    world: Float64, middles: Float64, lengths: Float64, expected: Float64,
) -> None:  # fmt: skip
    """Compute the inputs of association for a frame's bodies into the last four arrays, see `Prepared`."""
    for b in range(len(bodies)):
        move_points(T, bodies[b], world[b])
        for m in range(len(middle)):
            for k in range(3):
                middles[b, m, k] = world[b, middle[m], k]
    if len(ends):
        measure(bodies, ends, lengths)
    expect(middle, now_s, points, forget_after_s, expected)


@njit(cache=True)
def observe(
    frame: FrameViews,
    now_s: float,
    parameters: PeopleParameters,
    fusion: FusionParameters,
    layout: JointLayout,
    R_level: Float64,
    points: PointArrays,
    views: ViewArrays,
) -> tuple[Float64, Float64, Float64, Float64]:
    """Predict all people to ``now_s`` and store a frame's bodies as the newest views.

    Returns:
        The results of `to_level`, and the time since each person's previous view (bodies,), at most a second [s].
    """
    bring(now_s, points, parameters)
    rows = frame.rows
    dts = np.empty(len(rows))
    for b in range(len(rows)):
        dts[b] = min(frame.at_s - views.at_s[rows[b], frame.column], 1.0)
    see(frame, fusion, parameters, points.velocities, views)
    follow_labels(rows, frame.column, dts, parameters, layout.mirror, views)
    level, toward, speeds = to_level(
        R_level, frame.positions, frame.sensor_position, layout.root, rows, points.velocities
    )
    return level, toward, speeds, dts


@njit(cache=True)
def expect(middle: Int64, now_s: float, points: PointArrays, forget_after_s: float, out: Float64) -> None:
    """Predict the middle joints of people at ``now_s`` into ``out`` (people, middle, 3); NaN where not known."""
    at_s, positions, velocities, seen_s = points.at_s, points.positions, points.velocities, points.seen_s
    for r in range(len(at_s)):
        dt = max(0.0, now_s - at_s[r])
        for m in range(len(middle)):
            j = middle[m]
            if now_s - seen_s[r, j] > forget_after_s:
                out[r, m, 0] = out[r, m, 1] = out[r, m, 2] = np.nan
            else:
                for k in range(3):
                    out[r, m, k] = positions[r, j, k] + dt * velocities[r, j, k]


@njit(cache=True)
def bring(now_s: float, points: PointArrays, parameters: PeopleParameters) -> None:
    """Predict all people to ``now_s``; never backwards in time.

    The velocity of a joint that no view has decays: the last frames of a person who is being occluded often move the
    joints too fast.
    """
    at_s, positions, velocities = points.at_s, points.positions, points.velocities
    variances, seen_s = points.variances, points.seen_s
    for r in range(len(at_s)):
        dt = now_s - at_s[r]
        if dt > 0.0:
            predict(
                positions[r], velocities[r], variances[r], seen_s[r], dt, now_s, parameters.acceleration_density,
                parameters.forget_after_s,
            )  # fmt: skip
            at_s[r] = now_s
            fading = np.exp(-dt / parameters.speed_memory_s)
            for j in range(len(seen_s[r])):
                if now_s - seen_s[r, j] > parameters.view_age_s:
                    for k in range(3):
                        velocities[r, j, k] *= fading


@njit(cache=True)
def distance_of(joints: Float64) -> float:
    """Return the distance from the origin to the mean of the visible joints (joints, 3) [m]."""
    x, y, z, count = 0.0, 0.0, 0.0, 0
    for j in range(len(joints)):
        if np.isfinite(joints[j, 0]):
            x, y, z = x + joints[j, 0], y + joints[j, 1], z + joints[j, 2]
            count += 1
    distance: float = np.sqrt(x * x + y * y + z * z) / max(count, 1)
    return distance


@njit(cache=True)
def learn_noise(
    before: Float64, dt: float, seen: Float64, states: UInt8, velocities: Float64, memory_s: float, noise: Float64
) -> None:
    """Learn the variance of each joint's jumps in a view, beyond its motion, into ``noise`` (joints,).

    The residual of x(t) = x(t − dt) + v dt + n(t) − n(t − dt) has twice the variance of the noise n.
    """
    part = -np.expm1(-dt / memory_s)
    for j in range(len(noise)):
        if states[j] == _NOT_TRACKED or not np.isfinite(velocities[j, 0]):
            continue
        square = 0.0
        for k in range(3):
            square += (seen[j, k] - before[j, k] - dt * velocities[j, k]) ** 2
        if np.isfinite(square):
            noise[j] += part * (square / 6.0 - noise[j])


@njit(cache=True)
def see(
    frame: FrameViews, fusion: FusionParameters, parameters: PeopleParameters, velocities: Float64, views: ViewArrays
) -> None:
    """Store a frame's bodies as the newest views of people."""
    seen, seen_states, column = frame.positions, frame.states, frame.column
    positions, states, variances, noise = views.positions, views.states, views.variances, views.noise
    for b in range(len(frame.rows)):
        r = frame.rows[b]
        dt = frame.at_s - views.at_s[r, column]
        if 0.0 < dt < _LONGEST_STEP_S:
            learn_noise(
                positions[r, column], dt, seen[b], seen_states[b], velocities[r], parameters.noise_memory_s,
                noise[r, column],
            )  # fmt: skip
        views.at_s[r, column] = frame.at_s
        for j in range(seen.shape[1]):
            states[r, column, j] = seen_states[b, j]
            for k in range(3):
                positions[r, column, j, k] = seen[b, j, k]
                views.bias[r, column, j, k] = frame.bias[b, j, k]
        sd = sd_at(fusion.sd_m, distance_of(frame.own_positions[b]), frame.clipped[b], fusion.clipped_factor)
        joint_variances(seen_states[b], sd, fusion.inferred_factor, 0.0, variances[r, column])
        for j in range(noise.shape[2]):
            variances[r, column, j] += parameters.noise_gain * noise[r, column, j]


@njit(cache=True)
def advantage(view: Float64, other: Float64, mirror: Int64, crossed: bool) -> float:
    """Return how much nearer a view is to another one with left and right swapped [m].

    ``crossed`` swaps the other view's labels first. NaN where fewer than two joints can be compared.
    """
    total, count = 0.0, 0
    for j in range(len(mirror)):
        m = mirror[j]
        k = m if crossed else j
        if m == j or not np.isfinite(other[k, 0]):
            continue
        straight, swapped = 0.0, 0.0
        for i in range(3):
            straight += (view[j, i] - other[k, i]) ** 2
            swapped += (view[m, i] - other[k, i]) ** 2
        if np.isfinite(straight) and np.isfinite(swapped):
            total += np.sqrt(straight) - np.sqrt(swapped)
            count += 1
    return total / count if count >= 2 else np.nan


@njit(cache=True)
def follow_labels(
    rows: Int64, column: int, dts: Float64, parameters: PeopleParameters, mirror: Int64, views: ViewArrays
) -> None:
    """Decide whether to swap left and right of the new views so that they agree with the other sensors' views."""
    at_s, swapped, advantages = views.at_s, views.swapped, views.advantage
    for b in range(len(rows)):
        r = rows[b]
        total, count = 0.0, 0
        for c in range(at_s.shape[1]):
            if c == column or at_s[r, column] - at_s[r, c] > parameters.view_age_s:
                continue
            more = advantage(views.positions[r, column], views.positions[r, c], mirror, swapped[r, c])
            if np.isfinite(more):
                total += more
                count += 1
        if count == 0:
            continue
        now = -total / count if swapped[r, column] else total / count
        advantages[r, column] -= np.expm1(-dts[b] / parameters.swap_s) * (now - advantages[r, column])
        if advantages[r, column] > parameters.swap_m:
            swapped[r, column] = not swapped[r, column]
            advantages[r, column] = -advantages[r, column]


@njit(cache=True)
def to_level(
    R: Float64, positions: Float64, sensor_position: Float64, root: int, rows: Int64, velocities: Float64
) -> tuple[Float64, Float64, Float64]:
    """Return, in a space with y up, bodies, the yaw from each to the sensor [rad], and their persons' velocities."""
    bodies, joints = positions.shape[:2]
    level, toward, speeds = np.empty((bodies, joints, 3)), np.empty(bodies), np.empty((bodies, 3))
    for b in range(bodies):
        for j in range(joints):
            for k in range(3):
                level[b, j, k] = (
                    R[k, 0] * positions[b, j, 0] + R[k, 1] * positions[b, j, 1] + R[k, 2] * positions[b, j, 2]
                )
        sight = np.empty(3)
        for k in range(3):
            sight[k] = -level[b, root, k]
            speeds[b, k] = 0.0
            for i in range(3):
                sight[k] += R[k, i] * sensor_position[i]
                speeds[b, k] += R[k, i] * velocities[rows[b], root, i]
        toward[b] = np.arctan2(sight[0], sight[2])
    return level, toward, speeds


@njit(cache=True)
def turn_views(
    rows: Int64, column: int, dts: Float64, parameters: PeopleParameters, lines: Int64, facing: FacingResults,
    yaw: Float64, views: ViewArrays,
) -> None:  # fmt: skip
    """Store the facing with a frame's views, and turn their shoulders and hips towards it.

    Each of the ``lines`` (lines, 2) of a left and a right joint is turned by its own error, because a sensor's errors
    at shoulders and hips differ. An uncertain facing, above ``sure_sd`` [rad], changes no labels, and turns lines less
    the more uncertain it is. If the labels change while the person stands, slower than ``still_m_s``, the old labels
    were wrong: the view restarts at the person's position and glides to its own.
    """
    sure_sd, turn_s = parameters.sure_sd, parameters.turn_s
    for b in range(len(rows)):
        r = rows[b]
        sure = min(1.0, max(0.0, 2.0 - facing.sd[b] / sure_sd))
        changed = facing.mirrored[b] != views.mirrored[r, column]
        if changed and facing.sd[b] <= sure_sd:
            views.mirrored[r, column] = facing.mirrored[b]
        changed = changed and views.mirrored[r, column] == facing.mirrored[b]
        v = facing.velocities[b]
        if changed and np.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2) < parameters.still_m_s:
            views.offsets[r, column] = np.nan
        own_yaw = facing.reported[b] + (np.pi if facing.mirrored[b] != views.mirrored[r, column] else 0.0)
        for n in range(len(lines)):
            of_line = reported_yaw(facing.bodies[b], lines[n : n + 1])
            of_line = of_line + (np.pi if views.mirrored[r, column] else 0.0) if np.isfinite(of_line) else own_yaw
            off = sure * wrap(facing.yaw[b] - of_line)
            if not np.isfinite(off):
                off = 0.0
            before = off if changed else views.turn[r, column, n]
            views.turn[r, column, n] = before - np.expm1(-dts[b] / turn_s) * wrap(off - before)
        yaw[r] = facing.yaw[b]
        views.toward[r, column], views.reported[r, column] = facing.toward[b], own_yaw


@njit(cache=True)
def turn(body: Float64, line_of: Int64, root: int, up: Float64, angles: Float64) -> None:
    """Turn each joint by the angle of its line about the vertical through the root, in place (Rodrigues).

    ``line_of`` (joints,) selects one of the ``angles`` [rad]; −1: none.
    """
    if not np.isfinite(body[root, 0]):
        return
    for j in range(len(line_of)):
        if line_of[j] < 0 or angles[line_of[j]] == 0.0:
            continue
        sine, versine = np.sin(angles[line_of[j]]), 1.0 - np.cos(angles[line_of[j]])
        x, y, z = body[j, 0] - body[root, 0], body[j, 1] - body[root, 1], body[j, 2] - body[root, 2]
        along = up[0] * x + up[1] * y + up[2] * z
        a, b, c = up[1] * z - up[2] * y, up[2] * x - up[0] * z, up[0] * y - up[1] * x
        body[j, 0] += sine * a + versine * (along * up[0] - x)
        body[j, 1] += sine * b + versine * (along * up[1] - y)
        body[j, 2] += sine * c + versine * (along * up[2] - z)


@njit(cache=True)
def begin_offsets(offsets: Float64, view: Float64, expected: Float64) -> None:
    """Initialise offsets (joints, 3) that are NaN, so that the corrected view begins at the expected joints."""
    for j in range(len(offsets)):
        if np.isnan(offsets[j, 0]):
            x, y, z = view[j, 0] - expected[j, 0], view[j, 1] - expected[j, 1], view[j, 2] - expected[j, 2]
            if not (np.isfinite(x) and np.isfinite(y) and np.isfinite(z)):
                x, y, z = 0.0, 0.0, 0.0
            offsets[j, 0], offsets[j, 1], offsets[j, 2] = x, y, z


@njit(cache=True)
def subtract_offsets(offsets: Float64, view: Float64, kept: Float64) -> None:
    """Subtract offsets (joints, 3) from a view, and store them in ``kept``."""
    for j in range(len(offsets)):
        for k in range(3):
            kept[j, k] = offsets[j, k]
            view[j, k] -= offsets[j, k]


@njit(cache=True)
def make(
    rows: Int64,
    columns: int,
    now_s: float,
    parameters: PeopleParameters,
    fusion: FusionParameters,
    layout: JointLayout,
    up: Float64,
    points: PointArrays,
    views: ViewArrays,
    skeletons: SkeletonArrays,
) -> tuple[Float64, Float64]:
    """Fuse each person's views, correct the Kalman filter by the result, and write its state as the skeletons.

    Returns:
        The fused positions of the persons in the frame (rows, joints, 3) and their variances (rows, joints).
    """
    positions, variances = points.positions, points.variances
    joints = len(layout.mirror)
    measured, measured_variances = np.empty((len(rows), joints, 3)), np.empty((len(rows), joints))
    corrected = np.empty((columns, joints, 3))
    worth = np.empty((columns, joints))
    offsets = np.empty((columns, joints, 3))
    used = np.empty(columns, dtype=np.int64)
    nu, offset_s = fusion.degrees_of_freedom, fusion.offset_s
    for i in range(len(rows)):
        r = rows[i]
        count = views_in_use(
            r, now_s, parameters, fusion.age_speed_m_s, layout, up, skeletons.yaw[r], points.velocities[r], views,
            used, corrected, worth, offsets,
        )  # fmt: skip
        if count == 0:
            continue
        for n in range(count):
            begin_offsets(offsets[n], corrected[n], positions[r])
        doubts = variances[r, :, 0]
        fuse(corrected[:count], worth[:count], positions[r], doubts, nu, measured[i], measured_variances[i])
        step = 1.0 if offset_s == 0.0 else -np.expm1(-max(0.0, now_s - skeletons.fused_s[r]) / offset_s)
        follow_offsets(offsets[:count], corrected[:count], measured[i], step)
        for n in range(count):
            subtract_offsets(offsets[n], corrected[n], views.offsets[r, used[n]])
        fuse(corrected[:count], worth[:count], positions[r], doubts, nu, measured[i], measured_variances[i])
        # The other views were fused in earlier frames: scaling the variance by their number avoids counting them twice.
        correct(
            positions[r], points.velocities[r], variances[r], points.seen_s[r], points.at_s[r], measured[i],
            measured_variances[i], float(count), nu, parameters.speed_variance,
        )  # fmt: skip
        skeletons.fused_s[r] = now_s
        for j in range(joints):
            best = _NOT_TRACKED
            for n in range(count):
                m = layout.mirror[j] if views.mirrored[r, used[n]] else j
                best = max(best, views.states[r, used[n], m])
            skeletons.states[r, j] = best
    infer(now_s, parameters.view_age_s, positions, skeletons.states, views.at_s)
    steady, steady_variances = skeletons.steady, skeletons.doubts
    for r in range(len(positions)):
        for j in range(joints):
            steady[r, j, 0], steady[r, j, 1], steady[r, j, 2] = (
                positions[r, j, 0],
                positions[r, j, 1],
                positions[r, j, 2],
            )
            steady_variances[r, j] = variances[r, j, 0]
    return measured, measured_variances


@njit(cache=True)
def views_in_use(
    row: int, now_s: float, parameters: PeopleParameters, age_speed: float, layout: JointLayout, up: Float64,
    yaw: float, velocities: Float64, views: ViewArrays,
    used: Int64, corrected: Float64, variances: Float64, offsets: Float64,
) -> int:  # fmt: skip
    """Collect a person's views that are recent enough, with repaired labels and brought to ``now_s``.

    Args:
        row: of the person.
        age_speed: standard deviation that a view gains per second of its age [m/s].
        yaw: facing of the person [rad]; NaN where not known.
        velocities: (joints, 3) of the person [m/s].
        used, corrected, variances, offsets: written: (sensors,) columns, (sensors, joints, 3) positions,
            (sensors, joints) variances, and (sensors, joints, 3) offsets of these views.

    Returns:
        The number of views.
    """
    count = 0
    for c in range(len(used)):
        age = now_s - views.at_s[row, c]
        if age > parameters.view_age_s:
            continue
        age = max(0.0, age)
        used[count] = c
        value = 1.0
        if np.isfinite(yaw):
            value = max(parameters.least_worth, view_worth(yaw, views.toward[row, c], views.reported[row, c]))
        for j in range(len(layout.mirror)):
            m = layout.mirror[j] if views.mirrored[row, c] else j
            for k in range(3):
                moved = age * velocities[j, k]
                seen = views.positions[row, c, m, k] + (views.bias[row, c, m, k] if layout.line_of[j] < 0 else 0.0)
                corrected[count, j, k] = seen + (moved if np.isfinite(moved) else 0.0)
                offsets[count, j, k] = views.offsets[row, c, j, k]
            variances[count, j] = (views.variances[row, c, m] + (age_speed * age) ** 2) / value
        turn(corrected[count], layout.line_of, layout.root, up, views.turn[row, c])
        count += 1
    return count


@njit(cache=True)
def infer(now_s: float, view_age_s: float, positions: Float64, states: UInt8, view_at: Float64) -> None:
    """Mark predicted joints that no view has as inferred, and joints without a prediction as not tracked."""
    for r in range(len(positions)):
        seen = False
        for c in range(view_at.shape[1]):
            seen = seen or now_s - view_at[r, c] <= view_age_s
        for j in range(states.shape[1]):
            if not np.isfinite(positions[r, j, 0]):
                states[r, j] = _NOT_TRACKED
            elif not seen or states[r, j] == _NOT_TRACKED:
                states[r, j] = _INFERRED


@njit(cache=True)
def pose_people(
    rows: Int64,
    model: Any,
    body: Float64,
    measured: Float64,
    measured_variances: Float64,
    at_s: float,
    steady: Float64,
    doubts: Float64,
) -> None:
    """Fit the articulated bodies of the persons in the frame, and predict the others, into ``steady``, ``doubts``."""
    layout, dof_kind, dof_values, joint_table, joint_values, order, config = model
    positions, variances = np.empty(steady.shape[1:]), np.empty(steady.shape[1])
    for r in range(len(steady)):
        b = -1
        for i in range(len(rows)):
            if rows[i] == r:
                b = i
        if b >= 0:
            known = articulated_kernels.correct(
                layout, dof_kind, dof_values, joint_table, joint_values, order, config, body[r], at_s, measured[b],
                measured_variances[b], positions, variances,
            )  # fmt: skip
        else:
            known = articulated_kernels.predict(
                layout, dof_kind, dof_values, joint_table, joint_values, order, config, body[r], at_s, positions,
                variances,
            )  # fmt: skip
        if known:
            for j in range(len(variances)):
                doubts[r, j] = variances[j]
                for k in range(3):
                    steady[r, j, k] = positions[j, k]


@njit(cache=True)
def smooth_people(
    rows: Int64, euro_positions: Float64, euro_velocities: Float64, euro_seen_s: Float64, measured: Float64,
    at_s: float, min_cutoff_hz: float, beta_per_m: float, speed_cutoff_hz: float, forget_after_s: float,
    view_age_s: float, steady: Float64,
) -> None:  # fmt: skip
    """Run the 1-euro filter of the persons in the frame; ``steady`` gets joints measured within ``view_age_s``."""
    for i in range(len(rows)):
        r = rows[i]
        smooth(
            euro_positions[r], euro_velocities[r], euro_seen_s[r], measured[i], at_s,
            min_cutoff_hz, beta_per_m, speed_cutoff_hz, forget_after_s,
        )  # fmt: skip
    for r in range(len(steady)):
        for j in range(steady.shape[1]):
            if at_s - euro_seen_s[r, j] <= view_age_s:
                for k in range(3):
                    steady[r, j, k] = euro_positions[r, j, k]


@njit(cache=True)
def move_views(column: int, T_new_old: Float64, mirror: Int64, views: ViewArrays) -> None:
    """Move one sensor's views, and add the change to their offsets, which fade; see `People.move_sensor`."""
    shift = np.empty((len(mirror), 3))
    for p in range(len(views.positions)):
        view = views.positions[p, column]
        for j in range(len(mirror)):
            for k in range(3):
                x = T_new_old[k, 3]
                for i in range(3):
                    x += T_new_old[k, i] * view[j, i]
                shift[j, k] = x - view[j, k]
        for j in range(len(mirror)):
            m = mirror[j] if views.mirrored[p, column] else j
            for k in range(3):
                if np.isfinite(shift[m, k]):
                    views.offsets[p, column, j, k] += shift[m, k]
                view[j, k] += shift[j, k]


@njit(cache=True)
def report(
    T: Float64, now_s: float, view_age_s: float, skeletons: SkeletonArrays, view_at: Float64, view_positions: Float64
) -> tuple[Float64, NDArray[np.float32], Float64, Bools]:
    """Transform all people and views by ``T`` (4, 4) for output; see `PeopleResults`."""
    people, sensors, joints = view_positions.shape[:3]
    positions, sd = np.empty((people, joints, 3)), np.empty((people, joints), dtype=np.float32)
    views, fresh = np.empty((people, sensors, joints, 3)), np.empty((people, sensors), dtype=np.bool_)
    for r in range(people):
        move_points(T, skeletons.steady[r], positions[r])
        for j in range(joints):
            sd[r, j] = np.sqrt(skeletons.doubts[r, j])
        for c in range(sensors):
            fresh[r, c] = now_s - view_at[r, c] <= view_age_s
            if fresh[r, c]:
                move_points(T, view_positions[r, c], views[r, c])
    return positions, sd, views, fresh
