"""Decide when to request a take's missing frames again, and how far back.

The bus itself fetches frames that are lost in transfer, but not all earlier ones. The cache of a node that is still
connecting may miss the request (measured on a busy machine: 2 of 14 restarts of a recording server lost the frames
published meanwhile), and a server that stood still for longer than the bus' lease of 10 s meets its nodes as new ones
(it lost about 600 frames of each). A request after all nodes have connected brings those frames.
"""

from __future__ import annotations

import math

ASK_AFTER_S = 2.0
"""How long the bus may fill a gap itself, and how long to wait for an answer [s]."""
MOST_ASKS = 3
"""Requests after which missing frames count as lost: their node has ended, or no longer keeps them."""
_MARGIN_S = 5.0


class Refetch:
    """Tracks the gaps of a take. Times are on one monotonic clock [s].

    Attributes:
        given_up: number of frames that count as lost.
    """

    def __init__(self) -> None:
        self.given_up = 0
        self._newcomer_since_s: float | None = None
        self._newcomer_added_s = 0.0
        self._rest()

    def _rest(self) -> None:
        self._since_s = math.inf
        self._asked_s: float | None = None
        self._asks = 0

    def opened(self, since_s: float) -> None:
        """Add a gap: frames sent after ``since_s`` are missing."""
        self._since_s = min(self._since_s, since_s)

    def newcomer(self, since_s: float, now_s: float) -> None:
        """Add a new sensor whose first frames, sent after ``since_s``, may be missing: request them once, later."""
        if self._newcomer_since_s is None:
            self._newcomer_since_s, self._newcomer_added_s = since_s, now_s
        self._newcomer_since_s = min(self._newcomer_since_s, since_s)

    def update(self, missing: int, now_s: float, *, at_once: bool = False) -> float | None:
        """Return how many seconds back to request frames now, given the number missing; None for no request.

        ``at_once`` does not wait for the bus to fill the gap itself.
        """
        if self._newcomer_since_s is not None and (at_once or now_s - self._newcomer_added_s >= ASK_AFTER_S):
            since_s, self._newcomer_since_s = self._newcomer_since_s, None
            return now_s - since_s + _MARGIN_S
        if missing <= self.given_up:
            self.given_up = missing
            self._rest()
            return None
        if self._asked_s is None:
            self._asked_s = now_s
        if now_s - self._asked_s < ASK_AFTER_S and not at_once:
            return None
        if self._asks == MOST_ASKS or self._since_s == math.inf:
            self.given_up = missing
            self._rest()
            return None
        self._asks, self._asked_s = self._asks + 1, now_s
        return now_s - self._since_s + _MARGIN_S
