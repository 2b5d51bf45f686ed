"""Compiled step of `mocapella.calibration.pair_calibration`; importing this module imports numba.

The step updates the extrinsics and the clock offset of two sensors by the joints of one frame: rigid alignment by
fading moments (Horn), robust weights, and a test whether left and right are swapped.

State is in arrays, whose elements the constants of `pair_memory` name. Times are seconds on the common clock.
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position, and loops are written out
from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

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
    BodyFrames,
    PairArrays,
    PairParameters,
)
from mocapella.compiled import njit
from mocapella.geometry.alignment_kernels import accumulate, align, residuals

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Bools = NDArray[np.bool_]

LONGEST_STEP = 0.2
"""Longest time that one frame counts for [s]."""
STANDS_FOR = 20.0
"""Upper bound of the time that standing in one spot counts, at `PairSettings.still_fraction` [s]."""
FARTHEST = 0.3
"""Upper bound of residuals in the statistics [m]."""
CLOCK_LAG = 0.1
"""Clock offsets are estimated from the motion of joints over this time [s]."""
CLOCK_MEMORY = 30.0
"""Time constant of the sums for the clock offset, in shared motion [s]."""
CLOCK_FARTHEST = 0.15
"""Joints whose motion differs by more between the two sensors are left out: a jump, or another person [m]."""
CLOCK_FASTEST = 3.0
"""Joints whose velocity changes by more are left out [m/s]."""


@njit(cache=True, error_model="numpy")
def resample(times: Float64, points: Float64, weights: Float64, t: float, q: Float64, w: Float64) -> int:
    """Interpolate a body's frames at a time.

    Args:
        times: (frames,) increasing [s].
        points: (frames, joints, 3) [m].
        weights: (frames, joints) weights of the points.
        t: the time [s].
        q: (joints, 3) written if the result is 1: positions [m].
        w: (joints,) written if the result is 1: weights, the smaller ones of the neighbouring frames.

    Returns:
        1 if t is between two frames at most `LONGEST_STEP` apart; 0 if it is in a gap or before the first frame; −1 if
        it is after the last frame.
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


class Interpolated(NamedTuple):
    """A sensor's bodies at one time each, so that hypotheses that share a body interpolate its frames once.

    Attributes:
        at_s: (slots,) the time [s]; NaN before the first.
        known: (slots,) whether frames surround it.
        x, v: (slots, joints, 3) joints, or their changes [m], and velocities, or their changes [m/s].
        w: (slots, joints) weights.
    """

    at_s: Float64
    known: Bools
    x: Float64
    v: Float64
    w: Float64


@njit(cache=True, error_model="numpy")
def _interpolated(slots: int, joints: int) -> Interpolated:
    """Return bodies without a time."""
    return Interpolated(
        np.full(slots, np.nan),
        np.zeros(slots, dtype=np.bool_),
        np.empty((slots, joints, 3)),
        np.empty((slots, joints, 3)),
        np.empty((slots, joints)),
    )


@njit(cache=True, error_model="numpy")
def take_newest(
    pair: PairArrays, a: BodyFrames, b: BodyFrames, mirror: Int64, turned: Bools, p: PairParameters
) -> bool:
    """Update the pair with the newest frame of a that b's frames surround in time; return whether there was one.

    One step of the online calibration of two sensors: joints of b are interpolated at the capture time of the frame of
    a; the correspondences then update the relative pose and clock offset. At most one frame per ``every_s``.

    Args:
        pair: state, updated in place.
        a, b: the body's newest frames in both sensors.
        mirror: (joints,) index of each joint's counterpart on the other side, of the topology.
        turned: (joints,) whether sensors turn the joint towards themselves, see `pair_memory.turned_joints`.
        p: the settings.
    """
    first, one, joints = np.int64(0), np.int64(1), len(mirror)
    now, a_lag, b_lag = _interpolated(one, joints), _interpolated(one, joints), _interpolated(one, joints)
    return bool(_take(pair, a, b, first, first, now, a_lag, b_lag, mirror, turned, p))


