"""Smoothness prior on points of a body's surface: their accelerations are small, as a part of the pose estimate.

A point's cost is its squared distance from its predicted position, over the variance of the displacement by people's
accelerations (`Steadiness`). These depend on its speed and its recent acceleration, as in filters whose process noise
follows their innovations (R. Mehra, "Approaches to adaptive filtering", IEEE Transactions on Automatic Control, 1972):
a person at rest is held, a jumping one is not.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.kinematics.twist_fit import OnPoints
from mocapella.model.memory import set_memory
from mocapella.model.rigged_mesh import at_rest
from mocapella.tracker.limb_stillness import HeldPoints
from mocapella.tracker.silhouette_body import SilhouetteBody, Standing
from mocapella.tracker.silhouette_settings import Steadiness

Float64 = NDArray[np.float64]

LATELY_S = 0.1
"""Half-life of recent speeds and accelerations [s]."""
_MEMORY: Final = ("_last", "_onward", "_weights", "_speed", "_acceleration", "_since_s", "_per_s2")
AT_FIRST_M_PER_S = 4.0
"""Initial speed of points: that of a runner's limbs, because recordings may begin in motion [m/s]."""


class SurfacePrior:
    """Prior on points of one body's surface: call `expect`, then `steady` for each pose fit, then `learn`.

    Args:
        body: the body; the points are its vertices ``skin``.
        steadiness: usual accelerations of the points.
    """

    def __init__(self, body: SilhouetteBody, steadiness: Steadiness) -> None:
        self._body, self._steadiness = body, steadiness
        self._part = body.figure.part[body.skin].astype(np.int64)
        count = len(body.skin)
        self._last: Float64 | None = None
        self._onward, self._weights = np.zeros((count, 3)), np.zeros(count)
        self._speed, self._acceleration = np.full(count, AT_FIRST_M_PER_S), np.zeros(count)
        self._since_s, self._per_s2 = 0.0, 0.0
        self._held = np.zeros(count, np.bool_)

    def memory(self) -> dict[str, Any]:
        """Return all state, for `recall` and a tracker's snapshot; its mutable values are shared, not copied."""
        return {name: getattr(self, name) for name in _MEMORY}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Restore the state that `memory` returned for the same body."""
        set_memory(self, memory)

    def expect(self, stands: Standing, since_s: float, per_s2: float, away_m: Float64 | None = None) -> None:
        """Set mean and weights of the prior: the points' predicted positions, and their inverse variances.

        The standard deviation of a point's acceleration grows with its speed and its recent acceleration.

        Args:
            stands: the body in its predicted pose.
            since_s: time since the last frame [s].
            per_s2: 1 / T², T the time between two frames: an acceleration a displaces a point from the
                prediction at constant velocity by a · T² [1/s²].
            away_m: (parts,) distances of parts from where keypoints show them, which count as accelerations; 0 where
                they agree, None without keypoints [m].
        """
        s = self._steadiness
        if away_m is not None:
            self._acceleration = np.maximum(self._acceleration, per_s2 * away_m[self._part])
        self._onward, self._since_s, self._per_s2 = stands.vertices[self._body.skin], since_s, per_s2
        if self._last is not None:
            speed = np.linalg.norm(self._onward - self._last, axis=1) / since_s
            self._speed = np.maximum(speed, self._faded(self._speed))
        usual = np.hypot(s.point_m_per_s2, s.point_per_s * self._speed)
        self._weights = (per_s2 / np.hypot(usual, s.point_per_past * self._acceleration)) ** 2

    def hold(self, held: HeldPoints) -> None:
        """Replace the prior of points that are still by one about where they came to rest; after `expect`."""
        self._held = held.points
        self._onward = np.where(held.points[:, None], held.at, self._onward)
        still = self._steadiness.still_m**-2
        self._weights = np.where(held.points, np.maximum(self._weights, still), self._weights)

    def steady(self, stands: Standing, motions: tuple[Float64, Float64], *, held_alone: bool = False) -> OnPoints:
        """Return the prior as point constraints that pull the surface to its predicted position, for `twist_fit.fit`.

        Args:
            stands: the body in its present pose.
            motions: R (parts, 9) and t (parts, 3) of the kinematic tree in that pose.
            held_alone: whether only points that are held count, of `hold`: where one camera alone sees the body, its
                distance is hardly visible and moves all other points.
        """
        these = self._held if held_alone else np.ones(len(self._part), np.bool_)
        part = self._part[these]
        rest = at_rest(stands.vertices[self._body.skin[these]], part, motions)
        return OnPoints(part, rest, self._onward[these], self._weights[these])

    def learn(self, stands: Standing) -> None:
        """Update the points' positions and accelerations with the fitted body of this frame, for the next `expect`."""
        self._last = stands.vertices[self._body.skin]
        if self._per_s2:
            acceleration = self._per_s2 * np.linalg.norm(self._last - self._onward, axis=1)
            self._acceleration = np.maximum(acceleration, self._faded(self._acceleration))

    def _faded(self, was: Float64) -> Float64:
        return np.asarray(was * 0.5 ** (self._since_s / LATELY_S))
