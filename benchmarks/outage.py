"""A recording server that is away for six minutes, killed or standing still, while its nodes go on.

Two nodes of 60 Hz send meanwhile. Afterwards every frame that they sent is in the take. The full run takes fourteen
minutes; ``--quick`` has outages of 20 s.
"""

from __future__ import annotations

import json
import tempfile
import time
from pathlib import Path

from benchmarks.harness import Row, at_least, at_most, measured
from benchmarks.kill import Session, read_log
from mocapella.recording.take_reader import read_take

AWAY_S = 360.0
QUICK_AWAY_S = 20.0
RECOVERED_S = 120.0
"""Longest wait until the frames of the outage are acknowledged [s]."""


def run(quick: bool = False) -> list[Row]:
    away_s = QUICK_AWAY_S if quick else AWAY_S
    return [row for stopped in (False, True) for row in _rows(away_s, stopped=stopped)]


def _rows(away_s: float, *, stopped: bool) -> list[Row]:
    with tempfile.TemporaryDirectory(prefix="mocapella-outage-") as name:
        folder = Path(name)
        session = Session(folder)
        try:
            session.rest()
            began_ns, back_ns = session.outage(away_s, stopped=stopped)
            recovered_s = recovered_after_s(folder, back_ns)
            session.rest()
            session.end()
        finally:
            session.kill_all()
        nodes = {node.node_id: node for node in read_take(session.takes[0]).complete()}
        logs = [read_log(path) for path in folder.glob("*.log")]
        latency = json.loads((folder / "server.json").read_text())["latency_ms"]
    sent = sum((log.sent or 0) - nodes[log.node_id].first for log in logs)
    meanwhile = [sum(began_ns <= at < back_ns for _, at, _ in log.acknowledged) for log in logs]
    label = f"outage: {away_s:g} s, server {'stands still' if stopped else 'killed'}:"
    return [
        measured(f"{label} frames sent", sent, "frames"),
        measured(f"{label} frames stored", sum(node.stored for node in nodes.values()), "frames", goal=at_least(sent)),
        measured(f"{label} frames lost", sum(node.lost for node in nodes.values()), "frames", goal=at_most(0)),
        measured(f"{label} frames sent meanwhile", sum(meanwhile), "frames"),
        measured(f"{label} until all of them are acknowledged", recovered_s, "s"),
        measured(f"{label} publish to result, median", latency["p50"], "ms"),
        measured(f"{label} publish to result, p99", latency["p99"], "ms"),
    ]


def recovered_after_s(folder: Path, back_ns: int) -> float:
    """Wait until both nodes have an acknowledgement of a frame that they sent after the outage; return when [s]."""
    deadline = time.monotonic() + RECOVERED_S
    while time.monotonic() < deadline:
        logs = [read_log(path) for path in folder.glob("*.log")]
        heard = [[at for _, sent, at in log.acknowledged if sent >= back_ns] for log in logs]
        if all(heard):
            return max(map(min, heard)) / 1e9 - back_ns / 1e9
        time.sleep(0.5)
    return float("inf")
