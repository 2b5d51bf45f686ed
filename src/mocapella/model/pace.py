"""The pace of a sensor: its usual interval between frames, and from when on it is silent. Time is an argument."""

from __future__ import annotations

import statistics
from collections import deque
from typing import Final

from mocapella.conventions import NS_PER_S

SILENT_AFTER_S: Final = 0.8
"""Shortest time without a frame after which a sensor of known interval is silent; checked every 0.2 s [s]."""
SILENT_INTERVALS: Final = 3
"""Number of usual intervals without a frame after which a slow sensor is silent."""
UNKNOWN_S: Final = 2.0
"""Time without a second frame after which a sensor is silent, because its interval is not known [s]."""
_LONGEST_S: Final = 20.0
"""Longest time without a frame after which a slow sensor is silent [s]."""
_INTERVALS: Final = 5
"""Number of the last intervals whose median is the usual one."""


class Pace:
    """The usual interval between a sensor's frames, the median of its last five intervals, and its silence.

    Attributes:
        heard_ns: time of the last frame [ns]; None before the first.
    """

    def __init__(self) -> None:
        self.heard_ns: int | None = None
        self._since_ns: int | None = None
        self._intervals: deque[int] = deque(maxlen=_INTERVALS)

    def update(self, at_ns: int) -> None:
        """Add a frame's time on the receiver's monotonic clock [ns]."""
        if self.heard_ns is not None:
            self._intervals.append(at_ns - self.heard_ns)
        self.heard_ns = self._since_ns = at_ns

    def awake(self, at_ns: int) -> None:
        """Count the present silence from now on only, because the receiver was suspended meanwhile.

        Only the first call after a frame has an effect; none before the first frame.

        Args:
            at_ns: the present time on the receiver's monotonic clock [ns].
        """
        if self._since_ns == self.heard_ns and self.heard_ns is not None:
            self._since_ns = at_ns

    @property
    def interval_s(self) -> float | None:
        """Usual interval between two frames [s]; None before the second."""
        return statistics.median(self._intervals) / NS_PER_S if self._intervals else None

    @property
    def silent_after_s(self) -> float:
        """Time without a frame after which the sensor is silent [s]."""
        interval_s = self.interval_s
        if interval_s is None:
            return UNKNOWN_S
        return min(max(SILENT_AFTER_S, SILENT_INTERVALS * interval_s), _LONGEST_S)

    def silent(self, now_ns: int) -> bool:
        """Whether no frame has come for longer than `silent_after_s`; False before the first.

        ``now_ns`` is the present time on the receiver's monotonic clock [ns]. After a call of `awake`, which ends a
        suspension of the receiver, the silence counts from that call.
        """
        return self._since_ns is not None and now_ns - self._since_ns > self.silent_after_s * NS_PER_S
