"""Six sensors of six people at 30 Hz, each a process of its own, against one server: latency, load, memory.

The full run takes eleven minutes, because memory is watched for ten; ``--quick`` takes one.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import psutil

from benchmarks.harness import Row, at_most, measured
from mocapella.live.launch import free_port

SENSORS = 6
PEOPLE = 6
WARM_UP_S = 30.0


def run(quick: bool = False) -> list[Row]:
    watched_s = 30.0 if quick else 600.0
    with tempfile.TemporaryDirectory() as folder:
        summary, load, grown = _measure(Path(folder), watched_s)
    label = f"live: {SENSORS} sensors × {PEOPLE} people × 30 Hz:"
    latency = summary["latency_ms"]
    return [
        measured(f"{label} publish to result, median", latency["p50"], "ms"),
        measured(f"{label} publish to result, p99", latency["p99"], "ms", goal=at_most(6)),
        measured(f"{label} publish to result, slowest", latency["max"], "ms"),
        measured(f"{label} server's share of one core", load, "%", goal=at_most(35)),
        measured(f"{label} memory grown in {watched_s / 60:g} min", grown, "MiB", goal=at_most(1)),
        measured(f"{label} frames dropped of {summary['frames_in']}", summary["drops"], "frames"),
    ]


def _measure(folder: Path, watched_s: float) -> tuple[dict[str, Any], float, float]:
    port = free_port()
    out = folder / "summary.json"
    server = subprocess.Popen(
        [sys.executable, "-m", "mocapella", "serve", "--no-view", "--port", str(port), "--sensors", str(SENSORS),
         "--json", str(out)],
        stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    seconds = WARM_UP_S + watched_s + 2.0
    sensors = [_sensor(f"tls/127.0.0.1:{port}", number, seconds) for number in range(SENSORS)]
    try:
        process = psutil.Process(server.pid)
        time.sleep(WARM_UP_S)
        before, began, memory = process.cpu_times(), time.monotonic(), process.memory_info().rss
        time.sleep(watched_s)
        after, took, grown = process.cpu_times(), time.monotonic() - began, process.memory_info().rss - memory
        load = 100 * ((after.user + after.system) - (before.user + before.system)) / took
    finally:
        server.send_signal(signal.SIGINT)
        server.wait(30)
        for sensor in sensors:
            sensor.terminate()
            sensor.wait(10)
    return json.loads(out.read_text()), round(load, 2), round(grown / 2**20, 3)


def _sensor(connect: str, number: int, seconds: float) -> subprocess.Popen[bytes]:
    options = {"connect": connect, "sensor": f"s{number}", "people": PEOPLE, "seconds": seconds, "seed": number}
    words = [word for key, value in options.items() for word in (f"--{key}", str(value))]
    return subprocess.Popen([sys.executable, "-m", "benchmarks._live_load", *words])
