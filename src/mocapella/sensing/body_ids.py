"""Ids of one sensor's bodies that last from frame to frame, as body sensors give them."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]
UInt64 = NDArray[np.uint64]

NEAR_M: Final = 0.3
"""Greatest mean distance between a body's joints in two frames, at rest [m]."""
SPEED_M_S: Final = 3.0
"""Further distance per time between the frames [m/s]."""
KEPT_S: Final = 0.5
"""Time after which a body that is not seen is forgotten; seen again, it has a new id [s]."""
KEPT_IN_STALLS_S: Final = 2.0
"""The same for a body of the last frame: a busy machine skips frames, so the body was not looked for since [s]."""


class BodyIds:
    """Gives bodies of successive frames their ids: the nearest bodies of the last frames keep theirs.

    The ids count from 1 and are never used twice. A body and the last place of another one that is as near are
    distinguished by the distances of all joints that both have. A pause between two frames is not a body's absence.
    """

    def __init__(self) -> None:
        self._next = 1
        self._last_s = 0.0
        self._last: dict[int, tuple[float, Float64]] = {}

    def reset(self) -> None:
        """Forget all bodies; ids go on counting."""
        self._last = {}

    def update(self, positions: Float64, at_s: float) -> UInt64:
        """Return the ids (bodies,) of a frame's bodies.

        Args:
            positions: (bodies, joints, 3) in the sensor's frame [m]; NaN where not tracked.
            at_s: the frame's time, not before that of the last frame [s].
        """
        self._last = {i: seen for i, seen in self._last.items() if at_s - seen[0] <= self._kept_s(seen[0])}
        pairs = []
        for body, joints in enumerate(positions):
            for number, (then_s, before) in self._last.items():
                apart = _apart_m(joints, before)
                if apart <= NEAR_M + SPEED_M_S * max(0.0, at_s - then_s):
                    pairs.append((apart, number, body))
        ids = np.zeros(len(positions), np.uint64)
        taken: set[int] = set()
        for _, number, body in sorted(pairs):
            if ids[body] == 0 and number not in taken:
                ids[body] = number
                taken.add(number)
        for body in np.flatnonzero(ids == 0).tolist():
            ids[body] = self._next
            self._next += 1
        for body, number in enumerate(ids.tolist()):
            self._last[number] = (at_s, positions[body])
        self._last_s = at_s
        return ids

    def _kept_s(self, seen_s: float) -> float:
        """Return the time for which a body is kept that was seen last at ``seen_s`` [s]."""
        return KEPT_IN_STALLS_S if seen_s == self._last_s else KEPT_S


def _apart_m(joints: Float64, before: Float64) -> float:
    """Return the mean distance of the joints that two bodies (joints, 3) both have [m]; infinite without any."""
    distances = np.linalg.norm(joints - before, axis=-1)
    there = np.isfinite(distances)
    return float(distances[there].mean()) if there.any() else np.inf
