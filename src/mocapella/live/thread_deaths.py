"""End the process if one of its threads dies, so that a supervisor can start it again.

A boundary (`mocapella.supervision`) keeps threads alive; this is for what it cannot catch, such as `MemoryError`.
"""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

from mocapella.errors import MocapellaError
from mocapella.supervision import printable

EXIT_WITHIN_S: Final = 1.8
"""Time to close takes and leave the bus after the death of a thread; then the process exits all the same [s]."""
_LOG: Final = logging.getLogger(__name__)


class StopEvent(threading.Event):
    """Event that ends a command.

    Attributes:
        died: set before the event if the reason is the death of a thread: takes are closed, and nothing else is
            waited for.
    """

    def __init__(self) -> None:
        super().__init__()
        self.died = threading.Event()


def exit_process() -> None:
    """Exit with status 1, whatever other threads do."""
    os._exit(1)


@contextmanager
def end_with_any_thread(
    stop: StopEvent,
    *,
    exit_now: Callable[[], None] | None = None,
    within_s: float = EXIT_WITHIN_S,
) -> Iterator[None]:
    """Set ``stop.died`` and ``stop`` if a thread dies of an exception within this block; raise an error at its end.

    If the process has not ended by itself ``within_s`` after the death, ``exit_now`` is called, also after the block;
    None stands for `exit_process`.

    Raises:
        MocapellaError: a thread died; names it and its error.
    """
    deaths: list[str] = []

    def died(death: threading.ExceptHookArgs) -> None:
        if issubclass(death.exc_type, SystemExit):
            return
        name = "a thread" if death.thread is None else f"the thread {death.thread.name}"
        said = printable(f"{name} died: {death.exc_type.__name__}: {death.exc_value}")
        deaths.append(said)
        stop.died.set()
        stop.set()
        threading.Thread(
            target=_exit_later, args=(exit_now or exit_process, within_s), name="exit", daemon=True
        ).start()
        trace = None if death.exc_value is None else (death.exc_type, death.exc_value, death.exc_traceback)
        _LOG.critical("%s", said, exc_info=trace)

    before, threading.excepthook = threading.excepthook, died
    try:
        yield
    finally:
        threading.excepthook = before
    if deaths:
        raise MocapellaError(f"{deaths[0]}; takes are closed as far as possible; start the program again")


def _exit_later(exit_now: Callable[[], None], within_s: float) -> None:
    time.sleep(within_s)
    exit_now()
