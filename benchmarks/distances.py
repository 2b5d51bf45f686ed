"""Budget of Walk's Δd on the study logs: what remains if one cause of the distance of two views were known."""

from __future__ import annotations

import warnings
from collections import defaultdict
from typing import Final

import msgspec
import numpy as np

from benchmarks.harness import Row, measured
from benchmarks.tracker import recordings
from mocapella.evaluation.distance_budget import DistanceBudget, distance_budget
from mocapella.evaluation.kinectmultitrack import WALK
from mocapella.evaluation.methods import scored_tracker
from mocapella.evaluation.session_runs import run_session
from mocapella.evaluation.study_pairs import study_sessions

PEOPLE: Final = range(10)
QUICK: Final = (0,)
NAMES: Final = {
    "scored": "as scored",
    "labels": "with the nearer labels of each pair",
    "offset": "with the best clock offset",
    "motion": "with the best rigid motion",
    "each_motion": "with the best rigid motion of each pair",
    "own_bias": "with a joint bias fitted to the same pairs",
    "second_half": "second half, as scored",
    "earlier_bias": "second half, with a joint bias fitted to the first half",
    "lasting": "what lasts half a second",
    "fast": "what does not last",
}


def run(*, quick: bool = False) -> list[Row]:
    folder = recordings() / "kinectmultitrack"
    if not folder.is_dir():
        warnings.warn(f"no walk measured: {folder} is not there (MOCAPELLA_DATA names another place)", stacklevel=2)
        return []
    make = scored_tracker("default")
    found: dict[str, list[DistanceBudget]] = defaultdict(list)
    for session in study_sessions(folder, QUICK if quick else PEOPLE):
        walk = session.pairs.where(session.pairs.task == WALK)
        if len(walk):
            run_of_it = run_session(session, make, session.frames)
            found[session.placement].append(distance_budget(session, run_of_it, walk))
    return [
        measured(f"Walk Δd, {placement}, {what}", _mean_cm(budgets, field), "cm")
        for placement, budgets in found.items()
        for field, what in NAMES.items()
    ]


def _mean_cm(budgets: list[DistanceBudget], field: str) -> float:
    return 100 * float(np.mean([msgspec.structs.asdict(one)[field] for one in budgets]))
