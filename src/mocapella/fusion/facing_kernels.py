"""Compiled steps of `mocapella.fusion.facing`; importing this module imports numba.

A histogram (Bayes) filter over a person's facing: prediction by random turns (`facing_grid`), and update by
log-likelihoods of yaw, body shape and walking direction.

For bodies like the training data, `mocapella.fusion.facing_training` computes the same in numpy for many frames at
once, and tests compare the two. The learnt model comes as `mocapella.fusion.facing.FacingTables`; angles are radians.
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.fusion.facing import FacingArrays, FacingTables, FacingWeights
from mocapella.fusion.facing_grid import ANGLE_WITHIN, BIN, BINS, CERTAIN, CLIMB_BINS, LEAST, PEAK_WITHIN, STEP_S
from mocapella.fusion.facing_model import MOST_SCORE, SHAPE_BINS, SPEEDS, YAW_BINS
from mocapella.fusion.facing_shape import (
    FADES_FROM,
    FADES_TO,
    FEATURES,
    LEANS_FROM,
    LEANS_TO,
    LENGTHS_M,
    MOST_SPREADS,
    NARROWEST_M,
    UNLIKE_FROM,
    UNLIKE_TO,
)

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

YAW_AT = 0
SHAPE_AT = YAW_AT + YAW_BINS
MOTION_AT = SHAPE_AT + SHAPE_BINS
WAVES_AT = MOTION_AT + len(SPEEDS)
RATES_AT = WAVES_AT + BINS // 2 + 1
COS_AT = RATES_AT + 1
TABLE_ROWS = COS_AT + 2
"""Number of rows, of `BINS` columns each, in `mocapella.fusion.facing.FacingTables.tables`.

In this order: log-likelihoods of yaw, shape and motion; the cosine waves of the process model; their decay rates, in
one row; the cosine and the sine of each bin.
"""

ALONE_S = 0.5
"""Time without evidence from another sensor after which a sensor counts as the only one that sees a person [s]."""
UNLIKE_S = 5.0
"""Time constant of the smoothing of how unlike the training data a view is [s]."""
REPORTED_SD = 0.35
"""Standard deviation of the yaw that a sensor unlike the training data's reports [rad]."""
LABELS_TRUE = 0.51
"""Probability that a view unlike the training data does not exchange left and right, as evidence of one frame.

A view's labels are nearly the same evidence in every frame: they decide where nothing else does, and hardly weigh
against a facing that was known before the posture.
"""
_LEAST_COS = np.cos(ANGLE_WITHIN)
_PEAK_COS = np.cos(PEAK_WITHIN)
N = len(FEATURES)
_SPEEDS = np.array(SPEEDS)


