"""A thread of a recording server dies: how long until the process has ended, and whether its take is closed.

A node of 60 Hz sends to a server that records. One thread of the server runs out of memory, each in its turn.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.harness import Row, at_most, measured, wait_until
from benchmarks.kill import READY
from mocapella.live.launch import free_port
from mocapella.recording.take_reader import read_take

THREADS = ("tracker", "recorder", "record-path", "clocks", "housekeeping")
TIMES = 4
"""Deaths of each thread."""
EXIT_S = 2.0
PATIENCE_S = 60.0


def run(quick: bool = False) -> list[Row]:
    rows = []
    for thread in THREADS:
        ends = [_death(thread) for _ in range(1 if quick else TIMES)]
        label = f"deaths: {thread}:"
        rows += [
            measured(
                f"{label} until the process has ended, longest", max(s for s, *_ in ends), "s", goal=at_most(EXIT_S)
            ),
            measured(
                f"{label} exit status other than 1", sum(status != 1 for _, status, _ in ends), "times", goal=at_most(0)
            ),
            measured(
                f"{label} takes that are not closed", sum(not closed for *_, closed in ends), "takes", goal=at_most(0)
            ),
        ]
    return rows


def _death(thread: str) -> tuple[float, int, bool]:
    """Let a thread die; return the time until the process has ended [s], its status, and whether the take is closed."""
    with tempfile.TemporaryDirectory(prefix="mocapella-deaths-") as name:
        folder, port = Path(name), free_port()
        words = f"serve --no-view --port {port} --method stand-still --record ./take --set reserve_gib=0".split()
        said = folder / "server.txt"
        with said.open("wb") as out:
            server = subprocess.Popen(
                [sys.executable, "-m", "benchmarks._dying_server", thread, name, *words], cwd=folder, stderr=out,
                env={**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parent.parent),
                     "MOCAPELLA_LOGS": str(folder / "logs")},
                stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            )  # fmt: skip
        processes = [server]
        try:
            wait_until("the server listens", lambda: READY in said.read_text(encoding="utf-8"), PATIENCE_S)
            processes.append(subprocess.Popen(
                [sys.executable, "-m", "benchmarks._kill_node", "--connect", f"tls/127.0.0.1:{port}", "--sensor",
                 "front", "--folder", name, "--farewell", "0"], stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            ))  # fmt: skip
            wait_until("frames are stored", lambda: any(map(_acknowledged, folder.glob("*.log"))), PATIENCE_S)
            (folder / "die").touch()
            status = server.wait(PATIENCE_S)
            ended_ns = time.monotonic_ns()
        finally:
            for process in processes:
                process.kill()
                process.wait()
        take = read_take(folder / "take.mcap")
        closed = not [problem for problem in take.problems if "unknown after frame" not in problem]
        return (ended_ns - int((folder / "died").read_text())) / 1e9, status, closed


def _acknowledged(log: Path) -> bool:
    """Whether a line of `benchmarks._kill_node` says that a frame was acknowledged."""
    return any(line[:1].isdigit() for line in log.read_text(encoding="utf-8").splitlines())
