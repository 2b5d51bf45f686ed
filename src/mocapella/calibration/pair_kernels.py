"""The hot step of `mocapella.calibration.pair_calibration`, compiled; importing this module imports numba.

All memory is in arrays, whose places have the names below. Times are seconds on the common clock.
"""

# ruff: noqa: PLR0912, PLR0915, PLR0917 - compiled: arrays come by position, and loops are written out
from __future__ import annotations

import numpy as np

from mocapella.calibration.pair_memory import (
    AGREED,
    ANCHOR,
    ANCHORED,
    APART,
    APART_SQ,
    BLOCK_A,
    BLOCK_G,
    BLOCKS,
    BLOCKS_CLOSED,
    BLOCKS_SQ,
    CENTRE,
    CLOCK_A,
    CLOCK_AA,
    CLOCK_AG,
    CLOCK_G,
    CLOCK_GG,
    COST,
    COST_WEIGHT,
    DISAGREES_SINCE,
    FRAMES_KEPT,
    GRADIENT,
    LAST,
    MIRRORED,
    MOTION,
    OFFSET,
    OWN_SD,
    REFERENCE_OFFSET,
    RESIDUAL,
    STEP_AT,
    STEPS,
    STOOD,
)
from mocapella.compiled import njit
from mocapella.geometry.alignment_kernels import accumulate, align, residuals

LONGEST_STEP = 0.2
"""A frame counts for no more time than this [s]."""
STANDS_FOR = 20.0
"""However long somebody stands in one place, it counts no more than so long at `PairSettings.still_fraction` [s]."""
TRACKED = 2
"""`JointState.TRACKED`."""
FARTHEST = 0.3
"""Residuals count as no more than this in the statistics [m]."""
CLOCK_LAG = 0.1
"""Offsets of clocks are judged by how joints moved since so long ago [s]."""
CLOCK_MEMORY = 30.0
"""Time constant of what is remembered of the clocks, of shared motion [s]."""
CLOCK_FARTHEST = 0.15
"""Joints that the two sensors see move so differently since then have jumped, or are others' [m]."""
CLOCK_FASTEST = 3.0
"""Nor does a joint change its velocity so much meanwhile [m/s]."""


@njit(cache=True)
def resample(times, points, weights, t, q, w):
    """Interpolate (frames, joints, 3) at t into q (joints, 3) and w (joints,): 1 it did, 0 there is a gap, −1 not yet.

    Between frames that are farther apart than `LONGEST_STEP` is a gap.
    """
    n = len(times)
    if n == 0 or times[n - 1] < t:
        return -1
    i = n - 1
    while i > 0 and times[i - 1] > t:
        i -= 1
    if i == 0:
        if times[0] != t:
            return 0
        i = 1
        if n == 1:
            return 0
    step = times[i] - times[i - 1]
    if step > LONGEST_STEP or step <= 0.0:
        return 0
    f = (t - times[i - 1]) / step
    for j in range(len(w)):
        w[j] = min(weights[i - 1, j], weights[i, j])
        for k in range(3):
            q[j, k] = points[i - 1, j, k] + f * (points[i, j, k] - points[i - 1, j, k])
    return 1


@njit(cache=True)
def add_frame(times, points, weights, held, frozen_since, at, positions, states, inferred):
    """See `pair_memory.BodyTrack.add`."""
    begin, end = held
    if not np.isfinite(at) or (end > begin and at <= times[end - 1]):
        return False
    if end == len(times):
        for i in range(FRAMES_KEPT):
            times[i] = times[i + FRAMES_KEPT]
            for j in range(len(states)):
                weights[i, j] = weights[i + FRAMES_KEPT, j]
                for k in range(3):
                    points[i, j, k] = points[i + FRAMES_KEPT, j, k]
        begin, end = 0, FRAMES_KEPT
    times[end] = at
    seen, same = 0, end > begin
    for j in range(len(states)):
        x, y, z = positions[j, 0], positions[j, 1], positions[j, 2]
        good = np.isfinite(x) and np.isfinite(y) and np.isfinite(z) and (x != 0.0 or y != 0.0 or z != 0.0)
        if good and states[j] > 0:
            weights[end, j] = 1.0 if states[j] == TRACKED else inferred
            seen += 1
        else:
            x, y, z, weights[end, j] = 0.0, 0.0, 0.0, 0.0
        points[end, j, 0], points[end, j, 1], points[end, j, 2] = x, y, z
        for k in range(3):
            same = same and points[end, j, k] == points[end - 1, j, k]
    if not (same and seen > 0):
        frozen_since[0] = np.nan
    elif np.isnan(frozen_since[0]):
        frozen_since[0] = at
    held[0], held[1] = max(0, end + 1 - FRAMES_KEPT), end + 1
    return True