@njit(cache=True, error_model="numpy")
def take_newest_of_each(
    pairs: PairArrays, a: BodyFrames, b: BodyFrames, slots: Int64, mirror: Int64, turned: Bools, p: PairParameters
) -> None:
    """Do what `take_newest` does for each of several hypotheses about the bodies of two sensors.

    Args:
        pairs: state of each hypothesis: the arrays of `PairArrays` with a leading axis (hypotheses,), updated in place.
        a, b: frames of all bodies of a sensor: the arrays of `BodyFrames` with a leading axis (slots,).
        slots: (hypotheses, 2) slots of the two bodies, in a and in b.
        mirror, turned, p: as in `take_newest`.
    """
    joints = len(mirror)
    now, a_lag = _interpolated(len(b.times), joints), _interpolated(len(a.times), joints)
    b_lag = _interpolated(len(b.times), joints)
    for i in range(len(slots)):
        pair = PairArrays(
            pairs.moments[i], pairs.scatter[i], pairs.T_a_b[i], pairs.scalars[i], pairs.clock[i], pairs.body[i]
        )
        one, other = slots[i, 0], slots[i, 1]
        _take(
            pair,
            BodyFrames(a.times[one], a.points[one], a.weights[one], a.held[one]),
            BodyFrames(b.times[other], b.points[other], b.weights[other], b.held[other]),
            one,
            other,
            now,
            a_lag,
            b_lag,
            mirror,
            turned,
            p,
        )


@njit(cache=True, error_model="numpy")
def _take(
    pair: PairArrays, a: BodyFrames, b: BodyFrames, one: int, other: int, now: Interpolated, a_lag: Interpolated,
    b_lag: Interpolated, mirror: Int64, turned: Bools, p: PairParameters,
) -> bool:  # fmt: skip
    """Do what `take_newest` does; the two bodies' slots are ``one`` and ``other``.

    ``now`` has the bodies of b at the time of a frame, ``a_lag`` and ``b_lag`` the changes for the clock; all may be
    left from another pair of bodies in this instant, and are updated.
    """
    S, body, half = pair.scalars, pair.body, p.velocity_window_s
    joints, offset = len(mirror), S[REFERENCE_OFFSET]
    b_end = b.held[1]
    frames = BodyFrames(b.times[b.held[0] : b_end], b.points[b.held[0] : b_end], b.weights[b.held[0] : b_end], b.held)
    i = a.held[1] - 1
    while i >= a.held[0] and a.times[i] > body[LAST] + p.every_s:
        if len(frames.times) and frames.times[-1] >= a.times[i] + offset + half:
            break
        i -= 1
    if i < a.held[0] or a.times[i] <= body[LAST] + p.every_s:
        return False
    t = a.times[i]
    body[LAST] = t
    if now.at_s[other] != t + offset:
        now.at_s[other] = t + offset
        now.known[other] = _moving(frames, t + offset, half, now.x[other], now.v[other], now.w[other])
    if not now.known[other]:
        return False
    q, v, w_q = now.x[other], now.v[other], now.w[other]
    w, w_mirrored = np.empty(joints), np.empty(joints)
    used = 0
    for j in range(joints):
        w[j], w_mirrored[j] = min(a.weights[i, j], w_q[j]), min(a.weights[i, j], w_q[mirror[j]])
        used += w[j] > 0.0
    if used < 4:
        return False
    if pair.moments[0] > 0.0:
        a_frames = BodyFrames(
            a.times[a.held[0] : i + 1], a.points[a.held[0] : i + 1], a.weights[a.held[0] : i + 1], a.held
        )
        if _changes(a_frames, t - half, half, one, a_lag) and _changes(frames, t - half + offset, half, other, b_lag):
            _learn_clock(body, pair.T_a_b, one, a_lag, other, b_lag, mirror)
    _step(pair, t, a.points[i], q, v, w, w_mirrored, mirror, turned, p)
    return True


@njit(cache=True, error_model="numpy")
def _moving(frames: BodyFrames, at: float, half: float, q: Float64, v: Float64, w: Float64) -> bool:
    """Write joints q, velocities v (joints, 3) and weights w (joints,) at a time; return whether frames surround it."""
    times, points, weights = frames.times, frames.points, frames.weights
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


