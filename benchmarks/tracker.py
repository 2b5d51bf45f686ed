"""What a step of the tracker costs, and how much faster than real time a real file goes through it.

There is no peer here: no program that does the same work (calibrate, pair and fuse Kinect skeletons) can be run beside
ours, so the rows name the machine.
"""

from __future__ import annotations

import os
import statistics
import time
import warnings
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.harness import Row, at_least, at_most, measured
from mocapella.model.observations import Arrival, JointState, body_frame
from mocapella.model.scene import Phase
from mocapella.model.topology import topology
from mocapella.recording.study_log import read_study_log
from mocapella.sources.study_replay import StudyReplay
from mocapella.tracker import Tracker, make_tracker

MAX_STEP_MS: Final = 0.5
MIN_TIMES_REAL_TIME: Final = 50
STUDY_LOG: Final = "Study_7_Kinect_2_Time_3_11_06_PM.csv.gz"
FRAME_NS: Final = 33_333_333
SEED: Final = 7


def run(quick: bool = False) -> list[Row]:
    rounds = 200 if quick else 3000
    rows = []
    for people, sensors, goal in ((2, 3, at_most(MAX_STEP_MS)), (6, 6, None)):
        calibrating_ms, tracking_ms = step_ms(people, sensors, rounds)
        size = f"{people} people, {sensors} sensors"
        rows += [
            measured(f"tracker: step while tracking, median, {size}", statistics.median(tracking_ms), "ms", goal=goal),
            measured(f"tracker: step while tracking, p99, {size}", float(np.percentile(tracking_ms, 99)), "ms"),
            measured(f"tracker: step while calibrating, median, {size}", statistics.median(calibrating_ms), "ms"),
            measured(f"tracker: the step that ends a calibration, {size}", calibrating_ms[-1], "ms"),
        ]
    log = recordings() / "kinectmultitrack" / STUDY_LOG
    if not log.is_file():
        warnings.warn(f"no replay measured: {log} is not there (MOCAPELLA_DATA names another place)", stacklevel=2)
        return rows
    speeds = [times_real_time(log) for _ in range(3 if quick else 9)]
    goal = at_least(MIN_TIMES_REAL_TIME)
    name = "tracker: replay of a real file, from opening it to the last scene"
    return [*rows, measured(name, statistics.median(speeds), "× real time", goal=goal)]


def recordings() -> Path:
    """The folder of real recordings, as the tests find it."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    return Path(os.environ.get("MOCAPELLA_DATA", beside))


def step_ms(people: int, sensors: int, rounds: int) -> tuple[list[float], list[float]]:
    """Return the duration of each step [ms] up to the end of the calibration, and during tracking."""
    tracker = make_tracker("stand-still", sensors_expected=sensors)
    steps: dict[bool, list[float]] = {False: [], True: []}
    was_tracking = False
    for arrival in standing_people(people, sensors, 130 + rounds):
        begin = time.perf_counter()
        scene = tracker.update(arrival)
        steps[was_tracking].append(1e3 * (time.perf_counter() - begin))
        was_tracking = scene.state.phase is Phase.TRACKING
    return steps[False], steps[True]


def standing_people(people: int, sensors: int, rounds: int) -> list[Arrival]:
    """Frames of people who stand, with noise of a few millimetres and a tenth of their joints inferred."""
    rng = np.random.default_rng(SEED)
    kinect = topology("kinect_v2")
    bodies = rng.normal(scale=0.3, size=(people, len(kinect), 3)) + np.array([0.0, 0.0, 2.5])
    arrivals = []
    for i in range(rounds):
        for sensor in range(sensors):
            states = np.where(rng.random(bodies.shape[:2]) < 0.1, JointState.INFERRED, JointState.TRACKED)
            frame = body_frame(
                f"sensor-{sensor}",
                kinect,
                time_ns=i * FRAME_NS,
                positions=bodies + rng.normal(scale=0.005, size=bodies.shape),
                states=states,
                sequence=i,
            )
            arrivals.append(Arrival(frame, i * FRAME_NS + sensor * FRAME_NS // sensors))
    return arrivals


def times_real_time(log: Path) -> float:
    """Seconds recorded for each second of wall time, reading and unpacking the file included."""
    begin = time.perf_counter()
    replay = StudyReplay(read_study_log(log))
    tracker: Tracker = make_tracker("stand-still", sensors_expected=len(replay.sensors))
    for arrival in replay.arrivals():
        tracker.update(arrival)
    return replay.duration_s / (time.perf_counter() - begin)
