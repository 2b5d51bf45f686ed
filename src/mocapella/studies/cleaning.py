"""The cleaning of a study's rows, step by step as in the thesis, each step with the number of its rows.

Blocks of rows come in the file's order. `RowCleaner` does what needs one row at a time; `mocapella.studies.pairing`
removes the rows that need others: repeated ones and those without a partner.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NOT_AVAILABLE
from mocapella.model.session import SCENARIOS
from mocapella.model.study_log import StudyLog
from mocapella.sources.study_sensors import STUDY_SENSORS
from mocapella.studies.results import CleaningStep

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Bool = NDArray[np.bool_]

UNREADABLE: Final = "rows that cannot be read removed"
NO_TASK: Final = "rows without a scenario (−9999) removed"
FOUR_IS_EIGHT: Final = "scenario 4 after the first 8 read as 8"
TIME_RESET: Final = "time counted from the first row of each scenario"
SECONDS: Final = "time converted from ms to s"
METRES: Final = "positions converted from cm to m"
CENTIMETRES: Final = "differences converted from m to cm"
MISSING_JOINTS: Final = "joints at −9999 or (0, 0, 0) left out"
NO_JOINTS: Final = "rows without any joint removed"
OUT_OF_ORDER: Final = "rows out of the order of time put in order"
REPEATED: Final = "repeated rows of a sensor in one result removed"
SINGLETONS: Final = "rows without a partner removed"
STEPS: Final = {
    UNREADABLE: True,
    NO_TASK: True,
    FOUR_IS_EIGHT: False,
    TIME_RESET: False,
    SECONDS: False,
    METRES: False,
    CENTIMETRES: False,
    MISSING_JOINTS: False,
    NO_JOINTS: True,
    OUT_OF_ORDER: False,
    REPEATED: True,
    SINGLETONS: True,
}
"""The steps in their order, and whether they remove rows."""
LARGEST_BODY_M: Final = 5.0
"""Bodies of this extent or more, in the median, are in centimetres."""
_SIZED_ROWS: Final = 200
"""Number of the first rows whose bodies are measured."""

_FIRST, _SECOND = SCENARIOS["around-first"], SCENARIOS["around-second"]


class RowCleaner:
    """Cleans the rows of one file, one block after the other.

    Attributes:
        counts: number of rows by step.
        in_cm: whether the file's positions are in centimetres; None before the first row with a joint.
    """

    def __init__(self) -> None:
        self.counts = dict.fromkeys(STEPS, 0)
        self.in_cm: bool | None = None
        self._second_came = False
        self._newest: dict[tuple[int, int, int], int] = {}

    @property
    def steps(self) -> tuple[CleaningStep, ...]:
        """The steps with their numbers of rows, so far."""
        return tuple(CleaningStep(step, self.counts[step], removed) for step, removed in STEPS.items())

    def clean(self, rows: StudyLog) -> StudyLog:
        """Return the rows that are left, with corrected scenarios and positions in metres.

        Everything else is unchanged. To clean cleaned rows again changes nothing.
        """
        rows = self._without(rows, np.equal(rows.scenario_id, NOT_AVAILABLE), NO_TASK)
        rows = msgspec.structs.replace(rows, scenario_id=self._tasks(rows))
        missing: Bool = np.isnan(rows.positions[..., 0])
        self.counts[MISSING_JOINTS] += int(missing.any(axis=1).sum())
        rows = self._without(rows, np.all(missing, axis=1), NO_JOINTS)
        rows = msgspec.structs.replace(rows, positions=self._in_metres(rows.positions))
        self.counts[OUT_OF_ORDER] += self._late(rows)
        for step in (TIME_RESET, SECONDS, CENTIMETRES):
            self.counts[step] += len(rows)
        return rows

    def _without(self, rows: StudyLog, removed: NDArray[Any], step: str) -> StudyLog:
        self.counts[step] += int(removed.sum())
        return only(rows, np.flatnonzero(~removed)) if removed.any() else rows

    def _tasks(self, rows: StudyLog) -> Int64:
        """Return Scenario_Id (rows,) with 4 as 8 after the file's first 8, in logs of the study's own sensors."""
        after = np.logical_or.accumulate(rows.scenario_id == _SECOND) | self._second_came
        self._second_came = bool(after[-1]) if len(after) else self._second_came
        wrong = after & (rows.scenario_id == _FIRST)
        if wrong.any():
            wrong &= np.logical_or.reduce([np.char.endswith(rows.kinect_id, end) for end in STUDY_SENSORS])
        self.counts[FOUR_IS_EIGHT] += int(wrong.sum())
        return np.where(wrong, _SECOND, rows.scenario_id)

    def _in_metres(self, positions: NDArray[np.float32]) -> NDArray[np.float32]:
        if self.in_cm is None and len(positions):
            some = positions[:_SIZED_ROWS]
            extent = np.nanmax(some, axis=1) - np.nanmin(some, axis=1)
            self.in_cm = bool(np.median(extent.max(axis=1)) >= LARGEST_BODY_M)
        if not self.in_cm:
            return positions
        self.counts[METRES] += len(positions)
        return positions / np.float32(100)

    def _late(self, rows: StudyLog) -> int:
        """Return the number of rows with an earlier time than a row before them of the same scenario."""
        late = 0
        for condition, begin, end in conditions(rows):
            times = rows.tracker_time_ms[begin:end]
            newest = max(self._newest.get(condition, int(times[0])), int(times[0]))
            newer = np.maximum.accumulate(np.concatenate([[newest], times]))
            late += int((times < newer[:-1]).sum())
            self._newest[condition] = int(newer[-1])
        return late


def conditions(rows: StudyLog) -> Iterator[tuple[tuple[int, int, int], int, int]]:
    """Yield participant, placement and scenario of each run of rows that have the same, with its begin and end."""
    keys = np.column_stack([rows.study_id, rows.kinect_config, rows.scenario_id])
    begins = np.flatnonzero((keys[1:] != keys[:-1]).any(axis=1)) + 1
    edges = [0, *begins.tolist(), len(keys)] if len(keys) else []
    for begin, end in pairwise(edges):
        participant, placement, scenario = keys[begin].tolist()
        yield (participant, placement, scenario), begin, end


def only(rows: StudyLog, chosen: NDArray[np.intp]) -> StudyLog:
    """Return the chosen rows."""
    names = [name for name in StudyLog.__struct_fields__ if name != "source"]
    return StudyLog(rows.source, **{name: getattr(rows, name)[chosen] for name in names})