@njit(cache=True, error_model="numpy")
def _learn_clock(
    body: Float64, T: Float64, one: int, a: Interpolated, other: int, b: Interpolated, mirror: Int64
) -> None:
    """Add Σ w u_a·u_b and Σ w z·r of the bodies in two slots to the block's sums for the clock offset.

    See `time_offset`; ``a`` and ``b`` are of `_changes`.
    """
    p, q, u_a, u_b = a.x[one], b.x[other], a.v[one], b.v[other]
    for j in range(len(mirror)):
        o = mirror[j] if body[MIRRORED] > 0.0 else j
        weight = min(a.w[one, j], b.w[other, o])
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


@njit(cache=True, error_model="numpy")
def _changes(frames: BodyFrames, t: float, half: float, slot: int, out: Interpolated) -> bool:
    """Write changes of joints and velocities over `CLOCK_LAG` into a slot; return whether frames cover it."""
    if out.at_s[slot] == t:
        return bool(out.known[slot])
    x, v, w = out.x[slot], out.v[slot], out.w[slot]
    x_before, v_before, w_before = np.empty_like(x), np.empty_like(v), np.empty_like(w)
    out.at_s[slot] = t
    out.known[slot] = _moving(frames, t, half, x, v, w) and _moving(
        frames, t - CLOCK_LAG, half, x_before, v_before, w_before
    )
    if not out.known[slot]:
        return False
    for j in range(len(w)):
        w[j] = min(w[j], w_before[j])
        for k in range(3):
            x[j, k] -= x_before[j, k]
            v[j, k] -= v_before[j, k]
    return True


@njit(cache=True, error_model="numpy")
def _choose_labels(
    pair: PairArrays, p: Float64, q: Float64, v: Float64, w: Float64, w_mirrored: Float64, mirror: Int64,
    hysteresis: float, r: Float64,
) -> Int64:  # fmt: skip
    """Decide which labels of b match a's: keep the present ones unless the others fit better by the hysteresis.

    Args:
        pair: its ``body[MIRRORED]`` is updated.
        p, q, v: (joints, 3) joints in a, in b, and velocities in b.
        w, w_mirrored: (joints,) weights with b's labels and with mirrored ones; ``w`` becomes the chosen ones.
        r: (joints,) scratch.

    Returns:
        (joints,) b's joint for each joint of a.
    """
    body, T, offset, joints = pair.body, pair.T_a_b, pair.scalars[OFFSET], len(w)
    order = np.arange(joints)
    if pair.moments[0] > 0.0:
        r_mirrored = np.empty(joints)
        for j in range(joints):  # compare over the same joints
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
        for j in range(joints):
            w[j] = w_mirrored[j]
        return mirror
    return order


@njit(cache=True, error_model="numpy")
def _moves(v: Float64, w: Float64, labels: Int64, full_speed: float) -> float:
    """Return how far a body walks, from 0 in place to 1 at the full speed."""
    speed_sq, used = 0.0, 0
    for j in range(len(w)):
        used += w[j] > 0.0
    for k in range(3):
        u = 0.0
        for j in range(len(w)):
            if w[j] > 0.0:
                u += v[labels[j], k]
        speed_sq += (u / max(used, 1)) ** 2
    moves: float = min(1.0, np.sqrt(speed_sq) / full_speed)
    return moves


@njit(cache=True, error_model="numpy")
def _time_of_motion(body: Float64, dt: float, moves: float, settings: PairParameters) -> float:
    """Return a frame's effective duration [s], which depends on the body's speed and decreases at standstill."""
    stands = settings.still_fraction * (STANDS_FOR / (STANDS_FOR + body[STOOD])) ** 2
    body[STOOD] += dt * (1.0 - moves)
    counts: float = dt * max(stands, moves)
    return counts


