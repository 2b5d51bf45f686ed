"""Divide a study log into sessions that methods can track: one participant and one placement, any number of sensors.

A replay needs each sensor's rows in one camera space of its own. A log has all rows of a result in the space of the
result's reference view, so results with another reference than the session's are left out and counted.
"""

from __future__ import annotations

from collections.abc import Iterator

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.model.session import PLACEMENTS
from mocapella.model.study_log import StudyLog
from mocapella.studies.cleaning import only


class LogSession(msgspec.Struct, frozen=True, eq=False):
    """The rows of one participant and placement.

    Attributes:
        log: the rows.
        participant, placement: their ``Study_Id`` and ``Kinect_Config``.
        by_angle: whether the sensors are placed by their logged angles: there are more than two, or the placement is
            none of the thesis'.
        left_out: number of rows of results with another reference sensor.
    """

    log: StudyLog
    participant: int
    placement: int
    by_angle: bool
    left_out: int


def sessions_of_log(log: StudyLog) -> Iterator[LogSession]:
    """Yield the sessions of a study log, in the order of their first rows."""
    keys = np.stack([log.study_id, log.kinect_config], axis=1)
    _, first, which = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    for number in np.argsort(first, kind="stable").tolist():
        rows = np.flatnonzero(which.reshape(-1) == number)
        own = only(log, rows)
        kept = _with_one_reference(own)
        participant, placement = keys[rows[0]].tolist()
        by_angle = len(np.unique(own.kinect_id)) > 2 or placement not in PLACEMENTS.values()
        yield LogSession(
            own if kept.all() else only(own, np.flatnonzero(kept)),
            participant,
            placement,
            by_angle,
            int((~kept).sum()),
        )


def _with_one_reference(log: StudyLog) -> NDArray[np.bool_]:
    """Whether each row's result has no other reference sensor than most results of the log."""
    is_reference = log.skeleton_id == 0
    kinects, counts = np.unique(log.kinect_id[is_reference], return_counts=True)
    if len(kinects) < 2:
        return np.ones(len(log), dtype=bool)
    other = is_reference & (log.kinect_id != kinects[np.argmax(counts)])
    results = np.stack([log.tracker_time_ms, log.scenario_id, log.person_id], axis=1)
    _, which = np.unique(results, axis=0, return_inverse=True)
    which = which.reshape(-1)
    return np.asarray(~np.isin(which, which[other]))
