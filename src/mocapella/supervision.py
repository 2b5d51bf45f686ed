"""Error boundaries: an unexpected error in one message, command or file is counted and reported; the loop goes on.

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

from mocapella.errors import visible

AGAIN_S: Final = 10.0
"""An error that recurs is reported again after this time at the earliest [s]."""
MOST_REASONS: Final = 32
"""Number of different reasons that are counted separately; errors with further reasons count as `OTHER`."""
OTHER: Final = "other errors"
LONGEST_LINE: Final = 500
"""Longest line that is shown or logged, in characters; longer ones are cut."""
_LOG: Final = logging.getLogger(__name__)
_PACKAGE: Final = Path(__file__).resolve().parent


def printable(text: str, most: int = LONGEST_LINE) -> str:
    """Return a text of foreign origin as one line that is safe in a terminal and a log.

    C0 and C1 control characters, bidirectional controls, line separators and lone surrogates are escaped, such as
    ``\\x1b``. A longer text is cut to ``most`` characters, the last one "…", before characters are escaped.
    """
    return visible(text if len(text) <= most else text[: most - 1] + "…")


class Boundary:
    """Runs the work of a loop or callback, and catches, counts and reports unexpected errors. Any thread may use it.

    It catches every `Exception` except `MemoryError`, after which the process cannot be trusted: `run` raises it, and
    `wrap` gives it to `threading.excepthook`.

    Args:
        say: receives a line about an error, at most every `AGAIN_S` for each reason (see `counts`), in the thread of
            the work; by default errors are only logged.
        clock: returns the monotonic time [s].
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
        """Copy of the numbers of errors by reason, such as ``frame: ValueError in model/memory.py:57``.

        After `MOST_REASONS` different reasons, further ones are counted as `OTHER`.
        """
        with self._lock:
            return dict(self._counts)

    def run(self, what: str, work: Callable[[], object]) -> str:
        """Call ``work``; return an empty text, or a description of its error in one line.

        Args:
            what: name of the operation, which begins the reason in `counts`: one of a few constants, never a text from
                a message.
            work: is called once, without arguments; its result is dropped.

        Raises:
            MemoryError: raised by ``work``.
        """
        try:
            work()
        except MemoryError:
            raise
        except Exception as error:  # noqa: BLE001 - the one place that catches all that a message can cause
            return self._catch(what, error)
        return ""

    def wrap(self, what: str, work: Callable[..., object]) -> Callable[..., None]:
        """Return a callback for a library: it passes its positional arguments to ``work``, and runs it as `run` does.

        It returns None, and never raises. A library would swallow a `MemoryError`, so `threading.excepthook` gets it,
        as if a thread of the name ``what`` had died.
        """

        def guarded(*arguments: Any) -> None:
            try:
                self.run(what, lambda: work(*arguments))
            except MemoryError as error:
                thread = threading.Thread(name=what)
                threading.excepthook(threading.ExceptHookArgs((type(error), error, error.__traceback__, thread)))

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
