"""Budget of Δd on the study logs, of Walk and of two people: what remains if one cause of the distance were known."""

from __future__ import annotations

import warnings
from collections import defaultdict
from collections.abc import Sequence
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
from mocapella.evaluation.two_people_budget import TwoPeopleBudget, near_views, two_people_budget

PEOPLE: Final = (*range(10), 20, 21, 22)
QUICK: Final = (0, 22)
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
NEAR: Final = {
    "scored": "as scored",
    "labels": "with the nearer labels of each pair",
    "motion": "with the best rigid motion",
    "motion_of_other_half": "with the best rigid motion of the other half",
    "own_motion": "with the best rigid motion of each person",
    "each_motion": "with the best rigid motion of each pair",
    "constant": "without the joints' constant differences",
    "constant_of_other_half": "without those of the other half",
    "own_constant": "without the constant differences of each person",
    "own_constant_of_other_half": "without those of the person's other half",
    "constant_of_other_person": "without the constant differences of the other person",
}


def run(*, quick: bool = False) -> list[Row]:
    folder = recordings() / "kinectmultitrack"
    if not folder.is_dir():
        warnings.warn(f"no walk measured: {folder} is not there (MOCAPELLA_DATA names another place)", stacklevel=2)
        return []
    make = scored_tracker("default")
    found: dict[str, list[DistanceBudget]] = defaultdict(list)
    near: list[TwoPeopleBudget] = []
    for session in study_sessions(folder, QUICK if quick else PEOPLE):
        walk = session.pairs.where(session.pairs.task == WALK)
        if session.two_people:
            near.append(two_people_budget(near_views(session, run_session(session, make, session.frames))))
        elif len(walk):
            run_of_it = run_session(session, make, session.frames)
            found[session.placement].append(distance_budget(session, run_of_it, walk))
    rows = [
        measured(f"Walk Δd, {placement}, {what}", _mean_cm(budgets, field), "cm")
        for placement, budgets in found.items()
        for field, what in NAMES.items()
    ]
    if near:
        rows += [
            measured(f"two people, median Δd, {what}", _mean_cm(near, field), "cm") for field, what in NEAR.items()
        ]
    return rows


def _mean_cm(budgets: Sequence[DistanceBudget | TwoPeopleBudget], field: str) -> float:
    return 100 * float(np.mean([msgspec.structs.asdict(one)[field] for one in budgets]))
