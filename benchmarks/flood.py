"""Floods of the view and the bus: what they change in the latency of others, and what becomes of those who flood.

A server, its view, sensors and a reader run as they do in a session; each flood comes from a process of its own. The
latency is from a frame's capture to its scene at the reader, a process that does nothing else.
"""

from __future__ import annotations

import http.client
import json
import math
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import zenoh
from numpy.typing import NDArray

from benchmarks._page import Page
from benchmarks.harness import Row, at_least, at_most, measured, wait_until
from mocapella.live.launch import free_port
from mocapella.wire.reader import Newest
from mocapella.wire.session import open_reader

SENSORS, PEOPLE = 3, 2
CONNECTIONS, QUICK_CONNECTIONS = 1500, 300
ROUNDS, ROUND_S, QUICK_S = 4, 20.0, 10.0
FLOOD_S = 5.0
"""So long a page presses a button [s]."""
PRESSES = "a page that presses a button"
"""It is compared with times in which a page records too, so that what a recording costs is not counted as its."""
TOKEN = "tokenofthebenchmark"
PATIENCE_S = 60.0
Span = tuple[int, int]
"""Begin and end on the monotonic clock [ns]."""
CHANGE_MS = 1.0
"""Largest change of the latency's 99th percentile [ms]."""


def run(quick: bool = False) -> list[Row]:
    rounds, seconds = (1, QUICK_S) if quick else (ROUNDS, ROUND_S)
    connections = QUICK_CONNECTIONS if quick else CONNECTIONS
    with tempfile.TemporaryDirectory(prefix="mocapella-flood-") as folder:
        session = Session(Path(folder))
        try:
            session.wait_until_it_tracks()
            floods: dict[str, Callable[[], dict[str, float]]] = {
                f"{connections} slow connections": lambda: slow(session, connections, seconds),
                PRESSES: lambda: press(session, seconds),
                "a client that sends commands": lambda: session.flood("commands", session.address, seconds),
                "a view without file descriptors": lambda: starve(session, seconds),
            }
            calm: dict[str, list[Span]] = {name: [] for name in floods}
            late: dict[str, list[Span]] = {name: [] for name in floods}
            said: dict[str, list[dict[str, float]]] = {name: [] for name in floods}
            for _ in range(rounds):
                for name, flood in floods.items():
                    without = record if name == PRESSES else wait
                    calm[name].append(span_of(lambda without=without: without(session, seconds)))  # type: ignore[misc]
                    late[name].append(span_of(lambda name=name, flood=flood: said[name].append(flood())))  # type: ignore[misc]
            latencies = session.latencies()
        finally:
            session.close()
    waiting = within(latencies, [span for name in floods if name != PRESSES for span in calm[name]])
    recording = within(latencies, calm[PRESSES])
    rows = [
        measured("flood: nothing: capture to scene at a reader, median", percentile_ms(waiting, 50), "ms"),
        measured("flood: nothing: capture to scene at a reader, p99", percentile_ms(waiting), "ms"),
        measured("flood: nothing but a page that records: p99", percentile_ms(recording), "ms"),
    ]
    for name in floods:
        usual = recording if name == PRESSES else waiting
        change_ms = percentile_ms(within(latencies, late[name])) - percentile_ms(usual)
        rows.append(measured(f"flood: {name}: change of p99", change_ms, "ms", goal=at_most(CHANGE_MS)))
        rows += [_row(name, figure, [one[figure] for one in said[name]]) for figure in said[name][0]]
    return rows


FIGURES: dict[str, tuple[str, str, Any, Any]] = {
    "longest_s": ("closed after, at most", "s", max, at_most(10.0)),
    "page_s": ("the page is loaded meanwhile, at most", "s", max, at_most(1.0)),
    "presses": ("presses", "presses", sum, None),
    "cut_off": ("cut off", "times", sum, at_least(1)),
    "record_s": ("Record in another page is carried out after, at most", "s", max, at_most(1.0)),
    "commands": ("commands", "commands", sum, None),
    "refused": ("refused commands", "commands", sum, None),
    "said": ("it says so", "lines", min, at_least(1)),
    "again_s": ("it answers again after, at most", "s", max, at_most(5.0)),
}
"""Of what a flood reports: words, unit, how rounds are joined, and goal."""


