"""Calibration of two sensors from a person who exercises in place, in simulation, with stated uncertainties.

The sensors have the errors of real ones, and are 30°, 60° and 90° apart.
"""

from __future__ import annotations

import math

import numpy as np

from benchmarks.harness import Row, at_least, at_most, measured
from mocapella.evaluation.calibration_in_place import (
    ANGLES_DEG,
    EXERCISES,
    in_place_room,
    normalised_error,
    run_in_place,
)
from mocapella.tracker.default import DefaultTracker

TIMES_S = (5.0, 10.0)
SCORED_S = 10.0


def run(*, quick: bool = False) -> list[Row]:
    times_s = TIMES_S[:1] if quick else TIMES_S
    runs = [
        (exercise, run_in_place(DefaultTracker(sensors_expected=2), in_place_room(exercise, angle, seed), times_s))
        for exercise in EXERCISES
        for angle in (ANGLES_DEG[:1] if quick else ANGLES_DEG)
        for seed in ((0,) if quick else (0, 1))
    ]
    found = sum(math.isfinite(result.calibrated_s) for _, result in runs)
    rows = [
        measured(f"sessions of {len(runs)} that calibrate", found, "", goal=at_least(len(runs))),
        measured("time until calibrated, worst", max(result.calibrated_s for _, result in runs), "s"),
    ]
    for at_s in times_s:
        errors = [error for _, result in runs for error in result.errors if abs(error.at_s - at_s) < 0.5]
        said = f"after {at_s:.0f} s"
        metres, degrees = ([getattr(error, name) for error in errors] for name in ("position_m", "rotation_deg"))
        goals = (at_most(15.0), at_most(0.8)) if at_s == SCORED_S else (None, None)
        rows += [
            measured(f"place {said}, median", 1e3 * float(np.median(metres)), "mm", goal=goals[0]),
            measured(f"place {said}, worst", 1e3 * max(metres), "mm"),
            measured(f"angle {said}, median", float(np.median(degrees)), "°", goal=goals[1]),
            measured(f"angle {said}, worst", max(degrees), "°"),
            measured(f"normalised error {said} (0.8 to 1.3)", normalised_error(errors), "", goal=at_most(1.3)),
        ]
    last_s = times_s[-1]
    for exercise in EXERCISES:
        degrees = [
            error.rotation_deg
            for name, result in runs
            for error in result.errors
            if name == exercise and abs(error.at_s - last_s) < 0.5
        ]
        rows.append(measured(f"angle after {last_s:.0f} s, {exercise}, mean", float(np.mean(degrees)), "°"))
    return rows
