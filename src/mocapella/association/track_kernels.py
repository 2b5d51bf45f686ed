"""Compiled steps of `mocapella.association.tracks` and `jumps`, in place; importing this module imports numba.

They compute the gated costs of assigning bodies to tracks (global nearest neighbour), update the tracks after the
assignment, and reject bodies that jump.

See `mocapella.association.tracks.TrackMemory` for the arrays: a row for each track, a column for each sensor.
"""

# ruff: noqa: PLR0912, PLR0917 - compiled: arrays come by position, loops stand in one place
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.association.jumps import JumpLimits, KnownBodies
from mocapella.association.proportions import MOST, SD_M
from mocapella.association.tracks import (
    AMBIGUOUS,
    CHANGED,
    EXPIRED,
    FORGOTTEN,
    INCOMPLETE,
    MAY_BE_KNOWN,
    MAY_BE_ONE,
    RECENT_S,
    Assignment,
    FrameBodies,
    Gates,
    TrackArrays,
    TrackInputs,
)
from mocapella.compiled import njit

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
UInt64 = NDArray[np.uint64]
Bools = NDArray[np.bool_]

_MOST_VALUES = 300


@njit(cache=True)
def apart(one: Float64, other: Float64) -> float:
    """Return the mean distance between two bodies' joints [m]; infinite if they share none.

    Args:
        one, other: (joints, 3) in one frame [m]; NaN where not seen.
    """
    total, count = 0.0, 0
    for j in range(min(len(one), len(other))):
        square = 0.0
        for k in range(3):
            square += (one[j, k] - other[j, k]) ** 2
        if np.isfinite(square):
            total += np.sqrt(square)
            count += 1
    return total / count if count > 0 else np.inf


@njit(cache=True)
def is_placed(middle: Float64) -> bool:
    """Return whether any joint on the body's middle line is visible: finite in middle (joints, 3)."""
    for j in range(len(middle)):
        if np.isfinite(middle[j, 0]) and np.isfinite(middle[j, 1]) and np.isfinite(middle[j, 2]):
            return True
    return False


@njit(cache=True)
def distances(bodies: Float64, people: Float64, out: Float64) -> None:
    """Write the distance `apart` of each body from each person.

    Args:
        bodies, people: (bodies, joints, 3) and (people, joints, 3) in one frame [m]; NaN where not seen.
        out: (bodies, people) written [m].
    """
    for b in range(len(bodies)):
        for p in range(len(people)):
            out[b, p] = apart(bodies[b], people[p])


@njit(cache=True)
def measure(positions: Float64, ends: Int64, lengths: Float64) -> None:
    """Measure the lengths of bodies between pairs of joints, as means of left and right.

    Args:
        positions: (bodies, joints, 3) [m]; NaN where not seen.
        ends: (2 · lengths, 2) of `proportions.ends_of_lengths`.
        lengths: (bodies, lengths) written [m]; NaN if a joint is missing.
    """
    for b in range(len(lengths)):
        for i in range(lengths.shape[1]):
            total = 0.0
            for side in range(2):
                one, other = ends[2 * i + side]
                square = 0.0
                for k in range(3):
                    square += (positions[b, one, k] - positions[b, other, k]) ** 2
                total += np.sqrt(square)
            lengths[b, i] = 0.5 * total


@njit(cache=True)
def learn_size(size: Float64, seen: Float64) -> None:
    """Update a body's running mean of lengths by the lengths in one frame, in place.

    The mean is robust: a new length is clipped to `MOST` standard deviations around it (winsorised). After 300 values
    it becomes an exponential moving average.

    Args:
        size: (2, lengths) mean [m], and number of values; see `mocapella.association.proportions.unknown_size`.
        seen: (lengths,) [m]; NaN where not measured.
    """
    for i in range(len(seen)):
        if not np.isfinite(seen[i]):
            continue
        size[1, i] = min(size[1, i] + 1.0, _MOST_VALUES)
        if np.isfinite(size[0, i]):
            step = min(max(seen[i] - size[0, i], -MOST * SD_M[i]), MOST * SD_M[i])
            size[0, i] += step / size[1, i]
        else:
            size[0, i] = seen[i]


@njit(cache=True)
def known_size(size: Float64) -> bool:
    """Return whether at least half of the lengths have been measured, so that a body can be recognised by them.

    Args:
        size: (2, lengths) running mean [m], NaN where unmeasured, and number of values, of `learn_size`.
    """
    count = 0
    for i in range(size.shape[1]):
        count += size[1, i] > 0.0
    enough: bool = 2 * count >= size.shape[1]
    return enough