def _row(name: str, figure: str, values: list[float]) -> Row:
    words, unit, join, goal = FIGURES[figure]
    return measured(f"flood: {name}: {words}", join(values), unit, goal=goal)


def span_of(work: Callable[[], object]) -> Span:
    """Do the work; return when it began and ended [ns]."""
    began_ns = time.monotonic_ns()
    work()
    return began_ns, time.monotonic_ns()


def within(latencies_ns: NDArray[np.int64], spans: Sequence[Span]) -> NDArray[np.int64]:
    """Return the latencies of `benchmarks._latency` of the scenes that arrived within one of the spans [ns]."""
    at = latencies_ns[:, 0, None]
    begins, ends = np.array(spans).T
    return latencies_ns[((at >= begins) & (at < ends)).any(axis=1), 1]


def percentile_ms(latencies_ns: NDArray[np.int64], percent: float = 99) -> float:
    """A percentile [ms]; NaN without any latency."""
    return float(np.percentile(latencies_ns, percent)) / 1e6 if latencies_ns.size else math.nan


def slow(session: Session, connections: int, seconds: float) -> dict[str, float]:
    """Connections that send a byte now and then; the page is loaded again and again meanwhile."""
    found: list[dict[str, float]] = []
    flood = threading.Thread(
        target=lambda: found.append(session.flood("slow", session.view_port, connections, seconds))
    )
    flood.start()
    longest_s = 0.0
    while flood.is_alive():
        began_s = time.monotonic()
        if not session.page_loads(PATIENCE_S):
            longest_s = math.inf
        longest_s = max(longest_s, time.monotonic() - began_s)
        flood.join(0.5)
    return {**found[0], "page_s": longest_s}


def wait(session: Session, seconds: float) -> None:
    """Do nothing: what most floods are compared with."""
    time.sleep(seconds)


def record(session: Session, seconds: float) -> float:
    """A page records, as one does beside the page that presses; return after how long it is carried out [s]."""
    with Page(session.url) as page:
        began_s = time.monotonic()
        start, end = page.button("Record"), page.button("Stop recording")
        time.sleep(0.6 * FLOOD_S)
        record_s = session.until_recording(True, lambda: page.press(start))
        time.sleep(max(0.0, began_s + seconds - time.monotonic()))
        session.until_recording(False, lambda: page.press(end))
    return record_s


def press(session: Session, seconds: float) -> dict[str, float]:
    """A page presses a button and leaves; another one records meanwhile."""
    found: list[dict[str, float]] = []
    flood = threading.Thread(target=lambda: found.append(session.flood("press", session.url, FLOOD_S)))
    flood.start()
    record_s = record(session, seconds)
    flood.join()
    return {**found[0], "record_s": record_s}


def starve(session: Session, seconds: float) -> dict[str, float]:
    """Leave the view no file descriptors for a time, and then give them back."""
    view = psutil.Process(session.view.pid)
    usual = view.rlimit(psutil.RLIMIT_NOFILE)
    lines = session.lines_said("cannot open more connections")
    view.rlimit(psutil.RLIMIT_NOFILE, (view.num_fds(), usual[1]))
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s:
        session.page_loads(1.0)
    view.rlimit(psutil.RLIMIT_NOFILE, usual)
    began_s = time.monotonic()
    loads = any(session.page_loads(1.0) for _ in range(int(PATIENCE_S)))
    again_s = time.monotonic() - began_s if loads else math.inf
    return {"said": session.lines_said("cannot open more connections") - lines, "again_s": again_s}


