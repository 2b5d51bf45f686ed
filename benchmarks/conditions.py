"""Conditions that the method `default` reports in simulated sessions in which nothing is wrong: there should be none.

All scenes, and two more, with sensors that have the errors of real ones. `mocapella.evaluation.condition_sessions`
says what is counted.
"""

from __future__ import annotations

from benchmarks.harness import Row, at_most, measured
from mocapella.evaluation.condition_sessions import ALONE, run_session, session_names, session_room
from mocapella.tracker.default import DefaultTracker

PARTS = session_names()
SEEDS = 2


def run(*, quick: bool = False, parts: list[str] | None = None) -> list[Row]:
    rows = []
    for name in parts or ([ALONE, "walk"] if quick else session_names()):
        runs = []
        for seed in range(1 if quick else SEEDS):
            room = session_room(name, seed)
            runs.append(run_session(DefaultTracker(sensors_expected=len(room.sensor_names)), room))
        said = sorted({text for one in runs for text in (*one.warned, *one.unfinished)})
        words = f"{name}: frames with conditions, of {sum(one.frames for one in runs)}" + "".join(
            f"; {text}" for text in said
        )
        rows += [
            measured(words, sum(one.conditions for one in runs), "", goal=at_most(0)),
            measured(f"{name}: time until tracking, longest", max(one.tracking_s for one in runs), "s"),
        ]
    return rows
