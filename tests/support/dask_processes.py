"""A Dask scheduler and its workers as real processes, started as a user would, on this machine only."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
PATIENCE_S = 60.0


def wait_for(holds: Callable[[], object], what: str) -> None:
    until_s = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < until_s, f"waited in vain: {what}"
        time.sleep(0.05)


@contextmanager
def started(folder: Path, *arguments: str, name: str) -> Iterator[subprocess.Popen[bytes]]:
    """A process ``dask …``; what it says is in a file of the folder."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(TESTS), os.environ.get("PYTHONPATH", "")])}
    with (folder / f"{name}.txt").open("wb") as said:
        process = subprocess.Popen(
            [sys.executable, "-m", "dask", *arguments], stdout=said, stderr=said, env=environment, cwd=folder
        )
        try:
            yield process
        finally:
            process.send_signal(signal.SIGTERM)
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


@contextmanager
def scheduler(folder: Path, *options: str) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """The address of a scheduler, and its process."""
    file = folder / "scheduler.json"
    loopback = ("--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(file))
    with started(folder, "scheduler", *loopback, *options, name="scheduler") as process:
        wait_for(file.is_file, "a scheduler")
        yield json.loads(file.read_text())["address"], process


@contextmanager
def worker(folder: Path, address: str, name: str, *options: str) -> Iterator[subprocess.Popen[bytes]]:
    """A worker of one process and thread."""
    own = ("--host", "127.0.0.1", "--nthreads", "1", "--no-dashboard", "--local-directory", str(folder / name))
    with started(folder, "worker", address, *own, *options, name=name) as process:
        wait_for(lambda: "Registered to" in (folder / f"{name}.txt").read_text(), f"worker {name}")
        yield process
