"""The hot steps of `mocapella.fusion.facing`, compiled; importing this module imports numba.

The same in numpy, for many frames at once, is in `mocapella.fusion.facing_training`, and tests compare the two. What
was learnt comes as arrays, see `mocapella.fusion.facing._learnt`; angles are radians. Constants of other modules are
compiled in, and numba's cache asks for changes of this file only: who changes one of them changes this file too.
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position
from __future__ import annotations

import numpy as np

from mocapella.compiled import njit
from mocapella.fusion.facing_grid import BIN, BINS, LEAST, STEP_S
from mocapella.fusion.facing_model import MOST_SCORE, SHAPE_BINS, SPEEDS, YAW_BINS
from mocapella.fusion.facing_shape import FEATURES, LENGTHS_M, NARROWEST_M

YAW_AT = 0
SHAPE_AT = YAW_AT + YAW_BINS
MOTION_AT = SHAPE_AT + SHAPE_BINS
WAVES_AT = MOTION_AT + len(SPEEDS)
RATES_AT = WAVES_AT + BINS // 2 + 1
COS_AT = RATES_AT + 1
TABLE_ROWS = COS_AT + 2
"""Rows of `BINS`: of the tables of yaw, shape and motion; the cosine waves of which the turning is made, and how fast
each fades; the cosine and the sine of each bin."""

N = len(FEATURES)
_SPEEDS = np.array(SPEEDS)


@njit(cache=True)
def wrap(angle):
    """See `mocapella.geometry.angles.wrap`."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


@njit(cache=True)
def view_worth(yaw, toward, reported):
    """What a view is worth in the fusion, from 0 to 1: cos²α · cos⁴ of how far its repaired labels are off.

    A sensor that looks along the shoulders guesses the farther one, and labels that stick say so by their yaw. α is the
    angle between the person's yaw and that to the sensor; a view whose yaw is not known (NaN) is worth nothing.
    """
    off = np.cos(reported - yaw)
    if not (np.isfinite(off) and np.isfinite(toward)):
        return 0.0
    return np.cos(toward - yaw) ** 2 * max(0.0, off) ** 4


@njit(cache=True)
def turning(steps, tables, kernel):
    """Write the probability (BINS,) of having turned by so many bins after a while."""
    kernel[:] = 0.0
    for m in range(COS_AT - 1 - WAVES_AT):
        fading = np.exp(-steps * tables[RATES_AT, m])
        for d in range(BINS):
            kernel[d] += fading * tables[WAVES_AT + m, d]


@njit(cache=True)
def turn_on(p, kernel, twice):
    """See `mocapella.fusion.facing_grid.turned_on`; p (BINS,) is written over, twice (2 · BINS,) is room to work in."""
    for d in range(BINS):
        twice[d] = twice[BINS + d] = p[d]
        p[d] = 0.0
    for d in range(BINS):
        for i in range(BINS):
            p[i] += kernel[d] * twice[i + d]
    for i in range(BINS):
        p[i] = max(p[i], LEAST)


@njit(cache=True)
def add_turned(total, first, second, part, factor, by):
    """Add factor · ((1 − part) · first + part · second), all (BINS,), turned by an angle, to a total."""
    place = by / BIN
    whole = np.floor(place)
    rest = place - whole
    shift = int(whole) % BINS
    a, b = factor * (1.0 - part), factor * part
    previous = a * first[BINS - 1] + b * second[BINS - 1]
    for j in range(BINS):
        here = a * first[j] + b * second[j]
        i = j + shift
        total[i - BINS if i >= BINS else i] += (1.0 - rest) * here + rest * previous
        previous = here


@njit(cache=True)
def most_likely(p):
    """See `mocapella.fusion.facing_grid.most_likely`."""
    best, most = 0, -1.0
    for i in range(BINS):
        five = p[i] + p[i - 2] + p[i - 1] + p[(i + 1) % BINS] + p[(i + 2) % BINS]
        if five > most:
            best, most = i, five
    mean, total = 0.0, 0.0
    for k in range(-3, 4):
        near = p[(best + k) % BINS]
        mean += near * k
        total += near
    return wrap((best + mean / total) * BIN)


