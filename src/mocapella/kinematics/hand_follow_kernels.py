"""Kernels that follow a hand from one instant to the next: prediction, fit without outliers, and the motion's velocity.

`mocapella.kinematics.hand_tracker` describes the steps, `hand_fit_kernels` the fit itself. Importing this module
imports numba.
"""

# ruff: noqa: PLR0912, PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.geometry.alignment_kernels import diagonalise, rotation_of
from mocapella.geometry.cholesky_kernels import inverted
from mocapella.geometry.turn_kernels import FIRST, turn_between, turned
from mocapella.kinematics.hand_fit_kernels import digit_angles, digit_points, fit, misfits, within
from mocapella.kinematics.hand_kernels import hand_closed_form, limit

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

SPEED_S = 1 / 60
"""Time for which an unknown speed of a joint or the palm lasts; then another follows [s]."""
LEAST_SD_M = 1e-6
"""Least standard deviation of a marker, so that the normal equations can be solved [m]."""
LEAST_SPREAD_M = 0.005
"""Least extent of the base's markers across their longest direction, for a pose from them alone: the root of their
summed squares [m]."""
MOST_REJECTED = 2
"""Number of outliers that are rejected in one instant."""
FEWEST = 4
"""Largest number of markers without any rejection."""


class HandNumbers(NamedTuple):
    """A hand and its settings as the kernels take them.

    Attributes:
        digits: (5, `hand_kernels.DIGIT`) bones and limits.
        mirror: −1 for a left hand, else 1.
        layout: (k, 3) the base's markers in the palm's frame of a right hand [m].
        columns, gains: (5, 5) index and factor of the free angle that each of a digit's angles follows; −1: held at 0.
        c_max: limit of the thumb's opposition [rad].
        mean, prior: (n,), (n, n) mean and inverse covariance of the free angles.
        rates: (6 + n,) standard deviations of unpredicted speeds, of the palm [m/s, rad/s] and the angles [rad/s].
        memory_s: time constant of the decay of velocities [s].
        doubtful_sd: distance of a marker from the fit above which another start is tried, too [standard deviations].
        outlier_sd: distance above which a marker is rejected [standard deviations].
        iterations: largest number of iterations of a fit.
    """

    digits: Float64
    mirror: float
    layout: Float64
    columns: Int64
    gains: Float64
    c_max: float
    mean: Float64
    prior: Float64
    rates: Float64
    memory_s: float
    doubtful_sd: float
    outlier_sd: float
    iterations: int


class MovingHand(NamedTuple):
    """Pose, angles, velocities and covariance of a hand.

    Attributes:
        T: (4, 4) motion from the palm's frame to the world [m].
        z: (n,) free angles [rad].
        velocity: (6 + n,) of the palm, in its frame [m/s, rad/s], and of the angles [rad/s].
        covariance: (6 + n, 6 + n) of the palm's twist and the angles.
    """

    T: Float64
    z: Float64
    velocity: Float64
    covariance: Float64


@njit(cache=True, error_model="numpy")
def informed(points: Float64, covariances: Float64, clean: Float64, information: Float64) -> None:
    """Write the inverse covariances of measured markers; 0 of markers that are not used.

    A marker is not used if its point is not finite, or its covariance is not positive definite.

    Args:
        points: (m, 3) [m].
        covariances: (m, 3, 3) [m²].
        clean: (m, 3) written: the points, 0 where not finite.
        information: (m, 3, 3) written [1/m²].
    """
    N, V = np.empty((3, 3)), np.empty((3, 3))
    for i in range(len(points)):
        usable = True
        for a in range(3):
            p = points[i, a]
            clean[i, a] = p if math.isfinite(p) else 0.0
            usable = usable and abs(p) < 1e6 and covariances[i, a, a] > 0.0
            for b in range(3):
                N[a, b] = 0.5 * (covariances[i, a, b] + covariances[i, b, a])
                usable = usable and math.isfinite(N[a, b])
                information[i, a, b] = 0.0
        if not usable:
            continue
        diagonalise(N, V)
        least = min(N[0, 0], N[1, 1], N[2, 2])
        if not least > 1e-9 * max(N[0, 0], N[1, 1], N[2, 2]):
            continue
        for k in range(3):
            w = 1.0 / max(N[k, k], LEAST_SD_M**2)
            for a in range(3):
                for b in range(3):
                    information[i, a, b] += w * V[a, k] * V[b, k]


