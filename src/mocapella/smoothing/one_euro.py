"""The 1-euro filter: a low pass whose cutoff rises with speed, for little jitter at rest and little lag in motion.

Source: Casiez, Roussel, Vogel: 1€ Filter: A Simple Speed-based Low-pass Filter for Noisy Input in Interactive Systems
(CHI 2012), section 3 and appendix A. The paper filters one number. Here the cutoff depends on the speed of the point,
so that the result does not depend on the axes; optionally, on the speed of each coordinate.
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
    """Parameters of the filter, as in the paper, and the longest gap.

    Attributes:
        min_cutoff_hz: cutoff at rest; a smaller one reduces jitter, and adds lag to slow motion [Hz].
        beta_per_m: increase of the cutoff per speed; a larger one reduces lag of fast motion, with more jitter; for
            points in pixels, in Hz/(px/s) [Hz/(m/s)].
        speed_cutoff_hz: cutoff of the low pass of the velocity that sets the cutoff; a larger one follows changes of
            speed sooner, but noise raises the cutoff more [Hz].
        forget_after_s: gap in a point's measurements above which its filter restarts at the next one [s].
        per_component: whether each coordinate is filtered by its own speed, as in the paper, rather than by the
            point's; without effect on people's joints.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    min_cutoff_hz: float = 1.0
    beta_per_m: float = 10.0
    speed_cutoff_hz: float = 1.0
    forget_after_s: float = 0.25
    per_component: bool = False

    def __post_init__(self) -> None:
        check(0 < self.min_cutoff_hz < 1e6, "min_cutoff_hz", self.min_cutoff_hz, "above 0 Hz")
        check(0 <= self.beta_per_m < 1e6, "beta_per_m", self.beta_per_m, "0 or more")
        check(0 < self.speed_cutoff_hz < 1e6, "speed_cutoff_hz", self.speed_cutoff_hz, "above 0 Hz")
        check(0 <= self.forget_after_s < 1e6, "forget_after_s", self.forget_after_s, "0 s or more")


class OneEuro:
    """A 1-euro filter of one set of points. The same inputs give the same outputs, to the bit.

    Args:
        settings: parameters of the filter; the defaults if None.
    """

    def __init__(self, settings: OneEuroSettings | None = None) -> None:
        self.settings = settings or OneEuroSettings()
        self.reset()

    def reset(self) -> None:
        """Forget everything, as if newly made."""
        self._positions: Float64 | None = None
        self._velocities: Float64 = np.zeros(0)
        self._seen_s: Float64 = np.zeros(0)

    def update(self, positions: Float64, at_s: float) -> Float64:
        """Filter the points measured at one instant, and keep them as the filter's state.

        A point seen for the first time, or after a gap longer than ``forget_after_s``, is returned as measured. A
        second measurement at the same time as the last one is ignored: the last result is returned again.

        Args:
            positions: (..., dimensions) [m], or [px] with settings of that unit, of the same shape every time; a point
                with a NaN coordinate is not seen, and its state does not change.
            at_s: capture time [s]; not before the last one.

        Returns:
            (..., dimensions) filtered points, a new array; NaN where a point is not seen.
        """
        measured = np.ascontiguousarray(positions, dtype=np.float64)
        if self._positions is None:
            dimensions = measured.shape[-1]
            self._positions = np.full((measured.size // dimensions, dimensions), np.nan)
            self._velocities = np.zeros(self._positions.shape)
            self._seen_s = np.full(len(self._positions), -np.inf)
        s, out, shape = self.settings, np.empty(self._positions.shape), measured.shape
        if len(shape) != 2:
            measured = measured.reshape(out.shape)
        (_kernels().smooth_components if s.per_component else _kernels().smooth_points)(
            self._positions, self._velocities, self._seen_s, measured, out, at_s,
            s.min_cutoff_hz, s.beta_per_m, s.speed_cutoff_hz, s.forget_after_s,
        )  # fmt: skip
        return out if len(shape) == 2 else out.reshape(shape)


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.smoothing import one_euro_kernels

    return one_euro_kernels
