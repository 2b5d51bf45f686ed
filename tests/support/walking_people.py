"""Errors of a sensor's pose, and the published walkers (`mocapella.testing`) under the names that the tests use."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.rigid import inverse
from mocapella.testing.walking import BACK, FRONT, KINECT_V2, LEFT, MIRROR, RATE_HZ, SIDE, Walker, standing_at
from mocapella.testing.walking import WalkerSensor as Sensor

Float64 = NDArray[np.float64]

__all__ = [
    "BACK", "FRONT", "KINECT_V2", "LEFT", "MIRROR", "RATE_HZ", "SIDE", "Sensor", "Walker", "errors", "standing_at",
]  # fmt: skip


def errors(T: Float64, truth: Float64) -> tuple[float, float]:
    """Return the position error [m] and the rotation error [rad] of a rigid motion."""
    d = inverse(truth) @ T
    angle = np.arccos(np.clip((np.trace(d[:3, :3]) - 1) / 2, -1.0, 1.0))
    return float(np.linalg.norm(T[:3, 3] - truth[:3, 3])), float(angle)
