"""The 1-euro filter: a low pass whose cutoff rises with speed, so that rest is steady and motion is not late.

Source: Casiez, Roussel, Vogel: 1€ Filter: A Simple Speed-based Low-pass Filter for Noisy Input in Interactive Systems
(CHI 2012), section 3 and its appendix A. Theirs filters one number; here the speed that opens the filter is that of
the point, not of each coordinate, so that the result does not depend on where the axes lie.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocapella.settings import check

Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class OneEuroSettings:
    """The paper's parameters, and what happens after a gap.

    Attributes:
        min_cutoff_hz: cutoff at rest; lower is steadier.
        beta_per_m: how much the cutoff rises with speed [Hz/(m/s)]; higher is less late.
        speed_cutoff_hz: cutoff of the low pass on the velocity.
        forget_after_s: a joint that was not seen for longer begins anew.
    """

    min_cutoff_hz: float = 1.0
    beta_per_m: float = 10.0
    speed_cutoff_hz: float = 1.0
    forget_after_s: float = 0.25

    def __post_init__(self) -> None:
        check(0 < self.min_cutoff_hz < 1e6, "min_cutoff_hz", self.min_cutoff_hz, "above 0 Hz")
        check(0 <= self.beta_per_m < 1e6, "beta_per_m", self.beta_per_m, "0 or more")
        check(0 < self.speed_cutoff_hz < 1e6, "speed_cutoff_hz", self.speed_cutoff_hz, "above 0 Hz")
        check(0 <= self.forget_after_s < 1e6, "forget_after_s", self.forget_after_s, "0 s or more")


class OneEuro:
    """The filter of one set of points. The same inputs give the same outputs, to the bit."""

    def __init__(self, settings: OneEuroSettings | None = None) -> None:
        self.settings = settings or OneEuroSettings()
        self.reset()

    def reset(self) -> None:
        """Forget everything, as if newly made."""
        self._positions: Float64 | None = None
        self._velocities: Float64 = np.zeros(0)
        self._seen_s: Float64 = np.zeros(0)

    def update(self, positions: Float64, at_s: float) -> Float64:
        """Filter one instant.

        Args:
            positions: (..., 3) [m], of the same shape every time; NaN where a point is not seen.
            at_s: when they were captured [s]; not before the last.

        Returns:
            (..., 3), NaN where a point is not seen.
        """
        if self._positions is None:
            self._positions = np.full(positions.shape, np.nan)
            self._velocities = np.zeros(positions.shape)
            self._seen_s = np.full(positions.shape[:-1], -np.inf)
        s = self.settings
        _kernels().smooth(
            self._positions.reshape(-1, 3), self._velocities.reshape(-1, 3), self._seen_s.reshape(-1),
            np.ascontiguousarray(positions, dtype=np.float64).reshape(-1, 3), at_s,
            s.min_cutoff_hz, s.beta_per_m, s.speed_cutoff_hz, s.forget_after_s,
        )  # fmt: skip
        return np.where(np.isfinite(positions).all(axis=-1)[..., None], self._positions, np.nan)


@cache
def _kernels() -> Any:
    """Compiled; numba is imported when it is first needed."""
    from mocapella.smoothing import one_euro_kernels

    return one_euro_kernels
