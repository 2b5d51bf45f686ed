"""Quality metrics of a skeleton over time, without ground truth (docs/evaluation.md, *Fused skeleton*).

Positions are (frames, joints, 3) of the Kinect v2's joints, y up [m], at ``at_s`` (frames,), strictly rising.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.angles import wrap
from mocapella.model.topology import topology

Float64 = NDArray[np.float64]

SLIDE_OVER: Final = 0.1
"""Interval over which the speed of an ankle is measured [s]."""
HEADING_OVER: Final = 0.2
"""Interval, centred on the frame, over which the heading is measured [s]."""
MOVING: Final = 0.5
"""Smallest speed of a moving person [m/s]."""
REVERSED_BY: Final = np.radians(120.0)
REVERSED_WITHIN: Final = 0.4
"""Longest duration of a turn that counts as a reversal [s]."""
COLLAPSED: Final = 0.6
"""A narrower shoulder width, as a fraction of the median width, counts as collapsed."""
_LAG_STEPS = 12
"""Interval of a velocity in steps of 1/60 s, so long that the interpolation between frames does not matter."""
_KINECT = topology("kinect_v2")
_PARENTS, _CHILDREN = (list(ends) for ends in zip(*_KINECT.bones, strict=True))
_ROOT = _KINECT.parts["root"]
_ANKLES = [_KINECT.index("AnkleLeft"), _KINECT.index("AnkleRight")]
_LEFT = [_KINECT.index("ShoulderLeft"), _KINECT.index("HipLeft")]
_RIGHT = [_KINECT.index("ShoulderRight"), _KINECT.index("HipRight")]
_HORIZONTAL = [0, 2]


def facing_yaw(positions: Float64) -> Float64:
    """Return the yaw (...,) of skeletons (..., joints, 3), from shoulders and hips [rad]; 0 = +z, π/2 = +x.

    The yaw is NaN if one of these four joints is.
    """
    across = (positions[..., _LEFT, :] - positions[..., _RIGHT, :]).sum(axis=-2)
    return np.asarray(np.arctan2(-across[..., 2], across[..., 0]))


def bone_length_variation(positions: Float64) -> float:
    """Return the coefficient of variation over time of the bones' lengths, mean over the bones.

    ``positions`` (frames, joints, 3) [m]. Frames without a bone do not count for that bone; the result is NaN if a
    bone is never known.
    """
    lengths = np.linalg.norm(positions[:, _PARENTS] - positions[:, _CHILDREN], axis=-1)
    return float((np.nanstd(lengths, axis=0) / np.nanmean(lengths, axis=0)).mean())


def jitter(positions: Float64) -> float:
    """Return the root mean square second difference of joints ``positions`` (frames, joints, 3) over frames [m].

    The frames count as evenly spaced. Differences with a NaN are left out; the result is NaN without any other.
    """
    second = positions[2:] - 2 * positions[1:-1] + positions[:-2]
    return float(np.sqrt(np.nanmean((second**2).sum(axis=-1))))


def foot_slide(positions: Float64, at_s: Float64) -> float:
    """Return the mean horizontal speed of the slower ankle, each over the last `SLIDE_OVER` seconds [m/s].

    Args:
        positions: (frames, joints, 3), y up [m]; frames with an ankle that is NaN are left out.
        at_s: (frames,) times, strictly rising [s].
    """
    now = at_s >= at_s[0] + SLIDE_OVER
    speeds = [
        np.linalg.norm(
            (positions[now, ankle] - _at(at_s[now] - SLIDE_OVER, at_s, positions[:, ankle]))[:, _HORIZONTAL], axis=-1
        )
        for ankle in _ANKLES
    ]
    return float(np.nanmean(np.minimum(*speeds)) / SLIDE_OVER)


def shoulder_collapse(positions: Float64) -> float:
    """Return the fraction of frames with shoulders closer than `COLLAPSED` times their median distance, 0 to 1.

    ``positions`` (frames, joints, 3) [m]; a frame with a shoulder that is NaN counts as not collapsed.
    """
    width = np.linalg.norm(positions[:, _LEFT[0]] - positions[:, _RIGHT[0]], axis=-1)
    return float((width < COLLAPSED * np.nanmedian(width)).mean())


def facing_against_motion(positions: Float64, at_s: Float64) -> float:
    """Return the fraction of the frames faster than `MOVING` with a facing more than 90° off the heading, 0 to 1.

    The result is NaN if no frame is as fast.

    Args:
        positions: (frames, joints, 3), y up [m].
        at_s: (frames,) times, strictly rising [s].
    """
    half = HEADING_OVER / 2
    root = positions[:, _ROOT]
    velocity = (_at(at_s + half, at_s, root) - _at(at_s - half, at_s, root)) / HEADING_OVER
    moving = np.hypot(velocity[:, 0], velocity[:, 2]) > MOVING
    yaw = facing_yaw(positions)
    along = velocity[:, 0] * np.sin(yaw) + velocity[:, 2] * np.cos(yaw)
    return float((along[moving] < 0).mean()) if moving.any() else float("nan")


def facing_away(positions: Float64, towards: Float64) -> float:
    """Return the fraction of frames with a facing more than 90° away from a point, 0 to 1.

    Args:
        positions: (frames, joints, 3), y up [m]; a frame with an unknown facing counts as not away.
        towards: (3,) the point, in the same coordinates [m].
    """
    yaw = facing_yaw(positions)
    sight = towards - positions[:, _ROOT]
    return float((sight[:, 0] * np.sin(yaw) + sight[:, 2] * np.cos(yaw) < 0).mean())


def yaw_reversals(positions: Float64, at_s: Float64) -> int:
    """Count turns of the facing by more than `REVERSED_BY` within `REVERSED_WITHIN`, without overlaps.

    Args:
        positions: (frames, joints, 3), y up [m].
        at_s: (frames,) times, strictly rising [s].
    """
    return reversals(facing_yaw(positions), at_s)


def reversals(yaw: Float64, at_s: Float64) -> int:
    """Count fast turns of a facing ``yaw`` (frames,) [rad] at times ``at_s`` (frames,) [s].

    A reversal is a change by more than `REVERSED_BY` within `REVERSED_WITHIN`. A yaw that is NaN is no reversal.
    """
    count, start = 0, 0
    for i in range(1, len(yaw)):
        while at_s[i] - at_s[start] > REVERSED_WITHIN:
            start += 1
        if (np.abs(wrap(yaw[i] - yaw[start:i])) > REVERSED_BY).any():
            count, start = count + 1, i
    return count


def label_flips(positions: Float64) -> int:
    """Count the frames in which a skeleton is nearer to the previous frame's if left and right are swapped.

    ``positions`` (frames, joints, 3) [m]; a frame counts only if all joints of both are known.
    """
    before, now = positions[:-1], positions[1:]
    straight = np.linalg.norm(now - before, axis=-1).mean(axis=-1)
    crossed = np.linalg.norm(now - before[:, list(_KINECT.mirror)], axis=-1).mean(axis=-1)
    return int((crossed < straight).sum())


def lag(positions: Float64, raw: Float64, at_s: Float64, most: float = 0.3) -> float:
    """Return the lag of a smoothed skeleton behind the raw one: the delay with the most similar joint velocities [s].

    Args:
        positions, raw: (frames, joints, 3) at the same times [m]; NaN is taken as 0.
        at_s: (frames,) strictly rising [s].
        most: delays below this are tried, in steps of 5 ms from 0 [s].

    Returns:
        The lag; NaN if the frames last less than about ``most`` + 0.2 s.
    """
    grid = np.arange(at_s[0] + most, at_s[-1], 1 / 60)
    if len(grid) <= _LAG_STEPS:
        return float("nan")

    def velocities(values: Float64, at: Float64) -> Float64:
        flat = np.nan_to_num(values.reshape(len(values), -1))
        there = np.stack([np.interp(at, at_s, column) for column in flat.T], axis=1)
        return np.asarray(there[_LAG_STEPS:] - there[:-_LAG_STEPS])

    moved = velocities(positions, grid)
    delays = np.arange(0, most, 0.005)
    errors = [float(((moved - velocities(raw, grid - delay)) ** 2).sum()) for delay in delays]
    return float(delays[int(np.argmin(errors))])


def _at(times: Float64, at_s: Float64, points: Float64) -> Float64:
    """Interpolate points (frames, 3) linearly; return (times, 3)."""
    return np.stack([np.interp(times, at_s, column) for column in points.T], axis=1)


def rising(at_s: Float64, *values: Float64) -> Sequence[Float64]:
    """Sort samples by time, and keep the first of those with the same time.

    Args:
        at_s: (frames,) times [s].
        values: arrays (frames, ...) of samples.

    Returns:
        The strictly rising times, and each of ``values`` in the same order.
    """
    _, first = np.unique(at_s, return_index=True)
    return (at_s[first], *(value[first] for value in values))