@njit(cache=True)
def wrap(angle: float) -> float:
    """Wrap an angle [rad] into [−π, π)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


@njit(cache=True)
def view_worth(yaw: float, toward: float, reported: float) -> float:
    """Return a view's weight in the fusion, 0 to 1: cos⁴β / (3 − 2 cos α); 0 where an angle is NaN, or β beyond ±90°.

    The errors of a Kinect's joints grow as the person turns away. α is the angle between the person's ``yaw`` and the
    yaw ``toward`` the sensor; β is the error of the yaw ``reported`` by the view's corrected labels; all are in one
    frame [rad].
    """
    off = np.cos(reported - yaw)
    if not (np.isfinite(off) and np.isfinite(toward)):
        return 0.0
    worth: float = max(0.0, off) ** 4 / (3.0 - 2.0 * np.cos(toward - yaw))
    return worth


@njit(cache=True)
def turning(steps: float, tables: Float64, kernel: Float64) -> None:
    """Compute the probability of a turn by each number of bins after some time.

    Args:
        steps: elapsed time in units of `STEP_S`.
        tables: (TABLE_ROWS, BINS), see `TABLE_ROWS`.
        kernel: (BINS,) the probabilities, written.
    """
    kernel[:] = 0.0
    for m in range(COS_AT - 1 - WAVES_AT):
        fading = np.exp(-steps * tables[RATES_AT, m])
        for d in range(BINS):
            kernel[d] += fading * tables[WAVES_AT + m, d]


@njit(cache=True)
def turn_on(p: Float64, kernel: Float64, twice: Float64) -> None:
    """Predict probabilities p (BINS,), in place, by convolving them on the circle with the ``kernel`` of `turning`.

    ``twice`` (2 · BINS,) is workspace. See `mocapella.fusion.facing_grid.turned_on`.
    """
    for d in range(BINS):
        twice[d] = twice[BINS + d] = p[d]
        p[d] = 0.0
    for d in range(BINS):
        for i in range(BINS):
            p[i] += kernel[d] * twice[i + d]
    for i in range(BINS):
        p[i] = max(p[i], LEAST)


@njit(cache=True)
def add_turned(total: Float64, first: Float64, second: Float64, part: float, factor: float, by: float) -> None:
    """Add factor · ((1 − part) · first + part · second), rotated by an angle, to a total, in place.

    It interpolates the learnt log-likelihood between two rows (such as two speeds), and shifts it to a person's yaw.

    Args:
        total: (BINS,) log-likelihoods, updated.
        first, second: (BINS,) rows of a table.
        part: weight of the second row, 0 to 1.
        factor: weight of the sum.
        by: angle [rad]: the value at a yaw is added at that yaw + ``by``.
    """
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
def of_five(p: Float64, i: int) -> float:
    """Return the probability of bin ``i`` of p (BINS,), 0 to BINS − 1, and of its four nearest neighbours."""
    five: float = p[i] + p[i - 2] + p[i - 1] + p[(i + 1) % BINS] + p[(i + 2) % BINS]
    return five


@njit(cache=True)
def likeliest_bin(p: Float64) -> int:
    """Return the bin of p (BINS,) with the largest `of_five`."""
    best, most = 0, -1.0
    for i in range(BINS):
        five = of_five(p, i)
        if five > most:
            best, most = i, five
    return best


@njit(cache=True)
def mean_near(p: Float64, best: int) -> float:
    """Return the mean yaw of the seven bins of p (BINS,) around a bin, from the first bin's, in [−π, π) [rad]."""
    mean, total = 0.0, 0.0
    for k in range(-3, 4):
        near = p[(best + k) % BINS]
        mean += near * k
        total += near
    angle: float = wrap((best + mean / total) * BIN)
    return angle


@njit(cache=True)
def keep_near(p: Float64, yaw: float, least_cos: float, tables: Float64, near: Float64) -> float:
    """Write p (BINS,) to ``near`` (BINS,), 0 where a bin's cosine to ``yaw`` is less than ``least_cos``.

    ``tables`` (TABLE_ROWS, BINS) has each bin's cosine and sine; ``yaw`` is relative to the first bin [rad]. Returns
    the share of the probability that is kept.
    """
    c, s, kept, total = np.cos(yaw), np.sin(yaw), 0.0, 0.0
    for i in range(BINS):
        near[i] = 0.0 if tables[COS_AT, i] * c + tables[COS_AT + 1, i] * s < least_cos else p[i]
        kept += near[i]
        total += p[i]
    share: float = kept / total
    return share


@njit(cache=True)
def most_likely_angle(p: Float64, p_angle: Float64, tables: Float64, near: Float64) -> float:
    """Return `mocapella.fusion.facing_grid.most_likely_angle`, in [−π, π), relative to the yaw of the first bin [rad].

    Args:
        p, p_angle: (BINS,) probability of each bin, by all evidence and by that of the angle only.
        tables: (TABLE_ROWS, BINS), see `TABLE_ROWS`.
        near: (BINS,) workspace.
    """
    start = likeliest_bin(p)
    best, here = start, of_five(p_angle, start)
    for _ in range(CLIMB_BINS):
        above, below = (best + 1) % BINS, (best - 1) % BINS
        up, down = of_five(p_angle, above), of_five(p_angle, below)
        if max(up, down) <= here:
            break
        best, here = (above, up) if up > down else (below, down)
    peak: float = mean_near(p_angle, best)
    if keep_near(p_angle, peak, _PEAK_COS, tables, near) > CERTAIN:
        return peak
    keep_near(p_angle, mean_near(p, start), _LEAST_COS, tables, near)
    angle: float = mean_near(near, likeliest_bin(near))
    return angle


