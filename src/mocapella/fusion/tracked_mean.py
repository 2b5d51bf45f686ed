"""Fuse skeletons by the mean of tracked joints (the thesis' *average skeleton*).

A baseline without uncertainties: `weighted_mean` is the method of the tracker ``default``.
"""

from __future__ import annotations

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.model.observations import JointState

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]


class FusedSkeletons(msgspec.Struct, frozen=True, eq=False):
    """Fused skeletons, one for each element of the leading axes.

    Attributes:
        positions: (..., joints, 3) in the views' frame [m]; NaN where not tracked.
        states: (..., joints) `JointState`.
    """

    positions: Float64
    states: UInt8


def tracked_mean(positions: Float64, states: UInt8) -> FusedSkeletons:
    """Return the mean of each joint over the views that track it, which fills in joints hidden from one sensor.

    If no view tracks a joint, it is the mean over the views that infer it, marked inferred; otherwise not tracked. So a
    joint's state is the best over the views, and the views in that state are averaged.

    Args:
        positions: (..., views, joints, 3), all in one frame [m]; at least one view. Joints that are not tracked may be
            NaN.
        states: (..., views, joints) `JointState`; in a missing view all joints are not tracked.
    """
    best = states.max(axis=-2)
    counted = (states == best[..., None, :]) & (states != JointState.NOT_TRACKED)
    counts = counted.sum(axis=-2)
    sums = np.where(counted[..., None], positions, 0.0).sum(axis=-3)
    fused = sums / np.maximum(counts, 1)[..., None]
    fused[counts == 0] = np.nan
    return FusedSkeletons(fused, best)
