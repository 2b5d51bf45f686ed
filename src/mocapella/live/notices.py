"""Notices: messages for users about events, in the status, the log and the terminal.

Notices that other programs cause are limited to a rate, so that a flood of them hides nothing that matters.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Final

from mocapella.model.limits import LONGEST_NOTICE, NOTICES_A_SECOND, NOTICES_AT_ONCE
from mocapella.supervision import Boundary, printable

_LOG: Final = logging.getLogger("mocapella.notices")
_SHOWN: Final = 8
"""Newest notices that every status has."""
_UNSAID: Final = 256
"""Notices that wait for a terminal that does not take them; further ones are only logged."""
_PATIENCE_S: Final = 1.0
"""Longest wait for the terminal at the end [s]."""


class Notices:
    """Takes notices on any thread, and never blocks: a thread of its own writes them to the terminal.

    Args:
        say: called with each notice, on that thread only; a terminal may block it for as long as it likes, and an error
            of it is only logged.
        clock: the monotonic clock, in seconds.

    Attributes:
        left_out: number of notices beyond the rate, neither shown nor logged, and of notices that a blocked terminal
            did not print.
    """

    def __init__(self, say: Callable[[str], None], *, clock: Callable[[], float] = time.monotonic) -> None:
        self.left_out = 0
        self._say, self._clock, self._errors = say, clock, Boundary()
        self._newest: deque[str] = deque(maxlen=_SHOWN)
        self._lock = threading.Lock()
        self._allowed, self._since_s = float(NOTICES_AT_ONCE), clock()
        self._untold = 0
        self._unsaid: queue.Queue[str | None] = queue.Queue(_UNSAID)
        self._thread = threading.Thread(target=self._write, name="notices", daemon=True)
        self._thread.start()

    @property
    def newest(self) -> tuple[str, ...]:
        """The newest notices, the newest last."""
        with self._lock:
            return tuple(self._newest)

    def add(self, text: str, *, foreign: bool = False) -> None:
        """Show and log a notice, escaped and cut to `LONGEST_NOTICE`.

        Args:
            text: the notice.
            foreign: whether another program can cause it at will; beyond the allowed rate it is only counted.
        """
        with self._lock:
            if foreign and not self._may_speak():
                self.left_out, self._untold = self.left_out + 1, self._untold + 1
                return
            self._allowed -= foreign
            self._tell(text)

    def beat(self) -> None:
        """Add the number of notices left out as a notice, once the rate allows it; called several times a second."""
        with self._lock:
            if self._untold and self._may_speak():
                self._allowed -= 1
                count, self._untold = self._untold, 0
                self._tell(f"{count} more notices were left out: too many at once")

    def close(self) -> None:
        """End the thread once the terminal has taken the waiting notices, or give up after two seconds at most."""
        self.beat()
        try:
            self._unsaid.put(None, timeout=_PATIENCE_S)
        except queue.Full:
            return
        self._thread.join(_PATIENCE_S)

    def _may_speak(self) -> bool:
        now_s = self._clock()
        self._allowed = min(NOTICES_AT_ONCE, self._allowed + (now_s - self._since_s) * NOTICES_A_SECOND)
        self._since_s = now_s
        return self._allowed >= 1

    def _tell(self, text: str) -> None:
        notice = printable(text, LONGEST_NOTICE)
        self._newest.append(notice)
        _LOG.info("%s", notice)
        try:
            self._unsaid.put_nowait(notice)
        except queue.Full:
            self.left_out += 1

    def _write(self) -> None:
        while (notice := self._unsaid.get()) is not None:
            self._errors.run("notice", partial(self._say, notice))