@njit(cache=True)
def probability_away(p: Float64, yaw: float, tables: Float64) -> float:
    """Return the probability, by p (BINS,) of sum 1, that the facing is more than 90° from a ``yaw`` [rad].

    ``yaw`` is relative to the first bin; ``tables`` (TABLE_ROWS, BINS) has each bin's cosine and sine.
    """
    away, c, s = 0.0, np.cos(yaw), np.sin(yaw)
    for i in range(BINS):
        if tables[COS_AT, i] * c + tables[COS_AT + 1, i] * s < 0.0:
            away += p[i]
    return away


@njit(cache=True)
def is_alone(told_s: Float64, sensor: int, now: float) -> bool:
    """Return whether no other sensor has given evidence of a person's facing for `ALONE_S`.

    Args:
        told_s: (1 + sensors,) times of the last evidence, from the motion and from each sensor [s].
        sensor: index of the sensor, from 0, which is not counted.
        now: the present time on the same clock [s].
    """
    latest = -np.inf
    for k in range(1, len(told_s)):
        if k != 1 + sensor:
            latest = max(latest, told_s[k])
    return latest <= now - ALONE_S


@njit(cache=True)
def circular_sd(p: Float64, tables: Float64) -> float:
    """Return the circular standard deviation of probabilities p (BINS,), whose sum is 1 [rad].

    ``tables`` (TABLE_ROWS, BINS) has each bin's cosine and sine. See `mocapella.fusion.facing_grid.circular_sd`.
    """
    c, s = 0.0, 0.0
    for i in range(BINS):
        c += p[i] * tables[COS_AT, i]
        s += p[i] * tables[COS_AT + 1, i]
    R = np.hypot(c, s)
    sd: float = np.sqrt(-2.0 * np.log(min(max(R, LEAST), 1.0)))
    return sd


@njit(cache=True)
def reported_yaw(positions: Float64, across: Int64) -> float:
    """Return the yaw of the body that the left and right labels of its joints imply [rad]; NaN if unknown.

    Args:
        positions: (joints, 3) in a frame with y up [m]; NaN where not seen.
        across: (pairs, 2) indices of left and right joints, in the order of preference.
    """
    for k in range(len(across)):
        x = positions[across[k, 0], 0] - positions[across[k, 1], 0]
        z = positions[across[k, 0], 2] - positions[across[k, 1], 2]
        if np.hypot(x, z) > NARROWEST_M:
            yaw: float = np.arctan2(-z, x)
            return yaw
    return np.nan


