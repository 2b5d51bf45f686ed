"""People in postures unlike walking: exchanged left and right, and the fused error against the best sensor's.

Two sensors with the errors of real ones, 90° apart; the person walks first, and then faces three ways.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from benchmarks.harness import Row, at_most, measured
from mocapella.evaluation.posture_sessions import HEADINGS_DEG, UPRIGHT, PostureResult, score_postures
from mocapella.sources.simulate.postures import POSTURES

SEEDS = (0, 1)
QUICK = ("stand", "sit", "bow")


def run(*, quick: bool = False) -> list[Row]:
    postures = QUICK if quick else ("stand", *POSTURES)
    results = [
        result
        for heading in (HEADINGS_DEG[:1] if quick else HEADINGS_DEG)
        for seed in (SEEDS[:1] if quick else SEEDS)
        for result in score_postures(heading, seed, postures)
    ]
    upright = [result for result in results if result.posture in UPRIGHT]
    fused, mean, weighted = (
        _ratio(upright, error)
        for error in (lambda one: one.fused_m, lambda one: one.mean_m, lambda one: one.weighted_m)
    )
    rows = [
        measured(f"left and right exchanged, {len(upright)} sessions", _wrong(upright), "%", goal=at_most(0.3)),
        measured("frames without the person", _share(upright, lambda one: one.missing), "%", goal=at_most(1.0)),
        measured("frames with a condition", _share(upright, lambda one: one.warned), "%", goal=at_most(0.0)),
        measured("fused error / best sensor's, mean", fused, "%", goal=at_most(50.0)),
        measured("the same of the views' mean, true poses and labels", mean, "%"),
        measured("  and with ideal weights of joints", weighted, "%"),
    ]
    for posture in postures:
        of_it = [result for result in results if result.posture == posture]
        rows.append(measured(f"exchanged, {posture}", _wrong(of_it), "%"))
        rows.append(measured(f"fused error, {posture}", 100 * float(np.mean([one.fused_m for one in of_it])), "cm"))
    return rows


def _wrong(results: Sequence[PostureResult]) -> float:
    return _share(results, lambda one: one.wrong)


def _share(results: Sequence[PostureResult], count: Callable[[PostureResult], int]) -> float:
    return 100 * sum(map(count, results)) / sum(one.frames for one in results)


def _ratio(results: Sequence[PostureResult], error: Callable[[PostureResult], float]) -> float:
    return 100 * float(np.mean([error(one) / one.best_m for one in results]))
