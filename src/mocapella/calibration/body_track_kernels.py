"""Compiled buffers of bodies' newest frames, see `pair_memory.BodyTrack`; importing this module imports numba."""

# ruff: noqa: PLR0917 - compiled: arrays come by position, and loops are written out
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.pair_memory import FRAMES_KEPT
from mocapella.compiled import njit
from mocapella.model.anatomy import MOST_STRAY, THIGH_SHARE

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

TRACKED = 2
"""Value of `JointState.TRACKED`."""


@njit(cache=True)
def knees_misplaced(positions: Float64, legs: Int64) -> bool:
    """Return whether both knees lie at a place along the leg where no person's are: the sensor misjudges the legs.

    Args:
        positions: (joints, 3) a body's joints [m]; NaN where not seen.
        legs: (legs, 3) indices of each leg's hip, knee and ankle.
    """
    wrong = len(legs) > 0
    for n in range(len(legs)):
        thigh, shank = 0.0, 0.0
        for k in range(3):
            hip, knee, ankle = positions[legs[n, 0], k], positions[legs[n, 1], k], positions[legs[n, 2], k]
            thigh += (knee - hip) ** 2
            shank += (ankle - knee) ** 2
        thigh, shank = np.sqrt(thigh), np.sqrt(shank)
        whole = thigh + shank
        wrong = wrong and abs(thigh - THIGH_SHARE * whole) > MOST_STRAY * whole  # False for NaN
    return wrong


@njit(cache=True)
def add_frame(
    times: Float64,
    points: Float64,
    weights: Float64,
    held: Int64,
    frozen_since: Float64,
    at: float,
    positions: Float64,
    states: NDArray[np.uint8],
    inferred: float,
    legs: Int64,
) -> bool:
    """Append a frame to a body's frames, see `pair_memory.BodyTrack.add`.

    Return False if its time is not newer, or not finite; then nothing changes.

    Args:
        times, points, weights: (2·kept,) [s], (2·kept, joints, 3) [m] and (2·kept, joints) of `pair_memory.BodyTrack`,
            updated; kept is `FRAMES_KEPT`.
        held: (2,) index of the first stored frame, and index after the last one, updated.
        frozen_since: (1,) time since when no joint has moved at all [s], NaN if one has; updated.
        at: capture time, on the common clock [s].
        positions: (joints, 3) in the sensor's camera space [m]; a joint that is not finite or (0, 0, 0) is not seen.
        states: (joints,) `JointState`.
        inferred: weight of an inferred joint, and the most of a joint of a body whose knees are both misplaced.
        legs: (2, 3) indices of each leg's hip, knee and ankle; (0, 3) if the topology lacks one.
    """
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
    if knees_misplaced(positions, legs):
        weights[end] = np.minimum(weights[end], inferred)
    if not (same and seen > 0):
        frozen_since[0] = np.nan
    elif np.isnan(frozen_since[0]):
        frozen_since[0] = at
    held[0], held[1] = max(0, end + 1 - FRAMES_KEPT), end + 1
    return True


@njit(cache=True)
def add_bodies(
    times: Float64,
    points: Float64,
    weights: Float64,
    held: Int64,
    frozen_since: Float64,
    slots: Int64,
    at: float,
    positions: Float64,
    states: NDArray[np.uint8],
    inferred: float,
    legs: Int64,
) -> float:
    """Append a frame's bodies to their slots.

    Args:
        times, points, weights, held, frozen_since: the arrays of `pair_memory.BodyTrack` with a leading axis (slots,),
            updated.
        slots: (bodies,) slot of each body.
        at: capture time, on the common clock [s].
        positions: (bodies, joints, 3) in the sensor's camera space [m].
        states: (bodies, joints) `JointState`.
        inferred, legs: as in `add_frame`.

    Returns:
        The time since when none of the bodies has changed at all [s]; NaN if one has, or without bodies.
    """
    since = -np.inf if len(slots) else np.nan
    for i in range(len(slots)):
        s = slots[i]
        add_frame(
            times[s], points[s], weights[s], held[s], frozen_since[s], at, positions[i], states[i], inferred, legs
        )  # fmt: skip
        since = max(since, frozen_since[s, 0]) if not np.isnan(since) and not np.isnan(frozen_since[s, 0]) else np.nan
    return since


@njit(cache=True)
def newest_centres(points: Float64, weights: Float64, held: Int64, slots: Int64) -> Float64:
    """Return the centre (bodies, 3) of each body's newest visible joints [m]; NaN without any.

    Args:
        points, weights, held: the arrays of `pair_memory.BodyTrack` with a leading axis (slots,).
        slots: (bodies,) slot of each body.
    """
    out = np.zeros((len(slots), 3))
    for i in range(len(slots)):
        s, seen = slots[i], 0
        newest = held[s, 1] - 1
        for j in range(weights.shape[2]):
            if weights[s, newest, j] > 0.0:
                seen += 1
                for k in range(3):
                    out[i, k] += points[s, newest, j, k]
        for k in range(3):
            out[i, k] = out[i, k] / seen if seen > 0 else np.nan
    return out


@njit(cache=True)
def mutually_nearest(T_a_b: Float64, a: Float64, b: Float64, within_m: float) -> NDArray[np.bool_]:
    """Return which points of two sensors are mutually nearest and within a distance: (tried, n, m) bool.

    Args:
        T_a_b, a, b, within_m: (tried, 4, 4) candidate poses, (n, 3) [m], (m, 3) [m] and largest distance [m], as in
            `shared_people.mutually_nearest`.
    """
    tried, n, m = len(T_a_b), len(a), len(b)
    out = np.zeros((tried, n, m), dtype=np.bool_)
    d, of_b = np.empty((n, m)), np.empty(m)
    for e in range(tried):
        of_b[:] = np.inf
        for j in range(m):
            x, y, z = b[j, 0], b[j, 1], b[j, 2]
            p = T_a_b[e, 0, 0] * x + T_a_b[e, 0, 1] * y + T_a_b[e, 0, 2] * z + T_a_b[e, 0, 3]
            q = T_a_b[e, 1, 0] * x + T_a_b[e, 1, 1] * y + T_a_b[e, 1, 2] * z + T_a_b[e, 1, 3]
            r = T_a_b[e, 2, 0] * x + T_a_b[e, 2, 1] * y + T_a_b[e, 2, 2] * z + T_a_b[e, 2, 3]
            for i in range(n):
                d[i, j] = np.sqrt((a[i, 0] - p) ** 2 + (a[i, 1] - q) ** 2 + (a[i, 2] - r) ** 2)
                if not np.isfinite(d[i, j]):
                    d[i, j] = np.inf
                of_b[j] = min(of_b[j], d[i, j])
        for i in range(n):
            nearest = np.inf
            for j in range(m):
                nearest = min(nearest, d[i, j])
            for j in range(m):
                out[e, i, j] = d[i, j] <= within_m and d[i, j] == nearest and d[i, j] == of_b[j]
    return out
