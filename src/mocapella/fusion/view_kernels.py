"""Compiled steps of `mocapella.fusion.weighted_mean`; importing this module imports numba.

Inverse variance weighting of several sensors' views of one person's joints, with Student-t weights, and tracking of
each view's offset from the mean.

Views are (views, joints, 3) positions [m]; their variances are (views, joints) [m²], infinite where a view does not
have a joint.
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position
from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.model.observations import JointState

Float64 = NDArray[np.float64]

_NOT_TRACKED, _INFERRED = int(JointState.NOT_TRACKED), int(JointState.INFERRED)
_REFERENCE_M = 2.0
_AXES = 3.0


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
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


class ViewLanes(NamedTuple):
    """Views of one person, joint by joint, with the views of a joint side by side: (…, joints, views).

    Attributes:
        apart: (3, joints, views) position minus the predicted joint, or minus the origin without a prediction [m]; 0
            where not seen.
        offsets: (3, joints, views) learnt offset of the view from the mean [m].
        variances: (joints, views) variance of a coordinate [m²]; positive, and arbitrary where not seen.
        there: (joints, views) 1 where the view has the joint; 0 where not.
        weights: (joints, views) workspace.
    """

    apart: Float64
    offsets: Float64
    variances: Float64
    there: Float64
    weights: Float64


@njit(cache=True, error_model="numpy")
def fuse_lanes(
    lanes: ViewLanes, count: int, expected: Float64, expected_variances: Float64, nu: float, step: float,
    mean: Float64, variance: Float64,
) -> None:  # fmt: skip
    """Fuse the first ``count`` views, learn their offsets from the mean, and fuse the views without their offsets.

    See `mocapella.fusion.weighted_mean.weighted_mean` and `mocapella.fusion.weighted_mean.learn_offsets`. The loops
    over views choose between values and do not branch, so that the compiler vectorises those without sums.

    Args:
        lanes: the views; offsets are updated, and subtracted from the positions.
        count: number of views, at least 1.
        expected: (joints, 3) predicted joints [m]; NaN where unknown.
        expected_variances: (joints, …) the first column is the variance of a predicted coordinate [m²].
        nu: degrees of freedom of the Student-t weight, which lowers views far from the prediction; infinity disables
            it.
        step: learning rate of the offsets, 0 to 1.
        mean, variance: (joints, 3), (joints,) written [m], [m²]; NaN and infinity where no view has the joint.
    """
    apart, offsets, variances, there, weights = lanes
    dx, dy, dz, ox, oy, oz = apart[0], apart[1], apart[2], offsets[0], offsets[1], offsets[2]
    robust = np.isfinite(nu)
    for j in range(len(there)):
        known = np.isfinite(expected[j, 0])
        doubt, gate, freedom = expected_variances[j, 0], 1.0, nu
        if not (known and robust):
            doubt, gate, freedom = 0.0, 0.0, 1.0
        weigh_views(dx, dy, dz, variances, there, weights, j, count, doubt, gate, freedom)
        total, x, y, z, seen = 0.0, 0.0, 0.0, 0.0, 0.0
        for n in range(count):
            w = weights[j, n]
            total += w
            x += w * dx[j, n]
            y += w * dy[j, n]
            z += w * dz[j, n]
            seen += there[j, n]
        if not total > 0.0:
            mean[j, 0], mean[j, 1], mean[j, 2], variance[j] = np.nan, np.nan, np.nan, np.inf
            continue
        several = 1.0 if seen > 1.0 else 0.0  # the offset of a single view fades to 0
        follow_offset(ox, dx, there, j, count, x / total, several, step)
        follow_offset(oy, dy, there, j, count, y / total, several, step)
        follow_offset(oz, dz, there, j, count, z / total, several, step)
        weigh_views(dx, dy, dz, variances, there, weights, j, count, doubt, gate, freedom)
        total, x, y, z, square = 0.0, 0.0, 0.0, 0.0, 0.0
        for n in range(count):
            w, u, v, t = weights[j, n], dx[j, n], dy[j, n], dz[j, n]
            total += w
            x += w * u
            y += w * v
            z += w * t
        x, y, z = x / total, y / total, z / total
        for n in range(count):
            u, v, t = dx[j, n] - x, dy[j, n] - y, dz[j, n] - z
            square += weights[j, n] * (u * u + v * v + t * t)
        variance[j] = 1.0 / total + square / (total * _AXES)
        if known:
            x, y, z = x + expected[j, 0], y + expected[j, 1], z + expected[j, 2]
        mean[j, 0], mean[j, 1], mean[j, 2] = x, y, z


@njit(cache=True, error_model="numpy", forceinline=True)
def weigh_views(
    dx: Float64, dy: Float64, dz: Float64, variances: Float64, there: Float64, weights: Float64, j: int, count: int,
    doubt: float, gate: float, nu: float,
) -> None:  # fmt: skip
    """Write joint j's weight in each view: 1/σ² · (ν + 3) / (ν + max(d² / (σ² + doubt), 3)), with one division.

    Args:
        dx, dy, dz, variances, there, weights: the arrays of `ViewLanes`.
        j: index of the joint.
        count: number of views.
        doubt: variance of a predicted coordinate [m²].
        gate: 1; 0 for the weight 1/σ².
        nu: degrees of freedom ν of the Student-t weight.
    """
    for n in range(count):
        x, y, z, own = dx[j, n], dy[j, n], dz[j, n], variances[j, n]
        both = own + doubt
        away, usual = gate * (x * x + y * y + z * z), _AXES * both
        away = away if away > usual else usual
        weights[j, n] = there[j, n] * (nu + _AXES) * both / (own * (nu * both + away))


@njit(cache=True, error_model="numpy", forceinline=True)
def follow_offset(
    offsets: Float64, apart: Float64, there: Float64, j: int, count: int, mean: float, several: float, step: float
) -> None:
    """Update joint j's offsets along one axis, and subtract them from the positions.

    Args:
        offsets, apart, there: the arrays of `ViewLanes`, of one axis.
        j: index of the joint.
        count: number of views.
        mean: mean of ``apart`` [m].
        several: 1; 0 if a single view has the joint.
        step: learning rate of the offsets, 0 to 1.
    """
    for n in range(count):
        d, o = apart[j, n], offsets[j, n]
        o += there[j, n] * step * (several * (d - mean) - o)
        offsets[j, n] = o
        apart[j, n] = there[j, n] * (d - o)


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
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
