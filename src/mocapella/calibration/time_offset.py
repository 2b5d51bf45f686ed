"""Estimate the constant offset between two sensors' clocks from the motion of people.

With q(t + δ) ≈ q + δ v, the motion of a joint over a short time (`pair_kernels.CLOCK_LAG`) differs between two views by

    r = Δp − R Δq = δ u + noise        u_a = Δv_p, u_b = R Δv_q, z = (u_a + u_b) / 2

Differences cancel the sensors' poses, constant sensor errors, and motion at constant velocity, which carries no
information about a clock. Least squares, δ = Σ u_b·r / Σ u_b·u_b, is biased towards 0 because most of u_b is noise. The
noise of the two sensors is independent, so δ = Σ z·r / Σ u_a·u_b is unbiased: one sensor is the *instrument* of the
other (J. Durbin, "Errors in variables", Rev. Int. Stat. Inst. 22, 1954). Weights do not depend on the residual, which
would favour the previous offset. The error comes from the scatter of z·r − δ u_a·u_b, summed over the blocks of
`pair_calibration`. While it is too large the offset is *unknown*, with a bound. (Estimates from windows of a few
seconds were wrong by up to 135 ms on real sensors.)
"""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]

OFFSET_PRIOR_SD: Final = 0.1
"""Prior standard deviation of the offset between clocks that the network has synchronised [s]."""
BLOCKS_WANTED: Final = 3.0
"""Least number of independent blocks (Kish's count, (Σa)²/Σa²); with fewer, Σ u_a·u_b may be noise alone."""
MOVE_TRUSTED: Final = 0.05
"""Change of the assumed offset that reduces the weight of earlier sums to 1/e [s]."""


def moved_clock(clock: Float64, by: float) -> Float64:
    """Convert the sums for the clock offset to another assumed offset; a large change reduces them.

    A change of `MOVE_TRUSTED` reduces their weight to 1/e: within 50 ms, a tenth of the period of a swing of 2 Hz,
    velocities are about constant, but not beyond.

    Args:
        clock: (`pair_memory.CLOCK_SUMS`,) the sums: Σ a, Σ g, Σ a², Σ a g and Σ g², where a = Σ u_a·u_b and
            g = Σ z·r of a block, see the module; not changed.
        by: change of the assumed offset [s].

    Returns:
        The converted sums, a new array.
    """
    a, g, aa, ag, gg = clock
    fade = np.exp(-((by / MOVE_TRUSTED) ** 2))
    moved = np.array([a, g - by * a, aa, ag - by * aa, gg - 2 * by * ag + by * by * aa])
    return np.asarray(moved * np.array([fade, fade, fade**2, fade**2, fade**2]))


class TimeOffset(msgspec.Struct, frozen=True):
    """The estimated offset of b's clock from a's.

    Attributes:
        seconds: b's times minus a's; 0 while unknown [s].
        sd: standard deviation [s].
        known: whether the bound is small enough for the offset to be used.
    """

    seconds: float
    sd: float
    known: bool

    @property
    def bound(self) -> float:
        """Bound of the offset's error: twice its standard deviation [s]."""
        return 2 * self.sd

    def __str__(self) -> str:
        if self.known:
            return f"{1e3 * self.seconds:+.0f} ± {1e3 * self.bound:.0f} ms"
        return f"clock offset unknown, within ± {1e3 * self.bound:.0f} ms"
