"""The hot steps of `mocapella.tracker.people`, compiled and in place; importing this module imports numba.

Arrays are as `People` describes them; a body of the frame is taken for the person in row ``rows[body]``.
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position
from __future__ import annotations

import numpy as np

from mocapella.association.track_kernels import measure
from mocapella.compiled import njit
from mocapella.fusion.facing_kernels import reported_yaw, view_worth, wrap
from mocapella.fusion.view_kernels import follow_offsets, fuse, joint_variances, sd_at
from mocapella.kinematics import articulated_kernels
from mocapella.kinematics.articulated_kernels import move
from mocapella.model.observations import JointState
from mocapella.smoothing.kalman_kernels import correct, predict
from mocapella.smoothing.one_euro_kernels import smooth

_LONGEST_STEP_S = 0.2
_NOT_TRACKED, _INFERRED = int(JointState.NOT_TRACKED), int(JointState.INFERRED)


__all__ = [
    "begin_offsets", "bring", "make", "move", "observe", "pose_people", "prepare", "smooth_people", "tell", "turn",
    "turn_views",
]  # fmt: skip


@njit(cache=True)
def move_points(T, points, out):
    """Points (n, 3) moved, into ``out``."""
    for j in range(len(points)):
        x, y, z = points[j, 0], points[j, 1], points[j, 2]
        for k in range(3):
            out[j, k] = T[k, 0] * x + T[k, 1] * y + T[k, 2] * z + T[k, 3]


@njit(cache=True)
def prepare(
    T, bodies, ends, middle, now_s, forget_after_s, at_s, positions, velocities, seen_s,
    world, middles, lengths, expected,
):  # fmt: skip
    """What association asks for of a frame's bodies, see `Prepared`."""
    for b in range(len(bodies)):
        move_points(T, bodies[b], world[b])
        for m in range(len(middle)):
            for k in range(3):
                middles[b, m, k] = world[b, middle[m], k]
    if len(ends):
        measure(bodies, ends, lengths)
    expect(middle, at_s, now_s, positions, velocities, seen_s, forget_after_s, expected)


@njit(cache=True)
def observe(
    rows, column, now_s, captured_s, numbers, fusion, mirror, root, R_level,
    seen, seen_states, own_positions, bias, sensor_position, clipped,
    at_s, positions, velocities, variances, seen_s,
    view_at, view_positions, view_states, view_variances, view_noise, view_bias, view_swapped, view_advantage,
):  # fmt: skip
    """Everybody at ``now_s``, and a frame's bodies as the newest views of people.

    Returns:
        What `to_level` returns, and the time since the person's view before (bodies,), at most a second.
    """
    density, forget_after_s, noise_gain, noise_memory_s, view_age_s, swap_m, swap_s, speed_memory_s = numbers
    bring(now_s, at_s, positions, velocities, variances, seen_s, density, forget_after_s, view_age_s, speed_memory_s)
    dts = np.empty(len(rows))
    for b in range(len(rows)):
        dts[b] = min(captured_s - view_at[rows[b], column], 1.0)
    see(
        rows, column, captured_s, seen, seen_states, own_positions, bias, clipped, fusion, noise_gain, noise_memory_s,
        velocities, view_at, view_positions, view_states, view_variances, view_noise, view_bias,
    )  # fmt: skip
    follow_labels(
        rows, column, dts, view_age_s, mirror, swap_m, swap_s, view_at, view_positions, view_swapped, view_advantage
    )
    level, toward, speeds = to_level(R_level, seen, sensor_position, root, rows, velocities)
    return level, toward, speeds, dts


@njit(cache=True)
def expect(middle, at_s, now_s, positions, velocities, seen_s, forget_after_s, out):
    """Where the middles of people are at ``now_s``, into ``out`` (people, middle, 3); NaN where not known."""
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
def bring(
    now_s, at_s, positions, velocities, variances, seen_s, density, forget_after_s, view_age_s, speed_memory_s
):  # fmt: skip
    """Everybody predicted to ``now_s``; nobody goes back in time.

    A joint that is no longer seen comes to rest, for a sensor's last frames of somebody who disappears behind somebody
    else often run away with the joints.
    """
    for r in range(len(at_s)):
        dt = now_s - at_s[r]
        if dt > 0.0:
            predict(positions[r], velocities[r], variances[r], seen_s[r], dt, now_s, density, forget_after_s)
            at_s[r] = now_s
            fading = np.exp(-dt / speed_memory_s)
            for j in range(len(seen_s[r])):
                if now_s - seen_s[r, j] > view_age_s:
                    for k in range(3):
                        velocities[r, j, k] *= fading


