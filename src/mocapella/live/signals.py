"""Ctrl-C and SIGTERM as an event that loops wait on, so that everything is closed properly and the exit is 0.

Work that goes from one end to the other without a loop of ours is interrupted instead.

A process that another of ours has started also ends when that one is gone, however it went: a view that outlived a
killed server would keep the port that the next one wants.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final, NoReturn

STARTED_BY_US: Final = "MOCAPELLA_STARTED_BY_US"
"""Environment variable of a process whose standard input is held open by the one that started it."""
_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)

_Handler = Callable[[int, FrameType | None], None]


@contextmanager
def interruptible() -> Iterator[None]:
    """The signals raise `KeyboardInterrupt`, at the end at the latest; earlier handlers come back afterwards.

    What C calls back loses what is raised in it, as numba's compiler does: it goes on, or fails in its own way.
    """
    asked, unraisable = False, sys.unraisablehook

    def handle(_signal: int, _frame: FrameType | None) -> NoReturn:
        nonlocal asked
        asked = True
        raise KeyboardInterrupt

    def lost(told: sys.UnraisableHookArgs) -> None:
        if not issubclass(told.exc_type, KeyboardInterrupt):
            unraisable(told)

    with _handled_by(handle):
        sys.unraisablehook = lost
        try:
            yield
        finally:
            sys.unraisablehook = unraisable
            if asked:
                raise KeyboardInterrupt


@contextmanager
def stop_on_signals() -> Iterator[threading.Event]:
    """An event that SIGINT, SIGTERM or the end of who started us sets; earlier handlers come back afterwards."""
    stop = threading.Event()
    if STARTED_BY_US in os.environ:
        threading.Thread(target=_stop_when_alone, args=(stop,), name="parent", daemon=True).start()

    def handle(_signal: int, _frame: FrameType | None) -> None:
        stop.set()

    with _handled_by(handle):
        yield stop


@contextmanager
def _handled_by(handle: _Handler) -> Iterator[None]:
    before = {number: signal.signal(number, handle) for number in _SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _stop_when_alone(stop: threading.Event) -> None:
    # The descriptor itself: a thread that waits in sys.stdin would hold its lock when the interpreter ends.
    while os.read(0, 4096):
        pass
    stop.set()