@njit(cache=True, error_model="numpy")
def ahead(hand: HandNumbers, last: MovingHand, dt: float, T: Float64, z: Float64) -> None:
    """Write the pose T (4, 4) and free angles z (n,) that are predicted for a time dt [s] after the last instant."""
    part = hand.memory_s * -math.expm1(-dt / hand.memory_s)
    v, R, new = last.velocity, np.empty(9), np.empty(9)
    for i in range(3):
        T[i, 3] = last.T[i, 3]
        for k in range(3):
            R[3 * i + k] = last.T[i, k]
            T[i, 3] += last.T[i, k] * part * v[k]
    turned(R, FIRST, part * v[3], part * v[4], part * v[5], new)
    for i in range(3):
        T[3, i] = 0.0
        for k in range(3):
            T[i, k] = new[3 * i + k]
    T[3, 3] = 1.0
    for k in range(len(z)):
        z[k] = last.z[k] + part * v[6 + k]
    within(hand.digits, hand.columns, hand.gains, z, hand.c_max)


@njit(cache=True, error_model="numpy")
def predict(hand: HandNumbers, last: MovingHand, dt: float, new: MovingHand, certainty: Float64) -> None:
    """Write the hand that is predicted for a time dt [s] after the last instant.

    Args:
        hand: the hand.
        last: the hand at the last instant.
        dt: time since then, not negative [s].
        new: written.
        certainty: (6 + n, 6 + n) written: the inverse of its covariance; 0 if there is none.
    """
    ahead(hand, last, dt, new.T, new.z)
    n, decay, damping = len(last.velocity), math.exp(-dt / hand.memory_s), 0.0
    for i in range(n):
        new.velocity[i] = last.velocity[i] * decay
        for k in range(n):
            new.covariance[i, k] = last.covariance[i, k]
        new.covariance[i, i] += hand.rates[i] ** 2 * dt * SPEED_S
    if not inverted(new.covariance, damping, certainty):
        for i in range(n):
            for k in range(n):
                certainty[i, k] = 0.0


@njit(cache=True, error_model="numpy")
def follow(
    hand: HandNumbers, points: Float64, kept: Float64, before: MovingHand, certainty: Float64, share: float,
    starts: Float64, starts_z: Float64, T: Float64, z: Float64, rejected: Int64,
) -> None:  # fmt: skip
    """Fit a hand to its markers from several starts, and reject outliers, the farthest first.

    If the only start leads to a bad fit, the palm's pose of three or more markers of the base, with the closed form of
    the fingers, is another start.

    Args:
        hand: the hand.
        points: (m, 3) markers, world [m]; finite.
        kept: (m, 3, 3) inverse covariances [1/m²], 0 where a marker is not used; 0 is written for outliers.
        before: the prediction.
        certainty: (6 + n, 6 + n) inverse covariance of the prediction; 0 without one.
        share: share of the prior's information that counts.
        starts, starts_z: (s, 4, 4), (s, n) initial poses and free angles, s ≥ 1.
        T, z: (4, 4), (n,) written: the fitted hand.
        rejected: (m,) counts, increased by 1 for an outlier.
    """
    n = len(z)
    direct, direct_z = np.empty((4, 4)), np.empty(n)
    prior, squared = np.empty((n, n)), np.empty(len(points))
    for i in range(n):
        for k in range(n):
            prior[i, k] = share * hand.prior[i, k]
    least = math.inf
    for s in range(len(starts)):
        least = _better(hand, points, kept, before, certainty, prior, starts[s], starts_z[s], T, z, least)
    worst = _worst(hand, points, kept, T, z, squared)
    has_direct = False
    if squared[worst] > hand.doubtful_sd**2 and len(starts) == 1:
        has_direct = direct_start(hand, points, kept, before.z, direct, direct_z)
        if has_direct:
            least = _better(hand, points, kept, before, certainty, prior, direct, direct_z, T, z, least)
            worst = _worst(hand, points, kept, T, z, squared)
    own, own_z = np.empty((4, 4)), np.empty(n)
    for _ in range(MOST_REJECTED):
        used = 0
        for i in range(len(points)):
            used += kept[i, 0, 0] > 0.0
        if not squared[worst] > hand.outlier_sd**2 or used <= FEWEST:
            break
        for a in range(3):
            for b in range(3):
                kept[worst, a, b] = 0.0
        rejected[worst] += 1
        for i in range(4):
            for k in range(4):
                own[i, k] = T[i, k]
        for k in range(n):
            own_z[k] = z[k]
        least = _better(hand, points, kept, before, certainty, prior, own, own_z, T, z, math.inf)
        for s in range(len(starts)):
            least = _better(hand, points, kept, before, certainty, prior, starts[s], starts_z[s], T, z, least)
        if has_direct:
            least = _better(hand, points, kept, before, certainty, prior, direct, direct_z, T, z, least)
        worst = _worst(hand, points, kept, T, z, squared)


