"""When to ask the nodes again for frames that a take misses, and how far back.

The bus fetches by itself what is lost on the way, but not all of what was published before: a cache that is asked while
its node is only just connecting may not hear the question (measured on a busy machine: 2 of 14 restarts of a recording
server lost what was published meanwhile), and to a server that stood still for longer than the bus' lease of 10 s the
nodes are new acquaintances (it lost some 600 frames of each). Asking when everybody is connected brings them.
"""

from __future__ import annotations

import math

ASK_AFTER_S = 2.0
"""How long a gap is left to the bus, and how long an answer is waited for."""
MOST_ASKS = 3
"""What did not come then is lost for good: its node has ended, or keeps it no longer."""
_MARGIN_S = 5.0


class Refetch:
    """Follows the gaps of a take. Times are on one steady clock [s].

    Attributes:
        given_up: how many frames are missing for good.
    """

    def __init__(self) -> None:
        self.given_up = 0
        self._newcomer_since_s: float | None = None
        self._newcomer_seen_s = 0.0
        self._rest()

    def _rest(self) -> None:
        self._since_s = math.inf
        self._asked_s: float | None = None
        self._asks = 0

    def opened(self, since_s: float) -> None:
        """A gap was found: frames that were sent after ``since_s`` are missing."""
        self._since_s = min(self._since_s, since_s)

    def newcomer(self, since_s: float, now_s: float) -> None:
        """A sensor has begun whose first frames, sent after ``since_s``, may have been missed: ask once, in a while."""
        if self._newcomer_since_s is None:
            self._newcomer_since_s, self._newcomer_seen_s = since_s, now_s
        self._newcomer_since_s = min(self._newcomer_since_s, since_s)

    def update(self, missing: int, now_s: float, *, at_once: bool = False) -> float | None:
        """How many seconds back to ask now, where so many frames are missing; None where there is nothing to ask.

        ``at_once`` does not wait for the bus to bring them by itself.
        """
        if self._newcomer_since_s is not None and (at_once or now_s - self._newcomer_seen_s >= ASK_AFTER_S):
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
