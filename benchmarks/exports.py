"""Time and memory of opening and exporting a take of two people, seen by two sensors at 30 Hz, in own processes.

The peer of opening is the ``mcap`` library's reader with protobuf, which gives parsed messages of results and no more.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.harness import Goal, Row, at_most, compared, measured
from mocapella.model.observations import body_frame
from mocapella.model.scene import Person, Phase, PotentialSkeleton, Scene, SensorPlace, TrackerState
from mocapella.model.session import Setup
from mocapella.model.topology import topology
from mocapella.recording.take import TakeInfo
from mocapella.recording.take_writer import TakeWriter
from mocapella.schema import encode_frame, encode_scene

PARTS: Final = ("ten-minutes", "hour")
MINUTES: Final = {"seconds": 0.2, "ten-minutes": 10.0, "hour": 60.0}
GOALS_S: Final[dict[str, dict[str, float]]] = {"ten-minutes": {"load": 1.0}, "hour": {"parquet": 5.0, "bvh": 20.0}}
SENSORS: Final = ("front", "side")
STEP_NS: Final = 1_000_000_000 // 30
SEED: Final = 5
MB: Final = 1e6
MOST_MB: Final = 500
OURS: Final = """
import sys, time, mocapella
load = mocapella.load
began = time.perf_counter()
taken = load(sys.argv[1]).take
print(time.perf_counter() - began)
"""
PEOPLE: Final = "import sys, mocapella; print(len(mocapella.load(sys.argv[1]).people))"
PEER: Final = """
import sys
from mcap.reader import make_reader
from mocapella.schema import mocapella_pb2 as pb
with open(sys.argv[1], "rb") as file:
    messages = make_reader(file).iter_messages(topics=["/scenes"], log_time_order=False)
    print(sum(len(pb.Scene.FromString(message.data).people) > 0 for _, _, message in messages))
"""


def run(quick: bool = False, parts: Sequence[str] = PARTS) -> list[Row]:
    rows = []
    with tempfile.TemporaryDirectory(prefix="mocapella-benchmark-") as folder:
        for part in ("seconds",) if quick else parts:
            path = Path(folder) / f"{part}.mcap"
            write_take(path, MINUTES[part])
            rows += _rows(path, part)
            path.unlink()
    return rows


def _rows(path: Path, part: str) -> list[Row]:
    said, goals = f"{MINUTES[part]:g} minutes", GOALS_S.get(part, {})
    _measure(PEOPLE, path)  # compiles kernels, and reads the file into the disk's cache
    _measure("", path, "export", "bvh", str(path), "--force", "--out", str(path.parent / "out"), "--rate", "1")
    load_s, load_mb, call_s = _measure(OURS, path)
    peer_s, _, _ = _measure(PEER, path)
    people_s, people_mb, _ = _measure(PEOPLE, path)

    def goal(name: str) -> Goal | None:
        return at_most(goals[name]) if name in goals else None

    rows = [
        measured(f"exports: load, {said}", call_s, "s", goal=goal("load")),
        compared(f"exports: start Python and load, {said}", load_s, "s", peer="mcap and protobuf", peer_value=peer_s),
        compared(f"exports: load with people, {said}", people_s, "s", peer="mcap and protobuf", peer_value=peer_s),
        measured(f"exports: memory of load, {said}", load_mb, "MB"),
        measured(f"exports: memory with people, {said}", people_mb, "MB", goal=at_most(MOST_MB)),
    ]  # fmt: skip
    for name in ("parquet", "bvh"):
        took_s, most_mb, _ = _measure("", path, "export", name, str(path), "--force", "--out", str(path.parent / "out"))
        rows += [
            measured(f"exports: {name}, {said}", took_s, "s", goal=goal(name)),
            measured(f"exports: memory of {name}, {said}", most_mb, "MB", goal=at_most(MOST_MB)),
        ]
    return rows


def _measure(code: str, path: Path, *command: str) -> tuple[float, float, float]:
    """Run Python code with a path, or one of our commands; return its duration [s], largest memory [MB], and number."""
    line = ["-m", "mocapella", *command] if command else ["-c", code, str(path)]
    began = time.perf_counter()
    process = subprocess.Popen([sys.executable, *line], stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    assert process.stdout is not None
    text = process.stdout.read()
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(text.decode(errors="replace"))
    return time.perf_counter() - began, used.ru_maxrss * 1024 / MB, 0.0 if command else float(text.split()[-1])


def write_take(path: Path, minutes: float) -> None:
    """Write a take of two people who move, with noise of 3 mm in each coordinate."""
    rng, kind = np.random.default_rng(SEED), topology("kinect_v2")
    info = TakeInfo(Setup("default", sensors_expected=len(SENSORS)), 1_700_000_000_000_000_000, 0)
    writer = TakeWriter.create(path, info=info, reserve_bytes=0)
    places = tuple(SensorPlace(name, np.eye(4), 0.01, 0.01, "good") for name in SENSORS)
    middle, states = rng.normal(size=(2, len(kind), 3)), np.full(len(kind), 2, np.uint8)
    sd = np.full(len(kind), 0.01, np.float32)
    step = 0
    for k in range(int(minutes * 60 * 30)):
        for j, sensor in enumerate(SENSORS):
            at_ns = k * STEP_NS + j * STEP_NS // 2
            positions = middle + 0.3 * np.sin(k / 40) + 0.003 * rng.normal(size=middle.shape)
            frame = body_frame(
                sensor,
                kind,
                time_ns=at_ns,
                positions=positions.astype(np.float32),
                node_id=1,
                sequence=k,
                sent_ns=at_ns,
            )
            writer.write_frame(encode_frame(frame), sensor=sensor, node_id=1, sequence=k, log_ns=at_ns)
            people = tuple(
                Person(i, one, states, tuple(
                    PotentialSkeleton(seen, 5 + i, at_ns, 0.0, 1.0, np.eye(4), one, states) for seen in SENSORS
                ), sd)
                for i, one in enumerate(positions)
            )  # fmt: skip
            state = TrackerState(Phase.TRACKING)
            writer.write_scene(
                encode_scene(Scene(step, at_ns, sensor, 1, k, kind, state, {"people": people}, places)), at_ns
            )
            step += 1
        if k % 15 == 14:
            writer.flush()
    writer.close()
