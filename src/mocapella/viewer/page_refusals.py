"""Count and log the requests and connections that the view refuses."""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter
from typing import Final

LOG_EVERY_S: Final = 10.0
"""Shortest time between two log entries of one kind [s]."""
_LOG: Final = logging.getLogger("mocapella.viewer")


class PageRefusals:
    """Counts HTTP requests and messages of web pages that the view refuses, by kind; may be called on any thread.

    The first refusal of a kind is logged, and later ones at most every `LOG_EVERY_S` seconds, with their number.

    Attributes:
        lines: one line for each kind, with the number and the latest reason. A new refusal makes a new tuple.
    """

    def __init__(self) -> None:
        self.lines: tuple[str, ...] = ()
        self._lock = threading.Lock()
        self._counts: Counter[str] = Counter()
        self._reasons: dict[str, str] = {}
        self._logged_s: dict[str, float] = {}

    def add(self, kind: str, reason: str) -> None:
        """Count one refusal.

        Args:
            kind: short name, such as ``origin``; use few different ones.
            reason: the reason, as sent to the refused program.
        """
        now_s = time.monotonic()
        with self._lock:
            self._counts[kind] += 1
            self._reasons[kind] = reason
            self.lines = tuple(_line(self._counts[each], text) for each, text in self._reasons.items())
            due = now_s >= self._logged_s.get(kind, -LOG_EVERY_S) + LOG_EVERY_S
            if due:
                self._logged_s[kind] = now_s
            count = self._counts[kind]
        if due:
            _LOG.warning("%s", _line(count, reason), extra={"reason": kind, "count": count})


def _line(count: int, reason: str) -> str:
    return f"the view refused {count} {'request' if count == 1 else 'requests'}, the latest because {reason}"
