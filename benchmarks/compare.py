"""Comparison with a reference on simulated pairs: errors of time, rate and rigid motion, and of their uncertainties.

The seeds, from 1000, were not used for tuning (0 to 99).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from benchmarks.harness import Goal, Row, at_least, at_most, measured
from mocapella.evaluation.compared_pairs import SCENES, ComparedPairSettings, PairErrors, errors_of, simulated_pair

USUAL: Final = ComparedPairSettings(seconds=60.0)
SHORT: Final = replace(USUAL, seconds=20.0)
FUSED: Final = replace(USUAL, noise_m=0.008)
TWO_SENSORS: Final = replace(FUSED, sensors=2, view_bias_m=0.02, lag_s=0.005)
CASES: Final = {
    "60 s": (USUAL, range(1000, 1006)),
    "20 s": (SHORT, range(1100, 1102)),
    "markers 20 mm off": (replace(USUAL, marker_m=0.02), range(1200, 1201)),
    "reference without times": (replace(SHORT, clock=False), range(1300, 1301)),
    "noise of 0.5 s": (replace(USUAL, correlation_s=0.5), range(1400, 1402)),
    "itself, one sensor": (replace(FUSED, itself=True), range(1500, 1502)),
    "itself, two sensors": (replace(TWO_SENSORS, itself=True), range(1600, 1603)),
    "two sensors": (TWO_SENSORS, range(1700, 1702)),
}
"""Settings of the pairs, and seeds; the first case has the goals."""
NORMALISED: Final = ("60 s", "noise of 0.5 s")
"""Cases whose stated uncertainty must be neither too small nor too large."""
NOT_TOO_SURE: Final = ("itself, one sensor", "itself, two sensors")
"""Cases whose stated uncertainty must not be too small."""


def run(quick: bool = False) -> list[Row]:
    rows = []
    for name, (settings, seeds) in list(CASES.items())[: 1 if quick else None]:
        chosen = seeds[:1] if quick else seeds
        found = [errors_of(simulated_pair(scene, seed, settings)) for seed in chosen for scene in SCENES]
        rows += rows_of(name, found, goals=settings == USUAL)
    return rows


def rows_of(name: str, found: Sequence[PairErrors], *, goals: bool) -> list[Row]:
    """Return the largest errors, and the root mean square of the normalised ones; ``goals`` are those of errors."""
    values = {
        "offset": ([1e3 * abs(one.offset_s) for one in found], "ms", at_most(2.0)),
        "rate": ([1e6 * abs(one.ratio) for one in found], "ppm", at_most(100.0)),
        "rotation": ([one.angle_deg for one in found], "°", at_most(0.1)),
        "position": ([1e3 * one.shift_m for one in found], "mm", at_most(2.0)),
    }
    rows: list[Row] = []
    for k, (what, (errors, unit, goal)) in enumerate(values.items()):
        of = f"compare, {name}: {what}"
        rows.append(measured(f"{of}, largest of {len(found)}", float(max(errors)), unit, goal=goal if goals else None))
        normalised = float(np.sqrt(np.mean([one.normalised[k] ** 2 for one in found])))
        within: Goal | None = at_most(1.3) if normalised >= 1 else at_least(0.8)
        wanted = within if name in NORMALISED else at_most(1.3) if name in NOT_TOO_SURE else None
        rows.append(measured(f"{of}, normalised", normalised, "sd", goal=wanted))
    right = 100.0 * float(np.mean([one.people_right for one in found]))
    return [*rows, measured(f"compare, {name}: people matched", right, "%", goal=at_least(100.0) if goals else None)]
