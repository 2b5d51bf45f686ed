"""The region of a stage that the camera shows: it follows people who move, and grows if they move apart.

It does not move while people stay within it, so that the image does not sway with every step.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]

SLACK_M: Final = 0.6
"""Horizontal distance that bodies may extend beyond the region before it moves [m]."""
HEADROOM_M: Final = 0.3
"""Distance that bodies may extend above the region's initial height before it rises [m]."""
SETTLES_S: Final = 0.35
"""Time constant of the region's motion to its target [s]."""


class Framing:
    """An upright box in the view's space that the camera shows, moved smoothly.

    Args:
        half_m: (2,) smallest half widths along x and z [m].
        tall_m: initial height [m].
        middle: (3,) initial centre of the box's base [m]; the origin if None.

    Attributes:
        middle: (3,) centre of the box's base, on the floor, or higher if people reach above the initial height [m].
        half_m: (2,) present half widths along x and z [m].
    """

    def __init__(self, half_m: Float64, tall_m: float, middle: Float64 | None = None) -> None:
        self._least, self._tall = np.asarray(half_m, np.float64), tall_m
        self.middle, self.half_m = np.zeros(3) if middle is None else np.array(middle, np.float64), self._least.copy()
        self._to_middle, self._to_half = self.middle.copy(), self.half_m.copy()
        self._last_s: float | None = None

    def follow(self, low: Float64, high: Float64, now_s: float) -> None:
        """Move and widen the box smoothly as far as people leave it; the first call changes it at once.

        People may reach `SLACK_M` beyond the box, and `HEADROOM_M` above it, before it changes.

        Args:
            low, high: (3,) opposite corners of the people's bounding box in the view's space [m].
            now_s: the present time on this process's monotonic clock [s].
        """
        for axis, k in ((0, 0), (2, 1)):
            wide = 0.5 * (high[axis] - low[axis])
            self._to_half[k] = max(self._least[k], wide - SLACK_M)
            reach = self._to_half[k] + SLACK_M
            self._to_middle[axis] = np.clip(self._to_middle[axis], high[axis] - reach, low[axis] + reach)
        self._to_middle[1] = max(0.0, high[1] - self._tall - HEADROOM_M)
        self.rest(now_s)

    def rest(self, now_s: float) -> None:
        """Continue the smooth motion to the last target, because no people are visible.

        Args:
            now_s: the present time on this process's monotonic clock [s].
        """
        share = 1.0 if self._last_s is None else -np.expm1(-max(0.0, now_s - self._last_s) / SETTLES_S)
        self._last_s = now_s
        self.middle = self.middle + share * (self._to_middle - self.middle)
        self.half_m = self.half_m + share * (self._to_half - self.half_m)

    @property
    def corners(self) -> Float64:
        """Corners (8, 3) of the box, from the floor to the top, in the view's space [m]."""
        (x, above, z), (wide, deep) = self.middle, self.half_m
        heights = (0.0, self._tall + above)
        return np.array([[x + i, y, z + k] for i in (-wide, wide) for y in heights for k in (-deep, deep)])