@njit(cache=True)
def distance_of(joints):
    """From the origin to the middle of the joints that are seen [m]."""
    x, y, z, count = 0.0, 0.0, 0.0, 0
    for j in range(len(joints)):
        if np.isfinite(joints[j, 0]):
            x, y, z = x + joints[j, 0], y + joints[j, 1], z + joints[j, 2]
            count += 1
    return np.sqrt(x * x + y * y + z * z) / max(count, 1)


@njit(cache=True)
def learn_noise(before, dt, seen, states, velocities, memory_s, noise):
    """Follow how far each joint of a view jumps beyond its motion: variance of a coordinate, into ``noise`` (joints,).

    Of x(t) = x(t − dt) + v dt + n(t) − n(t − dt), twice the noise's variance remains.
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
    rows, column, captured_s, seen, seen_states, own_positions, bias, clipped, fusion, noise_gain, noise_memory_s,
    velocities, view_at, view_positions, view_states, view_variances, view_noise, view_bias,
):  # fmt: skip
    """Take in a frame's bodies as the newest views of people."""
    for b in range(len(rows)):
        r = rows[b]
        dt = captured_s - view_at[r, column]
        if 0.0 < dt < _LONGEST_STEP_S:
            learn_noise(
                view_positions[r, column], dt, seen[b], seen_states[b], velocities[r], noise_memory_s,
                view_noise[r, column],
            )  # fmt: skip
        view_at[r, column] = captured_s
        for j in range(seen.shape[1]):
            view_states[r, column, j] = seen_states[b, j]
            for k in range(3):
                view_positions[r, column, j, k] = seen[b, j, k]
                view_bias[r, column, j, k] = bias[b, j, k]
        sd = sd_at(fusion[0], distance_of(own_positions[b]), clipped[b], fusion[2])
        joint_variances(seen_states[b], sd, fusion[1], 0.0, view_variances[r, column])
        for j in range(view_noise.shape[2]):
            view_variances[r, column, j] += noise_gain * view_noise[r, column, j]


@njit(cache=True)
def advantage(view, other, mirror, crossed):
    """How much nearer a view is to another with left and right swapped [m], the other's being ``crossed`` or not.

    NaN where fewer than two joints tell.
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
    rows, column, dts, view_age_s, mirror, swap_m, swap_s, view_at, view_positions, view_swapped, view_advantage
):  # fmt: skip
    """Whether left and right of a view are to be taken for each other, so that it agrees with the other sensors'."""
    for b in range(len(rows)):
        r = rows[b]
        total, count = 0.0, 0
        for c in range(view_at.shape[1]):
            if c == column or view_at[r, column] - view_at[r, c] > view_age_s:
                continue
            more = advantage(view_positions[r, column], view_positions[r, c], mirror, view_swapped[r, c])
            if np.isfinite(more):
                total += more
                count += 1
        if count == 0:
            continue
        now = -total / count if view_swapped[r, column] else total / count
        view_advantage[r, column] -= np.expm1(-dts[b] / swap_s) * (now - view_advantage[r, column])
        if view_advantage[r, column] > swap_m:
            view_swapped[r, column] = not view_swapped[r, column]
            view_advantage[r, column] = -view_advantage[r, column]


