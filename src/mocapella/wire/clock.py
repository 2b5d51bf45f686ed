"""Estimate the offset between two clocks continuously, with an error bound that holds while the clocks drift apart.

The *near* clock is that of the asking process, the *far* clock that of the answering one. A probe bounds the offset
(Cristian 1989): the far clock was read between question and answer. The bounds of all probes are intersected
(Marzullo and Owicki 1983), so that the fastest question and the fastest answer count, even if they are of different
probes. As the clocks drift, older bounds widen.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from mocapella.errors import WireError

_MAX_DIGITS = 19
"""Longest time in digits: 63 bits, which is 292 years."""


@dataclass(frozen=True, slots=True)
class ClockProbe:
    """One reading of the far clock (Cristian), between the times at which its question was sent and answered.

    Attributes:
        sent_ns: when the question was sent, on the near clock [ns].
        far_ns: what the far clock answered [ns].
        received_ns: when the answer was received, on the near clock [ns].
    """

    sent_ns: int
    far_ns: int
    received_ns: int

    @property
    def round_trip_ns(self) -> int:
        """Time from question to answer [ns]."""
        return self.received_ns - self.sent_ns


@dataclass(frozen=True, slots=True)
class ClockEstimate:
    """Offset of two clocks: ``far = near + offset``, with an error of at most ``bound``.

    Attributes:
        offset_ns: far clock minus near clock [ns].
        bound_ns: largest error of the offset [ns].
        drift_ppm: mean rate of change of the offset over the last minute or so [µs/s]; None until it is known.
        drift_bound_ppm: largest error of the drift [µs/s]; None until it is known.
    """

    offset_ns: int
    bound_ns: int
    drift_ppm: float | None = None
    drift_bound_ppm: float | None = None

    @property
    def offset(self) -> float:
        """Far clock minus near clock [s]."""
        return self.offset_ns / 1e9

    @property
    def bound(self) -> float:
        """Largest error of the offset [s]."""
        return self.bound_ns / 1e9

    @property
    def poor(self) -> bool:
        """Whether the offset is known to worse than `POOR_BOUND_S`."""
        return self.bound > POOR_BOUND_S


def read_clock(answer: bytes) -> int:
    """Return a node's clock [ns] from its answer, which is decimal text.

    Raises:
        WireError: it is no number, or too long.
    """
    if len(answer) > _MAX_DIGITS or not answer.isdigit():
        raise WireError(f"its clock answered {answer[:40]!r}; nanoseconds as decimal text are wanted")
    return int(answer)


MOST_DRIFT_PPM: Final = 1000
"""Largest drift between two clocks for which bounds hold [µs/s]: two clocks that are each slewed by 500 µs/s."""
POOR_BOUND_S: Final = 0.010
"""Error bound of the offset above which a clock counts as poorly synchronised [s]."""
DRIFT_OVER_S: Final = 60
"""Longest time over which the drift is measured [s]."""
DRIFT_FROM_S: Final = 10
"""Shortest time over which the drift is measured [s]."""


@dataclass(frozen=True, slots=True)
class _Bounds:
    """The offset was between ``low_ns`` and ``high_ns`` at ``at_ns`` of the near clock."""

    at_ns: int
    low_ns: int
    high_ns: int

    @property
    def middle_ns(self) -> int:
        return (self.low_ns + self.high_ns) // 2

    def later(self, at_ns: int) -> _Bounds:
        """Return the bounds at a later time, widened by the largest drift; at an earlier one the same."""
        passed = max(at_ns - self.at_ns, 0)
        change = -(-passed * MOST_DRIFT_PPM // 1_000_000)
        return _Bounds(self.at_ns + passed, self.low_ns - change, self.high_ns + change)


class OffsetFilter:
    """Bounds the offset between two monotonic clocks from all probes so far.

    The true offset is within the bounds as long as the clocks drift apart by less than `MOST_DRIFT_PPM`. A probe whose
    bounds do not overlap the earlier ones, as after a step of a clock, restarts the filter.

    Attributes:
        restarts: number of restarts so far.
    """

    def __init__(self) -> None:
        self.restarts = 0
        self._bounds: _Bounds | None = None
        self._past: deque[_Bounds] = deque()

    def update(self, probes: Iterable[ClockProbe]) -> None:
        """Use further probes, in the order of their times; probes with a negative round trip are ignored."""
        for probe in probes:
            if probe.round_trip_ns >= 0:
                self._add(probe)
        bounds = self._bounds
        if bounds is None:
            return
        if not self._past or bounds.at_ns >= self._past[-1].at_ns + 1_000_000_000:
            self._past.append(bounds)
        while bounds.at_ns - self._past[0].at_ns > DRIFT_OVER_S * 1_000_000_000:
            self._past.popleft()

    @property
    def offset_ns(self) -> int | None:
        """Far clock minus near clock [ns], the middle of the bounds; None without a probe."""
        return None if self._bounds is None else self._bounds.middle_ns

    def estimate(self, now_ns: int) -> ClockEstimate | None:
        """Return the estimate at a time on the near clock [ns], not before the last probe; None without a probe."""
        if self._bounds is None:
            return None
        now = self._bounds.later(now_ns)
        drift, drift_bound = self._drift(self._bounds)
        return ClockEstimate(now.middle_ns, now.high_ns - now.middle_ns, drift, drift_bound)

    def _add(self, probe: ClockProbe) -> None:
        # Read between question and answer: these are bounds at that instant, and so, widened, at the answer. A clock
        # that reads n is between n and n + 1.
        new = _Bounds(probe.sent_ns, probe.far_ns - probe.received_ns - 1, probe.far_ns + 1 - probe.sent_ns)
        new = new.later(probe.received_ns)
        if self._bounds is not None:
            old = self._bounds.later(new.at_ns)
            new = new.later(old.at_ns)
            low, high = max(old.low_ns, new.low_ns), min(old.high_ns, new.high_ns)
            if low <= high:
                new = _Bounds(old.at_ns, low, high)
            else:
                self.restarts += 1
                self._past.clear()
        self._bounds = new

    def _drift(self, now: _Bounds) -> tuple[float, float] | tuple[None, None]:
        """Return mean drift and its largest error [µs/s], from the past bounds that determine it best."""
        best: tuple[float, float] | None = None
        for past in self._past:
            seconds = (now.at_ns - past.at_ns) / 1e9
            if seconds < DRIFT_FROM_S:
                break
            low, high = (now.low_ns - past.high_ns) / seconds / 1e3, (now.high_ns - past.low_ns) / seconds / 1e3
            if best is None or high - low < 2 * best[1]:
                best = (low + high) / 2, (high - low) / 2
        return (None, None) if best is None else best


_JUMP_NS = 2_000_000_000
"""Fall of (arrival − capture) below its minimum that indicates a clock jump; so does a rise by ten times this [ns]."""


class SensorClock:
    """Converts a sensor's clock to the server's, online, from arrival times alone.

    A frame cannot arrive before its capture, so the smallest (arrival − capture) of the last seconds is the offset plus
    the smallest latency. The minimum is over the current and the previous half-window, so that it follows clock drift.
    A jump of the sensor's clock restarts the estimate.

    Args:
        window_s: length of both half-windows together [s]; a longer one follows drift more slowly.
    """

    def __init__(self, window_s: float = 10.0) -> None:
        self._half_ns = int(window_s / 2 * 1e9)
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._old: int | None = None
        self._new: int | None = None
        self._since_ns = 0

    def update(self, capture_ns: int, arrival_ns: int) -> int:
        """Learn from a frame; return its capture time on the server's clock [ns], never later than the arrival.

        The returned time is late by the smallest latency; that of the first frame is its arrival.

        Args:
            capture_ns: capture time on the sensor's clock [ns].
            arrival_ns: arrival on the server's monotonic clock [ns].
        """
        difference = arrival_ns - capture_ns
        offset = self._offset()
        if offset is not None and not -_JUMP_NS < difference - offset < 10 * _JUMP_NS:
            self.reset()
        if self._new is None or difference < self._new:
            self._new = difference
            self._since_ns = self._since_ns or arrival_ns
        if arrival_ns - self._since_ns > self._half_ns:
            self._old, self._new, self._since_ns = self._new, difference, arrival_ns
        offset = self._offset()
        return capture_ns + (difference if offset is None else offset)

    @property
    def offset_ns(self) -> int | None:
        """The server's clock minus the sensor's [ns], the smallest latency included; None before the first frame."""
        return self._offset()

    def _offset(self) -> int | None:
        known = [value for value in (self._old, self._new) if value is not None]
        return min(known, default=None)
