"""Processes that run a piece of code with kernels. They are forked from one that has imported numba: that takes most of
the time of such a process."""

from __future__ import annotations

import contextlib
import os
import sys
from io import StringIO
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path

_CONTEXT = get_context("forkserver")
_CONTEXT.set_forkserver_preload(["tests.support.numba_loaded", "mocapella.compiled"])  # found from the project's folder


class Forked:
    """``python -c code arguments`` in a folder and with some environment variables; its output is kept."""

    def __init__(self, folder: Path, code: str, *arguments: str, **environment: str) -> None:
        self._out, out = _CONTEXT.Pipe(duplex=False)
        self._process = _CONTEXT.Process(target=_run, args=(out, folder, code, arguments, environment))
        self._process.start()
        out.close()

    def ended(self) -> bool:
        return not self._process.is_alive()

    def kill(self) -> None:
        self._process.kill()

    def output(self, timeout: float = 120.0) -> str:
        """What it has printed, once it has ended without an error."""
        said = ""
        with contextlib.suppress(EOFError):
            assert self._out.poll(timeout), "the process hangs"
            said = self._out.recv()
        self._process.join(timeout)
        assert self._process.exitcode == 0
        return said


def _run(out: Connection, folder: Path, code: str, arguments: tuple[str, ...], environment: dict[str, str]) -> None:
    os.chdir(folder)
    os.environ.pop("NUMBA_CACHE_DIR", None)
    os.environ.update(environment)
    sys.argv, sys.path[:0] = ["-c", *arguments], [""]
    # What Python and numba read as they start.
    sys.dont_write_bytecode = "PYTHONDONTWRITEBYTECODE" in environment
    sys.pycache_prefix = environment.get("PYTHONPYCACHEPREFIX", sys.pycache_prefix)
    from numba.core import config

    config.reload_config()
    printed = StringIO()
    with contextlib.redirect_stdout(printed):
        exec(code, {"__name__": "__main__"})
    out.send(printed.getvalue())
