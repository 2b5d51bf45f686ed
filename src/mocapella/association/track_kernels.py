"""The hot steps of `mocapella.association.tracks`, compiled and in place; importing this module imports numba.

Arrays are as `mocapella.association.tracks.TrackMemory` describes them: a row for each track, a column for each sensor.
"""

# ruff: noqa: PLR0912, PLR0917 - compiled: arrays come by position, loops stand in one place
from __future__ import annotations

import numpy as np

from mocapella.association.proportions import MOST, SD_M
from mocapella.association.tracks import RECENT_S
from mocapella.compiled import njit

EXPIRED, EVERYBODY, DECIDED, AMBIGUOUS = -1, 0, 1, 2
"""What `costs` found."""
MAY_BE_ONE, MAY_BE_KNOWN, FORGOTTEN = 1, 2, 4
"""What `take` found; added."""

_MOST_VALUES = 300


@njit(cache=True)
def apart(one, other):
    """Mean distance of the joints that both have [m]; infinite where they have none in common."""
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
def is_placed(middle):
    """Whether a joint of the middle is seen."""
    for j in range(len(middle)):
        if np.isfinite(middle[j, 0]) and np.isfinite(middle[j, 1]) and np.isfinite(middle[j, 2]):
            return True
    return False


@njit(cache=True)
def distances(bodies, people, out):
    """Of each body to each person, into ``out`` (bodies, people)."""
    for b in range(len(bodies)):
        for p in range(len(people)):
            out[b, p] = apart(bodies[b], people[p])


@njit(cache=True)
def measure(positions, ends, lengths):
    """Lengths of bodies (bodies, joints, 3) between pairs of joints, left and right in turn, into (bodies, lengths)."""
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
def learn_size(size, seen):
    """`mocapella.association.proportions.learn_size` of one body, in place."""
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
def known_size(size):
    """Whether half of the lengths have been seen."""
    count = 0
    for i in range(size.shape[1]):
        count += size[1, i] > 0.0
    return 2 * count >= size.shape[1]


@njit(cache=True)
def costs(
    at_s, column, ids, middles, expected, sized, gates, seen_s, confirmed, middle, size, body, body_s,
    cost, allowed, unplaced, rows,
):  # fmt: skip
    """What it costs to take each body of a frame for each person, and whether that is allowed.

    Returns:
        `EXPIRED` where somebody is to be forgotten first, `AMBIGUOUS` where two bodies want the same row; else, with
        the row of each body in ``rows`` and −1 for nobody, `DECIDED`, or `EVERYBODY` where each has one.
    """
    gate, stay_bonus, speed, widest, by_place_s, forget_after_s = gates
    bodies, people = cost.shape
    for p in range(people):
        if at_s - seen_s[p] > (forget_after_s if confirmed[p] else 2.0 * RECENT_S):
            return EXPIRED
    taken = np.zeros(people, dtype=np.bool_)
    choice, everybody = False, True
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
            widened = min(gate + speed * unseen, widest)
            held = np.isfinite(body_s[p, column]) and body[p, column] == ids[b]
            value = away - (stay_bonus if held else 0.0) + 0.5 * (widened - gate)  # who is seen before who is lost
            cost[b, p] = value if np.isfinite(value) else gate
            by_size = sized and unseen > by_place_s and known_size(size[p])
            allowed[b, p] = (away <= widened and not by_size) or (held and unplaced[b])
            if allowed[b, p] and (rows[b] < 0 or cost[b, p] < cost[b, rows[b]]):
                rows[b] = p
        everybody = everybody and rows[b] >= 0
        if rows[b] >= 0:  # nothing costs less than what is best for everybody
            choice = choice or taken[rows[b]]
            taken[rows[b]] = True
    if choice:
        return AMBIGUOUS
    return EVERYBODY if everybody else DECIDED


