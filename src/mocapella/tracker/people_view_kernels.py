"""Compiled steps of `mocapella.tracker.people` for single views: storing them, repairing labels, turning them.

See `mocapella.tracker.people_memory` for the arrays; importing this module imports numba.
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.fusion.facing_kernels import reported_yaw, wrap
from mocapella.fusion.view_kernels import joint_variances, sd_at
from mocapella.fusion.weighted_mean import FusionParameters
from mocapella.model.anatomy import MOST_STRAY
from mocapella.model.observations import JointState
from mocapella.tracker.people_memory import (
    STRAY_S,
    FacingResults,
    FrameViews,
    JointLayout,
    PeopleParameters,
    ViewArrays,
)

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]
Bools = NDArray[np.bool_]
Int64 = NDArray[np.int64]

_LONGEST_STEP_S = 0.2
WALKS_COS = 0.87
"""Cosine of the largest angle of a walking person's trunk with the vertical (30°)."""
LEANS_COS = 0.5
"""Cosine of the angle of the trunk with the vertical from which the shoulders' yaw says nothing of the body's (60°)."""
_SHORTEST_TRUNK_M2 = 1e-4
_SHORTEST_LIMB_M = 0.2
_NOT_TRACKED, _INFERRED = int(JointState.NOT_TRACKED), int(JointState.INFERRED)


