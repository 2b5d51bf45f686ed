"""Refuse a frame whose sequence number leaps further than a sensor can count since its last frame.

One such frame, damaged or forged, would cut its node off: all later frames would be refused as older. And a take would
report all numbers between as lost. The number of the next frame, which a node reports on the record path, is checked,
too. Frames that are sent again are not: they were requested by number, and after an outage they arrive in any order.
"""

from __future__ import annotations

from typing import Final

from mocapella.errors import WireError
from mocapella.wire.keys import NodeKey

MOST_HZ: Final = 1000
"""Largest frame rate of any sensor [Hz]."""
ALWAYS: Final = 10_000
"""Number of frames that may be skipped at any time, as by a node that sends a backlog."""


def check_leap(sequence: int, last: int, since_s: float) -> None:
    """Check the sequence number of a frame against the node's last one.

    Args:
        sequence: the frame's sequence number.
        last: the node's highest one so far.
        since_s: time since the frame with ``last`` arrived [s].

    Raises:
        WireError: the sensor cannot have made so many frames since.
    """
    most = ALWAYS + int(MOST_HZ * max(0.0, since_s))
    if sequence - last > most:
        raise WireError(
            f"sequence {sequence} after {last} skips more than {ALWAYS} frames, and more than {MOST_HZ} a second; "
            "count the frames 0, 1, 2, …"
        )


class LeapGuard:
    """Refuses frames whose number is higher than the sensor can have counted (damaged, forged); see `check`."""

    def __init__(self) -> None:
        self._newest: dict[NodeKey, tuple[int, int]] = {}

    def check(self, node: NodeKey, sequence: int, arrived_ns: int) -> None:
        """Check the plausibility of a node's sequence number, and remember it; the first one may be any.

        Args:
            node: the node.
            sequence: sequence number of its new frame.
            arrived_ns: arrival of the frame, on one monotonic clock [ns].

        Raises:
            WireError: the sensor cannot have made so many frames since its highest number.
        """
        newest, newest_ns = self._newest.get(node, (sequence, arrived_ns))
        check_leap(sequence, newest, (arrived_ns - newest_ns) / 1e9)
        if sequence >= newest:
            self._newest[node] = sequence, arrived_ns
