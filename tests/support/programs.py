"""Whole processes of ours, started as a user starts them, and ended by their own id; and their commands without one."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from io import StringIO
from pathlib import Path
from tempfile import TemporaryFile
from types import TracebackType
from typing import IO, Any
from unittest.mock import patch

from support.warm_start import WarmProcess

from mocapella import cli

PYTHONPATH = os.environ.get("PYTHONPATH")
"""Of what warm programs have imported."""
Process = subprocess.Popen[Any] | WarmProcess


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def wait_until(what: str, holds: Callable[[], bool], timeout: float = 90.0) -> None:
    """Poll until it holds; a deadline far beyond what it takes, so that only a hang fails."""
    deadline = time.monotonic() + timeout
    while not holds():
        assert time.monotonic() < deadline, f"waited {timeout:g} s for: {what}"
        time.sleep(0.05)


def start(folder: Path, module: str, arguments: Sequence[str], out: IO[Any], err: IO[Any]) -> Process:
    """``python -m module arguments``; started by Python itself where processes cannot be forked and watched, or where
    it finds other packages, such as plug-ins."""
    environment = {**os.environ, "COLUMNS": "200"}
    if hasattr(os, "pidfd_open") and environment.get("PYTHONPATH") == PYTHONPATH:
        return WarmProcess(module, arguments, folder, environment, (out.fileno(), err.fileno()))
    command = [sys.executable, "-m", module, *arguments]
    return subprocess.Popen(command, cwd=folder, stdin=subprocess.DEVNULL, stdout=out, stderr=err, env=environment)


class Program:
    """``mocapella <arguments>`` as a process of its own; its output goes to a file that a failing test can show.

    ``module`` is what is run instead of `mocapella`, such as one that registers something first.
    """

    def __init__(self, folder: Path, name: str, *arguments: str, module: str = "mocapella") -> None:
        self.log = folder / f"{name}.log"
        with self.log.open("ab") as log:
            self.process = start(folder, module, arguments, log, log)

    @property
    def output(self) -> str:
        return self.log.read_text(encoding="utf-8")

    def said(self, text: str) -> Callable[[], bool]:
        """Whether it has printed that; a process that ended without it fails the test at once."""

        def check() -> bool:
            if text in self.output:
                return True
            assert self.process.poll() is None, f"ended without saying {text!r}:\n{self.output}"
            return False

        return check

    def end(self, how: signal.Signals = signal.SIGINT, timeout: float = 60.0) -> int:
        """Send the signal and return the exit status."""
        if self.process.poll() is None:
            self.process.send_signal(how)
        return self.process.wait(timeout)

    def __enter__(self) -> Program:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()


def run(folder: Path, *arguments: str, timeout: float = 120.0) -> subprocess.CompletedProcess[str]:
    """``mocapella <arguments>`` to its end."""
    with TemporaryFile("w+", encoding="utf-8") as out, TemporaryFile("w+", encoding="utf-8") as err:
        process = start(folder, "mocapella", arguments, out, err)
        try:
            status = process.wait(timeout)
        finally:
            process.kill()
        out.seek(0)
        err.seek(0)
        return subprocess.CompletedProcess(["mocapella", *arguments], status, out.read(), err.read())


def result(folder: Path, *arguments: str, timeout: float = 120.0) -> Any:
    """What ``--json -`` prints."""
    done = run(folder, *arguments, "--json", "-", timeout=timeout)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def run_here(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """`run` in this process, which need not start another: for commands that end by themselves."""
    out, err, status = StringIO(), StringIO(), 0
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    with (
        contextlib.chdir(folder),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        patch.dict(os.environ, COLUMNS="200"),
    ):
        try:
            cli.run(arguments)
        except SystemExit as ended:
            status = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)
    return subprocess.CompletedProcess(["mocapella", *arguments], status, out.getvalue(), err.getvalue())


def result_here(folder: Path, *arguments: str) -> Any:
    """`result` in this process."""
    done = run_here(folder, *arguments, "--json", "-")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)