@njit(cache=True, error_model="numpy")
def _better(
    hand: HandNumbers, points: Float64, information: Float64, before: MovingHand, certainty: Float64, prior: Float64,
    start: Float64, start_z: Float64, T: Float64, z: Float64, least: float,
) -> float:  # fmt: skip
    """Fit from a start; write the result into T and z if its cost is below ``least``; return the lesser cost."""
    R, t, angles, R0, t0 = np.empty(9), np.empty(3), np.empty(len(z)), np.empty(9), np.empty(3)
    for i in range(3):
        t[i], t0[i] = start[i, 3], before.T[i, 3]
        for k in range(3):
            R[3 * i + k], R0[3 * i + k] = start[i, k], before.T[i, k]
    for k in range(len(z)):
        angles[k] = start_z[k]
    cost = fit(
        hand.digits, hand.mirror, hand.layout, points, information, hand.columns, hand.gains, hand.c_max, hand.mean,
        prior, R0, t0, before.z, certainty, R, t, angles, hand.iterations,
    )  # fmt: skip
    if not cost < least:
        return least
    for i in range(3):
        T[i, 3], T[3, i] = t[i], 0.0
        for k in range(3):
            T[i, k] = R[3 * i + k]
    T[3, 3] = 1.0
    for k in range(len(z)):
        z[k] = angles[k]
    return float(cost)


@njit(cache=True, error_model="numpy")
def _worst(hand: HandNumbers, points: Float64, information: Float64, T: Float64, z: Float64, squared: Float64) -> int:
    """Write the squared Mahalanobis distances (m,) of the markers; return the index of the farthest."""
    R, t = np.empty(9), np.empty(3)
    for i in range(3):
        t[i] = T[i, 3]
        for k in range(3):
            R[3 * i + k] = T[i, k]
    misfits(hand.digits, hand.mirror, hand.layout, points, information, hand.columns, hand.gains, R, t, z, squared)
    worst = 0
    for i in range(1, len(squared)):
        if squared[i] > squared[worst]:
            worst = i
    return worst


@njit(cache=True, error_model="numpy")
def direct_start(
    hand: HandNumbers, points: Float64, information: Float64, start_z: Float64, T: Float64, z: Float64
) -> bool:
    """Align the palm to three or more markers of the base, and solve the fingers in closed form.

    Args:
        hand: the hand.
        points, information: (m, 3), (m, 3, 3) markers [m] and inverse covariances [1/m²]; 0 where not used.
        start_z: (n,) free angles of digits whose tips are not seen [rad].
        T, z: (4, 4), (n,) written.

    Returns:
        Whether the base's markers determine the palm.
    """
    base, total = 0, 0.0
    mean, mean_own, plain = np.zeros(3), np.zeros(3), np.zeros(3)
    for i in range(len(hand.layout)):
        w = _weight(information, 5 + i)
        base += w > 0.0
        total += w
        for a in range(3):
            own = hand.layout[i, a] * (hand.mirror if a == 0 else 1.0)
            mean[a] += w * points[5 + i, a]
            mean_own[a] += w * own
            plain[a] += own if w > 0.0 else 0.0
    if base < 3:
        return False
    S, N, V = np.zeros((3, 3)), np.zeros((3, 3)), np.empty((3, 3))
    for a in range(3):
        mean[a], mean_own[a], plain[a] = mean[a] / total, mean_own[a] / total, plain[a] / base
    for i in range(len(hand.layout)):
        w = _weight(information, 5 + i)
        if not w > 0.0:
            continue
        for a in range(3):
            own = hand.layout[i, a] * (hand.mirror if a == 0 else 1.0)
            for b in range(3):
                other = hand.layout[i, b] * (hand.mirror if b == 0 else 1.0)
                N[a, b] += (own - plain[a]) * (other - plain[b])
                S[a, b] += w * (own - mean_own[a]) * (points[5 + i, b] - mean[b])
    # The part across the longest direction: what keeps the palm from turning about it.
    diagonalise(N, V)
    low, high = min(N[0, 0], N[1, 1]), max(N[0, 0], N[1, 1])
    if not max(low, min(high, N[2, 2])) >= LEAST_SPREAD_M**2:
        return False
    rotation_of(S, T)
    for a in range(3):
        T[a, 3], T[3, a] = mean[a], 0.0
        for b in range(3):
            T[a, 3] -= T[a, b] * mean_own[b]
    T[3, 3] = 1.0
    _fingers(hand, points, information, start_z, T, z)
    return True


