"""Pair the views of one person in one result, in a file that is read in blocks.

A *result* is what one participant, placement, scenario and Tracker_Time have in common. For two sensors a pair is the
thesis' one, the person's first two rows. For more sensors all pairs of sensors are pairs.
"""

from __future__ import annotations

from itertools import combinations
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.model.study_log import StudyLog
from mocapella.studies.cleaning import only

Int64 = NDArray[np.int64]

LOOK_ROWS: Final = 200
"""Largest number of rows of a file from one row of a person's result to the next."""


class PairedRows(msgspec.Struct, frozen=True, eq=False):
    """Rows with a partner, and their pairs.

    Attributes:
        rows: the rows, in the file's order.
        pairs: (pairs, 2) indices of ``rows``.
    """

    rows: StudyLog
    pairs: Int64


class RowPairing:
    """Pairs the rows of one file, one block after the other; the pairs do not depend on the blocks.

    Attributes:
        repeated: number of rows that repeat a sensor in a person's result.
        singletons: number of rows without a partner.
    """

    def __init__(self) -> None:
        self.repeated = self.singletons = 0
        self._open: StudyLog | None = None
        self._numbers = np.zeros(0, dtype=np.int64)
        self._count = 0

    def add(self, block: StudyLog) -> PairedRows:
        """Return the pairs that are complete with this block; the others wait for the next."""
        return self._add(block, last=False)

    def end(self) -> PairedRows | None:
        """Return the pairs of the rows that wait, None without a row; the next block is of another recording."""
        if self._open is None:
            return None
        return self._add(only(self._open, np.zeros(0, dtype=np.intp)), last=True)

    def _add(self, block: StudyLog, *, last: bool) -> PairedRows:
        numbers = np.concatenate([self._numbers, self._count + np.arange(len(block))])
        self._count += len(block)
        rows = block if self._open is None else joined(self._open, block)
        group, order = _groups(rows, numbers)
        newest = np.full(group.max(initial=-1) + 1, -1)
        np.maximum.at(newest, group, numbers)
        waiting = np.zeros(len(rows), dtype=bool) if last else (newest >= self._count - LOOK_ROWS)[group]
        kept = np.flatnonzero(waiting)
        self._open, self._numbers = only(rows, kept), numbers[kept]
        return self._paired(rows, group, order[~waiting[order]])

    def _paired(self, rows: StudyLog, group: Int64, order: Int64) -> PairedRows:
        """Pair the rows ``order``, where the rows of a group follow each other in the file's order."""
        kinects, kinect = kinects_of(rows)
        _, first = np.unique(group[order] * len(kinects) + kinect[order], return_index=True)
        self.repeated += len(order) - len(first)
        order = order[np.sort(first)]
        starts = np.flatnonzero(np.diff(group[order], prepend=-1))
        sizes = np.diff(starts, append=len(order))
        self.singletons += int((sizes == 1).sum())
        pairs = [np.zeros((0, 2), dtype=np.int64)]
        for size in np.unique(sizes[sizes > 1]).tolist():
            chosen = np.array(list(combinations(range(size), 2)))
            pairs.append(order[starts[sizes == size][:, None, None] + chosen].reshape(-1, 2))
        used = np.sort(order[np.repeat(sizes, sizes) > 1])
        return PairedRows(only(rows, used), np.searchsorted(used, np.concatenate(pairs)))


def _groups(rows: StudyLog, numbers: Int64) -> tuple[Int64, Int64]:
    """Return the group (rows,) of each row, and an order of the rows that puts one group after the other.

    Args:
        rows: the rows.
        numbers: (rows,) their numbers in the file, ascending.
    """
    keys = [rows.person_id, rows.tracker_time_ms, rows.scenario_id, rows.kinect_config, rows.study_id]
    order = np.lexsort([numbers, *keys])
    begins = np.diff(numbers[order], prepend=0) > LOOK_ROWS
    for key in keys:
        begins[1:] |= np.diff(key[order]) != 0
    group = np.empty(len(rows), dtype=np.int64)
    group[order] = np.cumsum(begins)
    return group, order


def joined(first: StudyLog, second: StudyLog) -> StudyLog:
    """Return the rows of both."""
    names = [name for name in StudyLog.__struct_fields__ if name != "source"]
    return StudyLog(
        first.source, **{name: np.concatenate([getattr(first, name), getattr(second, name)]) for name in names}
    )


def kinects_of(rows: StudyLog) -> tuple[list[str], Int64]:
    """Return the different Kinect_Id, and the index (rows,) of each row's."""
    found: list[str] = []
    codes = np.full(len(rows), -1, dtype=np.int64)
    while (codes < 0).any():
        kinect = rows.kinect_id[np.argmin(codes)]
        codes[rows.kinect_id == kinect] = len(found)
        found.append(str(kinect))
    return found, codes
