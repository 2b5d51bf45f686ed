"""Compile a method's kernels in processes of their own.

Most of a compilation is numba's own Python, which holds the interpreter's lock. Other processes use the other cores,
and leave this one free to serve sensors and the view. They share the cache on disk: each compiles another part of the
method first, and loads what another one has compiled (`mocapella.kernel_cache`).
"""

from __future__ import annotations

import gc
import os
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Final

from mocapella.compiled import keeps_kernels
from mocapella.live.launch import Children
from mocapella.registry import load
from mocapella.tracker import METHODS, warm_up

_POLL_S: Final = 0.05
_NICENESS: Final = 10
"""Added to the processes' niceness: sensors and the view start first, and compilation still goes on beside them."""


class Compilation:
    """The processes that compile a method's kernels.

    They end with the ``with`` block at the latest. None is started if no folder for compiled kernels can be written.

    Args:
        method: key of `mocapella.tracker.METHODS`.
    """

    def __init__(self, method: str) -> None:
        self._method = method
        self._children = Children()
        self._started = False

    def start(self) -> None:
        """Start the processes; a second call has no effect."""
        if not self._started and keeps_kernels():
            for part in ("", *METHODS[self._method].warm_up_parts):
                self._children.start([self._method, part], module="mocapella.live.compilation")
        self._started = True

    @property
    def done(self) -> bool:
        """Whether all processes have ended; False before `start`, True after it if none was needed.

        A kernel that none of them could compile is compiled when it is called.
        """
        return self._started and self._children.all_ended()

    def wait(self) -> None:
        """Start the processes, and wait until all have ended."""
        self.start()
        while not self.done:
            time.sleep(_POLL_S)

    def close(self) -> None:
        """End the processes, also unfinished ones; may be called twice."""
        self._children.close()

    def __enter__(self) -> Compilation:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def compile_part(method: str, part: str) -> None:
    """Compile one of a method's ``warm_up_parts``, in this process; all of its kernels if ``part`` is empty."""
    if part:
        load(part)()
    else:
        warm_up(method)


def _end_with_parent() -> None:
    """Exit when standard input ends: the process that started this one holds it open."""
    sys.stdin.read()
    os._exit(1)


def _give_way() -> None:
    """Let every other process go first.

    Linux shares the processors among sessions first (autogroups, see sched(7)), and niceness counts only within one. A
    browser has a session of its own. So this process gets one, too, and its group the niceness.
    """
    if not hasattr(os, "nice"):
        return
    os.nice(_NICENESS)
    with suppress(OSError):
        os.setsid()
        Path("/proc/self/autogroup").write_text(str(_NICENESS), encoding="ascii")


if __name__ == "__main__":
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _give_way()
    gc.set_threshold(200_000, 50, 100)  # numba makes millions of small objects that live until the end
    compile_part(*sys.argv[1:3])
