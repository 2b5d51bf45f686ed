"""The upward direction of a rig's world, from people who stand and walk."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.model.topology import topology
from mocapella.tracker.webcams_memory import FIRST_HEIGHT_SD_M, PeopleArrays

Float64 = NDArray[np.float64]

FIRST_COUNT: Final = 12
"""Number of straight bodies at which the direction is first compared with theirs; later at twice as many each time."""
LEAST_ALIKE: Final = 0.8
"""Length of the mean of their directions below which they do not tell where upward is."""
LEAST_STRAIGHT: Final = math.cos(math.radians(25.0))
"""Cosine of the angle between the trunk and the legs above which a body is straight."""
NEAR_AXIS: Final = math.cos(math.radians(20.0))
"""Cosine of the angle between their mean and an axis of the world above which this axis is upward."""
SAME: Final = math.cos(math.radians(3.0))
"""Cosine of the angle below which a direction is another one."""
_NECK, _HIP, _LEFT, _RIGHT = (topology("halpe_26").index(name) for name in ("Neck", "Hip", "LAnkle", "RAnkle"))


class Vertical:
    """The upward direction: y until straight bodies show another one.

    Rigs of other programs have y, z or −y up, or any direction. Most people stand upright most of the time, so upward
    is the mean direction of straight bodies; the world's axis near it, if there is one. A body is straight if its trunk
    and its legs have one direction. Bent people do not count.

    Attributes:
        up: (3,) unit vector, world.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all bodies; y is upward."""
        self.up: Float64 = np.array([0.0, 1.0, 0.0])
        self._sum: Float64 = np.zeros(3)
        self._count = 0
        self._next = FIRST_COUNT

    @property
    def compared(self) -> bool:
        """Whether enough bodies were seen for a first comparison."""
        return self._next > FIRST_COUNT

    def memory(self) -> dict[str, Any]:
        """Return all state, for a tracker's snapshot; its mutable values are shared, not copied."""
        return {name: getattr(self, name) for name in MEMORY}

    def update(self, people: PeopleArrays) -> bool:
        """Add the straight bodies of confirmed people whom two cameras see.

        Args:
            people: the people; if the direction changes, their heights begin anew, from where they are.

        Returns:
            Whether the direction has changed.
        """
        joints = people.positions[(people.ids >= 0) & (people.cameras >= 2)]
        hips, ankles = joints[:, _HIP], (joints[:, _LEFT] + joints[:, _RIGHT]) / 2
        trunks, legs = joints[:, _NECK] - hips, hips - ankles
        lengths = np.linalg.norm(trunks, axis=1) * np.linalg.norm(legs, axis=1)
        straight = (trunks * legs).sum(axis=1) > LEAST_STRAIGHT * lengths  # False for NaN
        bodies = (trunks + legs)[straight]
        self._sum = self._sum + (bodies / np.linalg.norm(bodies, axis=1)[:, None]).sum(axis=0)
        self._count += len(bodies)
        if self._count < self._next:
            return False
        self._next = 2 * self._count
        found = upward(self._sum / self._count)
        if found is None or found @ self.up >= SAME:
            return False
        self.up = found
        known = np.isfinite(people.heights)
        people.heights[:] = np.where(known, people.positions @ found, np.nan)
        people.height_variances[:] = np.where(known, FIRST_HEIGHT_SD_M**2, 0.0)
        return True


MEMORY: Final = ("up", "_sum", "_count", "_next")
"""Attributes of `Vertical` that are its state."""


def upward(mean: Float64) -> Float64 | None:
    """Return the upward unit vector (3,) for the mean (3,) of the unit vectors from people's feet to their necks.

    It is the world's axis near the mean, if there is one, else the mean's direction; None where bodies differ too much.
    """
    alike = float(np.linalg.norm(mean))
    if not alike >= LEAST_ALIKE:
        return None
    direction, axis = mean / alike, int(np.abs(mean).argmax())
    if abs(direction[axis]) < NEAR_AXIS:
        return np.asarray(direction)
    up = np.zeros(3)
    up[axis] = math.copysign(1.0, direction[axis])
    return up