@njit(cache=True)
def costs(frame: FrameBodies, expected: Float64, gates: Gates, tracks: TrackArrays, result: Assignment) -> int:
    """Compute the cost [m] of assigning each body of a frame to each track, and whether the gates allow it.

    The cost is the mean distance of the joints on the middle line from their prediction, less a bonus if the track's
    last body in this sensor had the same tracking id, plus half of the gate's widening. The gate widens with the time
    that a track is unseen. A body without a visible middle joint may only keep the track of its id.

    Args:
        frame, gates, tracks: the frame's bodies, the gating settings, and the tracks.
        expected: (tracks, middle joints, 3) predicted positions, world [m]; NaN or no joints where not known.
        result: written, unless a track has expired.

    Returns:
        `EXPIRED` if a track must be dropped first; `AMBIGUOUS` if two bodies have the same cheapest track, so that
        ``result.rows`` is no assignment; `INCOMPLETE` if some bodies have no track; else 0.
    """
    at_s, column, ids, middles = frame.at_s, frame.column, frame.ids, frame.middles
    sized = len(frame.lengths) > 0
    seen_s, confirmed, middle, body = tracks.seen_s, tracks.confirmed, tracks.middle, tracks.body
    cost, allowed, unplaced, rows = result.cost, result.allowed, result.unplaced, result.rows
    gate = gates.gate_m
    bodies, people = cost.shape
    for p in range(people):
        if at_s - seen_s[p] > (gates.forget_after_s if confirmed[p] else 2.0 * RECENT_S):
            return EXPIRED
    taken = np.zeros(people, dtype=np.bool_)
    conflict, complete = False, True
    for b in range(bodies):
        unplaced[b] = not is_placed(middles[b])
        rows[b] = -1
        for p in range(people):
            there = middle[p]
            for j in range(expected.shape[1]):
                if np.isfinite(expected[p, j, 0]):
                    there = expected[p]
            away = apart(middles[b], there)
            unseen = max(0.0, at_s - seen_s[p] - RECENT_S)
            widened = min(gate + gates.speed_m_s * unseen, gates.widest_gate_m)
            held = np.isfinite(tracks.body_s[p, column]) and body[p, column] == ids[b]
            # A wider gate costs more, so that visible people come before lost ones.
            value = away - (gates.stay_bonus_m if held else 0.0) + 0.5 * (widened - gate)
            cost[b, p] = value if np.isfinite(value) else gate
            by_size = sized and unseen > gates.by_place_s and known_size(tracks.size[p])
            allowed[b, p] = (away <= widened and not by_size) or (held and unplaced[b])
            if allowed[b, p] and (rows[b] < 0 or cost[b, p] < cost[b, rows[b]]):
                rows[b] = p
        complete = complete and rows[b] >= 0
        if rows[b] >= 0:  # without a conflict, the cheapest tracks are the best assignment
            conflict = conflict or taken[rows[b]]
            taken[rows[b]] = True
    if conflict:
        return AMBIGUOUS
    return 0 if complete else INCOMPLETE


@njit(cache=True)
def take(frame: FrameBodies, rows: Int64, same_within_m: float, confirm_after_s: float, tracks: TrackArrays) -> int:
    """Update tracks, in place, by a frame's bodies after their assignment.

    Args:
        frame: the frame's bodies.
        rows: (bodies,) the track of each body; −1 for none.
        same_within_m, confirm_after_s: settings of `TrackSettings` [m], [s].
        tracks: the tracks, updated.

    Returns:
        The sum of events: two tracks may be one person (`MAY_BE_ONE`), a new track is due for confirmation
        (`MAY_BE_KNOWN`), another sensor's view of a person is older than `RECENT_S` and was dropped (`FORGOTTEN`), the
        sensor sees other people or bodies than before (`CHANGED`).
    """
    at_s, column, ids, middles, lengths = frame.at_s, frame.column, frame.ids, frame.middles, frame.lengths
    since_s, seen_s, confirmed, middle = tracks.since_s, tracks.seen_s, tracks.confirmed, tracks.middle
    size, body, body_s = tracks.size, tracks.body, tracks.body_s
    number, sensors = body_s.shape
    shown = np.zeros(number, dtype=np.bool_)
    events = 0
    for b in range(len(rows)):
        r = rows[b]
        if r < 0:
            continue
        shown[r] = True
        seen_s[r] = max(at_s, seen_s[r])  # frames of several sensors arrive slightly out of order
        if body[r, column] != ids[b] or not np.isfinite(body_s[r, column]):
            events |= CHANGED
        body[r, column], body_s[r, column] = ids[b], seen_s[r]
        for j in range(middle.shape[1]):
            if np.isfinite(middles[b, j, 0]) and np.isfinite(middles[b, j, 1]) and np.isfinite(middles[b, j, 2]):
                middle[r, j, 0], middle[r, j, 1], middle[r, j, 2] = middles[b, j, 0], middles[b, j, 1], middles[b, j, 2]
        if len(lengths):
            learn_size(size[r], lengths[b])
    present = np.zeros(number, dtype=np.bool_)
    for r in range(number):
        for c in range(sensors):
            if not shown[r] and np.isfinite(body_s[r, c]) and (c == column or at_s - body_s[r, c] > RECENT_S):
                body_s[r, c] = -np.inf
                events |= CHANGED if c == column else FORGOTTEN
            present[r] = present[r] or np.isfinite(body_s[r, c])
        if present[r] and not confirmed[r] and seen_s[r] - since_s[r] >= confirm_after_s:
            events |= MAY_BE_KNOWN
    for r in range(number):
        for other in range(r + 1, number):
            if not present[r] or not present[other]:
                continue
            share = False
            for c in range(sensors):
                if np.isfinite(body_s[r, c]) and np.isfinite(body_s[other, c]):
                    share = True
                    break
            if not share and apart(middle[r], middle[other]) <= same_within_m:
                events |= MAY_BE_ONE
    return events


