"""Detect that a hand holds an object: the thumb and another finger touch it for some time.

A touch begins when a fingertip's distance from the object's surface falls below a threshold, and ends above a larger
one (Schmitt trigger).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.rigid import apply, inverse
from mocapella.settings import check

Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class GraspSettings:
    """Thresholds for touching and holding an object.

    Attributes:
        touch_m: largest distance from the object's surface at which a fingertip begins to touch it; larger: grasps are
            detected sooner, also false ones [m].
        leave_m: distance from the surface above which a fingertip stops touching; larger: releases are detected later
            [m].
        after_s: time for which thumb and another finger must touch the object until it is held, or not touch it until
            it is released; larger: fewer false grasps, later ones [s].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    touch_m: float = 0.015
    leave_m: float = 0.03
    after_s: float = 0.1

    def __post_init__(self) -> None:
        check(0 < self.touch_m < 1, "touch_m", self.touch_m, "above 0, below 1 m")
        check(self.touch_m <= self.leave_m < 1, "leave_m", self.leave_m, f"from {self.touch_m:g} to below 1 m")
        check(0 <= self.after_s <= 10, "after_s", self.after_s, "from 0 to 10 s")


def distance_to_box(points: Float64, T_world_object: Float64, half_m: Float64) -> Float64:
    """Return the signed distances of points from the surface of a box; negative inside.

    Args:
        points: (..., n, 3), world [m].
        T_world_object: (4, 4) pose of the box, whose middle is its frame's origin.
        half_m: (3,) half of each side [m].

    Returns:
        (..., n) [m].
    """
    beyond = np.abs(apply(inverse(T_world_object), points)) - half_m
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1)
    return np.asarray(outside + np.minimum(beyond.max(axis=-1), 0.0))


class Grasp:
    """Detector of the grasp of one object by one hand: the thumb and at least one finger touch it.

    Args:
        settings: thresholds; the defaults if None.

    Attributes:
        touching: (5,) whether each fingertip touches the object, the thumb's first.
        held: whether the object is held.
    """

    def __init__(self, settings: GraspSettings | None = None) -> None:
        self.settings = settings or GraspSettings()
        self.reset()

    def reset(self) -> None:
        """Reset to the initial state: no fingertip touches the object, and it is not held."""
        self.touching = np.zeros(5, dtype=np.bool_)
        self.held = False
        self._since_s: float | None = None

    def update(self, distances: Float64, at_s: float) -> bool:
        """Update the touching fingertips; return whether the object is held.

        Args:
            distances: (5,) signed distances of the fingertips from the object's surface, the thumb's first [m]; a NaN
                keeps that finger's state.
            at_s: capture time [s]; if it is before the beginning of the wait for ``after_s``, the wait restarts.
        """
        s = self.settings
        with np.errstate(invalid="ignore"):
            self.touching = (distances <= s.touch_m) | (self.touching & ~(distances > s.leave_m))
        wanted = bool(self.touching[0] and self.touching[1:].any())
        if wanted == self.held:
            self._since_s = None
        elif self._since_s is None or at_s < self._since_s:
            self._since_s = at_s
        if self._since_s is not None and at_s - self._since_s >= s.after_s:
            self.held, self._since_s = wanted, None
        return self.held
