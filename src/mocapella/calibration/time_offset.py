"""The constant offset between two sensors' clocks, from the motion of people.

With q(t + δ) ≈ q + δ v, δ is a seventh unknown beside the six of the motion, and the same moments hold all that is
needed for it (`geometry.alignment`). Somebody who walks one way at one speed says nothing of it: there an offset looks
like a translation. So the estimate is over all motion that is remembered, its error is that of the joint solution, and
while that is too large the offset is *unknown*, with a bound. (Estimates from windows of a few seconds were wrong by up
to 135 ms on real sensors.)
"""

from __future__ import annotations

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.settings import check

Float64 = NDArray[np.float64]


class TimeOffset(msgspec.Struct, frozen=True):
    """A clock's offset.

    Attributes:
        seconds: what b's times are ahead of a's; 0 while unknown.
        sd: standard deviation [s].
        known: whether the bound is small enough for the offset to be used.
    """

    seconds: float
    sd: float
    known: bool

    @property
    def bound(self) -> float:
        """Twice the standard deviation [s]."""
        return 2 * self.sd

    def __str__(self) -> str:
        if self.known:
            return f"{1e3 * self.seconds:+.0f} ± {1e3 * self.bound:.0f} ms"
        return f"clock offset unknown, within ± {1e3 * self.bound:.0f} ms"


def offset_by_speed(
    times_a: Float64, speeds_a: Float64, times_b: Float64, speeds_b: Float64, *, within: float = 2.0
) -> TimeOffset:
    """A first guess for clocks that are far apart: where two bodies' speeds, which no rigid motion changes, agree best.

    The speeds are resampled at 30 Hz and correlated at all offsets; the best is refined by a parabola. It is known only
    where no other peak of the correlation comes near, which takes ten seconds or so of uneven motion.

    Args:
        times_a, times_b: (n,) rising [s]; speeds_a, speeds_b: (n,) of the body's centre [m/s].
        within: the offsets that are tried [s].

    Returns:
        `TimeOffset`; its ``sd`` is 10 ms where it is known, and ``within`` where it is not.
    """
    check(within > 0, "within", within, "greater than 0 s")
    rate = 30.0
    unknown = TimeOffset(0.0, within, False)
    first, last = max(times_a[0], times_b[0] - within), min(times_a[-1], times_b[-1] + within)
    grid = np.arange(first, last, 1 / rate)
    if len(grid) < 5 * rate:
        return unknown
    one = np.interp(grid, times_a, speeds_a)
    lags = np.arange(-round(within * rate), round(within * rate) + 1)
    scores = np.full(len(lags), -1.0)
    for i, lag in enumerate(lags):
        inside = (grid + lag / rate >= times_b[0]) & (grid + lag / rate <= times_b[-1])
        x, y = one[inside], np.interp(grid[inside] + lag / rate, times_b, speeds_b)
        if inside.sum() >= 5 * rate and x.std() > 0.05 and y.std() > 0.05:
            scores[i] = np.corrcoef(x, y)[0, 1]
    best = int(scores.argmax())
    rivals = np.abs(lags - lags[best]) > rate * 0.3
    rival = scores[rivals].max(initial=-1.0)
    if scores[best] < 0.8 or rival > scores[best] - 0.1 or best in (0, len(lags) - 1):
        return unknown
    left, top, right = scores[best - 1 : best + 2]
    curve = left - 2 * top + right
    return TimeOffset(float(lags[best] + (0.5 * (left - right) / curve if curve else 0.0)) / rate, 0.01, True)
