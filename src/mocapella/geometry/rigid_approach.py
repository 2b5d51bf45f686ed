"""Approach of rigid motions to refined ones, so that objects drawn with them do not jump."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]

APPROACH_S: Final = 0.3
"""Time constant of the approach to refined poses [s]."""
APPROACH_M_S: Final = 0.1
"""Least speed of the approach, at a distance of `REACH_M` [m/s]."""
REACH_M: Final = 4.0
"""Distance of a drawn object from the pose: a rotation moves that so much farther [m]."""
AT_ONCE_M: Final = 0.5
"""A pose that is farther off is replaced at once [m]."""


def approached(poses: Sequence[Float64], wanted: Sequence[Float64], elapsed_s: float) -> list[Float64]:
    """Move poses towards wanted ones along screw motions: exponentially, and at a least speed.

    Args:
        poses, wanted: transforms (4, 4), one for each pose.
        elapsed_s: elapsed time [s].

    Returns:
        The poses. One that arrives, or is farther off than `AT_ONCE_M`, is the wanted one itself.
    """
    now, goal = np.array(poses), np.array(wanted)
    moved = np.empty_like(now)
    arrives = _kernels().approach(now, goal, elapsed_s, moved).tolist()
    return [want if there else T for want, T, there in zip(wanted, moved, arrives, strict=True)]


@cache
def _kernels() -> Any:
    """Import the compiled step, and with it numba, on first use."""
    from mocapella.geometry import rigid_approach_kernels

    return rigid_approach_kernels