class Session:
    """A server, its view, sensors, and two readers: one in this process, and one that measures latencies."""

    def __init__(self, folder: Path) -> None:
        self._folder, port, self.view_port = folder, free_port(), free_port()
        self.address = f"tls/127.0.0.1:{port}"
        self.url = f"http://127.0.0.1:{self.view_port}/?token={TOKEN}"
        root = Path(__file__).resolve().parent.parent
        self._environment = {
            **os.environ, "PYTHONPATH": str(root), "MOCAPELLA_VIEW_TOKEN": TOKEN,
            "MOCAPELLA_LOGS": str(folder / "logs"),
        }  # fmt: skip
        serve = ["serve", "--no-view", "--port", str(port), "--sensors", str(SENSORS), "--method", "stand-still"]
        self._processes = [self._start("mocapella", *serve)]
        self.view = self._start("mocapella", "view", "--connect", self.address, "--view-port", str(self.view_port))
        self._processes.append(self.view)
        for k in range(SENSORS):
            words = {"connect": self.address, "sensor": f"s{k}", "people": PEOPLE, "seconds": 10**6, "seed": k}
            options = [word for key, value in words.items() for word in (f"--{key}", str(value))]
            self._processes.append(self._start("benchmarks._live_load", *options))
        self._latencies = folder / "latencies.npy"
        self._reader: zenoh.Session | None = None
        self._newest: Newest | None = None

    def wait_until_it_tracks(self) -> None:
        """Open the reader, and wait until all sensors send and the page is served."""
        self._reader = open_reader(self.address, timeout=PATIENCE_S)
        self._newest = Newest(self._reader)
        self._clock = self._start("benchmarks._latency", self.address, str(self._latencies))
        self._processes.append(self._clock)
        wait_until("the sensors", lambda: self._sensors() == SENSORS, PATIENCE_S)
        wait_until("the view", lambda: self.page_loads(PATIENCE_S), PATIENCE_S)

    def latencies(self) -> NDArray[np.int64]:
        """Return what `benchmarks._latency` has measured until now, and end it."""
        self._clock.terminate()
        self._clock.wait(PATIENCE_S)
        return np.load(self._latencies)  # type: ignore[no-any-return]

    def flood(self, *words: object) -> dict[str, float]:
        """Run a flood to its end, and return what it reports; it is in no session of ours, like another's program."""
        line = [sys.executable, "-m", "benchmarks._flooder", *map(str, words)]
        done = subprocess.run(
            line, env=self._environment, stdout=subprocess.PIPE, text=True, check=True, start_new_session=True
        )
        report: dict[str, float] = json.loads(done.stdout)
        return report

    def page_loads(self, timeout_s: float) -> bool:
        """Whether the view answers with its page within that time."""
        connection = http.client.HTTPConnection("127.0.0.1", self.view_port, timeout=timeout_s)
        try:
            connection.request("GET", f"/?token={TOKEN}")
            return connection.getresponse().status == http.HTTPStatus.OK
        except (OSError, http.client.HTTPException):
            return False
        finally:
            connection.close()

    def until_recording(self, active: bool, press: Callable[[], None]) -> float:
        """Press, and return how long it takes until the status says so [s]."""
        began_s = time.monotonic()
        press()
        wait_until("the recording", lambda: self._recording() is active, PATIENCE_S, every_s=0.01)
        return time.monotonic() - began_s

    def lines_said(self, text: str) -> int:
        """How many lines of the logs have the text."""
        return sum(path.read_text(encoding="utf-8").count(text) for path in (self._folder / "logs").glob("*"))

    def close(self) -> None:
        """End all processes."""
        if self._reader is not None:
            self._reader.close()  # type: ignore[no-untyped-call]
        for process in reversed(self._processes):
            process.terminate()
            try:
                process.wait(30)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def _start(self, module: str, *words: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-m", module, *words], cwd=self._folder, env=self._environment, stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip

    def _sensors(self) -> int:
        status = self._newest.status() if self._newest is not None else None
        return 0 if status is None else len(status.sensors)

    def _recording(self) -> bool | None:
        status = self._newest.status() if self._newest is not None else None
        return None if status is None else status.recording.active