@njit(cache=True, error_model="numpy")
def _step(
    pair: PairArrays, t: float, p: Float64, q: Float64, v: Float64, w: Float64, w_mirrored: Float64, mirror: Int64,
    turned: Bools, settings: PairParameters,
) -> None:  # fmt: skip
    """Update the estimate by one pair of frames.

    Args:
        pair: state, updated in place.
        t: time of a's frame [s].
        p: (joints, 3) joints in a [m].
        q, v: (joints, 3) joints in b at that time, and their velocities [m], [m/s].
        w, w_mirrored: (joints,) weights with b's labels, and with mirrored ones; written over.
        mirror, turned: (joints,) of the topology.
        settings: the settings.
    """
    M, B, T, S, clock, body = pair.moments, pair.scatter, pair.T_a_b, pair.scalars, pair.clock, pair.body
    joints, offset, started = len(w), S[OFFSET], M[0] > 0.0
    r, centre = np.empty(joints), np.empty(3)
    dt = min(max(t - body[STEP_AT], 0.0), LONGEST_STEP) if body[STEP_AT] > -1e300 else 0.0
    body[STEP_AT] = t
    labels = _choose_labels(pair, p, q, v, w, w_mirrored, mirror, settings.label_hysteresis_m, r)
    moves = _moves(v, w, labels, settings.full_speed_m_s)
    counts = _time_of_motion(body, dt, moves, settings)
    if not started:
        counts = 0.03 * settings.still_fraction
    mean = residuals(T, offset, p, q, v, labels, w, r) if started else 0.0
    body[RESIDUAL] = mean
    apart = _apart(T, offset, p, q, v, labels, w, centre)
    S[STEPS] += 1.0
    agrees = not started or _agrees(S, body, apart, t, dt, settings.moved_factor, settings.moved_least_m)
    if not agrees and S[OWN_SD] > 0.0:
        return
    S[MOTION] += counts
    memory_s = min(settings.memory_s, settings.first_memory_s + settings.memory_growth * S[MOTION])
    keep = np.exp(-counts / memory_s)
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
    scale, floor = settings.mirrored_weight if body[MIRRORED] > 0.0 else 1.0, settings.residual_floor_m
    for j in range(joints):
        w[j] *= counts * scale / (max(r[j], floor) if started else floor)
        if turned[j]:
            w[j] *= moves + (1.0 - moves) * settings.turned_weight
    if started:
        _gradient(body, T, offset, p, q, v, labels, w)
        _close_block(B, S, clock, body, centre, settings.independent_after_m)
    accumulate(M, p, q, v, w, labels)
    if M[0] > 0.0:
        align(M, offset, T)


@njit(cache=True, error_model="numpy")
def _apart(
    T: Float64, offset: float, p: Float64, q: Float64, v: Float64, labels: Int64, w: Float64, centre: Float64
) -> float:
    """Return the distance between the two views of the body's centre [m]; write a's centre into ``centre`` (3,)."""
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
    distance: float = np.sqrt(apart)
    return distance


@njit(cache=True, error_model="numpy")
def _agrees(S: Float64, body: Float64, apart: float, t: float, dt: float, factor: float, least_apart: float) -> bool:
    """Return whether the centres are as near as is usual for these sensors; record since when they are not."""
    body[APART] = apart
    usual = np.sqrt(S[APART_SQ] / S[COST_WEIGHT] + S[OWN_SD] ** 2)
    if apart <= max(least_apart, factor * usual):
        body[DISAGREES_SINCE] = np.nan
        body[AGREED] += dt
        return True
    if np.isnan(body[DISAGREES_SINCE]):
        body[DISAGREES_SINCE] = t
    return False


@njit(cache=True, error_model="numpy")
def _gradient(
    body: Float64, T: Float64, offset: float, p: Float64, q: Float64, v: Float64, labels: Int64, w: Float64
) -> None:
    """Add Σ w Jᵀ (p − x) of this frame to the sum of the block; J as in `alignment.normal_equations`."""
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


@njit(cache=True, error_model="numpy")
def _close_block(B: Float64, S: Float64, clock: Float64, body: Float64, centre: Float64, independent: float) -> None:
    """Close the block of frames as one independent sample once the body has moved far enough from its anchor."""
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
