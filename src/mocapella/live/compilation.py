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
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Final

from mocapella.compiled import keeps_kernels, on_compilation
from mocapella.live.launch import Children
from mocapella.model.names import plural
from mocapella.registry import load
from mocapella.tracker import METHODS, warm_up

_POLL_S: Final = 0.05
_COMPILED: Final = "compiled a kernel"
"""Line that a process prints for each kernel that it has compiled."""
GIVE_WAY_S: Final = 20.0
"""Time after its start in which a compilation has low priority, so that sensors and the view start first [s]."""
_NICENESS: Final = 10
"""Niceness of a compilation's group meanwhile, which gets a tenth of the processor time of another group."""
_AUTOGROUP: Final = Path("/proc/self/autogroup")
_AGAIN_S: Final = 0.1
"""Shortest time between two changes of a group's niceness by any user of the machine, as Linux demands [s]."""


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
        self._compiled, self._lock = 0, threading.Lock()

    def start(self) -> None:
        """Start the processes; a second call has no effect."""
        if not self._started and keeps_kernels():
            for part in ("", *METHODS[self._method].warm_up_parts):
                self._children.start([self._method, part], self._hear, module="mocapella.live.compilation")
        self._started = True

    @property
    def done(self) -> bool:
        """Whether all processes have ended; False before `start`, True after it if none was needed.

        A kernel that none of them could compile is compiled when it is called.
        """
        return self._started and self._children.all_ended()

    @property
    def progress(self) -> str:
        """Number of kernels compiled so far, such as ``34 of about 170 kernels``; empty before the first."""
        count, most = self._compiled, METHODS[self._method].kernels
        if not count:
            return ""
        return f"{min(count, most)} of about {most} kernels" if most else plural(count, "kernel", "kernels")

    def wait(self, on_progress: Callable[[], None] = lambda: None) -> None:
        """Start the processes, and wait until all have ended; ``on_progress`` is called when `progress` changes."""
        self.start()
        before = ""
        while not self.done:
            if self.progress != before:
                before = self.progress
                on_progress()
            time.sleep(_POLL_S)

    def close(self) -> None:
        """End the processes, also unfinished ones; may be called twice."""
        self._children.close()

    def _hear(self, line: str) -> None:
        with self._lock:  # each process has a thread that listens to it
            self._compiled += line == _COMPILED

    def __enter__(self) -> Compilation:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def compile_part(method: str, part: str) -> None:
    """Compile kernels of a method in this process.

    Args:
        method: key of `mocapella.tracker.METHODS`.
        part: one of the method's ``warm_up_parts``, a group of kernels; empty for all kernels.
    """
    if part:
        load(part)()
    else:
        warm_up(method)


def _end_with_parent() -> None:
    """Exit when standard input ends: the process that started this one holds it open."""
    sys.stdin.read()
    os._exit(1)


def _give_way(for_s: float) -> None:
    """Give this process low priority for ``for_s`` seconds, where the system has autogroups.

    Linux shares the processors among sessions first (autogroups, see sched(7)), and niceness counts only within one. So
    this process gets a session of its own, and the session the niceness. It can be taken back, but a process's own
    niceness cannot without privileges: a browser that draws in software would then leave nothing to the compilation,
    and people would not be tracked.
    """
    try:
        os.setsid()
        _set_group_niceness(_NICENESS)
    except (AttributeError, OSError):
        return
    end = threading.Timer(for_s, _set_group_niceness, (0,))
    end.daemon = True
    end.start()


def _set_group_niceness(niceness: int) -> None:
    while True:
        try:
            _AUTOGROUP.write_text(str(niceness), encoding="ascii")
        except BlockingIOError:  # another process has just changed its own
            time.sleep(_AGAIN_S)
        else:
            return


def _tell() -> None:
    sys.stdout.write(f"{_COMPILED}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _give_way(GIVE_WAY_S)
    gc.set_threshold(200_000, 50, 100)  # numba makes millions of small objects that live until the end
    with on_compilation(_tell):
        compile_part(*sys.argv[1:3])
