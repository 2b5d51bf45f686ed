"""Steps of the wall clock of a recording server or of its node, also while the server is away: what is stored.

A node sends 660 frames. In the middle, the wall clock of one process steps (`benchmarks/_wall_clock.c`, for Linux and a
C compiler); in half of the cases the server is killed before it, and started again after it. ``--quick`` takes four of
the 24 cases.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from benchmarks.harness import Row, at_least, at_most, measured, wait_until
from benchmarks.kill import READY, read_log
from mocapella.live.launch import free_port
from mocapella.recording.take_reader import read_take

FRAMES = 660
STEPS_S = (5, -5, 30, -30, 7200, -7200)
NOTICE = "wall clock of this machine stepped by"
PATIENCE_S = 120.0


@dataclass(frozen=True)
class Case:
    """Whose wall clock steps, by how much [s], and whether the server is away meanwhile."""

    whose: str
    step_s: int
    outage: bool

    @property
    def name(self) -> str:
        return f"clocks: {self.whose} {self.step_s:+d} s{' in an outage' if self.outage else ''}"

    @property
    def is_noticed(self) -> bool:
        """Whether the process whose clock steps runs when it does."""
        return self.whose == "node" or not self.outage


CASES = tuple(Case(*each) for each in product(("server", "node"), STEPS_S, (False, True)))
QUICK = (Case("server", -7200, True), Case("node", 30, True), Case("server", 5, False), Case("node", -7200, False))


def run(quick: bool = False) -> list[Row]:
    if not sys.platform.startswith("linux"):
        raise SystemExit("clocks: shifts clocks with LD_PRELOAD, which only Linux has")
    rows: list[Row] = []
    with tempfile.TemporaryDirectory(prefix="mocapella-clocks-") as folder:
        library = Path(folder) / "wall_clock.so"
        source = Path(__file__).with_name("_wall_clock.c")
        subprocess.run(["cc", "-shared", "-fPIC", "-O2", "-o", str(library), str(source), "-ldl"], check=True)
        for number, case in enumerate(QUICK if quick else CASES):
            place = Path(folder) / str(number)
            place.mkdir()
            rows += _run_case(case, place, library)
    return rows


def _run_case(case: Case, folder: Path, library: Path) -> list[Row]:
    session = Session(folder, library)
    try:
        session.wait_for(FRAMES // 3)
        if case.outage:
            session.kill_server()
        session.step(case.whose, case.step_s)
        session.wait_for(FRAMES // 2)
        if case.outage:
            session.start_server()
        noticed = NOTICE in session.end(case.whose)
    finally:
        session.kill_all()
    (node,) = read_take(folder / "take.mcap").complete()
    rows = [
        measured(f"{case.name}: stored of {FRAMES}", node.stored, "frames", goal=at_least(FRAMES)),
        measured(f"{case.name}: lost", node.lost, "frames", goal=at_most(0)),
    ]
    if case.is_noticed:
        rows.append(measured(f"{case.name}: notices", noticed, "notices", goal=at_least(1)))
    return rows


class Session:
    """A recording server and a node, each with a wall clock of its own."""

    def __init__(self, folder: Path, library: Path) -> None:
        self._folder, self._library, self._port = folder, library, free_port()
        self.start_server()
        words = ["--connect", f"tls/127.0.0.1:{self._port}", "--sensor", "front", "--folder", str(folder)]
        module = ["-m", "benchmarks._kill_node", *words, "--frames", str(FRAMES), "--farewell", str(PATIENCE_S)]
        self._node = self._start("node", module, Path.cwd(), folder / "node.txt")

    def start_server(self) -> None:
        """Start the server, and wait until it records."""
        words = ["serve", "--no-view", "--port", str(self._port), "--method", "stand-still", "--record", "./take.mcap"]
        module = ["-m", "mocapella", *words, "--set", "reserve_gib=0"]
        self._server = self._start("server", module, self._folder, self._folder / "server.txt")
        wait_until("the server listens", lambda: self._says(READY), PATIENCE_S)

    def _says(self, text: str) -> bool:
        said = (self._folder / "server.txt").read_text(encoding="utf-8")
        if self._server.poll() is not None:
            raise SystemExit(f"clocks: the server ended: {said}")
        return text in said

    def kill_server(self) -> None:
        """End the server as a power failure does."""
        self._server.kill()
        self._server.wait()

    def step(self, whose: str, step_s: int) -> None:
        """Shift the wall clock of the server or the node."""
        (self._folder / f"{whose}.clock").write_text(str(step_s), encoding="utf-8")

    def wait_for(self, frames: int) -> None:
        """Wait until the node has sent so many frames."""

        def sent() -> bool:
            return any(read_log(log).published >= frames for log in self._folder.glob("*.log"))

        wait_until(f"{frames} frames", sent, PATIENCE_S)

    def end(self, whose: str) -> str:
        """Wait for the last frame, and end the server as a user does; return what server or node has said."""
        self._node.wait(PATIENCE_S)
        self._server.send_signal(signal.SIGINT)
        self._server.wait(PATIENCE_S)
        files = [self._folder / "server.txt"] if whose == "server" else list(self._folder.glob("*.log"))
        return "".join(file.read_text(encoding="utf-8") for file in files)

    def kill_all(self) -> None:
        """End what still runs."""
        for process in (self._node, self._server):
            if process.poll() is None:
                process.kill()
                process.wait()

    def _start(self, whose: str, words: list[str], folder: Path, said: Path) -> subprocess.Popen[bytes]:
        clock = {"LD_PRELOAD": str(self._library), "MOCAPELLA_WALL_CLOCK": str(self._folder / f"{whose}.clock")}
        with said.open("wb") as out:
            return subprocess.Popen(
                [sys.executable, *words],
                cwd=folder, stdin=subprocess.DEVNULL, stdout=out, stderr=out, env={**os.environ, **clock},
            )  # fmt: skip
