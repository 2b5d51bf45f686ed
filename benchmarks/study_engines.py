"""Speed of a study's engines, and what methods and measures cost for a minute of recording.

A recording's work is pure computation, so the speed-up is that of the processes; their start is a row of its own.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from benchmarks.harness import Row, at_least, compared, cores, measured
from mocapella.evaluation.study_pairs import StudySession
from mocapella.geometry import rigid
from mocapella.model.study_log import StudyLog
from mocapella.model.topology import topology
from mocapella.studies.engines import Failed, run_each
from mocapella.studies.method_results import results_of_methods

PARTS: Final = ("engines", "methods")
NEAR_LINEAR: Final = 0.8
"""Goal of the speed-up, as a share of the number of processes."""
ITEM_S: Final = 2.0
"""About how long an item takes in one process [s]."""
NOON_MS: Final = 63_562_201_888_998
TICKS: Final = 333_333


def run(quick: bool = False, parts: Sequence[str] = PARTS) -> list[Row]:
    rows = []
    if "engines" in parts:
        rows += _engines(quick)
    if "methods" in parts:
        rows += _methods(quick)
    return rows


def compute(seconds: float) -> tuple[int, float, float]:
    """Compute for a time of the processor; return the process and when the item began and ended [s]."""
    began_s, until_s = time.monotonic(), time.process_time() + seconds
    while time.process_time() < until_s:
        np.linalg.svd(np.ones((30, 30)))
    return os.getpid(), began_s, time.monotonic()


def speed_up(items: Sequence[tuple[int, float, float]], item_s: float) -> float:
    """Return the processor's time over the time from when all processes work to the last result."""
    first_s: dict[int, float] = {}
    for process, began_s, _ in items:
        first_s[process] = min(began_s, first_s.get(process, began_s))
    from_s, to_s = max(first_s.values()), max(ended_s for _, _, ended_s in items)
    shares = [max(0.0, ended_s - max(began_s, from_s)) / (ended_s - began_s) for _, began_s, ended_s in items]
    return item_s * sum(shares) / (to_s - from_s)


def _engines(quick: bool) -> list[Row]:
    processes = cores()
    item_s = ITEM_S / 20 if quick else ITEM_S
    items = [item_s] * 4 * processes
    rows = []
    for name in (f"local:{processes}", f"dask:{processes}"):
        began_s = time.perf_counter()
        run_each(compute, [1e-3] * processes, name)
        start_s = time.perf_counter() - began_s
        done = [one for one in run_each(compute, items, name) if not isinstance(one, Failed)]
        rows += [
            measured(f"study engines: start and end of {name}", start_s, "s"),
            measured(
                f"study engines: speed-up of {name}",
                speed_up(done, item_s),
                "×",
                goal=at_least(NEAR_LINEAR * processes),
            ),
        ]
    return rows


def _methods(quick: bool) -> list[Row]:
    log = walked_log(0.1 if quick else 1.0)
    minutes = StudySession(log).replay.duration_s / 60
    thesis: Callable[[], Any] = lambda: results_of_methods(log, ["stand-still"])  # noqa: E731
    rows = []
    results_of_methods(walked_log(0.02), ["default"])  # compiles kernels
    thesis_s = _seconds(thesis)
    rows.append(measured("study engines: stand-still with measures, a minute of two sensors", thesis_s / minutes, "s"))
    for text, measures in (("and measures without hidden joints", ["lost", "identity"]), ("and all measures", None)):
        default_s = _seconds(lambda measures=measures: results_of_methods(log, ["default"], measures))
        rows.append(
            compared(
                f"study engines: default {text}, a minute of two sensors",
                default_s / minutes,
                "s",
                peer="stand-still",
                peer_value=thesis_s / minutes,
            )
        )
    return rows


def _seconds(work: Callable[[], Any]) -> float:
    began_s = time.perf_counter()
    work()
    return time.perf_counter() - began_s


def walked_log(minutes: float) -> StudyLog:
    """A study log of one person who walks in a circle around an obstacle, seen by two sensors at 30 Hz."""
    frames = int(minutes * 60 * 30)
    random = np.random.default_rng(3)
    joints = len(topology("kinect_v2").joints)
    body = random.normal(size=(joints, 3)) * [0.2, 0.5, 0.1]
    angle = np.arange(frames) / 30
    place = np.stack([0.6 * np.cos(angle), np.zeros(frames), 2.4 + 0.6 * np.sin(angle)], axis=-1)
    turned = np.stack([rigid.apply(rigid.rigid(rigid.rotation_about_y(-a), np.zeros(3)), body) for a in angle])
    seen = np.repeat((turned + place[:, None])[:, None], 2, axis=1).reshape(2 * frames, joints, 3)
    step, second = np.arange(2 * frames) // 2, np.arange(2 * frames) % 2
    return StudyLog(
        source="Study_7_Kinect_2.csv",
        study_id=np.full(2 * frames, 7),
        kinect_config=np.full(2 * frames, 2),
        scenario_id=np.full(2 * frames, 6),
        tracker_time_ms=NOON_MS + step * TICKS // 10_000,
        person_id=np.zeros(2 * frames, dtype=np.int64),
        skeleton_id=second,
        skeleton_time_ticks=step * TICKS + np.where(second, 5_000_000_000, 100_000),
        init_angle=np.where(second, -1.4, 0.1),
        init_dist=np.full(2 * frames, 2.4),
        kinect_id=np.where(second, "138.251.207.136", "138.251.213.82"),
        tilt_deg=np.zeros(2 * frames),
        height_cm=np.full(2 * frames, 100.0),
        positions=(seen + 0.01 * random.normal(size=seen.shape)).astype(np.float32),
    )