@njit(cache=True)
def add_bodies(times, points, weights, held, frozen_since, slots, at, positions, states, inferred):
    """Add one frame's bodies to their slots; since when none of them has moved at all [s], NaN where one has."""
    since = -np.inf if len(slots) else np.nan
    for i in range(len(slots)):
        s = slots[i]
        add_frame(times[s], points[s], weights[s], held[s], frozen_since[s], at, positions[i], states[i], inferred)
        since = max(since, frozen_since[s, 0]) if not np.isnan(since) and not np.isnan(frozen_since[s, 0]) else np.nan
    return since


@njit(cache=True)
def take_newest(
    M, B, T, S, clock, body, a_times, a_points, a_weights, a_held, b_times, b_points, b_weights, b_held, mirror, cfg
):  # fmt: skip
    """Take in the newest frame of a that b's frames reach around, if it is new enough; whether there was one.

    Args:
        M: (50,) moments; B: (7, 7) of the gradients; T: (4, 4); S: the pair's scalars; clock: its sums of that name;
            body: this pair of bodies'.
        a_times, a_points, a_weights, a_held, and the same of b: as in `pair_memory.BodyTrack`.
        mirror: (joints,).
        cfg: the settings, in the order of `PairSettings.vector`.
    """
    (memory, first_memory, growth, floor, mirrored_weight, hysteresis, full_speed, still, half, independent,
     factor, least_apart, every) = cfg  # fmt: skip
    joints = len(mirror)
    b_times, b_points, b_weights = (
        b_times[b_held[0] : b_held[1]], b_points[b_held[0] : b_held[1]], b_weights[b_held[0] : b_held[1]]
    )  # fmt: skip
    i = a_held[1] - 1
    while i >= a_held[0] and a_times[i] > body[LAST] + every:
        if len(b_times) and b_times[-1] >= a_times[i] + S[REFERENCE_OFFSET] + half:
            break
        i -= 1
    if i < a_held[0] or a_times[i] <= body[LAST] + every:
        return False
    t = a_times[i]
    at = t + S[REFERENCE_OFFSET]
    body[LAST] = t
    v, q, w_q = np.empty((joints, 3)), np.empty((joints, 3)), np.empty(joints)
    if not _moving(b_times, b_points, b_weights, at, half, q, v, w_q):
        return False
    w, w_mirrored = np.empty(joints), np.empty(joints)
    used = 0
    for j in range(joints):
        w[j], w_mirrored[j] = min(a_weights[i, j], w_q[j]), min(a_weights[i, j], w_q[mirror[j]])
        used += w[j] > 0.0
    if used < 4:
        return False
    if M[0] > 0.0:
        a_held_times, a_held_points, a_held_weights = (
            a_times[a_held[0] : i + 1], a_points[a_held[0] : i + 1], a_weights[a_held[0] : i + 1]
        )  # fmt: skip
        _learn_clock(body, T, a_held_times, a_held_points, a_held_weights, b_times, b_points, b_weights, t - half,
                     S[REFERENCE_OFFSET], half, mirror)  # fmt: skip
    _step(M, B, T, S, clock, body, t, a_points[i], q, v, w, w_mirrored, mirror, memory, first_memory, growth, floor,
          mirrored_weight, hysteresis, full_speed, still, independent, factor, least_apart)  # fmt: skip
    return True


@njit(cache=True)
def _moving(times, points, weights, at, half, q, v, w):
    """Write where joints are at a time, their velocities (joints, 3) and weights (joints,); whether that is known."""
    before, w_before, w_after = np.empty_like(q), np.empty_like(w), np.empty_like(w)
    if (
        resample(times, points, weights, at + half, v, w_after) != 1
        or resample(times, points, weights, at - half, before, w_before) != 1
        or resample(times, points, weights, at, q, w) != 1
    ):
        return False
    for j in range(len(w)):
        w[j] = min(w[j], w_before[j], w_after[j])
        for k in range(3):
            v[j, k] = (v[j, k] - before[j, k]) / (2.0 * half)
    return True


