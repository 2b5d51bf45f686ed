"""Compiled step of `mocapella.geometry.rigid_approach`; importing this module imports numba."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.geometry.rigid_approach import APPROACH_M_S, APPROACH_S, AT_ONCE_M, REACH_M
from mocapella.geometry.turn_kernels import FIRST, carry_on, turn_between

Float64 = NDArray[np.float64]

_NOTHING_M = 1e-9


@njit(cache=True)
def approach(now: Float64, goal: Float64, elapsed_s: float, out: Float64) -> NDArray[np.bool_]:
    """Move poses towards wanted ones, see `mocapella.geometry.rigid_approach.approached`.

    Args:
        now, goal: (n, 4, 4) the poses, and the wanted ones.
        elapsed_s: elapsed time [s].
        out: (n, 4, 4) written; unchanged for a pose that arrives.

    Returns:
        (n,) whether the pose arrives, or must be replaced at once.
    """
    arrives, P, Q = np.ones(len(now), dtype=np.bool_), np.empty(9), np.empty(9)
    for n in range(len(now)):
        apart = 0.0
        for i in range(3):
            apart += (goal[n, i, 3] - now[n, i, 3]) ** 2
            for k in range(3):
                P[3 * i + k], Q[3 * i + k] = now[n, i, k], goal[n, i, k]
        x, y, z = turn_between(P, FIRST, Q)
        off_m = math.sqrt(apart) + REACH_M * math.sqrt(x * x + y * y + z * z)
        if _NOTHING_M <= off_m <= AT_ONCE_M:
            part = max(-math.expm1(-elapsed_s / APPROACH_S), APPROACH_M_S * elapsed_s / off_m)
            if part < 1.0:
                arrives[n] = False
                carry_on(goal[n], now[n], -part, out[n])
    return arrives