@njit(cache=True)
def to_level(R, positions, sensor_position, root, rows, velocities):
    """In a space with y up: bodies, the yaw from each to the sensor [rad], and the velocities of their persons."""
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
    rows, column, dts, turn_s, sure_sd, bodies, lines, yaws, sds, mirrored, reported, toward,
    speeds, still_m_s, yaw, view_mirrored, view_toward, view_reported, view_turn, view_offsets,
):  # fmt: skip
    """Keep what the facing says of a frame's views, and how far shoulders and hips are turned towards it.

    Each of the ``lines`` (lines, 2) of a left and a right joint is turned by how far it is off itself, for a sensor is
    not wrong by the same angle in both. A facing that is not sure, ``sure_sd`` [rad], changes no labels, and turns
    nobody the less sure it is. Labels of somebody who stands, slower than ``still_m_s``, change because they were
    wrong: then the view goes on where the person is, and glides to where it is.
    """
    for b in range(len(rows)):
        r = rows[b]
        sure = min(1.0, max(0.0, 2.0 - sds[b] / sure_sd))
        changed = mirrored[b] != view_mirrored[r, column]
        if changed and sds[b] <= sure_sd:
            view_mirrored[r, column] = mirrored[b]
        changed = changed and view_mirrored[r, column] == mirrored[b]
        if changed and np.sqrt(speeds[b, 0] ** 2 + speeds[b, 1] ** 2 + speeds[b, 2] ** 2) < still_m_s:
            view_offsets[r, column] = np.nan
        said = reported[b] + (np.pi if mirrored[b] != view_mirrored[r, column] else 0.0)
        for n in range(len(lines)):
            of_line = reported_yaw(bodies[b], lines[n : n + 1])
            of_line = of_line + (np.pi if view_mirrored[r, column] else 0.0) if np.isfinite(of_line) else said
            off = sure * wrap(yaws[b] - of_line)
            if not np.isfinite(off):
                off = 0.0
            before = off if changed else view_turn[r, column, n]
            view_turn[r, column, n] = before - np.expm1(-dts[b] / turn_s) * wrap(off - before)
        yaw[r] = yaws[b]
        view_toward[r, column], view_reported[r, column] = toward[b], said


@njit(cache=True)
def turn(body, line_of, root, up, angles):
    """Turn each joint by the angle of its line about the vertical through the root, in place (Rodrigues).

    ``line_of`` (joints,) says which of the ``angles`` [rad] that is; −1: none.
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
def begin_offsets(offsets, view, expected):
    """Offsets (joints, 3) that are not known yet: with them, a view begins where the person is expected."""
    for j in range(len(offsets)):
        if np.isnan(offsets[j, 0]):
            x, y, z = view[j, 0] - expected[j, 0], view[j, 1] - expected[j, 1], view[j, 2] - expected[j, 2]
            if not (np.isfinite(x) and np.isfinite(y) and np.isfinite(z)):
                x, y, z = 0.0, 0.0, 0.0
            offsets[j, 0], offsets[j, 1], offsets[j, 2] = x, y, z


@njit(cache=True)
def take_off(offsets, view, kept):
    """Take a view's offsets (joints, 3) off it, and keep them."""
    for j in range(len(offsets)):
        for k in range(3):
            kept[j, k] = offsets[j, k]
            view[j, k] -= offsets[j, k]


