"""Random ``kill -9`` of a recording server and of its nodes: what is stored, acknowledged, and lost.

Two nodes of 60 Hz send to a server that records. There are seven kinds of kills: of the server; of a node; of both; of
a node while the server is away; of the server while it starts, while it closes its take, and while it merges the take's
parts. What was killed is started again, the server with the same command, or with the next take's name if the take was
closed. At the end the nodes end, then the server. Each node has logged which frames were acknowledged, and when.
``--quick`` kills twice of each kind; the full run 1,000 times, which takes an hour; ``--inputs N`` N times.
"""

from __future__ import annotations

import random
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.harness import Row, at_most, measured
from mocapella.live.launch import free_port
from mocapella.recording.disk import merging_path
from mocapella.recording.merge import merge_frames
from mocapella.recording.take import NodeFrames
from mocapella.recording.take_reader import Take, read_take

SEED = 23
KILLS = 1000
QUICK_KILLS = 14
SENSORS = ("front", "side")
READY = "waiting for sensors at"
TAKEN = "nothing is overwritten"
QUIET_S = 5.0
"""Time without kills before the first and after the last, in which the lag is measured: else it is the outages'."""
MERGING_S = 10.0
"""How long the parts of a take are waited for to be merged, before the server is killed all the same [s]."""


@dataclass
class Log:
    """What a node logged: number, and times of sending and acknowledgement [ns]; and its last number, if it ended."""

    node_id: int
    acknowledged: list[tuple[int, int, int]] = field(default_factory=list)
    sent: int | None = None
    published: int = 0


def run(quick: bool = False, inputs: int | None = None) -> list[Row]:
    kills = inputs or (QUICK_KILLS if quick else KILLS)
    with tempfile.TemporaryDirectory(prefix="mocapella-kills-") as folder:
        session = Session(Path(folder))
        try:
            session.run(kills)
        finally:
            session.kill_all()
        logs = [read_log(path) for path in sorted(Path(folder).glob("*.log")) if path.stat().st_size]
        paths = [path for path in session.takes if path.exists()]
        rows = _rows(kills, session, logs, [read_take(path) for path in paths])
        spooled = sorted((Path(folder) / "spool").glob("*.mcap"))
        for path in paths:
            merge_frames(path, spooled, reserve_bytes=0)
        left = sum(node.lost for path in paths for node in read_take(path).complete())
        return [*rows, measured(f"kill: {kills} kills: lost after the spools are merged", left, "frames")]