@njit(cache=True)
def assign_and_take(frame: FrameBodies, expected: Float64, tracks: TrackInputs, result: Assignment) -> int:
    """Call `costs`, and `take` if that assigned all bodies; see both for the arguments.

    Returns:
        What `costs` returns, or if that is 0 what `take` returns.
    """
    events: int = costs(frame, expected, tracks.gates, tracks.arrays, result)
    if events == 0:
        events = take(frame, result.rows, tracks.same_within_m, tracks.confirm_after_s, tracks.arrays)
    return events


@njit(cache=True)
def rows_of(ids: Int64, column: int, body: Int64, body_s: Float64, rows: Int64) -> None:
    """Write the row of the track of each of a sensor's bodies, as last assigned.

    Args:
        ids: (bodies,) tracking ids.
        column: column of the sensor.
        body, body_s: (tracks, sensors) of `TrackMemory`.
        rows: (bodies,) written; −1 for none.
    """
    for b in range(len(ids)):
        rows[b] = -1
        for r in range(len(body)):
            if body[r, column] == ids[b] and np.isfinite(body_s[r, column]):
                rows[b] = r


@njit(cache=True)
def index_of(number: int, ids: UInt64) -> int:
    """Return the index of the tracking id ``number`` in ids (bodies,); −1 if it is missing."""
    for i in range(len(ids)):
        if ids[i] == number:
            return i
    return -1


@njit(cache=True)
def stay(at_s: float, ids: UInt64, middles: Float64, limits: JumpLimits, known: KnownBodies, there: Bools) -> bool:
    """Compute which bodies have not jumped: are near enough to a recent position of any body of the same sensor.

    Args:
        at_s: capture time [s].
        ids: (bodies,) tracking ids.
        middles: (bodies, middle joints, 3) in the sensor's camera space [m]; NaN where not seen.
        limits: thresholds.
        known: the sensor's recent bodies.
        there: (bodies,) written; true also for a body that is new, was unseen for long, or has no visible middle joint.

    Returns:
        Whether ``known`` must be renewed, because a body is new or was unseen for long.
    """
    doubt_s = limits.doubt_s
    changed = False
    for i in range(len(known.ids)):
        changed = changed or not abs(at_s - known.at_s[i]) <= doubt_s
    for b in range(len(ids)):
        own = index_of(ids[b], known.ids)
        changed = changed or own < 0
        there[b] = own < 0 or abs(at_s - known.at_s[own]) > doubt_s or not is_placed(middles[b])
        for i in range(len(known.ids)):
            away_s = abs(at_s - known.at_s[i])
            if not there[b] and away_s <= doubt_s:
                longest_s = limits.longest_step_s if known.jumped[i] else doubt_s
                walked_m = limits.fastest_m_s * min(away_s, longest_s)
                there[b] = apart(middles[b], known.middle[i]) <= limits.step_m + walked_m
    return changed


@njit(cache=True)
def follow(at_s: float, ids: UInt64, middles: Float64, there: Bools, known: KnownBodies) -> None:
    """Store the positions of bodies that did not jump, and mark the others as jumped.

    Args:
        at_s, ids, middles, there: capture time [s], (bodies,), (bodies, middle joints, 3) [m] and (bodies,), as in
            `stay`, which is called before.
        known: the sensor's bodies, with all ``ids``; updated.
    """
    for b in range(len(ids)):
        i = index_of(ids[b], known.ids)
        if not there[b]:
            known.jumped[i] = True
        elif is_placed(middles[b]):
            known.at_s[i], known.jumped[i] = at_s, False
            for j in range(middles.shape[1]):
                for k in range(3):
                    known.middle[i, j, k] = middles[b, j, k]


@njit(cache=True)
def stay_and_follow(
    at_s: float, ids: UInt64, middles: Float64, limits: JumpLimits, known: KnownBodies, there: Bools
) -> bool:
    """Call `stay`, with the same arguments and result, and then `follow` unless ``known`` must be renewed before."""
    changed: bool = stay(at_s, ids, middles, limits, known, there)
    if not changed:
        follow(at_s, ids, middles, there, known)
    return changed
