"""Slowest step of the method `default`, by number of sensors: what delays results, however cheap a mean frame is.

The same frames run several times through a new tracker, which does the same work each time. A step's duration is the
least processor time of its runs, so that other programs hardly count. The garbage collector runs as in
`mocapella serve`.
"""

from __future__ import annotations

import cProfile
import gc
import pstats
import time
from collections.abc import Sequence
from typing import Final

import numpy as np

from benchmarks.harness import Row, at_most, measured
from benchmarks.people import hall
from mocapella.model.observations import Arrival
from mocapella.tracker.default import DefaultTracker
from mocapella.tracker.warmup import warm_up

PEOPLE: Final = 6
SENSORS: Final = (6, 16, 32)
SLOWEST_MS: Final = 6.0
SPAN_S: Final = 3.0
RUNS: Final = 4
STARTS: Final = {"from a layout": True, "cold start": False}


def run(quick: bool = False) -> list[Row]:
    warm_up("default")
    gc.collect()
    gc.freeze()
    rows = []
    for sensors in SENSORS[:1] if quick else SENSORS:
        known, arrivals = hall(PEOPLE, sensors, 1.0 if quick else SPAN_S)
        for start, told in STARTS.items():

            def tracker(known: dict[str, np.ndarray] = known, told: bool = told) -> DefaultTracker:
                one = DefaultTracker(sensors_expected=len(known))
                if told:
                    one.start_from(known)
                return one

            steps = np.min([steps_ms(tracker(), arrivals) for _ in range(2 if quick else RUNS)], axis=0)
            slowest = int(steps.argmax())
            what = f"stalls: {sensors} sensors × {PEOPLE} people, {start}:"
            stage, share = slow_stage(tracker(), arrivals[: slowest + 1])
            rows += [
                measured(f"{what} step, mean", float(steps.mean()), "ms"),
                measured(f"{what} step, p99", float(np.percentile(steps, 99)), "ms"),
                measured(f"{what} step, slowest", float(steps.max()), "ms", goal=at_most(SLOWEST_MS)),
                measured(f"{what} of the slowest, {stage}", 100 * share, "%"),
            ]
    return rows


def steps_ms(tracker: DefaultTracker, arrivals: Sequence[Arrival]) -> list[float]:
    """Return the processor time of each step [ms]."""
    durations = []
    for arrival in arrivals:
        begin = time.thread_time()
        tracker.update(arrival)
        durations.append(1e3 * (time.thread_time() - begin))
    return durations


def slow_stage(tracker: DefaultTracker, arrivals: Sequence[Arrival]) -> tuple[str, float]:
    """Return the innermost function of ours that takes 40 % of the last step, and its share of the step."""
    for arrival in arrivals[:-1]:
        tracker.update(arrival)
    profile = cProfile.Profile()
    profile.runcall(tracker.update, arrivals[-1])
    stats = pstats.Stats(profile).stats  # type: ignore[attr-defined]
    spent = {
        f"{file.rpartition('/')[2].removesuffix('.py')}.{name}": cumulative
        for (file, _, name), (_, _, _, cumulative, _) in stats.items()
        if "mocapella" in file
    }
    whole = max(spent.values())
    inner = min((seconds, name) for name, seconds in spent.items() if seconds >= 0.4 * whole)
    return inner[1], inner[0] / whole