@njit(cache=True, error_model="numpy")
def _weight(information: Float64, i: int) -> float:
    """Return the weight of marker i, the trace of its inverse covariance [1/m²]; 0 if it is not used."""
    return float(information[i, 0, 0] + information[i, 1, 1] + information[i, 2, 2])


@njit(cache=True, error_model="numpy")
def _fingers(
    hand: HandNumbers, points: Float64, information: Float64, start_z: Float64, T: Float64, z: Float64
) -> None:
    """Write the free angles z (n,) in closed form for the tips that are used, in a palm at T (4, 4)."""
    targets, rows, q = np.empty((5, 3)), np.empty((5, 4)), np.empty(5)
    errors, reached = np.empty(5), np.empty(5, dtype=np.bool_)
    for digit in range(5):
        digit_angles(start_z, hand.columns, hand.gains, digit, q)
        limit(hand.digits[digit], q[0], q[1], q[2], q[3], rows[digit])
        for a in range(3):
            value = 0.0
            for b in range(3):
                value += T[b, a] * (points[digit, b] - T[b, 3])
            seen = information[digit, 0, 0] > 0.0
            targets[digit, a] = value * (hand.mirror if a == 0 else 1.0) if seen else math.nan
    hand_closed_form(hand.digits, targets, rows, errors, reached)
    for k in range(len(z)):
        z[k] = start_z[k]
    for digit in range(5):
        for k in range(5):
            column = hand.columns[digit, k]
            # A factor other than 1 is that of a joint that follows another.
            if column < 0 or (k == 3 and column == hand.columns[digit, 2]):
                continue
            if k < 4:
                z[column] = rows[digit, k]
            elif information[digit, 0, 0] > 0.0:
                z[column] = 0.0  # the closed form is that of a thumb whose second joint does not abduct


@njit(cache=True, error_model="numpy")
def move(hand: HandNumbers, last: MovingHand, dt: float, T: Float64, z: Float64, velocity: Float64) -> None:
    """Write the smoothed velocity (6 + n,) of a hand that moved to T (4, 4) and z (n,) in dt [s]; see `MovingHand`."""
    A, B, d = np.empty(9), np.empty(9), np.empty(6)
    for i in range(3):
        d[i] = 0.0
        for k in range(3):
            A[3 * i + k], B[3 * i + k] = last.T[i, k], T[i, k]
            d[i] += last.T[k, i] * (T[k, 3] - last.T[k, 3])
    d[3], d[4], d[5] = turn_between(A, FIRST, B)
    part = -math.expm1(-dt / (0.5 * hand.memory_s))
    for i in range(len(velocity)):
        measured = (d[i] if i < 6 else z[i - 6] - last.z[i - 6]) / dt
        velocity[i] = last.velocity[i] + part * (measured - last.velocity[i])


@njit(cache=True, error_model="numpy")
def place_landmarks(hand: HandNumbers, T: Float64, z: Float64, x: Float64) -> None:
    """Write the landmarks x (21, 3) of a posed hand, world [m]; T (4, 4), z (n,) as in `MovingHand`."""
    q, joints, axes = np.empty(5), np.empty((4, 3)), np.empty((5, 3))
    for c in range(3):
        x[0, c] = T[c, 3]
    for digit in range(5):
        digit_angles(z, hand.columns, hand.gains, digit, q)
        digit_points(hand.digits[digit], hand.mirror, q, joints, axes)
        for k in range(4):
            for c in range(3):
                x[1 + 4 * digit + k, c] = T[c, 3]
                for a in range(3):
                    x[1 + 4 * digit + k, c] += T[c, a] * joints[k, a]


@njit(cache=True, error_model="numpy")
def predicted_landmarks(hand: HandNumbers, last: MovingHand, dt: float, x: Float64) -> None:
    """Write the landmarks x (21, 3) that are predicted for a time dt [s] after ``last``, world [m]."""
    T, z = np.empty((4, 4)), np.empty(len(last.z))
    ahead(hand, last, dt, T, z)
    place_landmarks(hand, T, z, x)
