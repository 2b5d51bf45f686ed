"""Compiled steps of `mocapella.fusion.weighted_mean`; importing this module imports numba.

Inverse variance weighting of several sensors' views of one person's joints, with Student-t weights, and tracking of
each view's offset from the mean.

Views are (views, joints, 3) positions [m]; their variances are (views, joints) [m²], infinite where a view does not
have a joint.
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.model.observations import JointState

Float64 = NDArray[np.float64]

_NOT_TRACKED, _INFERRED = int(JointState.NOT_TRACKED), int(JointState.INFERRED)
_REFERENCE_M = 2.0
_AXES = 3.0


@njit(cache=True)
def joint_variances(states: NDArray[np.uint8], sd: float, inferred_factor: float, added: float, out: Float64) -> None:
    """Compute the variance of a coordinate of each joint of one view.

    Args:
        states: (joints,) `JointState`.
        sd: standard deviation of a tracked joint's coordinate, see `sd_at` [m].
        inferred_factor: factor of the standard deviation of an inferred joint.
        added: variance that is added, because of the view's age [m²].
        out: (joints,) written [m²]; infinite where not tracked.
    """
    for j in range(len(states)):
        if states[j] == _NOT_TRACKED:
            out[j] = np.inf
        else:
            own = sd * inferred_factor if states[j] == _INFERRED else sd
            out[j] = own * own + added


@njit(cache=True)
def sd_at(sd: float, distance: float, clipped: bool, clipped_factor: float) -> float:
    """Return the standard deviation of a tracked joint's coordinate, which grows with the square of the distance [m].

    Args:
        sd: standard deviation at a distance of 2 m [m].
        distance: from the sensor to the body; less than 0.5 m counts as 0.5 m [m].
        clipped: whether the body is cut off at an edge of the image.
        clipped_factor: factor for such a body.
    """
    there = sd * max(distance / _REFERENCE_M, 0.25) ** 2
    return there * clipped_factor if clipped else there


@njit(cache=True)
def fuse(
    views: Float64,
    variances: Float64,
    expected: Float64,
    expected_variances: Float64,
    nu: float,
    mean: Float64,
    variance: Float64,
) -> None:
    """Compute the mean of the views by inverse variance, see `mocapella.fusion.weighted_mean.weighted_mean`.

    Args:
        views: (views, joints, 3) [m]; NaN where not seen.
        variances: (views, joints) variance of a coordinate [m²]; infinite where not seen.
        expected, expected_variances: (joints, 3), (joints,) predicted joints [m], [m²]; NaN where unknown.
        nu: degrees of freedom of the Student-t weight, which lowers views far from the prediction; infinity disables
            it.
        mean, variance: (joints, 3), (joints,) written [m], [m²]; NaN and infinity where no view has the joint.
    """
    count, joints = variances.shape
    weights = np.empty(count)
    for j in range(joints):
        total, x, y, z = 0.0, 0.0, 0.0, 0.0
        known = np.isfinite(expected[j, 0]) and np.isfinite(nu)
        for i in range(count):
            weights[i] = 0.0
            seen = np.isfinite(views[i, j, 0]) and np.isfinite(views[i, j, 1]) and np.isfinite(views[i, j, 2])
            if not seen or not np.isfinite(variances[i, j]):
                continue
            w = 1.0 / variances[i, j]
            if known:
                away = 0.0
                for k in range(3):
                    away += (views[i, j, k] - expected[j, k]) ** 2
                surprise = away / (variances[i, j] + expected_variances[j])
                w *= (nu + _AXES) / (nu + max(surprise, _AXES))
            weights[i] = w
            total += w
            x += w * views[i, j, 0]
            y += w * views[i, j, 1]
            z += w * views[i, j, 2]
        if total > 0.0:
            mean[j, 0], mean[j, 1], mean[j, 2] = x / total, y / total, z / total
            spread = 0.0
            for i in range(count):
                if weights[i] > 0.0:
                    for k in range(3):
                        spread += weights[i] * (views[i, j, k] - mean[j, k]) ** 2
            variance[j] = 1.0 / total + spread / (total * _AXES)
        else:
            mean[j] = np.nan
            variance[j] = np.inf


@njit(cache=True)
def follow_offsets(offsets: Float64, views: Float64, mean: Float64, step: float) -> None:
    """Update the views' offsets from the mean, in place; see `mocapella.fusion.weighted_mean.learn_offsets`.

    Args:
        offsets: (views, joints, 3) updated [m].
        views: (views, joints, 3) not corrected [m]; where NaN, the offset stays. The offset of an only view fades to 0.
        mean: (joints, 3) mean of the uncorrected views [m].
        step: learning rate, 0 to 1: fraction of the way from an offset to its present value.
    """
    count, joints = offsets.shape[:2]
    for j in range(joints):
        seen = 0
        for i in range(count):
            seen += np.isfinite(views[i, j, 0])
        for i in range(count):
            if np.isfinite(views[i, j, 0]):
                for k in range(3):
                    now = views[i, j, k] - mean[j, k] if seen > 1 else 0.0
                    offsets[i, j, k] += step * (now - offsets[i, j, k])