@njit(cache=True)
def shape_score(positions: Float64, yaw: float, model: FacingTables) -> tuple[float, float, float, float]:
    """Compare a body's shape with the training data.

    Returns:
        The log-odds that it faces the sensor; the usable fraction of its features, 0 to 1; how unlike the training data
        it is, 0 to 1; and how upright the trunk is, from 0 (`LEANS_TO`) to 1. Without a plausible distance of head and
        SpineBase, or without a model, the second and third are 0, and the last is 1.

    Args:
        positions: (joints, 3) in a frame with y up [m]; NaN where not seen.
        yaw: direction of the shoulders' normal on the sensor's side, along which features are measured [rad].
        model: the facing model's tables.
    """
    if len(model.weights) == 0:
        return 0.0, 0.0, 0.0, 1.0
    trunk, terms, weights, classifier = model.joints[0], model.joints[1:], model.weights, model.classifier
    head, base = positions[trunk[0]], positions[trunk[1]]
    length = np.sqrt((head[0] - base[0]) ** 2 + (head[1] - base[1]) ** 2 + (head[2] - base[2]) ** 2)
    if not LENGTHS_M[0] < length < LENGTHS_M[1]:
        return classifier[4 * N], 0.0, 0.0, 1.0
    features = np.zeros(N)
    sin, cos = np.sin(yaw), np.cos(yaw)
    for n in range(len(weights)):
        joint = positions[terms[n, 1]]
        features[terms[n, 0]] += weights[n] * (joint[0] * sin + joint[2] * cos)
    square, seen = 0.0, 0
    for f in range(N):
        features[f] = (features[f] / length - classifier[f]) / classifier[N + f]
        if np.isfinite(features[f]):
            square += features[f] ** 2
            seen += 1
    unlike = (square / max(seen, 1) - UNLIKE_FROM) / (UNLIKE_TO - UNLIKE_FROM)
    unlike = min(max(unlike, 0.0), 1.0)
    score, known = classifier[4 * N], 0.0
    for f in range(N):
        z = features[f]
        if not np.isfinite(z):
            continue
        told = 1.0 - unlike * min(max((abs(z) - FADES_FROM) / (FADES_TO - FADES_FROM), 0.0), 1.0)
        known += told
        z = min(max(z, -MOST_SPREADS), MOST_SPREADS)
        score += told * (classifier[2 * N + f] * z + classifier[3 * N + f] * (z * z - 1.0))
    lean = abs(np.arctan2((head[0] - base[0]) * sin + (head[2] - base[2]) * cos, head[1] - base[1]))
    upright = 1.0 - min(max((lean - LEANS_FROM) / (LEANS_TO - LEANS_FROM), 0.0), 1.0)
    return score, known / N, unlike, upright


@njit(cache=True)
def add_yaw(evidence: Float64, seen: float, by: float, weight: float, tables: Float64) -> None:
    """Add the weighted log-likelihoods of a view's yaw, in place; all angles are finite.

    `mocapella.fusion.facing_training.evidence` computes the same in numpy, with that of `add_shape`.

    Args:
        evidence: (BINS,) log-likelihoods over the facing, updated.
        seen: yaw that the labels imply, relative to the direction to the sensor, folded into [−π/2, π/2) [rad].
        by: yaw of the direction from the person to the sensor, relative to the first bin's [rad].
        weight: factor of the log-likelihoods.
        tables: (TABLE_ROWS, BINS), see `TABLE_ROWS`.
    """
    place = seen / BIN + YAW_BINS / 2
    first = int(np.floor(place))
    a, b = tables[YAW_AT + first % YAW_BINS], tables[YAW_AT + (first + 1) % YAW_BINS]
    add_turned(evidence, a, b, place - first, weight, by)


@njit(cache=True)
def add_shape(evidence: Float64, score: float, by: float, weight: float, tables: Float64) -> None:
    """Add the weighted log-likelihoods of a body's shape, in place.

    Args:
        evidence: (BINS,) log-likelihoods over the facing, updated.
        score: log-odds that the body faces the sensor, of `shape_score`.
        by: yaw of the direction from the person to the sensor, relative to the first bin's; finite [rad].
        weight: factor of the log-likelihoods; 0 adds nothing.
        tables: (TABLE_ROWS, BINS), see `TABLE_ROWS`.
    """
    if weight == 0.0:
        return
    place = (min(max(score, -MOST_SCORE), MOST_SCORE) / MOST_SCORE + 1.0) * (SHAPE_BINS - 1) / 2
    first = min(int(np.floor(place)), SHAPE_BINS - 2)
    a, b = tables[SHAPE_AT + first], tables[SHAPE_AT + first + 1]
    add_turned(evidence, a, b, place - first, weight, by)


@njit(cache=True)
def add_labels(evidence: Float64, reported: float, weight: float, tables: Float64) -> None:
    """Add the weighted log-likelihoods of a yaw reported by a view unlike the training data, in place.

    The facing is near the yaw with the probability `LABELS_TRUE`, and near its opposite otherwise.

    Args:
        evidence: (BINS,) log-likelihoods over the facing, updated.
        reported: yaw that the labels imply, relative to the first bin's [rad].
        weight: factor of the log-likelihoods.
        tables: (TABLE_ROWS, BINS), see `TABLE_ROWS`.
    """
    c, s = np.cos(reported), np.sin(reported)
    for i in range(BINS):
        near = (tables[COS_AT, i] * c + tables[COS_AT + 1, i] * s) / REPORTED_SD**2
        front, back = np.exp(near - 1.0 / REPORTED_SD**2), np.exp(-near - 1.0 / REPORTED_SD**2)
        evidence[i] += weight * np.log(LABELS_TRUE * front + (1.0 - LABELS_TRUE) * back + LEAST)


