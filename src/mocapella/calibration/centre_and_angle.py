"""Position and facing of a standing body, and the transform from there to a world frame.

Source: the KinectMultiTrack thesis (2015), its calibration and equations 7 (to the world) and 8 (back).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.rigid import rigid, rotation_about_y
from mocapella.model.observations import JointState

Float64 = NDArray[np.float64]


def body_centre(positions: Float64, states: NDArray[np.uint8], *, inferred: bool = False) -> Float64:
    """Return the centre C of a body over some frames: the mean over frames of the mean of the tracked joints.

    Args:
        positions: (..., frames, joints, 3) [m].
        states: (..., frames, joints) `JointState`.
        inferred: whether inferred joints count, too, in frames with a tracked one.

    Returns:
        (..., 3) [m]; frames without a tracked joint do not count; NaN if no frame counts.
    """
    tracked = states == JointState.TRACKED
    counted = tracked
    if inferred:
        counted = tracked.any(axis=-1, keepdims=True) & (states != JointState.NOT_TRACKED)
    counts = counted.sum(axis=-1)
    sums = np.where(counted[..., None], positions, 0.0).sum(axis=-2)
    centres = sums / np.maximum(counts, 1)[..., None]
    frames = (counts > 0).sum(axis=-1)[..., None]
    total = centres.sum(axis=-2)
    return np.where(frames > 0, total / np.maximum(frames, 1), np.nan)


def shoulder_angle(left: Any, right: Any) -> Float64:
    """Return the angle θ of the shoulder line to the sensor's x axis.

    With D = Z_right − Z_left and W = X_right − X_left it is arctan(D / W) where W > 0, continued over the full circle
    where W ≤ 0 (side view, or labels of a turned back): atan2(D, W).

    Args:
        left, right: (..., 3) shoulders, camera space: x to the sensor's left, y up, z out of the lens [m].

    Returns:
        (...,) [rad], within [−π, π]; NaN where a shoulder is NaN.
    """
    across = np.asarray(right, dtype=np.float64) - np.asarray(left, dtype=np.float64)
    # On strided views numpy selects its vector code or the C library by memory alignment; their results differ in the
    # last bit, and a replay must be identical.
    depth, width = across[..., 2].copy(), across[..., 0].copy()
    return np.asarray(np.arctan2(depth, width))


def world_from_sensor(centre: Any, angle: Any) -> Float64:
    """Return the thesis' equation 7 as a matrix: p' = p − C, x = x'·cosθ + z'·sinθ, y = y', z = z'·cosθ − x'·sinθ.

    The centre becomes the origin and the line of the shoulders the world's x axis. Its `inverse` is equation 8.

    Args:
        centre: (..., 3) C [m].
        angle: (...,) θ [rad].

    Returns:
        (..., 4, 4) ``T_world_sensor``.
    """
    R = rotation_about_y(angle)
    C = np.asarray(centre, dtype=np.float64)
    return rigid(R, -(R @ C[..., None])[..., 0])