class Session:
    """The processes, the takes, and when nothing was killed."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._port = folder, free_port()
        self._random = random.Random(SEED)
        self.takes = [folder / "take-1.mcap"]
        self.listening_s: list[float] = []
        self.quiet_ns: list[tuple[int, int]] = []
        self._nodes = [self._node(sensor) for sensor in SENSORS]
        self._server = self._start_server()

    def run(self, kills: int) -> None:
        """Kill and start again, and end all properly."""
        kinds: list[Callable[[], None]] = [
            self._kill_server, self._kill_node, self._kill_both, self._kill_node_alone, self._kill_starting,
            self._kill_closing, self._kill_merging,
        ]  # fmt: skip
        self.rest()
        for number in range(kills):
            if number % len(kinds) == 0:
                self._random.shuffle(kinds)
            kinds[number % len(kinds)]()
            time.sleep(self._random.uniform(0.2, 1.5))
        self.rest()
        self.end()

    def outage(self, seconds: float, *, stopped: bool) -> tuple[int, int]:
        """Let the server stand still, or kill it, for a time; return when it went and was back [ns, monotonic]."""
        began_ns = time.monotonic_ns()
        if stopped:
            self._server.send_signal(signal.SIGSTOP)
        else:
            self._server.kill()
            self._server.wait()
        time.sleep(seconds)
        if stopped:
            self._server.send_signal(signal.SIGCONT)
        else:
            self._server = self._start_server()
        return began_ns, time.monotonic_ns()

    def end(self) -> None:
        """End the nodes, then the server."""
        for node in self._nodes:
            node.send_signal(signal.SIGTERM)
        for node in self._nodes:
            node.wait(60)
        self._server.send_signal(signal.SIGINT)
        self._server.wait(120)

    def rest(self) -> None:
        """Wait until all is as before a kill, and then for a while."""
        time.sleep(4.0)
        began_ns = time.monotonic_ns()
        time.sleep(QUIET_S)
        self.quiet_ns.append((began_ns, time.monotonic_ns() - round(0.5 * 1e9)))

    def kill_all(self) -> None:
        """End what still runs."""
        for process in (*self._nodes, self._server):
            if process.poll() is None:
                process.kill()
                process.wait()

    def _end_node(self) -> int:
        place = self._random.randrange(len(SENSORS))
        self._nodes[place].kill()
        self._nodes[place].wait()
        return place

    def _start_node(self, place: int) -> None:
        self._nodes[place] = self._node(SENSORS[place])

    def _end_server(self) -> None:
        self._server.kill()
        self._server.wait()
        time.sleep(self._random.uniform(0.0, 1.0))

    def _kill_server(self) -> None:
        self._end_server()
        self._server = self._start_server()

    def _kill_node(self) -> None:
        self._start_node(self._end_node())

    def _kill_both(self) -> None:
        place = self._end_node()
        self._end_server()
        self._start_node(place)
        self._server = self._start_server()

    def _kill_node_alone(self) -> None:
        """A node is killed while the server is away."""
        self._end_server()
        self._start_node(self._end_node())
        time.sleep(self._random.uniform(0.0, 1.0))
        self._server = self._start_server()

    def _kill_starting(self) -> None:
        self._end_server()
        self._server = self._launch()
        time.sleep(self._random.uniform(0.0, 2.0))
        self._kill_server()

    def _kill_closing(self) -> None:
        self._server.send_signal(signal.SIGINT)
        time.sleep(self._random.uniform(0.0, 1.0))
        self._kill_server()

    def _kill_merging(self) -> None:
        self._kill_server()  # so that there are two parts
        self._server.send_signal(signal.SIGINT)
        scratch, deadline = merging_path(self.takes[-1]), time.monotonic() + MERGING_S
        while not scratch.exists() and self._server.poll() is None and time.monotonic() < deadline:
            time.sleep(0.001)
        self._kill_server()

    def _node(self, sensor: str) -> subprocess.Popen[bytes]:
        words = ["--connect", f"tls/127.0.0.1:{self._port}", "--sensor", sensor, "--folder", str(self._folder)]
        return subprocess.Popen([sys.executable, "-m", "benchmarks._kill_node", *words], stdin=subprocess.DEVNULL)

    def _launch(self) -> subprocess.Popen[bytes]:
        take = f"./{self.takes[-1].name}"
        words = ["serve", "--no-view", "--port", str(self._port), "--method", "stand-still", "--record", take,
                 "--json", "server.json"]  # fmt: skip
        with (self._folder / "server.txt").open("wb") as out:
            return subprocess.Popen(
                [sys.executable, "-m", "mocapella", *words, "--set", "reserve_gib=0"],
                cwd=self._folder, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=out,
            )  # fmt: skip

    def _start_server(self) -> subprocess.Popen[bytes]:
        while True:
            began = time.monotonic()
            server = self._launch()
            while not listens(self._port) and server.poll() is None:
                time.sleep(0.01)
            listening_s = time.monotonic() - began
            said = self._folder / "server.txt"
            while READY not in said.read_text(encoding="utf-8") and server.poll() is None:
                time.sleep(0.02)
            if server.poll() is None:
                self.listening_s.append(listening_s)
                return server
            text = said.read_text(encoding="utf-8")
            if TAKEN not in text:
                raise RuntimeError(f"the server ended: {text}")
            self.takes.append(self._folder / f"take-{len(self.takes) + 1}.mcap")  # the last one was closed


def _rows(kills: int, session: Session, logs: list[Log], takes: list[Take]) -> list[Row]:
    last = {node.node_id: node for node in takes[-1].complete()}
    stored: dict[int, set[int]] = {}
    for frame in (frame for take in takes for frame in take.frames()):
        stored.setdefault(frame.frame.node_id, set()).add(frame.frame.sequence)
    gone = sum(len({number for number, *_ in log.acknowledged} - stored.get(log.node_id, set())) for log in logs)
    ended = [(log.sent, last[log.node_id]) for log in logs if log.sent is not None and log.node_id in last]
    unsaid = [log for log in logs if log.sent is None and log.node_id in last and last[log.node_id].end_known]
    begin_ns, end_ns = session.quiet_ns[-1]
    silent = [
        log for log in logs if log.sent is not None and not any(begin_ns <= at <= end_ns for *_, at in log.acknowledged)
    ]
    lags = sorted(_lags_ms(logs, session.quiet_ns))
    label = f"kill: {kills} kills:"
    lost = sum(node.lost for take in takes for node in take.complete())
    return [
        measured(f"{label} takes", len(takes), "takes"),
        measured(f"{label} frames sent", sum(log.published for log in logs), "frames"),
        measured(f"{label} frames acknowledged", sum(len(log.acknowledged) for log in logs), "frames"),
        measured(f"{label} frames stored", sum(take.frame_count for take in takes), "frames"),
        measured(f"{label} frames reported lost", lost, "frames"),
        measured(f"{label} acknowledged but lost", gone, "frames", goal=at_most(0)),
        measured(f"{label} sent ≠ stored + lost, of nodes that ended", _wrong(ended), "nodes", goal=at_most(0)),
        measured(f"{label} nodes killed, and reported as complete", len(unsaid), "nodes", goal=at_most(0)),
        measured(f"{label} nodes not acknowledged again at the end", len(silent), "nodes", goal=at_most(0)),
        measured(f"{label} acknowledgement lag, median", statistics.median(lags), "ms"),
        measured(f"{label} acknowledgement lag, p99", lags[int(0.99 * len(lags))], "ms", goal=at_most(150)),
        measured(f"{label} until it listens again, median", statistics.median(session.listening_s), "s"),
        measured(f"{label} until it listens again, longest", max(session.listening_s), "s", goal=at_most(2)),
    ]


def _wrong(ended: list[tuple[int, NodeFrames]]) -> int:
    return sum(sent - node.first != node.stored + node.lost or not node.end_known for sent, node in ended)


def _lags_ms(logs: list[Log], quiet_ns: list[tuple[int, int]]) -> list[float]:
    """Return the lags of the frames that were sent while nothing was killed."""
    return [
        (acknowledged - sent) / 1e6
        for log in logs
        for _, sent, acknowledged in log.acknowledged
        if any(begin <= sent <= end for begin, end in quiet_ns)
    ]


def read_log(path: Path) -> Log:
    log = Log(0)
    for line in path.read_text(encoding="utf-8").splitlines(keepends=True):
        first, *rest = line.split()
        if not line.endswith("\n"):
            break
        if first == "node":
            log.node_id = int(rest[0], 16)
        elif first == "sent":
            log.published = int(rest[0]) + 1
        elif first == "end":
            log.sent = int(rest[0])
        elif first.isdigit() and len(rest) == 2:
            log.acknowledged.append((int(first), int(rest[0]), int(rest[1])))
    return log


def listens(port: int) -> bool:
    try:
        with socket.create_connection(("127.0.0.1", port), 0.2):
            return True
    except OSError:
        return False
