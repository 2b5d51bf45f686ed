"""Start programs of ours from a process that has imported them: imports are most of what a start costs.

A started program is a process like any other: it has its own arguments, folder, environment, output and exit status,
and Python ends it as it ends any. `tests/test_readme.py` and `tests/cli/test_start_time.py` start Python itself.
"""

from __future__ import annotations

import atexit
import importlib
import json
import os
import pkgutil
import runpy
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path

_ENVIRONMENT = dict(os.environ)
"""As no test has changed it yet."""
LONGEST = 1 << 20
"""Longest request, which contains the environment [B]."""


class WarmProcess:
    """``python -m module arguments``, with what the tests use of `subprocess.Popen`.

    Args:
        module, arguments: what is run.
        folder: working directory.
        environment: all its variables.
        outputs: file descriptors for its output and its errors.
    """

    def __init__(
        self,
        module: str,
        arguments: Sequence[str],
        folder: Path,
        environment: Mapping[str, str],
        outputs: tuple[int, int],
    ) -> None:
        self.returncode: int | None = None
        request = json.dumps([module, list(arguments), str(folder), dict(environment)]).encode()
        reports, report = os.pipe()
        socket.send_fds(_requests(), [request], [*outputs, report])
        os.close(report)
        self._reports = os.fdopen(reports, encoding="ascii")
        pid = self._reports.readline()
        assert pid, "the process that starts programs has died: its error is above"
        self.pid = int(pid)

    def poll(self) -> int | None:
        """Return the exit status; minus the signal's number if a signal ended it; None while it runs."""
        if self.returncode is None and select.select([self._reports], [], [], 0)[0]:
            self.returncode = int(self._reports.readline())
            self._reports.close()
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its end and return `poll`; raises `subprocess.TimeoutExpired` after ``timeout`` [s]."""
        if self.returncode is None and not select.select([self._reports], [], [], timeout)[0]:
            raise subprocess.TimeoutExpired(f"process {self.pid}", timeout or 0.0)
        status = self.poll()
        assert status is not None
        return status

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)


@cache
def _requests() -> socket.socket:
    """Start the process that has imported everything, once; it ends with this one."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    for end in (ours, theirs):
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, LONGEST)
    with theirs:
        started = subprocess.Popen(
            [sys.executable, __file__, str(theirs.fileno())],
            pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            env={**_ENVIRONMENT, "COLUMNS": "200", "OPENBLAS_NUM_THREADS": "1"},
        )

    def end() -> None:
        ours.shutdown(socket.SHUT_RDWR)
        ours.close()
        try:
            started.wait(10.0)
        except subprocess.TimeoutExpired:
            started.kill()

    atexit.register(end)
    return ours


def _import_everything() -> None:
    from support import numba_loaded  # noqa: F401

    import mocapella

    for module in pkgutil.walk_packages(mocapella.__path__, "mocapella."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    assert len(list(Path("/proc/self/task").iterdir())) == 1, "an import starts a thread: nothing can be forked safely"


def _serve(requests: socket.socket) -> tuple[str, list[str]]:
    """Fork a program for each request; returns in the program, with its module and arguments."""
    running: dict[int, tuple[int, int]] = {}  # by descriptor of the process: its id and where its end is reported
    while True:
        ready, _, _ = select.select([requests, *running], [], [])
        for process in set(ready) & set(running):
            pid, report = running.pop(process)
            _report(report, os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))
            os.close(report)
            os.close(process)
        if requests not in ready:
            continue
        request, files, _, _ = socket.recv_fds(requests, LONGEST, 3)
        if not request:
            os._exit(0)
        pid = os.fork()
        if pid:
            _report(files[2], pid)
            running[os.pidfd_open(pid)] = pid, files[2]
            for file in files[:2]:
                os.close(file)
            continue
        for file in (files[2], *running, *(report for _, report in running.values())):
            os.close(file)
        module, arguments, folder, environment = json.loads(request)
        for number, file in enumerate(files[:2], start=1):
            os.dup2(file, number)
            os.close(file)
        requests.close()
        os.chdir(folder)
        os.environ.clear()
        os.environ.update(environment)
        sys.path[0] = folder
        time.tzset()
        return module, arguments


def _report(pipe: int, number: int) -> None:
    with suppress(BrokenPipeError):  # a failed test has forgotten the program
        os.write(pipe, b"%d\n" % number)


if __name__ == "__main__":
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    _import_everything()
    name, sys.argv[1:] = _serve(socket.socket(fileno=int(sys.argv[1])))
    runpy.run_module(name, run_name="__main__", alter_sys=True)
