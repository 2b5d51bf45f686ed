"""Conventions of Azure Kinect Body Tracking, which its live node and the reader of its files share."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.model.observations import JointState
from mocapella.model.topology import topology

AZURE_KINECT: Final = topology("azure_kinect")
"""The joints, in the order of the SDK."""
TO_CAMERA_SPACE: Final = (-1e-3, -1e-3, 1e-3)
"""(3,) factors of the depth camera's x right, y down, z forward [mm] that give camera space [m]."""
STATES: Final = np.array(
    [JointState.NOT_TRACKED, JointState.INFERRED, JointState.TRACKED, JointState.TRACKED], np.uint8
)
"""State for each confidence level: none, low, medium, high."""


def camera_space(positions_mm: NDArray[Any]) -> NDArray[np.float32]:
    """Convert positions (…, 3) of the depth camera, x right, y down, z forward [mm], to camera space [m]."""
    return np.asarray(positions_mm.astype(np.float64) * TO_CAMERA_SPACE, np.float32)
