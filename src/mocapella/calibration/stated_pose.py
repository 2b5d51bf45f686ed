"""Check a sensor's stated tilt against the people in its image: it may be upside down, or the tilt may be wrong.

People stand, walk and sit with the head above the hips. So a sensor whose people have the head below them, seen along
the vertical of its stated tilt, is turned by 180° about its optical axis, and so is that vertical. Any other large
difference from the floor on which people walk refutes the stated tilt.
"""

from __future__ import annotations

import math
from functools import cache, lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.floor import Floor
from mocapella.model.bodies import Bodies
from mocapella.model.session import SensorPose

MOST_S: Final = 20.0
"""Bound of the evidence: a handstand of a shorter time turns no sensor round [s]."""
ENOUGH_S: Final = 0.15
"""Evidence that people must have given against the present orientation [s]."""
LONGEST_STEP_S: Final = 0.1
"""Longest time for which a frame counts [s]."""
MOST_OFF: Final = math.radians(30.0)
"""Largest angle of the stated vertical with that of the floor on which people walk [rad]."""
SURE_SD: Final = 0.08
"""Standard deviation of the floor's vertical below which people have walked: who stands or lies leaves it larger [rad].
"""
_UPRIGHT_COS: Final = math.cos(math.radians(45.0))


def head_up_s(evidence_s: float, bodies: Bodies, pose: SensorPose, dt: float) -> float:
    """Return the time for which people had the head above the hips, less the time for which it was below [s].

    Bodies that are more than 45° off the vertical, such as people who lie, do not count, nor joints that the sensor
    infers. The result is within ±`MOST_S`.

    Args:
        evidence_s: the result for the sensor's previous frame; 0 at first [s].
        bodies: the sensor's bodies.
        pose: its stated tilt, which defines the vertical.
        dt: time since its previous frame; counted up to `LONGEST_STEP_S` [s].
    """
    if not bodies.ids or not dt > 0:
        return evidence_s
    parts = bodies.topology.parts
    heads: int = _kernels().heads_up(
        np.ascontiguousarray(bodies.positions), np.ascontiguousarray(bodies.states), parts["root"], parts["head"],
        _vertical(pose.tilt), _UPRIGHT_COS,
    )  # fmt: skip
    change_s = heads * min(dt, LONGEST_STEP_S)
    return min(max(evidence_s + change_s, -MOST_S), MOST_S)


def vertical(pose: SensorPose) -> NDArray[np.float64]:
    """Return the upward direction (3,) in the camera space of a sensor of the stated tilt, not upside down."""
    return _vertical(pose.tilt).copy()


@lru_cache(maxsize=64)
def _vertical(tilt: float) -> NDArray[np.float64]:
    return np.array([0.0, math.cos(tilt), math.sin(tilt)])


def is_upside_down(evidence_s: float) -> bool:
    """Return whether a sensor with the evidence of `head_up_s` is mounted upside down; False before it is known."""
    return evidence_s <= -ENOUGH_S


def oriented(pose: SensorPose, *, upside_down: bool) -> SensorPose:
    """Return the pose whose tilt includes the roll of 180° of a sensor that is upside down: 180° − tilt.

    A rotation of 180° about the optical axis and one about the camera's x axis have the same vertical.
    """
    if not upside_down:
        return pose
    return SensorPose(math.remainder(math.pi - pose.tilt, math.tau), pose.height)


def refuted(stated: Floor, walked: Floor | None) -> bool:
    """Return whether a sensor's stated floor contradicts the one on which people have walked; False before they have.

    Args:
        stated: floor of the stated pose, turned round if the sensor is upside down.
        walked: floor from standing feet, of `mocapella.calibration.floor.FloorFromFeet`; None before it is known.
    """
    return walked is not None and walked.up_sd < SURE_SD and bool(stated.up @ walked.up < math.cos(MOST_OFF))


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.calibration import floor_kernels

    return floor_kernels