@njit(cache=True)
def circular_sd(p, tables):
    """See `mocapella.fusion.facing_grid.circular_sd`; p must sum to 1."""
    c, s = 0.0, 0.0
    for i in range(BINS):
        c += p[i] * tables[COS_AT, i]
        s += p[i] * tables[COS_AT + 1, i]
    R = np.hypot(c, s)
    return np.sqrt(-2.0 * np.log(min(max(R, LEAST), 1.0)))


@njit(cache=True)
def reported_yaw(positions, across):
    """The yaw that labels say of a body (joints, 3), see `mocapella.fusion.facing_shape.view_of`; NaN where unknown.

    Args:
        positions: (joints, 3).
        across: (pairs, 2) indices of left and right, in the order in which they are asked.
    """
    for k in range(len(across)):
        x = positions[across[k, 0], 0] - positions[across[k, 1], 0]
        z = positions[across[k, 0], 2] - positions[across[k, 1], 2]
        if np.hypot(x, z) > NARROWEST_M:
            return np.arctan2(-z, x)
    return np.nan


@njit(cache=True)
def shape_score(positions, yaw, terms, weights, trunk, classifier):
    """The score of a body's shape, and how much of it was seen.

    Args:
        positions: (joints, 3); yaw: along which features are measured.
        terms: (n, 2) feature and joint, and weights: (n,), of the sums that are the features.
        trunk: indices of the head and the SpineBase.
        classifier: (4 · N + 2,) mean, spread, weights of the features and of their squares, the constant, and by how
            many spreads a feature counts at most.
    """
    head, base = positions[trunk[0]], positions[trunk[1]]
    length = np.sqrt((head[0] - base[0]) ** 2 + (head[1] - base[1]) ** 2 + (head[2] - base[2]) ** 2)
    if not LENGTHS_M[0] < length < LENGTHS_M[1]:
        return classifier[4 * N], 0.0
    features = np.zeros(N)
    sin, cos = np.sin(yaw), np.cos(yaw)
    for n in range(len(weights)):
        joint = positions[terms[n, 1]]
        features[terms[n, 0]] += weights[n] * (joint[0] * sin + joint[2] * cos)
    score, missing = classifier[4 * N], 0
    for f in range(N):
        z = (features[f] / length - classifier[f]) / classifier[N + f]
        if np.isnan(z):
            missing += 1
            continue
        z = min(max(z, -classifier[4 * N + 1]), classifier[4 * N + 1])
        score += classifier[2 * N + f] * z + classifier[3 * N + f] * (z * z - 1.0)
    return score, 1.0 - missing / N


@njit(cache=True)
def add_view(evidence, positions, seen, toward, zero, scale, tables, joints, weights, classifier, settings):
    """Add what the yaw ``seen`` and the shape of a body say, see `mocapella.fusion.facing_training.evidence`."""
    place = seen / BIN + YAW_BINS / 2
    first = int(np.floor(place))
    a, b = tables[YAW_AT + first % YAW_BINS], tables[YAW_AT + (first + 1) % YAW_BINS]
    add_turned(evidence, a, b, place - first, settings[0] * scale, toward - zero)
    if len(weights) == 0:
        return
    score, share = shape_score(positions, toward + seen, joints[1:], weights, joints[0], classifier)
    place = (min(max(score, -MOST_SCORE), MOST_SCORE) / MOST_SCORE + 1.0) * (SHAPE_BINS - 1) / 2
    first = min(int(np.floor(place)), SHAPE_BINS - 2)
    a, b = tables[SHAPE_AT + first], tables[SHAPE_AT + first + 1]
    add_turned(evidence, a, b, place - first, settings[1] * scale * share, toward - zero)


@njit(cache=True)
def add_motion(evidence, velocity, zero, factor, tables):
    """Add what a velocity (3,) says, see `mocapella.fusion.facing_model.FacingModel.motion_evidence`."""
    speed = np.hypot(velocity[0], velocity[2])
    if not speed >= _SPEEDS[0]:
        return
    row = 0
    while row + 1 < len(_SPEEDS) and speed >= _SPEEDS[row + 1]:
        row += 1
    table = tables[MOTION_AT + row]
    add_turned(evidence, table, table, 0.0, factor, np.arctan2(velocity[0], velocity[2]) - zero)


