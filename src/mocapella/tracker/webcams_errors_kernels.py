"""Kernels of the uncertainty that the method ``webcams`` states; importing this module imports numba.

Errors of keypoint detectors change slowly: the same image of an elbow is wrong in the same way in the next frame. The
body's filter takes them for white noise, so its covariances are too small. A filter of gain K whose measurements have
errors of variance R and correlation ρ between updates has, in the steady state of x ← (1 − K) x + K e, the part

    N = K R / (2 − K) · (1 + r) / (1 − r),    r = ρ (1 − K)

of its variance from them, and white noise would give N with r = 0 (A. Gelb, Applied Optimal Estimation, 1974, section
4.5, *correlated measurement errors*). With P = K R for the filter's own variance P, the difference is added to it.
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.association.keypoint_rays import JOINTS
from mocapella.compiled import njit
from mocapella.tracker.webcams_memory import PeopleArrays

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
UInt8 = NDArray[np.uint8]

LEAST_GAIN = 0.2
"""Least gain of a joint; the covariance of a joint with a smaller one is not of its rays alone."""
UNSURE_WEIGHT = 0.1
"""Weight of an instant in the running mean of a joint's unpredicted speed."""
SHORT_S = 0.02
"""Time below which a prediction tells less of that speed, and more of the keypoints' own errors [s]."""


@njit(cache=True, error_model="numpy")
def widen(
    joints: Int64, origins: Float64, directions: Float64, sds_rad: Float64, weights: Float64, correlation: float,
    positions: Float64, support: UInt8, covariances: Float64,
) -> None:  # fmt: skip
    """Add the effect of slow detector errors to the covariances of the joints that two cameras agree about.

    Args:
        joints, origins, directions, sds_rad, weights: rays, as in `correct_by_rays`.
        correlation: of a keypoint's errors between the last update and this one, from 0 to 1.
        positions: (26, 3) the joints, world [m].
        support: (26,) number of cameras that agree about a joint.
        covariances: (26, 3, 3) changed [m²].
    """
    gains = np.zeros(JOINTS)
    for i in range(len(joints)):
        j, along, across = joints[i], 0.0, 0.0
        if not weights[i] > 0.0:
            continue
        C = covariances[j]
        for k in range(3):
            along += directions[i, k] * (positions[j, k] - origins[i, k])
            across += C[k, k]
            for m in range(3):
                across -= directions[i, k] * C[k, m] * directions[i, m]
        gains[j] += weights[i] * across / (3.0 * (sds_rad[i] * along) ** 2)
    for j in range(JOINTS):
        if support[j] < 2:
            continue
        gain = min(max(gains[j], LEAST_GAIN), 1.0)
        r = correlation * (1.0 - gain)
        factor = 1.0 + 2.0 * r / ((1.0 - r) * (2.0 - gain))
        for k in range(3):
            for m in range(3):
                covariances[j, k, m] *= factor


@njit(cache=True, error_model="numpy")
def follow_unpredicted(people: PeopleArrays, p: int, dt: float, predicted: Float64) -> None:
    """Update by how much the predictions of a person's joints are wrong, where two cameras agree about them.

    The keypoints' own errors look like a speed of themselves over the time: after late frames, which follow each other
    within a millisecond, like one of 20 m/s. So shorter times count less: as in the least-squares fit of squared errors
    by the squared times.

    Args:
        people: changed.
        p: row of the person.
        dt: time over which was predicted [s].
        predicted: (26, 3) the predicted joints, world [m]; NaN where not known.
    """
    if not dt > 0.0:
        return
    longer = max(dt, SHORT_S)
    part = (dt / longer) ** 2
    for j in range(JOINTS):
        square = 0.0
        for k in range(3):
            square += (people.positions[p, j, k] - predicted[j, k]) ** 2
        square /= 3.0 * longer * longer
        if people.support[p, j] >= 2 and square < math.inf:
            before = people.unpredicted[p, j]
            change = UNSURE_WEIGHT * part * (square - part * before)
            people.unpredicted[p, j] = before + change if before >= 0.0 else square


@njit(cache=True, error_model="numpy")
def stated_variance(
    people: PeopleArrays, p: int, j: int, at_s: float, ahead_s: float, covariance: Float64, seen: bool
) -> float:  # fmt: skip
    """Return the variance of a coordinate of a joint at an instant, or predicted beyond it [m²].

    The filter predicts without correlations between the degrees of freedom, hence more than its errors. The variance
    when two cameras last agreed, and by how much predictions over such a time were wrong, give another value; the
    smaller one counts.

    Args:
        people: the people.
        p: row of the person.
        j: the joint.
        at_s: time of the last instant [s].
        ahead_s: time since then [s].
        covariance: (3, 3) the filter's estimate or prediction [m²].
        seen: whether two cameras agree about the joint, now or a short time ago; else, and where no camera sees the
            joint now, the filter's value counts.
    """
    own = (covariance[0, 0] + covariance[1, 1] + covariance[2, 2]) / 3.0
    if not seen or people.support[p, j] == 0:
        return float(own)
    C, since_s = people.covariances[p, j], ahead_s
    other = (C[0, 0] + C[1, 1] + C[2, 2]) / 3.0
    if people.support[p, j] < 2:
        other, since_s = people.measured_variances[p, j], at_s + ahead_s - people.measured_s[p, j]
    other += people.unpredicted[p, j] * since_s * since_s
    return float(other if other < own else own)
