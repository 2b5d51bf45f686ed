"""Check whether two cameras side by side are parallel, and advise how to turn the second one.

The formula of depth by disparity assumes parallel axes and rows at one height. Errors are given as the angles by which
to turn the second camera, and as the vertical disparity of a far point.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.lens import undistort
from mocapella.geometry.rigid import inverse
from mocapella.model.camera import PlacedCamera

Float64 = NDArray[np.float64]

LITTLE_PX: Final = 1.0
"""Vertical disparity that is negligible beside a marker's height [px]."""


@dataclass(frozen=True)
class PairAlignment:
    """The second camera's pose relative to the first: x right, y down, z forwards.

    Attributes:
        baseline_m: distance between the cameras [m].
        axes_deg: angle between the optical axes [°].
        turn_right_deg: rotation to the right that would align the second camera [°].
        turn_down_deg: rotation downwards that would align it [°].
        roll_clockwise_deg: clockwise roll, as seen from behind it, that would align it [°].
        higher_mm: height of the second camera above the first [mm].
        ahead_mm: distance of the second camera ahead of the first [mm].
        vertical_px: largest vertical disparity of far points at the centre and the corners of the image; NaN if one is
            outside the lens model [px].
        swapped: whether the second camera is to the left of the first.
    """

    baseline_m: float
    axes_deg: float
    turn_right_deg: float
    turn_down_deg: float
    roll_clockwise_deg: float
    higher_mm: float
    ahead_mm: float
    vertical_px: float
    swapped: bool

    def advice(self, first: str, second: str) -> list[str]:
        """Return instructions for users to align the cameras with these names; empty if the pair is well aligned."""
        out = []
        if self.swapped:
            out.append(f"camera {second} stands to the left of camera {first}: exchange them")
        if self.vertical_px <= LITTLE_PX:
            return out
        turns = [
            (self.turn_right_deg, "to the right", "to the left"),
            (self.turn_down_deg, "down", "up"),
            (self.roll_clockwise_deg, "clockwise, seen from behind it", "counter-clockwise, seen from behind it"),
        ]
        for angle, one_way, other_way in turns:
            if abs(angle) >= 0.05:
                out.append(f"turn camera {second} {one_way if angle > 0 else other_way} by {abs(angle):.1f}°")
        return out


def align_pair(first: PlacedCamera, second: PlacedCamera) -> PairAlignment:
    """Return the pose of the second camera relative to the first, as the turns that would make the pair parallel."""
    T_first_second = first.T_camera_world @ inverse(second.T_camera_world)
    R, t = T_first_second[:3, :3], T_first_second[:3, 3]
    axis = R[:, 2]
    width, height = first.camera.size_px
    x, y = np.array([0, 0.5, 1])[:, None] * (width - 1), np.array([0, 0.5, 1])[None] * (height - 1)
    rows = np.stack(np.broadcast_arrays(x, y), axis=-1).reshape(-1, 2)[[0, 2, 4, 6, 8]]
    far = undistort(rows, first.camera.lens)
    far = np.column_stack([far, np.ones(len(far))])
    seen = far @ R  # in the second camera's space: Rᵀ far
    vertical = second.camera.lens[1] * (seen[:, 1] / seen[:, 2] - far[:, 1])
    return PairAlignment(
        float(np.linalg.norm(t)),
        float(np.degrees(np.arccos(np.clip(axis[2], -1, 1)))),
        float(np.degrees(np.arctan2(-axis[0], axis[2]))),
        float(np.degrees(np.arctan2(-axis[1], np.hypot(axis[0], axis[2])))),
        float(np.degrees(np.arctan2(-R[1, 0], R[0, 0]))),
        float(-1e3 * t[1]),
        float(1e3 * t[2]),
        float(abs(vertical).max()) if np.isfinite(vertical).all() else float("nan"),
        bool(t[0] < 0),
    )