@njit(cache=True, error_model="numpy")
def learn_noise(
    before: Float64, dt: float, seen: Float64, states: UInt8, velocities: Float64, memory_s: float, noise: Float64
) -> None:
    """Estimate the noise variance of each joint in a view, from jumps beyond its motion, into ``noise`` (joints,).

    The residual of x(t) = x(t − dt) + v dt + n(t) − n(t − dt) has twice the variance of the noise n. Joints that are
    NOT_TRACKED in the present view, or NaN in a view or in the velocities, keep their variance.

    Args:
        before, seen: (joints, 3) the sensor's previous and present view of the person [m].
        dt: time between them [s].
        states: (joints,) `JointState` of the present view; INFERRED counts like TRACKED.
        velocities: (joints, 3) velocities of the person [m/s].
        memory_s: time constant of the learning [s].
        noise: (joints,) variance of a coordinate, updated; 0 before the first update [m²].
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


@njit(cache=True, error_model="numpy")
def doubt_limbs(seen: Float64, dt: float, limbs: Int64, shares: Float64, strays: Float64, variances: Float64) -> None:
    """Follow where a view's knees and elbows are along their limbs, and add variance where that contradicts any body.

    A joint's stray is the share of its limb's length by which the limb's first bone is longer than an average person's
    (negative: shorter), averaged over `STRAY_S`. It needs no other view, so sensors do not silence each other: those
    with the same fault keep the same weights. The part beyond `MOST_STRAY` counts as an error of that joint alone,
    because hip and ankle may be right.

    Args:
        seen: (joints, 3) a view's joints [m]; NaN where not tracked.
        dt: time since the previous view of the person by this sensor [s]; infinite for none.
        limbs, shares: those of `JointLayout`.
        strays: (joints,) the averages, updated [ratio].
        variances: (joints,) variance of a coordinate, increased [m²].
    """
    part = -np.expm1(-min(max(dt, 0.0), _LONGEST_STEP_S) / STRAY_S)
    for n in range(len(limbs)):
        a, j, c = limbs[n, 0], limbs[n, 1], limbs[n, 2]
        first, second = 0.0, 0.0
        for k in range(3):
            first += (seen[j, k] - seen[a, k]) ** 2
            second += (seen[c, k] - seen[j, k]) ** 2
        first = np.sqrt(first)
        whole = first + np.sqrt(second)
        if not whole > _SHORTEST_LIMB_M:  # also for NaN
            continue
        strays[j] += part * (first / whole - shares[n] - strays[j])
        beyond = max(0.0, abs(strays[j]) - MOST_STRAY) * whole
        variances[j] += beyond * beyond


@njit(cache=True, error_model="numpy")
def distance_of(joints: Float64) -> float:
    """Return the distance from the origin to the mean of the visible joints (joints, 3) [m]."""
    x, y, z, count = 0.0, 0.0, 0.0, 0
    for j in range(len(joints)):
        if np.isfinite(joints[j, 0]):
            x, y, z = x + joints[j, 0], y + joints[j, 1], z + joints[j, 2]
            count += 1
    distance: float = np.sqrt(x * x + y * y + z * z) / max(count, 1)
    return distance


@njit(cache=True, error_model="numpy")
def see(
    frame: FrameViews, fusion: FusionParameters, parameters: PeopleParameters, layout: JointLayout,
    velocities: Float64, views: ViewArrays,
) -> None:  # fmt: skip
    """Store a frame's bodies as the newest views of people.

    Args:
        frame: the bodies.
        fusion, parameters: the settings.
        layout: joints with a special role.
        velocities: (people, joints, 3) velocities of the people [m/s].
        views: updated.
    """
    rows, seen, seen_states, seen_bias, own = frame.rows, frame.positions, frame.states, frame.bias, frame.own_positions
    column, clipped = frame.column, frame.clipped
    positions, states, variances, noise = views.positions, views.states, views.variances, views.noise
    at_s, rigidity, bias, strays = views.at_s, views.rigidity, views.bias, views.strays
    for b in range(len(rows)):
        r = rows[b]
        dt = frame.at_s - at_s[r, column]
        if 0.0 < dt < _LONGEST_STEP_S:
            learn_noise(
                positions[r, column], dt, seen[b], seen_states[b], velocities[r], parameters.noise_memory_s,
                noise[r, column],
            )  # fmt: skip
        rigidity[r, column, 0], rigidity[r, column, 1] = frame.noise, frame.scale_sd
        at_s[r, column] = frame.at_s
        for j in range(seen.shape[1]):
            states[r, column, j] = seen_states[b, j]
            for k in range(3):
                positions[r, column, j, k] = seen[b, j, k]
                bias[r, column, j, k] = seen_bias[b, j, k]
        sd = sd_at(fusion.sd_m, distance_of(own[b]), clipped[b], fusion.clipped_factor)
        joint_variances(seen_states[b], sd, fusion.inferred_factor, 0.0, variances[r, column])
        for j in range(noise.shape[2]):
            variances[r, column, j] += parameters.noise_gain * noise[r, column, j]
        if len(layout.limbs):
            doubt_limbs(seen[b], dt, layout.limbs, layout.shares, strays[r, column], variances[r, column])


@njit(cache=True, error_model="numpy")
def advantage(view: Float64, other: Float64, mirror: Int64, crossed: bool) -> float:
    """Return how much nearer a view is to another one if its left and right are swapped, as a mean over joints [m].

    Args:
        view, other: (joints, 3) in one frame [m].
        mirror: (joints,) index of each joint's counterpart on the other side of the body.
        crossed: whether the other view's labels are swapped first.

    Returns:
        The difference of distances; NaN if fewer than two joints can be compared.
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


@njit(cache=True, error_model="numpy")
def follow_labels(
    rows: Int64, column: int, dts: Float64, parameters: PeopleParameters, mirror: Int64, views: ViewArrays
) -> None:
    """Correct swapped left and right labels of the new views by agreement with other sensors, with hysteresis.

    Args:
        rows: (bodies,) row of each body's person.
        column: column of the sensor.
        dts: (bodies,) time since each person's previous view by this sensor [s].
        parameters: the settings.
        mirror: (joints,) index of each joint's counterpart on the other side of the body.
        views: ``swapped`` and ``advantage`` are updated.
    """
    at_s, swapped, advantages, positions = views.at_s, views.swapped, views.advantage, views.positions
    for b in range(len(rows)):
        r = rows[b]
        total, count = 0.0, 0
        for c in range(at_s.shape[1]):
            if c == column or at_s[r, column] - at_s[r, c] > parameters.view_age_s:
                continue
            more = advantage(positions[r, column], positions[r, c], mirror, swapped[r, c])
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


