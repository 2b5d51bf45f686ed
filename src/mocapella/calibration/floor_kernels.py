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
HEAD_SHARE = 0.425
"""Factor c: the centre of mass is from the feet in the direction (root − feet) + c · (head − root).

From the masses of segments in D. A. Winter, *Biomechanics and Motor Control of Human Movement* (2009), table 4.1, with
trunk and arms between root and head, and the legs between root and feet.
"""
LEANS_COS = 0.94
"""Cosine of the largest angle of an upright back with the direction from the feet to the centre of mass (20°)."""
STRETCHED = 1.15
"""Least distance of root and feet with stretched legs, in lengths from root to head."""
LEAST_BACK_M = 0.2
"""Least distance of head and root of a body that shows a direction [m]."""
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
    """Write a frame's feet, and add each body's lower foot, if it stands, to the sums of `floor.FloorFromFeet`.

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
            _add_upright(back, p[root], p[head], feet[i])
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
def _add_upright(back: Float64, root: Float64, head: Float64, feet: Float64) -> None:
    """Add the direction of a body that is vertical, if any, to ``back`` (4,) of `floor.FloorFromFeet`.

    It is that of the back; but where people squat or bend, the centre of mass is above the feet instead. Where these
    two differ by more than `LEANS_COS`, the second is used if the legs are stretched; else people may sit, and the one
    nearer to the sensor's own vertical is used: sensors are about level, or upside down.

    Args:
        back: updated.
        root, head: (3,) [m].
        feet: (feet, 3), NaN where not seen [m].
    """
    x, y, length, reach, legs, dot, seen = np.empty(3), np.empty(3), 0.0, 0.0, 0.0, 0.0, 0
    for k in range(len(feet)):
        seen += np.isfinite(feet[k, 0])
    for m in range(3):
        below = 0.0
        for k in range(len(feet)):
            if np.isfinite(feet[k, 0]):
                below += feet[k, m] / seen
        x[m] = head[m] - root[m]
        leg = root[m] - below
        y[m] = leg + HEAD_SHARE * x[m]
        length += x[m] * x[m]
        reach += y[m] * y[m]
        legs += leg * leg
        dot += x[m] * y[m]
    length, reach, legs = np.sqrt(length), np.sqrt(reach), np.sqrt(legs)
    if not length > 0.0:
        return
    leans = dot < LEANS_COS * length * reach and (legs > STRETCHED * length or abs(y[1]) * length > abs(x[1]) * reach)
    for m in range(3):
        back[m] += BACK_STEP_S * (y[m] / reach if leans else x[m] / length)
    back[3] += BACK_STEP_S


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


@njit(cache=True)
def heads_up(positions: Float64, states: NDArray[np.uint8], root: int, head: int, up: Float64, cosine: float) -> int:
    """Return how many bodies have the head above the root, less those that have it below.

    Bodies do not count whose back is off the vertical by an angle with a cosine below ``cosine``, or shorter than
    `LEAST_BACK_M`, nor those of which the sensor does not measure both joints.

    Args:
        positions: (bodies, joints, 3) in the sensor's frame [m].
        states: (bodies, joints) `JointState`.
        root, head: indices of the joints.
        up: (3,) unit vector upwards.
        cosine: the least cosine.
    """
    count = 0
    for i in range(len(positions)):
        p = positions[i]
        if not (_seen(p[root], states[i, root]) and _seen(p[head], states[i, head])):
            continue
        length = _distance(p[head], p[root])
        above = 0.0
        for m in range(3):
            above += (p[head, m] - p[root, m]) * up[m]
        if length > LEAST_BACK_M and abs(above) > cosine * length:
            count += 1 if above > 0.0 else -1
    return count
