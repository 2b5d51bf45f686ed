"""Compiled step of `mocapella.calibration.floor` for each frame; importing this module imports numba.

It adds a frame's standing feet to the moments from which the floor's plane is fitted by least squares.
"""

# ruff: noqa: PLR0917 - compiled functions take arrays by position
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.floor import (
    FOOT_HEIGHT_M,
    OUTLIER_M,
    STANCE_S,
    STANDS_BELOW_M_S,
    FeetOfFrame,
    FloorJoints,
)
from mocapella.compiled import njit

Float64 = NDArray[np.float64]

LONGEST_STEP = 0.3
"""Longest time between two views of a foot for which its motion is measured [s]."""
BACK_STEP_S = 0.03
"""Time that each frame adds to the weight of the back directions [s]."""
TRACKED = 2
"""Value of `JointState.TRACKED`."""


@njit(cache=True)
def stand(
    sums: Float64,
    back: Float64,
    plane: Float64,
    before: FeetOfFrame,
    now: FeetOfFrame,
    dt: float,
    positions: Float64,
    states: NDArray[np.uint8],
    joints: FloorJoints,
) -> None:
    """Write the feet of a frame, and add the standing ones to the sums of `floor.FloorFromFeet`.

    Args:
        sums, back: (10,) and (4,) of `floor.FloorFromFeet`, updated.
        plane: (4,) of `floor.FloorFromFeet`; 0 while the floor is unknown.
        before: the previous frame.
        now: this frame; its ids are read, its feet are written.
        dt: time between the frames [s].
        positions: (bodies, joints, 3) in the sensor's frame [m].
        states: (bodies, joints) `JointState`.
        joints: the joints that are used.
    """
    ids, feet, foot_joints, root, head = now.ids, now.positions, joints.feet, joints.root, joints.head
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
                    back[m] += BACK_STEP_S * (p[head, m] - p[root, m]) / length
                back[3] += BACK_STEP_S
        # Only the lower foot: the other one may be lifted and at rest.
        lowest, least = 0, np.inf
        for k in range(len(foot_joints)):
            height = back[0] * feet[i, k, 0] + back[1] * feet[i, k, 1] + back[2] * feet[i, k, 2]
            if height < least:
                lowest, least = k, height
        if not 0.0 < dt < LONGEST_STEP:
            continue
        for b in range(len(before.ids)):
            if before.ids[b] == ids[i]:
                _add(sums, plane, before.positions[b, lowest], feet[i, lowest], dt)


@njit(cache=True)
def _seen(p: Float64, state: int) -> bool:
    finite: bool = np.isfinite(p[0]) and np.isfinite(p[1]) and np.isfinite(p[2])
    there: bool = p[0] != 0.0 or p[1] != 0.0 or p[2] != 0.0
    return state == TRACKED and finite and there


@njit(cache=True)
def _distance(p: Float64, q: Float64) -> float:
    distance: float = np.sqrt((p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2)
    return distance


@njit(cache=True)
def _add(sums: Float64, plane: Float64, earlier: Float64, x: Float64, dt: float) -> None:
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
