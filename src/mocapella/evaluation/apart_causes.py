"""Why the two logged views of a study log's person lie apart: a wrong motion between the sensors, and the rest.

Of the pairs of one task the single rigid motion is computed that fits best. What the views lie apart after it is due to
the sensors (errors, labels, instants); by how much it turns is the error of the logged calibration, which costs the
more the farther people are from where they were calibrated.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.evaluation.study_pairs import PLACEMENT_NAMES, TASKS, corrected_tasks, pairs_of, study_logs
from mocapella.geometry import alignment, rigid
from mocapella.model.session import PLACEMENTS
from mocapella.model.study_log import StudyLog
from mocapella.model.topology import topology

Float64 = NDArray[np.float64]

LEAST_PAIRS: Final = 20
"""Fewest pairs of a task for a fit of a motion."""
CLEARLY_M: Final = 0.02
"""By how much nearer the views must be with swapped labels to count as swapped [m]."""


class ApartCauses(msgspec.Struct, frozen=True):
    """How far two views lie apart in one task, and why.

    Attributes:
        apart_cm: mean Δd of the logged views [cm].
        turned_deg: angle by which the best motion of the task turns the second view [deg].
        left_cm: mean Δd after the best motion [cm].
        steady_cm: part of it that does not change in the task: the mean over joints of the length of the mean
            difference [cm].
        shared_cm: the same of the mean difference over sessions with the same reference sensor, which all people have
            in common; of one session equal to ``steady_cm`` [cm].
        swapped_percent: share of pairs that are then nearer with the labels of one view swapped [%].
        spread_cm: mean horizontal distance of the person from the person's mean place in the task [cm].
    """

    apart_cm: float
    turned_deg: float
    left_cm: float
    steady_cm: float
    shared_cm: float
    swapped_percent: float
    spread_cm: float


def causes_of(views: Float64) -> tuple[ApartCauses, Float64]:
    """Return why pairs of views lie apart, and the joints' mean difference (25, 3) after the best motion [m].

    Args:
        views: (pairs, 2, 25, 3) joints of the Kinect v2 in one space, y up [m]; NaN where a joint is missing. Pairs
            without a joint in both views are left out; at least one must have one.
    """
    in_both = np.isfinite(views).all(axis=(1, 3))
    views = views[np.any(in_both, axis=-1)]
    first, second = views[:, 0], views[:, 1]
    T = alignment.align(alignment.moments(first.reshape(-1, 3), second.reshape(-1, 3)))
    fitted = rigid.apply(T, second)
    as_labelled = np.nanmean(np.linalg.norm(fitted - first, axis=-1), axis=1)
    swapped = np.nanmean(np.linalg.norm(fitted[:, list(topology("kinect_v2").mirror)] - first, axis=-1), axis=1)
    floor = np.nanmean(first, axis=1)[:, [0, 2]]
    steady = np.nanmean(fitted - first, axis=0)
    steady_cm = _length_cm(steady)
    causes = ApartCauses(
        apart_cm=100 * float(np.nanmean(np.linalg.norm(first - second, axis=-1))),
        turned_deg=float(np.degrees(np.arccos(np.clip((np.trace(T[:3, :3]) - 1) / 2, -1, 1)))),
        left_cm=100 * float(np.nanmean(np.linalg.norm(fitted - first, axis=-1))),
        steady_cm=steady_cm,
        shared_cm=steady_cm,
        swapped_percent=100 * float((swapped < as_labelled - CLEARLY_M).mean()),
        spread_cm=100 * float(np.linalg.norm(floor - floor.mean(axis=0), axis=1).mean()),
    )
    return causes, steady


def causes_by_task(
    folder: Path, participants: Collection[int] | None = None, on_file: Callable[[str], None] = lambda name: None
) -> dict[str, dict[str, ApartCauses]]:
    """Return the mean causes over a folder's study logs of one person, by task and placement.

    Args:
        folder: as in `mocapella.evaluation.study_pairs.study_logs`.
        participants: numbers of the participants; None for all.
        on_file: called with the name of each file before it is read.

    Raises:
        InputError: no such folder, no log in it, or one that cannot be read.
        SettingsError: a participant without a file; lists the participants.
    """
    found: dict[tuple[str, str], list[ApartCauses]] = defaultdict(list)
    steady: dict[tuple[str, str], dict[str, list[Float64]]] = defaultdict(lambda: defaultdict(list))
    for log in study_logs(folder, participants, on_file):
        for key, reference, (causes, difference) in _of_log(log):
            found[key].append(causes)
            steady[key][reference].append(difference)
    result: dict[str, dict[str, ApartCauses]] = defaultdict(dict)
    for (task, placement), each in sorted(found.items()):
        values = np.mean([msgspec.structs.astuple(one) for one in each], axis=0).tolist()
        same = max(steady[task, placement].values(), key=len)
        shared_cm = _length_cm(np.nanmean(same, axis=0))
        result[task][placement] = msgspec.structs.replace(ApartCauses(*values), shared_cm=shared_cm)
    return dict(result)


def _length_cm(differences: Float64) -> float:
    return 100 * float(np.nanmean(np.linalg.norm(differences, axis=-1)))


def _of_log(log: StudyLog) -> list[tuple[tuple[str, str], str, tuple[ApartCauses, Float64]]]:
    log = msgspec.structs.replace(log, scenario_id=corrected_tasks(log))
    numbers = {number: PLACEMENT_NAMES[name] for name, number in PLACEMENTS.items()}
    placement = numbers.get(int(log.kinect_config[0]), "")
    if len(np.unique(log.person_id)) > 1 or not placement:
        return []
    pairs = pairs_of(log)
    found = []
    for number in np.unique(pairs.task).tolist():
        rows = pairs.rows[pairs.task == number]
        if number in TASKS and len(rows) >= LEAST_PAIRS:
            reference = str(log.kinect_id[rows[0, 0]])
            found.append(((TASKS[number], placement), reference, causes_of(log.positions[rows].astype(np.float64))))
    return found