@njit(cache=True)
def add_motion(evidence: Float64, velocity: Float64, zero: float, factor: float, tables: Float64) -> None:
    """Add the log-likelihoods of a velocity to ``evidence`` (BINS,), in place, multiplied by ``factor``.

    See `mocapella.fusion.facing_model.FacingModel.motion_evidence`.

    Args:
        evidence: (BINS,) log-likelihoods over the facing, updated.
        velocity: (3,) velocity of the person, y up [m/s]; NaN or a slow one adds nothing.
        zero: yaw of the first bin [rad].
        factor: weight of the log-likelihoods.
        tables: (TABLE_ROWS, BINS), see `TABLE_ROWS`.
    """
    speed = np.hypot(velocity[0], velocity[2])
    if not speed >= _SPEEDS[0]:
        return
    row = 0
    while row + 1 < len(_SPEEDS) and speed >= _SPEEDS[row + 1]:
        row += 1
    table = tables[MOTION_AT + row]
    add_turned(evidence, table, table, 0.0, factor, np.arctan2(velocity[0], velocity[2]) - zero)


@njit(cache=True)
def believe(p: Float64, evidence: Float64) -> None:
    """Update probabilities p (BINS,) by log-likelihoods ``evidence`` (BINS,), in place, by Bayes' rule."""
    most, total = evidence[0], 0.0
    for i in range(BINS):
        most = max(most, evidence[i])
    for i in range(BINS):
        p[i] *= np.exp(evidence[i] - most)
        total += p[i]
    for i in range(BINS):
        p[i] /= total


@njit(cache=True)
def counts_for(now: float, last: float) -> float:
    """Return the weight of new evidence, 0 to 1: the time since the last evidence in units of `STEP_S`, at most 1.

    ``now`` and ``last`` are capture times on one clock [s].
    """
    return min(max((now - last) / STEP_S, 0.0), 1.0)