@njit(cache=True, error_model="numpy")
def to_level(
    R: Float64, positions: Float64, sensor_position: Float64, root: int, head: int, rows: Int64, velocities: Float64
) -> tuple[Float64, Float64, Float64]:
    """Rotate a frame's bodies into a space with y up, for the facing.

    Bodies whose trunk leans by more than `WALKS_COS` get no horizontal velocity: who falls or lies down walks nowhere.

    Args:
        R: (3, 3) from the space of the people to one with y up.
        positions: (bodies, joints, 3) in the space of the people [m].
        sensor_position: (3,) in the space of the people [m].
        root, head: indices of the root joint and the head.
        rows: (bodies,) row of each body's person.
        velocities: (people, joints, 3) velocities of the people [m/s].

    Returns:
        In the space with y up: the joints (bodies, joints, 3) [m], the yaw from each body to the sensor (bodies,)
        [rad], and the velocities of the persons' roots (bodies, 3) [m/s].
    """
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
        x = level[b, head, 0] - level[b, root, 0]
        y = level[b, head, 1] - level[b, root, 1]
        z = level[b, head, 2] - level[b, root, 2]
        if y < WALKS_COS * np.sqrt(x * x + y * y + z * z):  # False for NaN
            speeds[b, 0] = speeds[b, 2] = 0.0
    return level, toward, speeds


@njit(cache=True, error_model="numpy")
def upright(body: Float64, lines: Int64) -> float:
    """Return 1 for a trunk within 30° of the vertical (`WALKS_COS`), 0 beyond 60° (`LEANS_COS`), linear in its cosine.

    It is 1 where the trunk is not known.

    Args:
        body: (joints, 3) joints, with y up [m].
        lines: (2, 2) indices of the left and the right joint of shoulders and hips.
    """
    square, rise = 0.0, 0.0
    for k in range(3):
        along = body[lines[0, 0], k] + body[lines[0, 1], k] - body[lines[1, 0], k] - body[lines[1, 1], k]
        square += along * along
        if k == 1:
            rise = along
    if not square > _SHORTEST_TRUNK_M2:  # also for NaN
        return 1.0
    share: float = min(1.0, max(0.0, (rise / np.sqrt(square) - LEANS_COS) / (WALKS_COS - LEANS_COS)))
    return share


@njit(cache=True, error_model="numpy")
def turn_views(
    rows: Int64, column: int, dts: Float64, parameters: PeopleParameters, lines: Int64, facing: FacingResults,
    yaw: Float64, views: ViewArrays,
) -> None:  # fmt: skip
    """Store the facing with a frame's views, and turn their shoulders and hips towards it.

    Each of the ``lines`` (lines, 2) of a left and a right joint is turned by its own error, because a sensor's errors
    at shoulders and hips differ. An uncertain facing, above ``sure_sd`` [rad], changes no labels, and turns lines less
    the more uncertain it is; those of a leaning trunk are turned less, too (`upright`). If the labels change while the
    person stands, slower than ``still_m_s``, the old labels were wrong: the view's offsets are learnt anew, so that it
    begins at the person's position.

    Args:
        rows: (bodies,) row of each body's person.
        column: column of the sensor.
        dts: (bodies,) time since each person's previous view [s].
        parameters: the settings.
        lines: (lines, 2) indices of the left and the right joint of each line.
        facing: the facing filter's results for the frame.
        yaw: (people,) facing of all people [rad], updated.
        views: updated.
    """
    sure_sd, turn_s = parameters.sure_sd, parameters.turn_s
    mirrored, turns, offsets = views.mirrored, views.turn, views.offsets
    for b in range(len(rows)):
        r = rows[b]
        sure = min(1.0, max(0.0, 2.0 - facing.sd[b] / sure_sd)) * (1.0 - facing.unlike[b])
        sure *= upright(facing.bodies[b], lines)
        changed = facing.mirrored[b] != mirrored[r, column]
        if changed and facing.sd[b] <= sure_sd:
            mirrored[r, column] = facing.mirrored[b]
        changed = changed and mirrored[r, column] == facing.mirrored[b]
        v = facing.velocities[b]
        if changed and np.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2) < parameters.still_m_s:
            offsets[r, column] = np.nan
        own_yaw = facing.reported[b] + (np.pi if facing.mirrored[b] != mirrored[r, column] else 0.0)
        for n in range(len(lines)):
            of_line = reported_yaw(facing.bodies[b], lines[n : n + 1])
            of_line = of_line + (np.pi if mirrored[r, column] else 0.0) if np.isfinite(of_line) else own_yaw
            off = sure * wrap(facing.yaw[b] - of_line)
            if not np.isfinite(off):
                off = 0.0
            before = off if changed else turns[r, column, n]
            turns[r, column, n] = before - np.expm1(-dts[b] / turn_s) * wrap(off - before)
        yaw[r] = facing.yaw[b]
        views.toward[r, column], views.reported[r, column] = facing.toward[b], own_yaw


