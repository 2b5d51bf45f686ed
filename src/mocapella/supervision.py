"""Boundaries: an unexpected error of one message, command, file or question is counted and reported; its loop goes on.

errors = Boundary(say)
while not stopped:
    errors.run("frame", partial(take, queue.get()))
"""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Final

from mocapella.model.names import visible

AGAIN_S: Final = 10.0
"""An error that recurs is reported again after this time at the earliest [s]."""
MOST_REASONS: Final = 32
"""Number of errors that are told apart; further ones are counted as `OTHER`."""
OTHER: Final = "other errors"
LONGEST_LINE: Final = 500
"""Longest line that is shown or logged, in characters; longer ones are cut."""
_LOG: Final = logging.getLogger(__name__)
_PACKAGE: Final = Path(__file__).resolve().parent


def printable(text: str, most: int = LONGEST_LINE) -> str:
    """Return a text of foreign origin as one line that is safe in a terminal and a log.

    C0 and C1 control characters, bidirectional controls, line separators and lone surrogates are escaped, such as
    ``\\x1b``; a text of more than ``most`` characters is cut.
    """
    return visible(text if len(text) <= most else text[: most - 1] + "…")


class Boundary:
    """Carries out work, and catches its unexpected errors. Any thread may use it.

    `MemoryError` is not caught, because the process cannot be trusted afterwards.

    Args:
        say: receives a line about an error, at most every `AGAIN_S` for each place in the source.
        clock: the monotonic clock, in seconds.
    """

    def __init__(
        self, say: Callable[[str], None] = lambda text: None, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._say, self._clock = say, clock
        self._counts: Counter[str] = Counter()
        self._told_s: dict[str, float] = {}
        self._lock = threading.Lock()

    @property
    def counts(self) -> dict[str, int]:
        """Number of errors, by reason: the operation, the type of the error, and the place in the source."""
        with self._lock:
            return dict(self._counts)

    def run(self, what: str, work: Callable[[], object]) -> str:
        """Carry out ``work``; return an empty text, or a description of its error.

        Args:
            what: is done, in a constant number of variants: never a text from a message.
            work: is called once.

        Raises:
            MemoryError: of ``work``.
        """
        try:
            work()
        except MemoryError:
            raise
        except Exception as error:  # noqa: BLE001 - the one place that catches all that a message can cause
            return self._catch(what, error)
        return ""

    def wrap(self, what: str, work: Callable[..., object]) -> Callable[..., None]:
        """Return a function with the arguments of ``work`` that is carried out as by `run`."""

        def guarded(*arguments: Any) -> None:
            self.run(what, lambda: work(*arguments))

        return guarded

    def _catch(self, what: str, error: Exception) -> str:
        place = f"{type(error).__name__} in {_place(error.__traceback__)}"
        now_s = self._clock()
        with self._lock:
            reason = f"{what}: {place}"
            if reason not in self._counts and len(self._counts) >= MOST_REASONS:
                reason = OTHER
            self._counts[reason] += 1
            count = self._counts[reason]
            due = now_s - self._told_s.get(reason, -AGAIN_S) >= AGAIN_S
            if due:
                self._told_s[reason] = now_s
        said = printable(f"unexpected error ({what}): {type(error).__name__}: {error}")
        if due:
            _LOG.error("%s", said, exc_info=error, extra={"told": True, "reason": reason, "count": count})
            self._say(said + (f" ({count} times so far)" if count > 1 else ""))
        return said


def _place(trace: TracebackType | None) -> str:
    """Return the last place of a traceback in this package, such as ``model/memory.py:57``."""
    place = "an unknown place"
    while trace is not None:
        file = Path(trace.tb_frame.f_code.co_filename)
        if file.is_relative_to(_PACKAGE) and file != Path(__file__):
            place = f"{file.relative_to(_PACKAGE).as_posix()}:{trace.tb_lineno}"
        trace = trace.tb_next
    return place