@njit(cache=True)
def update(
    slots: Int64,
    sensor: int,
    positions: Float64,
    toward: Float64,
    at: float,
    velocities: Float64,
    zero: float,
    memory: FacingArrays,
    model: FacingTables,
    factors: FacingWeights,
    out: Float64,
) -> int:
    """Update the facings with a frame, as `mocapella.fusion.facing.FacingFilter.update`.

    Args:
        slots: (bodies,) row of each body's person in the memory.
        sensor: the sensor's column in ``memory.mirrored``.
        positions: (bodies, joints, 3) with the sensor's labels, world, y up [m]; NaN where not seen.
        toward: (bodies,) yaw from the person to the sensor [rad].
        at: capture time on the common clock [s].
        velocities: (bodies, 3) velocities of the persons, world [m/s]; NaN where unknown.
        zero: yaw of the first bin [rad].
        memory: updated in place.
        model, factors: the facing model's tables, and the weights of the evidence.
        out: (5, bodies) written: yaw [rad], its standard deviation [rad], yaw of the corrected labels [rad], 1 if the
            mirroring changed, else 0, and how unlike the training data the view is, 0 to 1.

    Returns:
        The number of bodies whose mirroring changed.
    """
    p, p_angle, at_s = memory.p, memory.p_angle, memory.at_s
    told_s, mirrored, tables = memory.told_s, memory.mirrored, model.tables
    twice, evidence, kernel, of_kernel = np.empty(2 * BINS), np.empty(BINS), np.empty(BINS), -1.0
    changed = 0
    for n in range(len(slots)):
        slot = slots[n]
        now = max(at, at_s[slot])
        steps = (now - at_s[slot]) / STEP_S
        at_s[slot] = now
        if steps > 0.0:
            if steps != of_kernel:  # usually all bodies of a frame were in the previous one
                turning(steps, tables, kernel)
                of_kernel = steps
            turn_on(p[slot], kernel, twice)
            turn_on(p_angle[slot], kernel, twice)
        reported = reported_yaw(positions[n], model.across)
        if np.isfinite(reported) and np.isfinite(toward[n]):
            evidence[:] = 0.0
            seen = (reported - toward[n] + np.pi / 2) % np.pi - np.pi / 2
            scale = counts_for(now, told_s[slot, 1 + sensor])
            score, share, far, upright = shape_score(positions[n], toward[n] + seen, model)
            unlike = memory.unlike[slot, sensor]
            unlike -= np.expm1((told_s[slot, 1 + sensor] - now) / UNLIKE_S) * (far - unlike)
            memory.unlike[slot, sensor] = unlike
            trained = (1.0 - unlike) * upright  # who leans far is unlike the training data at once
            yaw_weight, shape_weight = factors.yaw * scale * trained, factors.shape * scale * trained * share
            add_yaw(evidence, seen, toward[n] - zero, yaw_weight, tables)
            if trained < 1.0:
                add_labels(evidence, reported - zero, factors.yaw * scale * (1.0 - trained), tables)
            add_motion(evidence, velocities[n], zero, factors.motion * counts_for(now, told_s[slot, 0]), tables)
            told_s[slot, 0] = told_s[slot, 1 + sensor] = now
            believe(p_angle[slot], evidence)
            add_shape(evidence, score, toward[n] - zero, shape_weight, tables)
            believe(p[slot], evidence)
        yaw, was = wrap(most_likely_angle(p[slot], p_angle[slot], tables, evidence) + zero), mirrored[slot, sensor]
        if np.isfinite(reported):
            limit = factors.swap_alone if is_alone(told_s[slot], sensor, now) else factors.swap
            mirrored[slot, sensor] = probability_away(p[slot], reported - zero, tables) > (0.5 if was else limit)
        elif np.isfinite(toward[n]):
            off = abs(wrap(toward[n] - yaw))
            mirrored[slot, sensor] = off > factors.mirrors_from + (-factors.hysteresis if was else factors.hysteresis)
        out[0, n] = yaw
        out[1, n] = circular_sd(p[slot], tables)
        out[2, n] = wrap(reported + np.pi) if mirrored[slot, sensor] else reported
        out[3, n] = 1.0 if mirrored[slot, sensor] != was else 0.0
        out[4, n] = memory.unlike[slot, sensor]
        changed += mirrored[slot, sensor] != was
    return changed


@njit(cache=True)
def predict(slots: Int64, at: float, zero: float, memory: FacingArrays, tables: Float64, out: Float64) -> None:
    """Predict the facings of people at a time.

    Args:
        slots: (bodies,) rows of the memory; −1 for an unknown person.
        at: the time on the common clock [s]; a time before a person's last frame counts as that.
        zero: yaw of the first bin [rad].
        memory: not changed.
        tables: (TABLE_ROWS, BINS), see `TABLE_ROWS`.
        out: (2, bodies) written: yaw and its standard deviation [rad]; NaN and infinity for an unknown person.
    """
    twice, kernel, near = np.empty(2 * BINS), np.empty(BINS), np.empty(BINS)
    later, later_angle = np.empty(BINS), np.empty(BINS)
    for n in range(len(slots)):
        if slots[n] < 0:
            out[0, n], out[1, n] = np.nan, np.inf
            continue
        for d in range(BINS):
            later[d], later_angle[d] = memory.p[slots[n], d], memory.p_angle[slots[n], d]
        steps = (at - memory.at_s[slots[n]]) / STEP_S
        if steps > 0.0:
            turning(steps, tables, kernel)
            turn_on(later, kernel, twice)
            turn_on(later_angle, kernel, twice)
        out[0, n] = wrap(most_likely_angle(later, later_angle, tables, near) + zero)
        out[1, n] = circular_sd(later, tables)
