"""The hot steps of `mocapella.fusion.weighted_mean`, compiled; importing this module imports numba.

Views are (views, joints, 3), their variances (views, joints) with infinity where a view does not have a joint.
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position
from __future__ import annotations

import numpy as np

from mocapella.compiled import njit
from mocapella.model.observations import JointState

_NOT_TRACKED, _INFERRED = int(JointState.NOT_TRACKED), int(JointState.INFERRED)
_REFERENCE_M = 2.0
_AXES = 3.0


@njit(cache=True)
def joint_variances(states, sd, inferred_factor, added, out):
    """`view_variances` of one view, into ``out`` (joints,): ``sd`` is that of a tracked joint there [m]."""
    for j in range(len(states)):
        if states[j] == _NOT_TRACKED:
            out[j] = np.inf
        else:
            own = sd * inferred_factor if states[j] == _INFERRED else sd
            out[j] = own * own + added


@njit(cache=True)
def sd_at(sd, distance, clipped, clipped_factor):
    """What a tracked joint's coordinate may be wrong by at a distance [m]."""
    there = sd * max(distance / _REFERENCE_M, 0.25) ** 2
    return there * clipped_factor if clipped else there


@njit(cache=True)
def fuse(views, variances, expected, expected_variances, nu, mean, variance):
    """`weighted_mean` into ``mean`` (joints, 3) and ``variance`` (joints,)."""
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
def follow_offsets(offsets, views, mean, step):
    """`learn_offsets` in place: by ``step`` of the way."""
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