@njit(cache=True)
def _learn_clock(body, T, a_times, a_points, a_weights, b_times, b_points, b_weights, t, offset, half, mirror):
    """Add Σ w u_a·u_b and Σ w z·r at one time to those of the block; see `time_offset`."""
    n = len(mirror)
    p, q, u_a, u_b, w = (
        np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3)), np.empty(n)
    )  # fmt: skip
    w_b = np.empty(n)
    if not (
        _changes(a_times, a_points, a_weights, t, half, p, u_a, w)
        and _changes(b_times, b_points, b_weights, t + offset, half, q, u_b, w_b)
    ):
        return
    for j in range(n):
        o = mirror[j] if body[MIRRORED] > 0.0 else j
        weight = min(w[j], w_b[o])
        if weight <= 0.0:
            continue
        rr, zr, uu, fastest = 0.0, 0.0, 0.0, 0.0
        for k in range(3):
            r, u = p[j, k], 0.0
            for m in range(3):
                r -= T[k, m] * q[o, m]
                u += T[k, m] * u_b[o, m]
            rr += r * r
            zr += 0.5 * (u_a[j, k] + u) * r
            uu += u_a[j, k] * u
            fastest = max(fastest, abs(u_a[j, k]), abs(u))
        if rr < CLOCK_FARTHEST * CLOCK_FARTHEST and fastest < CLOCK_FASTEST:
            body[BLOCK_A] += weight * uu
            body[BLOCK_G] += weight * zr


@njit(cache=True)
def _changes(times, points, weights, t, half, x, v, w):
    """Write by how much joints and their velocities (joints, 3) changed in the last `CLOCK_LAG`; whether known."""
    x_before, v_before, w_before = np.empty_like(x), np.empty_like(v), np.empty_like(w)
    if not (
        _moving(times, points, weights, t, half, x, v, w)
        and _moving(times, points, weights, t - CLOCK_LAG, half, x_before, v_before, w_before)
    ):
        return False
    for j in range(len(w)):
        w[j] = min(w[j], w_before[j])
        for k in range(3):
            x[j, k] -= x_before[j, k]
            v[j, k] -= v_before[j, k]
    return True


@njit(cache=True)
def _step(
    M, B, T, S, clock, body, t, p, q, v, w, w_mirrored, mirror, memory, first_memory, growth, floor, mirrored_weight,
    hysteresis, full_speed, still, independent, factor, least_apart
):  # fmt: skip
    joints, offset, started = len(w), S[OFFSET], M[0] > 0.0
    order, r, r_mirrored, centre = np.arange(joints), np.empty(joints), np.empty(joints), np.empty(3)
    dt = min(max(t - body[STEP_AT], 0.0), LONGEST_STEP) if body[STEP_AT] > -1e300 else 0.0
    body[STEP_AT] = t

    # Which labels: those of before, unless the others fit better by the hysteresis.
    labels = order
    if started:
        for j in range(joints):  # over the same joints, or the comparison is none
            r[j] = w[j] if w_mirrored[j] > 0.0 else 0.0
        both = r.copy()
        same = residuals(T, offset, p, q, v, order, both, r)
        other = residuals(T, offset, p, q, v, mirror, both, r_mirrored)
        if body[MIRRORED] > 0.0:
            if same < other - hysteresis:
                body[MIRRORED] = 0.0
        elif other < same - hysteresis:
            body[MIRRORED] = 1.0
    if body[MIRRORED] > 0.0:
        labels = mirror
        for j in range(joints):
            w[j] = w_mirrored[j]

    # Standing still says less and less that is new: how long a frame counts goes by how far the body moves.
    speed_sq, used = 0.0, 0
    for j in range(joints):
        used += w[j] > 0.0
    for k in range(3):
        u = 0.0
        for j in range(joints):
            if w[j] > 0.0:
                u += v[labels[j], k]
        speed_sq += (u / max(used, 1)) ** 2
    moves = min(1.0, np.sqrt(speed_sq) / full_speed)
    stands = still * (STANDS_FOR / (STANDS_FOR + body[STOOD])) ** 2
    body[STOOD] += dt * (1.0 - moves)
    counts = dt * max(stands, moves)
    if not started:
        counts = 0.03 * still
    mean = residuals(T, offset, p, q, v, labels, w, r) if started else 0.0
    body[RESIDUAL] = mean
    apart = _apart(T, offset, p, q, v, labels, w, centre)
    S[STEPS] += 1.0
    if started and not _agrees(S, body, apart, t, dt, factor, least_apart) and S[OWN_SD] > 0.0:
        return
    S[MOTION] += counts
    keep = np.exp(-counts / min(memory, first_memory + growth * S[MOTION]))
    for k in (BLOCKS, COST, COST_WEIGHT, APART_SQ):
        S[k] *= keep
    S[BLOCKS_SQ] *= keep * keep
    keep_clock = np.exp(-counts / CLOCK_MEMORY)
    for k in range(len(clock)):
        clock[k] *= keep_clock if k < CLOCK_AA else keep_clock * keep_clock
    S[COST_WEIGHT] += counts
    S[COST] += counts * min(mean, FARTHEST)
    S[APART_SQ] += counts * min(apart, FARTHEST) ** 2 if started else 0.0
    for k in range(3):
        S[CENTRE + k] = S[CENTRE + k] * keep + counts * centre[k]
    M *= keep
    B *= keep * keep
    scale = mirrored_weight if body[MIRRORED] > 0.0 else 1.0
    for j in range(joints):
        w[j] *= counts * scale / (max(r[j], floor) if started else floor)
    if started:
        _gradient(body, T, offset, p, q, v, labels, w)
        _close_block(B, S, clock, body, centre, independent)
    accumulate(M, p, q, v, w, labels)
    if M[0] > 0.0:
        align(M, offset, T)


