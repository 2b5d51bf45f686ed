"""The penalty on accelerations of points of a body's skin, which is part of the estimate.

A point costs the square of how far it is from where it would be if it went on as it did, over what the accelerations
of people bring it away: `Steadiness` says what these are. How fast it was and how much it was accelerated lately count,
as in filters whose process noise follows their innovations (R. Mehra, "Approaches to adaptive filtering", IEEE
Transactions on Automatic Control, 1972): who sits still is held, and who jumps is not.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.kinematics.twist_fit import OnPoints
from mocapella.model.rigged_mesh import at_rest
from mocapella.tracker.silhouette_body import SilhouetteBody, Standing
from mocapella.tracker.silhouette_settings import Steadiness

Float64 = NDArray[np.float64]

LATELY_S = 0.1
"""In so much time what a point was is forgotten by half [s]."""
_MEMORY: Final = ("_last", "_onward", "_weights", "_speed", "_acceleration", "_since_s", "_per_s2")
AT_FIRST_M_PER_S = 4.0
"""Recordings begin amid motion: before it is known how fast a point is, it may be as fast as a runner's limbs [m/s]."""


class SurfacePrior:
    """One body's points, frame by frame: `expect`, `steady` as often as the pose is fitted, `learn`.

    Args:
        body: see there.
        steadiness: how steady they are.
    """

    def __init__(self, body: SilhouetteBody, steadiness: Steadiness) -> None:
        self._body, self._steadiness = body, steadiness
        self._part = body.figure.part[body.skin].astype(np.int64)
        count = len(body.skin)
        self._last: Float64 | None = None
        self._onward, self._weights = np.zeros((count, 3)), np.zeros(count)
        self._speed, self._acceleration = np.full(count, AT_FIRST_M_PER_S), np.zeros(count)
        self._since_s, self._per_s2 = 0.0, 0.0

    def memory(self) -> dict[str, Any]:
        """All that `recall` wants."""
        return {name: getattr(self, name) for name in _MEMORY}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Be as when `memory` was made; of the same body."""
        vars(self).update(memory)

    def expect(self, stands: Standing, since_s: float, per_s2: float) -> None:
        """Where the body will be if it goes on as it did.

        Args:
            stands: there.
            since_s: after the last frame [s].
            per_s2: an acceleration of 1 brings points away by 1 / this.
        """
        s = self._steadiness
        self._onward, self._since_s, self._per_s2 = stands.vertices[self._body.skin], since_s, per_s2
        if self._last is not None:
            speed = np.linalg.norm(self._onward - self._last, axis=1) / since_s
            self._speed = np.maximum(speed, self._faded(self._speed))
        usual = np.hypot(s.point_m_per_s2, s.point_per_s * self._speed)
        self._weights = (per_s2 / np.hypot(usual, s.point_per_past * self._acceleration)) ** 2

    def steady(self, stands: Standing, motions: tuple[Float64, Float64]) -> OnPoints:
        """That the points are to be where they would be.

        Args:
            stands: where the body is.
            motions: R (parts, 9) and t (parts, 3) of the tree that is fitted, there.
        """
        rest = at_rest(stands.vertices[self._body.skin], self._part, motions)
        return OnPoints(self._part, rest, self._onward, self._weights)

    def learn(self, stands: Standing) -> None:
        """Where it was in this frame."""
        self._last = stands.vertices[self._body.skin]
        if self._per_s2:
            acceleration = self._per_s2 * np.linalg.norm(self._last - self._onward, axis=1)
            self._acceleration = np.maximum(acceleration, self._faded(self._acceleration))

    def _faded(self, was: Float64) -> Float64:
        return np.asarray(was * 0.5 ** (self._since_s / LATELY_S))
