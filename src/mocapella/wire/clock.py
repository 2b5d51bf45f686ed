"""Estimate the offset between two clocks, with an error bound.

Cristian's algorithm (1989): of several probes, use the one with the smallest round trip, and assume that the far clock
was read in its middle; half the round trip bounds the error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mocapella.errors import WireError

_MAX_DIGITS = 19
"""Longest time in digits: 63 bits, which is 292 years."""


@dataclass(frozen=True, slots=True)
class ClockProbe:
    """Measurement of another machine's clock by one question and its answer.

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
        bound_ns: largest error of the offset, half the smallest round trip [ns].
    """

    offset_ns: int
    bound_ns: int

    @property
    def offset(self) -> float:
        """Far clock minus near clock [s]."""
        return self.offset_ns / 1e9

    @property
    def bound(self) -> float:
        """Half the smallest round trip [s]."""
        return self.bound_ns / 1e9


def read_clock(answer: bytes) -> int:
    """Return a node's clock [ns] from its answer, which is decimal text.

    Raises:
        WireError: it is no number, or too long.
    """
    if len(answer) > _MAX_DIGITS or not answer.isdigit():
        raise WireError(f"its clock answered {answer[:40]!r}; nanoseconds as decimal text are wanted")
    return int(answer)


def estimate_offset(probes: Sequence[ClockProbe]) -> ClockEstimate | None:
    """Return the estimate of the best probe; None if no probe has consistent times."""
    sane = [probe for probe in probes if probe.round_trip_ns >= 0]
    if not sane:
        return None
    best = min(sane, key=lambda probe: probe.round_trip_ns)
    middle = best.sent_ns + best.round_trip_ns // 2
    return ClockEstimate(best.far_ns - middle, (best.round_trip_ns + 1) // 2)


_JUMP_NS = 2_000_000_000
"""A frame earlier by this than all previous ones, or later by ten times this, indicates a clock jump [ns]."""


class SensorClock:
    """Converts a sensor's clock to the server's, online, from arrival times alone.

    A frame cannot arrive before its capture, so the smallest (arrival − capture) of the last seconds is the offset plus
    the smallest latency. Two half-windows follow clock drift. A jump of the sensor's clock restarts the estimate.

    Args:
        window_s: time over which the smallest difference is taken [s]; a longer one follows drift more slowly.
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