@njit(cache=True)
def make(
    rows, columns, now_s, view_age_s, mirror, line_of, up, root, least_worth, fusion, speed_variance, yaw,
    at_s, positions, velocities, variances, seen_s, states, fused_s, steady, steady_variances,
    view_at, view_positions, view_states, view_variances, view_bias, view_mirrored, view_toward, view_reported,
    view_turn, view_offsets,
):  # fmt: skip
    """Make one skeleton of each person's views, correct the points by it, and take those for steady.

    Returns:
        What was fused of those in the frame: (rows, joints, 3), and its variances (rows, joints).
    """
    joints = len(mirror)
    measured, measured_variances = np.empty((len(rows), joints, 3)), np.empty((len(rows), joints))
    views = np.empty((columns, joints, 3))
    worth = np.empty((columns, joints))
    offsets = np.empty((columns, joints, 3))
    used = np.empty(columns, dtype=np.int64)
    nu, offset_s, age_speed = fusion[3], fusion[4], fusion[5]
    for i in range(len(rows)):
        r = rows[i]
        count = 0
        for c in range(columns):
            age = now_s - view_at[r, c]
            if age > view_age_s:
                continue
            age = max(0.0, age)
            used[count] = c
            value = 1.0
            if np.isfinite(yaw[r]):
                value = max(least_worth, view_worth(yaw[r], view_toward[r, c], view_reported[r, c]))
            for j in range(joints):
                m = mirror[j] if view_mirrored[r, c] else j
                for k in range(3):
                    moved = age * velocities[r, j, k]
                    seen = view_positions[r, c, m, k] + (view_bias[r, c, m, k] if line_of[j] < 0 else 0.0)
                    views[count, j, k] = seen + (moved if np.isfinite(moved) else 0.0)
                    offsets[count, j, k] = view_offsets[r, c, j, k]
                worth[count, j] = (view_variances[r, c, m] + (age_speed * age) ** 2) / value
            turn(views[count], line_of, root, up, view_turn[r, c])
            begin_offsets(offsets[count], views[count], positions[r])
            count += 1
        if count == 0:
            continue
        doubts = variances[r, :, 0]
        fuse(views[:count], worth[:count], positions[r], doubts, nu, measured[i], measured_variances[i])
        step = 1.0 if offset_s == 0.0 else -np.expm1(-max(0.0, now_s - fused_s[r]) / offset_s)
        follow_offsets(offsets[:count], views[:count], measured[i], step)
        for n in range(count):
            take_off(offsets[n], views[n], view_offsets[r, used[n]])
        fuse(views[:count], worth[:count], positions[r], doubts, nu, measured[i], measured_variances[i])
        # The views that are not of this frame were taken in before: their news is not counted twice.
        correct(
            positions[r], velocities[r], variances[r], seen_s[r], at_s[r], measured[i], measured_variances[i],
            float(count), nu, speed_variance,
        )  # fmt: skip
        fused_s[r] = now_s
        for j in range(joints):
            best = _NOT_TRACKED
            for n in range(count):
                m = mirror[j] if view_mirrored[r, used[n]] else j
                best = max(best, view_states[r, used[n], m])
            states[r, j] = best
    infer(now_s, view_age_s, positions, states, view_at)
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
def infer(now_s, view_age_s, positions, states, view_at):
    """What nobody sees is predicted, and told as inferred for as long as it is."""
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
def pose_people(rows, model, body, measured, measured_variances, at_s, steady, doubts):
    """The articulated bodies of those in the frame, and the others as predicted; where one is known."""
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
    rows, euro_positions, euro_velocities, euro_seen_s, measured, at_s,
    min_cutoff_hz, beta_per_m, speed_cutoff_hz, forget_after_s, view_age_s, steady,
):  # fmt: skip
    """The 1-euro filter of those in the frame; ``steady`` becomes what was measured within ``view_age_s``."""
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
def place_anew(column, T_new_old, mirror, view_mirrored, view_positions, view_offsets):
    """`People.place_anew`: views are moved, and what they are off the person by now is an offset that fades."""
    shift = np.empty((len(mirror), 3))
    for p in range(len(view_positions)):
        view = view_positions[p, column]
        for j in range(len(mirror)):
            for k in range(3):
                x = T_new_old[k, 3]
                for i in range(3):
                    x += T_new_old[k, i] * view[j, i]
                shift[j, k] = x - view[j, k]
        for j in range(len(mirror)):
            told = mirror[j] if view_mirrored[p, column] else j
            for k in range(3):
                if np.isfinite(shift[told, k]):
                    view_offsets[p, column, j, k] += shift[told, k]
                view[j, k] += shift[j, k]


@njit(cache=True)
def tell(T, now_s, view_age_s, steady, doubts, view_at, view_positions):
    """What is told of people, in the space to which ``T`` moves.

    Returns:
        (people, joints, 3) where they are; (people, joints) float32 standard deviations; (people, sensors, joints, 3)
        the views; (people, sensors) whether they are in use.
    """
    people, sensors, joints = view_positions.shape[:3]
    positions, sd = np.empty((people, joints, 3)), np.empty((people, joints), dtype=np.float32)
    views, fresh = np.empty((people, sensors, joints, 3)), np.empty((people, sensors), dtype=np.bool_)
    for r in range(people):
        move_points(T, steady[r], positions[r])
        for j in range(joints):
            sd[r, j] = np.sqrt(doubts[r, j])
        for c in range(sensors):
            fresh[r, c] = now_s - view_at[r, c] <= view_age_s
            if fresh[r, c]:
                move_points(T, view_positions[r, c], views[r, c])
    return positions, sd, views, fresh
