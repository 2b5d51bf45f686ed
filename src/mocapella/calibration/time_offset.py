"""The constant offset between two sensors' clocks, from the motion of people.

With q(t + δ) ≈ q + δ v, δ is a seventh unknown beside the six of the motion, and the same moments hold all that is
needed for it (`geometry.alignment`). Somebody who walks one way at one speed says nothing of it: there an offset looks
like a translation. So the estimate is over all motion that is remembered, its error is that of the joint solution, and
while that is too large the offset is *unknown*, with a bound. (Estimates from windows of a few seconds were wrong by up
to 135 ms on real sensors.)
"""

from __future__ import annotations

import msgspec


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
