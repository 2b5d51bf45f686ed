"""Feet that rest are on one plane, the floor: residuals of the adjustment in `keypoint_bundle`.

The floor has a normal and a height of its own for each kind of keypoint, so that a detector may place all heels too
high. It is an observation with a robust loss: a step or a foot on a chair is an outlier. Source of the constraint: the
contact of feet in M. Vo, Y. Sheikh, S. Narasimhan, "Spatiotemporal bundle adjustment for dynamic 3D human
reconstruction in the wild", TPAMI (2020), and in physical priors of motion since.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.keypoint_tracks import HALPE

Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

FEET: Final = {"Ankle": 0.045, "Heel": 0.02, "BigToe": 0.015, "SmallToe": 0.015}
"""Heights of the keypoints of a foot on the floor, in statures."""
CONTACTS: Final = tuple(HALPE.index(side + name) for name in FEET for side in "LR")
"""Keypoints of feet in `HALPE`."""
FLOOR: Final = 2 + len(FEET)
"""Number of parameters of the floor: two slopes, and a height for each kind of keypoint."""
CONTACT_SD: Final = 0.02
"""Standard deviation of the height of a resting keypoint of one kind: feet roll, and floors are uneven [m]."""
_KIND: Final = np.repeat(np.arange(len(FEET)), 2)


def no_floor() -> Float64:
    """Return the values of an unknown floor, as `contact_residuals` takes them."""
    return np.concatenate([[0.0, -1.0, 0.0], np.zeros(len(FEET))])


def contact_residuals(joints: Float64, resting: Bool, floor: Float64) -> Float64:
    """Return the heights (bodies, 8) of resting keypoints above the floor's, in `CONTACT_SD`; 0 where none is.

    Args:
        joints: (bodies, 26, 3) [m].
        resting: (bodies, 26) whether a keypoint of a foot rests on the floor.
        floor: (7,) unit normal, then the height of each kind of keypoint of `FEET` along it [m].
    """
    heights = joints[:, CONTACTS] @ floor[:3] - floor[3 + _KIND]
    return np.where(resting[:, CONTACTS], heights / CONTACT_SD, 0.0)


def contact_derivatives(joints: Float64, floor: Float64) -> tuple[Float64, Float64]:
    """Return the derivatives of `contact_residuals` by a keypoint (3,) and by the floor (bodies, 8, 6)."""
    by_floor = np.zeros((len(joints), len(CONTACTS), FLOOR))
    by_floor[..., :2] = joints[:, CONTACTS] @ _tangents(floor[:3]).T
    by_floor[:, np.arange(len(CONTACTS)), 2 + _KIND] = -1.0
    return floor[:3] / CONTACT_SD, by_floor / CONTACT_SD


def moved_floor(floor: Float64, step: Float64) -> Float64:
    """Return the floor after a step (6,) of its parameters."""
    normal = floor[:3] + np.clip(step[:2], -0.3, 0.3) @ _tangents(floor[:3])
    return np.concatenate([normal / np.linalg.norm(normal), floor[3:] + np.clip(step[2:], -0.5, 0.5)])


def _tangents(normal: Float64) -> Float64:
    """Return two unit vectors (2, 3) across a normal."""
    aside = np.zeros(3)
    aside[np.argmin(np.abs(normal))] = 1.0
    first = np.cross(normal, aside)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first)])
