"""The step of `mocapella.calibration.floor` for each frame, compiled; importing this module imports numba."""

# ruff: noqa: PLR0917 - compiled functions take arrays by position
from __future__ import annotations

import numpy as np

from mocapella.calibration.floor import FOOT_HEIGHT_M, OUTLIER_M, STANCE_S, STANDS_BELOW_M_S
from mocapella.compiled import njit

LONGEST_STEP = 0.3
"""A foot that was not seen for longer may have been anywhere [s]."""
LOOKED_AT = 0.03
"""What a frame adds to the seconds of backs [s]."""
TRACKED = 2
"""`JointState.TRACKED`."""


@njit(cache=True)
def stand(sums, back, plane, ids_before, feet_before, ids, feet, dt, positions, states, root, head, foot_joints):
    """Fill ``feet`` and add to ``sums`` and ``back``; all as in `floor.FloorFromFeet`.

    Args:
        dt: since the frame of ``feet_before`` [s].
        positions: (bodies, joints, 3); states: (bodies, joints); root, head: joints; foot_joints: (feet,).
    """
    for i in range(len(ids)):
        p, found = positions[i], 0
        for k in range(len(foot_joints)):
            there = _seen(p[foot_joints[k]], states[i, foot_joints[k]])
            found += there
            for m in range(3):
                feet[i, k, m] = p[foot_joints[k], m] if there else np.nan
        if not found:
            continue
        if _seen(p[root], states[i, root]) and _seen(p[head], states[i, head]):
            length = _distance(p[head], p[root])
            if length > 0.0:
                for m in range(3):
                    back[m] += LOOKED_AT * (p[head, m] - p[root, m]) / length
                back[3] += LOOKED_AT
        # The lower one: the other may be lifted and still.
        lowest, least = 0, np.inf
        for k in range(len(foot_joints)):
            height = back[0] * feet[i, k, 0] + back[1] * feet[i, k, 1] + back[2] * feet[i, k, 2]
            if height < least:
                lowest, least = k, height
        if not 0.0 < dt < LONGEST_STEP:
            continue
        for b in range(len(ids_before)):
            if ids_before[b] == ids[i]:
                _add(sums, plane, feet_before[b, lowest], feet[i, lowest], dt)


@njit(cache=True)
def _seen(p, state):
    finite = np.isfinite(p[0]) and np.isfinite(p[1]) and np.isfinite(p[2])
    return state == TRACKED and finite and (p[0] != 0.0 or p[1] != 0.0 or p[2] != 0.0)


@njit(cache=True)
def _distance(p, q):
    return np.sqrt((p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2)


@njit(cache=True)
def _add(sums, plane, earlier, x, dt):
    if not _distance(x, earlier) <= STANDS_BELOW_M_S * dt:
        return
    weight = dt / STANCE_S
    if plane[0] != 0.0 or plane[1] != 0.0 or plane[2] != 0.0:
        off = plane[0] * x[0] + plane[1] * x[1] + plane[2] * x[2] + plane[3] - FOOT_HEIGHT_M
        weight *= (OUTLIER_M**2 / (OUTLIER_M**2 + off * off)) ** 2
    sums[0] += weight
    at = 4
    for i in range(3):
        sums[1 + i] += weight * x[i]
        for k in range(i, 3):
            sums[at] += weight * x[i] * x[k]
            at += 1
