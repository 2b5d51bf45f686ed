"""A recording over a bad network: errors and bounds of the node's clock, and frames that are missing after it healed.

Server and node run in two network namespaces of one machine, with a link between them that loses and delays packets at
random (`benchmarks/_bad_link.py`). Both read the same monotonic clock, so the true offset is 0. Needs root on Linux.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from benchmarks._bad_link import ADDRESSES, READY
from benchmarks.harness import Row, at_most, measured
from benchmarks.kill import read_log
from mocapella.live.launch import free_port
from mocapella.recording.take_reader import read_take

PHASE_S, QUICK_S = 45.0, 10.0
PHASES = (
    ("clean link", "0 0 0", ("front",)),
    ("200 ms jitter", "0 200 0", ("side",)),  # which has never seen a clean link
    ("200 ms jitter, 50 % loss", "0 200 0.5", ()),
    ("healed", "0 0 0", ()),
)
"""Name, delay and jitter [ms] and share of lost packets, and the nodes that join."""
CLEAN_MS = 1.0
"""Largest error on a clean link [ms]."""
LISTENS = "waiting for sensors at"


@dataclass(frozen=True)
class Sample:
    """The clock of the node as the server's status shows it [ms]."""

    offset_ms: float
    bound_ms: float


def run(quick: bool = False) -> list[Row]:
    if not sys.platform.startswith("linux") or os.geteuid() != 0:
        raise SystemExit("network: needs root on Linux, for network namespaces; try: sudo python -m benchmarks network")
    seconds = QUICK_S if quick else PHASE_S
    rows: list[Row] = []
    with tempfile.TemporaryDirectory(prefix="mocapella-network-") as folder:
        session = Session(Path(folder))
        try:
            for phase, limits, joins in PHASES:
                session.link(limits)
                for sensor in joins:
                    session.node(sensor)
                for sensor, samples in sorted(session.samples(seconds).items()):
                    rows += _rows(f"{phase}, {sensor}", samples, CLEAN_MS if phase == PHASES[0][0] else None)
            sent = session.end()
        finally:
            session.close()
        stored = {node.node_id: node for node in read_take(Path(folder) / "take.mcap").complete()}
    lost = sum(node.lost for node in stored.values())
    kept = sum(node.stored for node in stored.values())
    first = sum(node.first for node in stored.values())  # frames before the recording began
    return [
        *rows,
        measured("network: nodes that ended without a word", len(stored) - len(sent), "nodes", goal=at_most(0)),
        measured("network: frames sent since the recording began", sum(sent.values()) - first, "frames"),
        measured("network: frames stored after it healed", kept, "frames"),
        measured("network: frames reported lost", lost, "frames", goal=at_most(0)),
        measured("network: frames neither stored nor reported lost", sum(sent.values()) - first - kept - lost, "frames",
                 goal=at_most(0)),
    ]  # fmt: skip


class Session:
    """The namespaces, the link between them, a recording server, and nodes of 60 Hz."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._spaces = [f"mocapella-{os.getpid()}-{place}" for place in ("server", "node")]
        self._processes: list[subprocess.Popen[str]] = []
        self._address = f"tls/{ADDRESSES[0]}:{free_port()}"
        for space in self._spaces:
            subprocess.run(["ip", "netns", "add", space], check=True)
        self._link = self._start("", [sys.executable, "-m", "benchmarks._bad_link", *self._spaces], said=READY)
        host, port = ADDRESSES[0], self._address.rpartition(":")[2]
        words = ["serve", "--no-view", "--host", host, "--port", port, "--method", "stand-still"]
        words += ["--record", str(folder / "take.mcap"), "--set", "reserve_gib=0"]
        self._server = self._start(self._spaces[0], [sys.executable, "-m", "mocapella", *words], said=LISTENS)
        self._nodes: list[subprocess.Popen[str]] = []

    def node(self, sensor: str) -> None:
        """Start a node on the other side."""
        words = ["--connect", self._address, "--sensor", sensor, "--folder", str(self._folder)]
        self._nodes.append(self._start(self._spaces[1], [sys.executable, "-m", "benchmarks._kill_node", *words]))

    def link(self, limits: str) -> None:
        """Change the link."""
        assert self._link.stdin is not None
        print(limits, file=self._link.stdin, flush=True)

    def samples(self, seconds: float) -> dict[str, list[Sample]]:
        """What the status shows, by sensor, again and again; it is asked beside the server, not over the link."""
        found, until_s = dict[str, list[Sample]](), time.monotonic() + seconds
        words = [sys.executable, "-m", "mocapella", "status", "--connect", self._address, "--json", "-"]
        while time.monotonic() < until_s:
            done = subprocess.run(
                ["ip", "netns", "exec", self._spaces[0], *words], capture_output=True, text=True, check=True
            )
            for row in json.loads(done.stdout)["sensors"]:
                if row["clock_offset"] is not None:
                    sample = Sample(1e3 * row["clock_offset"], 1e3 * row["clock_bound"])
                    found.setdefault(row["name"], []).append(sample)
        return found

    def end(self) -> dict[int, int]:
        """End nodes and server as a user does; return the number of frames that each node sent, by node id."""
        for node in self._nodes:
            node.send_signal(signal.SIGTERM)
        for node in self._nodes:
            node.wait(120)
        self._server.send_signal(signal.SIGINT)
        self._server.wait(120)
        logs = [read_log(path) for path in self._folder.glob("*.log")]
        return {log.node_id: log.sent for log in logs if log.sent is not None}

    def close(self) -> None:
        """End what still runs, and remove the namespaces."""
        for process in reversed(self._processes):
            if process.poll() is None:
                process.kill()
            process.wait()
        for space in self._spaces:
            subprocess.run(["ip", "netns", "delete", space], check=False)

    def _start(self, space: str, words: list[str], said: str = "") -> subprocess.Popen[str]:
        inside = ["ip", "netns", "exec", space] if space else []
        path = self._folder / f"said-{len(self._processes)}.txt"
        with path.open("w") as out:
            process = subprocess.Popen([*inside, *words], stdin=subprocess.PIPE, stdout=out, stderr=out, text=True)
        self._processes.append(process)
        while said not in path.read_text(encoding="utf-8"):
            if process.poll() is not None:
                raise SystemExit(f"network: {words[2]} ended: {path.read_text(encoding='utf-8')}")
            time.sleep(0.05)
        return process


def _rows(name: str, samples: list[Sample], most_ms: float | None) -> list[Row]:
    errors = [abs(one.offset_ms) for one in samples]
    beyond = sum(error > one.bound_ms for error, one in zip(errors, samples, strict=True))
    return [
        measured(f"network: {name}: largest error of the clock offset", max(errors), "ms",
                 goal=None if most_ms is None else at_most(most_ms)),
        measured(f"network: {name}: largest bound shown", max(one.bound_ms for one in samples), "ms"),
        measured(f"network: {name}: errors beyond the bound, of {len(samples)}", beyond, "samples", goal=at_most(0)),
    ]  # fmt: skip