@njit(cache=True)
def _apart(T, offset, p, q, v, labels, w, centre):
    """How far apart the two views of the body's centre are [m]; write a's into centre (3,)."""
    x, used = np.zeros(3), 0
    centre[0] = centre[1] = centre[2] = 0.0
    for j in range(len(w)):
        if w[j] <= 0.0:
            continue
        used += 1
        o = labels[j]
        for k in range(3):
            y = T[k, 3]
            for m in range(3):
                y += T[k, m] * (q[o, m] + offset * v[o, m])
            x[k] += p[j, k] - y
            centre[k] += p[j, k]
    apart = 0.0
    for k in range(3):
        apart += (x[k] / max(used, 1)) ** 2
        centre[k] /= max(used, 1)
    return np.sqrt(apart)


@njit(cache=True)
def _agrees(S, body, apart, t, dt, factor, least_apart):
    """Whether the centres are no farther apart than is usual for these sensors, and remember since when not."""
    body[APART] = apart
    usual = np.sqrt(S[APART_SQ] / S[COST_WEIGHT] + S[OWN_SD] ** 2)
    if apart <= max(least_apart, factor * usual):
        body[DISAGREES_SINCE] = np.nan
        body[AGREED] += dt
        return True
    if np.isnan(body[DISAGREES_SINCE]):
        body[DISAGREES_SINCE] = t
    return False


@njit(cache=True)
def _gradient(body, T, offset, p, q, v, labels, w):
    """Add Σ w Jᵀ (p − x) of this frame to that of the block; J as in `alignment.normal_equations`."""
    x, d, u = np.empty(3), np.empty(3), np.empty(3)
    for j in range(len(w)):
        if w[j] <= 0.0:
            continue
        o = labels[j]
        for k in range(3):
            x[k], u[k] = T[k, 3], 0.0
            for m in range(3):
                x[k] += T[k, m] * (q[o, m] + offset * v[o, m])
                u[k] += T[k, m] * v[o, m]
            d[k] = p[j, k] - x[k]
        for k in range(3):
            body[GRADIENT + k] += w[j] * d[k]
            a, b = (k + 1) % 3, (k + 2) % 3
            body[GRADIENT + 3 + k] += w[j] * (x[a] * d[b] - x[b] * d[a])
            body[GRADIENT + 6] += w[j] * u[k] * d[k]


@njit(cache=True)
def _close_block(B, S, clock, body, centre, independent):
    """When the body is somewhere else, what was seen since it was at the anchor counts as one independent sample."""
    away = 0.0
    for k in range(3):
        away += (centre[k] - body[ANCHOR + k]) ** 2
    if body[ANCHORED] > 0.0 and away < independent * independent:
        return
    if body[ANCHORED] > 0.0:
        for a in range(7):
            for b in range(7):
                B[a, b] += body[GRADIENT + a] * body[GRADIENT + b]
        a, g = body[BLOCK_A], body[BLOCK_G]
        clock[CLOCK_A] += a
        clock[CLOCK_G] += g
        clock[CLOCK_AA] += a * a
        clock[CLOCK_AG] += a * g
        clock[CLOCK_GG] += g * g
        S[BLOCKS] += 1.0
        S[BLOCKS_SQ] += 1.0
        S[BLOCKS_CLOSED] += 1.0
    body[ANCHORED] = 1.0
    for k in range(3):
        body[ANCHOR + k] = centre[k]
    for k in range(7):
        body[GRADIENT + k] = 0.0
    body[BLOCK_A] = body[BLOCK_G] = body[STOOD] = 0.0