@njit(cache=True, error_model="numpy")
def turn(body: Float64, line_of: Int64, root: int, up: Float64, angles: Float64) -> None:
    """Rotate the joints of shoulders and hips about the vertical through the root, in place (Rodrigues' formula).

    Args:
        body: (joints, 3) [m], updated.
        line_of: (joints,) index of each joint's angle; −1 for a joint that stays.
        root: index of the root joint.
        up: (3,) unit vector upwards.
        angles: (2,) rotation of the shoulder line and of the hip line [rad].
    """
    if not np.isfinite(body[root, 0]):
        return
    s0, v0, s1, v1 = np.sin(angles[0]), 1.0 - np.cos(angles[0]), np.sin(angles[1]), 1.0 - np.cos(angles[1])
    for j in range(len(line_of)):
        if line_of[j] < 0 or angles[line_of[j]] == 0.0:
            continue
        sine, versine = (s0, v0) if line_of[j] == 0 else (s1, v1)
        x, y, z = body[j, 0] - body[root, 0], body[j, 1] - body[root, 1], body[j, 2] - body[root, 2]
        along = up[0] * x + up[1] * y + up[2] * z
        a, b, c = up[1] * z - up[2] * y, up[2] * x - up[0] * z, up[0] * y - up[1] * x
        body[j, 0] += sine * a + versine * (along * up[0] - x)
        body[j, 1] += sine * b + versine * (along * up[1] - y)
        body[j, 2] += sine * c + versine * (along * up[2] - z)


@njit(cache=True, error_model="numpy")
def move_views(columns: Int64, T_new_old: Float64, mirror: Int64, views: ViewArrays) -> None:
    """Move sensors' views after their extrinsics changed; offsets take up the change and fade, without a jump.

    Args:
        columns: (sensors,) columns of the sensors.
        T_new_old: (sensors, 4, 4) from the old to the new positions.
        mirror: (joints,) index of each joint's counterpart on the other side of the body.
        views: updated.
    """
    positions, mirrored, offsets = views.positions, views.mirrored, views.offsets
    shift = np.empty((len(mirror), 3))
    for n in range(len(columns)):
        column, T = columns[n], T_new_old[n]
        for p in range(len(positions)):
            for j in range(len(mirror)):
                for k in range(3):
                    x = T[k, 3]
                    for i in range(3):
                        x += T[k, i] * positions[p, column, j, i]
                    shift[j, k] = x - positions[p, column, j, k]
            for j in range(len(mirror)):
                m = mirror[j] if mirrored[p, column] else j
                for k in range(3):
                    if np.isfinite(shift[m, k]):
                        offsets[p, column, j, k] += shift[m, k]
                    positions[p, column, j, k] += shift[j, k]