@njit(cache=True)
def take(
    at_s, column, ids, middles, lengths, rows, same_within_m, confirm_after_s,
    since_s, seen_s, confirmed, middle, size, body, body_s,
):  # fmt: skip
    """Take the bodies of a frame for the people in ``rows``; −1 for nobody.

    Returns:
        Whether there are two who may be one (`MAY_BE_ONE`), and somebody new of whom to tell (`MAY_BE_KNOWN`); whether
        another sensor has not seen somebody for so long that it does not see them (`FORGOTTEN`).
    """
    tracks, sensors = body_s.shape
    shown = np.zeros(tracks, dtype=np.bool_)
    found = 0
    for b in range(len(rows)):
        r = rows[b]
        if r < 0:
            continue
        shown[r] = True
        seen_s[r] = max(at_s, seen_s[r])  # frames of several sensors come a little out of order
        body[r, column], body_s[r, column] = ids[b], seen_s[r]
        for j in range(middle.shape[1]):
            if np.isfinite(middles[b, j, 0]) and np.isfinite(middles[b, j, 1]) and np.isfinite(middles[b, j, 2]):
                middle[r, j, 0], middle[r, j, 1], middle[r, j, 2] = middles[b, j, 0], middles[b, j, 1], middles[b, j, 2]
        if len(lengths):
            learn_size(size[r], lengths[b])
    present = np.zeros(tracks, dtype=np.bool_)
    for r in range(tracks):
        for c in range(sensors):
            if not shown[r] and np.isfinite(body_s[r, c]) and (c == column or at_s - body_s[r, c] > RECENT_S):
                body_s[r, c] = -np.inf
                found |= 0 if c == column else FORGOTTEN
            present[r] = present[r] or np.isfinite(body_s[r, c])
        if present[r] and not confirmed[r] and seen_s[r] - since_s[r] >= confirm_after_s:
            found |= MAY_BE_KNOWN
    for r in range(tracks):
        for other in range(r + 1, tracks):
            if not present[r] or not present[other]:
                continue
            share = False
            for c in range(sensors):
                share = share or (np.isfinite(body_s[r, c]) and np.isfinite(body_s[other, c]))
            if not share and apart(middle[r], middle[other]) <= same_within_m:
                found |= MAY_BE_ONE
    return found


@njit(cache=True)
def rows_of(ids, column, body, body_s):
    """(bodies,) the row of whoever a sensor's bodies are, −1 of nobody."""
    rows = np.full(len(ids), -1, dtype=np.int64)
    for b in range(len(ids)):
        for r in range(len(body)):
            if body[r, column] == ids[b] and np.isfinite(body_s[r, column]):
                rows[b] = r
    return rows


@njit(cache=True)
def place_of(number, ids):
    """Where the number is among the ids; −1 for nowhere."""
    for i in range(len(ids)):
        if ids[i] == number:
            return i
    return -1


@njit(cache=True)
def stay(at_s, ids, middles, limits, known_ids, known_at_s, known_middle, known_jumped, there):
    """Which bodies are where one was just before, into ``there``; whether one is new, or was not seen for long.

    Arrays are as `mocapella.association.jumps.SeenBodies` describes them.
    """
    step_m, fastest_m_s, longest_step_s, doubt_s = limits
    changed = False
    for i in range(len(known_ids)):
        changed = changed or not abs(at_s - known_at_s[i]) <= doubt_s
    for b in range(len(ids)):
        own = place_of(ids[b], known_ids)
        changed = changed or own < 0
        there[b] = own < 0 or abs(at_s - known_at_s[own]) > doubt_s or not is_placed(middles[b])
        for i in range(len(known_ids)):
            away_s = abs(at_s - known_at_s[i])
            if not there[b] and away_s <= doubt_s:
                longest_s = longest_step_s if known_jumped[i] else doubt_s
                there[b] = apart(middles[b], known_middle[i]) <= step_m + fastest_m_s * min(away_s, longest_s)
    return changed


@njit(cache=True)
def follow(at_s, ids, middles, there, known_ids, known_at_s, known_middle, known_jumped):
    """Keep where bodies are that did not jump, and which did."""
    for b in range(len(ids)):
        i = place_of(ids[b], known_ids)
        if not there[b]:
            known_jumped[i] = True
        elif is_placed(middles[b]):
            known_at_s[i], known_jumped[i] = at_s, False
            for j in range(middles.shape[1]):
                for k in range(3):
                    known_middle[i, j, k] = middles[b, j, k]
