"""The hot step of `mocapella.calibration.pair_calibration`, compiled; importing this module imports numba.

All memory is in arrays, whose places have the names below. Times are seconds on the common clock.
"""

# ruff: noqa: PLR0912, PLR0917 - compiled: arrays come by position, and loops are written out
from __future__ import annotations

import numpy as np
from numba import njit

from mocapella.calibration.pair_memory import (
    AGREED,
    ANCHOR,
    ANCHORED,
    APART,
    APART_SQ,
    BLOCKS,
    BLOCKS_CLOSED,
    BLOCKS_SQ,
    CENTRE,
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
)
from mocapella.geometry.alignment_kernels import accumulate, align, residuals

LONGEST_STEP = 0.2
"""A frame counts for no more time than this [s]."""
TRACKED = 2
"""`JointState.TRACKED`."""
FARTHEST = 0.3
"""Residuals count as no more than this in the statistics [m]."""


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
            times[i], points[i], weights[i] = times[i + FRAMES_KEPT], points[i + FRAMES_KEPT], weights[i + FRAMES_KEPT]
        begin, end = 0, FRAMES_KEPT
    times[end] = at
    seen, same = 0, end > begin
    for j in range(len(states)):
        x, y, z = positions[j]
        good = np.isfinite(x) and np.isfinite(y) and np.isfinite(z) and (x != 0.0 or y != 0.0 or z != 0.0)
        points[end, j] = 0.0
        weights[end, j] = 0.0
        if good and states[j] > 0:
            points[end, j] = positions[j]
            weights[end, j] = 1.0 if states[j] == TRACKED else inferred
            seen += 1
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
    M, B, T, S, body, a_times, a_points, a_weights, a_held, b_times, b_points, b_weights, b_held, mirror, cfg
):  # fmt: skip
    """Take in the newest frame of a that b's frames reach around, if it is new enough; whether there was one.

    Args:
        M: (50,) moments; B: (7, 7) of the gradients; T: (4, 4); S: the pair's scalars; body: this pair of bodies'.
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
    before, v, q = np.empty((joints, 3)), np.empty((joints, 3)), np.empty((joints, 3))
    w_before, w_after, w_q = np.empty(joints), np.empty(joints), np.empty(joints)
    if (
        resample(b_times, b_points, b_weights, at + half, v, w_after) != 1
        or resample(b_times, b_points, b_weights, at - half, before, w_before) != 1
        or resample(b_times, b_points, b_weights, at, q, w_q) != 1
    ):
        return False
    w, w_mirrored = np.empty(joints), np.empty(joints)
    for j in range(joints):
        w_q[j] = min(w_q[j], w_before[j], w_after[j])
        for k in range(3):
            v[j, k] = (v[j, k] - before[j, k]) / (2.0 * half)
    used = 0
    for j in range(joints):
        w[j], w_mirrored[j] = min(a_weights[i, j], w_q[j]), min(a_weights[i, j], w_q[mirror[j]])
        used += w[j] > 0.0
    if used < 4:
        return False
    _step(M, B, T, S, body, t, a_points[i], q, v, w, w_mirrored, mirror, memory, first_memory, growth, floor,
          mirrored_weight, hysteresis, full_speed, still, independent, factor, least_apart)  # fmt: skip
    return True


@njit(cache=True)
def _step(
    M, B, T, S, body, t, p, q, v, w, w_mirrored, mirror, memory, first_memory, growth, floor, mirrored_weight,
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

    # Standing still says nothing new: how long a frame counts goes by how far the body moves.
    speed_sq, used = 0.0, 0
    for j in range(joints):
        used += w[j] > 0.0
    for k in range(3):
        u = 0.0
        for j in range(joints):
            if w[j] > 0.0:
                u += v[labels[j], k]
        speed_sq += (u / max(used, 1)) ** 2
    counts = dt * max(still, min(1.0, np.sqrt(speed_sq) / full_speed))
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
        _close_block(B, S, body, centre, independent)
    accumulate(M, p, q, v, w, labels)
    if M[0] > 0.0:
        align(M, offset, T)


@njit(cache=True)
def _apart(T, offset, p, q, v, labels, w, centre):
    """How far apart the two views of the body's centre are [m]; write a's into centre (3,)."""
    x, used = np.zeros(3), 0
    centre[:] = 0.0
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
def _close_block(B, S, body, centre, independent):
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
        S[BLOCKS] += 1.0
        S[BLOCKS_SQ] += 1.0
        S[BLOCKS_CLOSED] += 1.0
    body[ANCHORED] = 1.0
    for k in range(3):
        body[ANCHOR + k] = centre[k]
    for k in range(7):
        body[GRADIENT + k] = 0.0