@njit(cache=True)
def believe(p, evidence):
    """See `mocapella.fusion.facing_training.believed`; p (BINS,) is written over."""
    most, total = evidence[0], 0.0
    for i in range(BINS):
        most = max(most, evidence[i])
    for i in range(BINS):
        p[i] *= np.exp(evidence[i] - most)
        total += p[i]
    for i in range(BINS):
        p[i] /= total


@njit(cache=True)
def counts_for(now, last):
    """How much of a `STEP_S` what is said now stands for, from 0 to 1."""
    return min(max((now - last) / STEP_S, 0.0), 1.0)


@njit(cache=True)
def update(
    slots, sensor, positions, toward, at, velocities, zero, p, at_s, told_s, mirrored,
    tables, across, joints, weights, classifier, settings, out,
):  # fmt: skip
    """See `mocapella.fusion.facing.FacingFilter.update`.

    Args:
        slots: (bodies,) rows of the memory; sensor: the column there.
        positions: (bodies, joints, 3), toward: (bodies,), at: [s], velocities: (bodies, 3).
        zero: yaw of the first bin.
        p, at_s, told_s, mirrored: the memory, written over.
        tables, across, joints, weights, classifier: what was learnt; across (pairs, 2) are the joints that say the yaw,
            joints (1 + n, 2) the trunk and the terms.
        settings: (5,) weights of yaw, shape and motion, the hysteresis, and from where on backs are mirrored.
        out: (4, bodies) yaw, standard deviation, yaw of the repaired labels, and 1 where the mirroring changed.

    Returns:
        of how many it did.
    """
    twice, evidence, kernel, of_kernel = np.empty(2 * BINS), np.empty(BINS), np.empty(BINS), -1.0
    changed = 0
    for n in range(len(slots)):
        slot = slots[n]
        now = max(at, at_s[slot])
        steps = (now - at_s[slot]) / STEP_S
        at_s[slot] = now
        if steps > 0.0:
            if steps != of_kernel:  # mostly all bodies of a frame were in the one before
                turning(steps, tables, kernel)
                of_kernel = steps
            turn_on(p[slot], kernel, twice)
        reported = reported_yaw(positions[n], across)
        if np.isfinite(reported) and np.isfinite(toward[n]):
            evidence[:] = 0.0
            seen = (reported - toward[n] + np.pi / 2) % np.pi - np.pi / 2
            scale = counts_for(now, told_s[slot, 1 + sensor])
            add_view(
                evidence, positions[n], seen, toward[n], zero, scale, tables, joints, weights, classifier, settings
            )
            add_motion(evidence, velocities[n], zero, settings[2] * counts_for(now, told_s[slot, 0]), tables)
            told_s[slot, 0] = told_s[slot, 1 + sensor] = now
            believe(p[slot], evidence)
        yaw, was = wrap(most_likely(p[slot]) + zero), mirrored[slot, sensor]
        off, limit = abs(wrap(reported - yaw)), np.pi / 2
        if np.isnan(off):
            off, limit = abs(wrap(toward[n] - yaw)), settings[4]
        if np.isfinite(off):
            mirrored[slot, sensor] = off > limit + (-settings[3] if was else settings[3])
        out[0, n] = yaw
        out[1, n] = circular_sd(p[slot], tables)
        out[2, n] = wrap(reported + np.pi) if mirrored[slot, sensor] else reported
        out[3, n] = 1.0 if mirrored[slot, sensor] != was else 0.0
        changed += mirrored[slot, sensor] != was
    return changed


@njit(cache=True)
def predict(slots, at, zero, p, at_s, tables, out):
    """Yaw and standard deviation (2, bodies) at a time, for rows of the memory; a row −1 is nobody who is known."""
    twice, later, kernel = np.empty(2 * BINS), np.empty(BINS), np.empty(BINS)
    for n in range(len(slots)):
        if slots[n] < 0:
            out[0, n], out[1, n] = np.nan, np.inf
            continue
        for d in range(BINS):
            later[d] = p[slots[n], d]
        steps = (at - at_s[slots[n]]) / STEP_S
        if steps > 0.0:
            turning(steps, tables, kernel)
            turn_on(later, kernel, twice)
        out[0, n] = wrap(most_likely(later) + zero)
        out[1, n] = circular_sd(later, tables)
