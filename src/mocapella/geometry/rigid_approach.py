"""Approach of rigid motions to refined ones, so that what is drawn with them does not jump."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.rigid import inverse
from mocapella.geometry.twists import exp_twist, log_motion

Float64 = NDArray[np.float64]

_APPROACH_S: Final = 0.3
"""Time constant of the approach to refined poses [s]."""
_APPROACH_M_S: Final = 0.1
"""Least speed of the approach, at a distance of `_REACH_M` [m/s]."""
_REACH_M: Final = 4.0
"""Distance at which the motion of a pose is judged [m]."""
_AT_ONCE_M: Final = 0.5
"""A pose that is farther off is replaced at once [m]."""


def approached(poses: Sequence[Float64], wanted: Sequence[Float64], elapsed_s: float) -> list[Float64]:
    """Move poses towards wanted ones along screw motions: exponentially, and at a least speed.

    Args:
        poses, wanted: transforms (4, 4), one for each pose.
        elapsed_s: elapsed time [s].

    Returns:
        The poses. One that arrives, or is farther off than `_AT_ONCE_M`, is the wanted one itself.
    """
    now, goal = np.stack(poses), np.stack(wanted)
    off = log_motion(goal @ inverse(now))
    off_m = np.linalg.norm(off[:, :3], axis=1) + _REACH_M * np.linalg.norm(off[:, 3:], axis=1)
    part = np.maximum(-np.expm1(-elapsed_s / _APPROACH_S), _APPROACH_M_S * elapsed_s / np.maximum(off_m, 1e-9))
    moved = exp_twist(part[:, None] * off) @ now
    arrives = (off_m < 1e-9) | (part >= 1) | (off_m > _AT_ONCE_M)
    return [want if there else T for want, T, there in zip(wanted, moved, arrives.tolist(), strict=True)]
