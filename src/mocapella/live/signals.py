"""Turn signals (Ctrl-C, SIGTERM, SIGHUP) into an event that loops wait on: everything is closed, the exit status is 0.

Work without such a loop is interrupted by an exception instead.

A child process of Mocapella also ends when its parent has ended for any reason: a view that outlives a killed server
would keep the port that the next server needs.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Final, NoReturn

from mocapella.live.thread_deaths import StopEvent, end_with_any_thread

STARTED_BY_US: Final = "MOCAPELLA_STARTED_BY_US"
"""Environment variable set for a child process of Mocapella, which ends when its parent closes its standard input."""
_SIGNALS: Final = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""SIGHUP comes when the terminal is closed; Windows has none."""

_Handler = Callable[[int, FrameType | None], None]


@contextmanager
def interruptible() -> Iterator[None]:
    """Let the signals raise `KeyboardInterrupt`, at the end of the block at the latest; then restore earlier handlers.

    Callbacks from C, such as those of numba's compiler, lose exceptions: the C code continues or fails in its own way.
    Only the main thread may enter the block.
    """
    asked, unraisable = False, sys.unraisablehook

    def handle(_signal: int, _frame: FrameType | None) -> NoReturn:
        nonlocal asked
        asked = True
        raise KeyboardInterrupt

    def lost(report: sys.UnraisableHookArgs) -> None:
        if not issubclass(report.exc_type, KeyboardInterrupt):
            unraisable(report)

    with _handled_by(handle):
        sys.unraisablehook = lost
        try:
            yield
        finally:
            sys.unraisablehook = unraisable
            if asked:
                raise KeyboardInterrupt


@contextmanager
def stop_on_signals() -> Iterator[StopEvent]:
    """Yield an event that is set by a signal, the parent's end, or the death of a thread; restore earlier handlers.

    Raises:
        MocapellaError: a thread died within the block (`mocapella.live.thread_deaths`).
    """
    stop = StopEvent()
    if STARTED_BY_US in os.environ:
        threading.Thread(target=_stop_when_alone, args=(stop,), name="parent", daemon=True).start()

    with _set_by_signals(stop), end_with_any_thread(stop):
        yield stop


@contextmanager
def _set_by_signals(stop: threading.Event) -> Iterator[None]:
    """Let a thread set the event on signals.

    A handler must not: it interrupts the main thread, which may hold the event's lock at that moment.
    """
    read, write = os.pipe()
    os.set_blocking(write, False)

    def handle(_signal: int, _frame: FrameType | None) -> None:
        with suppress(BlockingIOError):  # thousands of signals wait already
            os.write(write, b"!")

    def listen() -> None:
        while os.read(read, 4096):
            stop.set()

    listener = threading.Thread(target=listen, name="signals", daemon=True)
    listener.start()
    try:
        with _handled_by(handle):
            yield
    finally:
        os.close(write)
        listener.join()
        os.close(read)


@contextmanager
def _handled_by(handle: _Handler) -> Iterator[None]:
    # nohup ignores SIGHUP, which is then nobody's wish; a shell's background jobs ignore SIGINT, but a script sends it.
    before = {
        number: signal.signal(number, handle)
        for number in _SIGNALS
        if number in (signal.SIGINT, signal.SIGTERM) or signal.getsignal(number) is not signal.SIG_IGN
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _stop_when_alone(stop: threading.Event) -> None:
    # Reads the descriptor: a thread waiting in sys.stdin would hold its lock when the interpreter ends.
    with suppress(OSError):  # an input that cannot be read has nobody at its other end
        while os.read(0, 4096):
            pass
    stop.set()
