"""A recording over a bad network: clock, age of live frames, notices, and frames that are missing after it healed.

Server and node run in two network namespaces of one machine, with a link between them that loses and delays packets at
random (`benchmarks/_bad_link.py`). Both read the same monotonic clock, so the true offset is 0. Needs root on Linux.
"""

from __future__ import annotations

import json
import math
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from benchmarks._bad_link import ADDRESSES, READY
from benchmarks.harness import Row, at_most, measured
from benchmarks.kill import read_log
from benchmarks.outage import recovered_after_s
from mocapella.live.launch import free_port
from mocapella.recording.take_reader import read_take

PHASE_S, QUICK_S = 45.0, 10.0
PHASES = (
    ("clean link", "0 0 0", ("front",)),
    ("200 ms jitter", "0 200 0", ("side",)),  # which has never seen a clean link
    ("200 ms jitter, 50 % loss", "0 200 0.5", ()),
    ("healed", "0 0 0", ()),
    ("1 Mbit/s", "5 0 0 1", ()),
    ("20 % repeated, 20 % overtaking", "20 20 0 0 0.2 0.2", ()),
)
"""Name, limits of the link (`benchmarks._bad_link.Limits`), and the nodes that join."""
DOWN_S, QUICK_DOWN_S = 60.0, 15.0
"""Time for which the link is down, without a word to either side [s]."""
STOPPED_S = 5.0
"""Time for which the server stands still [s]."""
NOTICED_S = 3.0
"""Longest time until a link that is down, or a server that stands still, is noticed [s]."""
FRESH_MS = 300.0
"""Largest age of live frames on a narrow or disordered link [ms]; the path's own delay is up to 40 ms."""
CLEAN_MS = 1.0
"""Largest error on a clean link [ms]."""
LISTENS = "waiting for sensors at"
NODE_SAYS = re.compile("does not answer|is gone")
SERVER_SAYS = re.compile('sensor "(.*)" has sent nothing for')


@dataclass(frozen=True)
class Sample:
    """The clock of the node as the server's status shows it, and the age of its newest results [ms]."""

    offset_ms: float
    bound_ms: float
    age_ms: float | None


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
            session.link("0 0 0")
            session.samples(2.0)
            rows += _noticed("server stopped", session.stop_server())
            rows += _noticed("link down", session.cut(QUICK_DOWN_S if quick else DOWN_S))
            recovered_s = recovered_after_s(Path(folder), time.monotonic_ns())
            sent = session.end()
        finally:
            session.close()
        stored = {node.node_id: node for node in read_take(Path(folder) / "take.mcap").complete()}
    lost = sum(node.lost for node in stored.values())
    kept = sum(node.stored for node in stored.values())
    first = sum(node.first for node in stored.values())  # frames before the recording began
    return [
        *rows,
        measured("network: link down: until all frames are acknowledged, once it is up", recovered_s, "s"),
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
                    age = None if row["latency"] is None else 1e3 * row["latency"]
                    sample = Sample(1e3 * row["clock_offset"], 1e3 * row["clock_bound"], age)
                    found.setdefault(row["name"], []).append(sample)
        return found

    def stop_server(self) -> dict[str, float | None]:
        """Let the server stand still for a while; return after what time each node said so [s]."""
        since = time.time(), time.monotonic()
        self._server.send_signal(signal.SIGSTOP)
        time.sleep(STOPPED_S)
        self._server.send_signal(signal.SIGCONT)
        time.sleep(2.0)
        return self._said_by_nodes(since[1])

    def cut(self, seconds: float) -> dict[str, float | None]:
        """Cut the link for a while; return after what time each node and, for each sensor, the server said so [s]."""
        since = time.time(), time.monotonic()
        self.link("0 0 1")
        time.sleep(seconds)
        found = self._said_by_nodes(since[1]) | self._said_by_server(since[0])
        self.link("0 0 0")
        return found

    def _said_by_nodes(self, since_s: float) -> dict[str, float | None]:
        found: dict[str, float | None] = {}
        for path in self._folder.glob("*.log"):
            rows = [line.split(maxsplit=2) for line in path.read_text(encoding="utf-8").splitlines()]
            name = next(row[2] for row in rows if row[0] == "node")
            said = [int(row[1]) / 1e9 - since_s for row in rows if row[0] == "said" and NODE_SAYS.search(row[2])]
            found[f"node {name}"] = min((at for at in said if at > 0), default=None)
        return found

    def _said_by_server(self, since_s: float) -> dict[str, float | None]:
        found: dict[str, float | None] = {}
        for path in self._folder.glob("logs/serve*.jsonl"):
            for line in path.read_text(encoding="utf-8").splitlines():
                entry = json.loads(line)
                at_s = datetime.fromisoformat(entry["time"]).timestamp() - since_s
                silent = SERVER_SAYS.match(entry["text"])
                if silent and at_s > 0:
                    found.setdefault(f"server, of {silent[1]}", at_s)
        return found or {"server": None}

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
        logs = {"MOCAPELLA_LOGS": str(self._folder / "logs")}
        with path.open("w") as out:
            process = subprocess.Popen(
                [*inside, *words], stdin=subprocess.PIPE, stdout=out, stderr=out, text=True, env={**os.environ, **logs}
            )
        self._processes.append(process)
        while said not in path.read_text(encoding="utf-8"):
            if process.poll() is not None:
                raise SystemExit(f"network: {words[2]} ended: {path.read_text(encoding='utf-8')}")
            time.sleep(0.05)
        return process


def _rows(name: str, samples: list[Sample], most_ms: float | None) -> list[Row]:
    errors = [abs(one.offset_ms) for one in samples]
    ages = [one.age_ms for one in samples if one.age_ms is not None]
    fresh = at_most(FRESH_MS) if name.startswith(("1 Mbit", "20 %")) else None
    beyond = sum(error > one.bound_ms for error, one in zip(errors, samples, strict=True))
    return [
        measured(f"network: {name}: largest error of the clock offset", max(errors), "ms",
                 goal=None if most_ms is None else at_most(most_ms)),
        measured(f"network: {name}: largest bound shown", max(one.bound_ms for one in samples), "ms"),
        measured(f"network: {name}: errors beyond the bound, of {len(samples)}", beyond, "samples", goal=at_most(0)),
        measured(f"network: {name}: age of live frames, largest median of four seconds", max(ages, default=math.nan),
                 "ms", goal=fresh),
    ]  # fmt: skip


def _noticed(what: str, found: dict[str, float | None]) -> list[Row]:
    return [
        measured(f"network: {what}: noticed after, {who}", math.nan if at_s is None else at_s, "s",
                 goal=at_most(NOTICED_S))
        for who, at_s in sorted(found.items())
    ]  # fmt: skip
