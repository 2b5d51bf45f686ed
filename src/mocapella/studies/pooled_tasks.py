"""The differences of each participant in each task, pooled over the pairs of views that belong together.

Tests, intervals and pictures have one value for each participant, placement and task: the mean Δd over the joints.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from functools import cached_property, reduce
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.model.session import SCENARIOS
from mocapella.studies.results import AXES, TIMELINE_S, DifferenceSums, StudyOrder, StudyResults

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

FUSED: Final = "fused"
"""Name of the fused person in `ComparedViews.first` and `second`."""
BETWEEN_SENSORS: Final = "between sensors"
TO_FUSED: Final = "sensor to fused"
CM: Final = 100.0
_DD: Final = AXES.index("dd")
_FEWEST_BINS: Final = 10
"""Smallest number of a timeline's bins for a slope."""


class StudyComparison(msgspec.Struct, frozen=True, order=True):
    """Views that are tested and drawn together.

    Attributes:
        method: tracking method whose alignment is scored.
        views: `BETWEEN_SENSORS`, or `TO_FUSED` for each sensor against the fused person.
    """

    method: str
    views: str

    @property
    def title(self) -> str:
        """Its name in sentences and above pictures."""
        return f"{self.method}, {self.views}"


class PooledTask(msgspec.Struct, frozen=True, eq=False, dict=True):
    """Differences of one participant in one task with one placement, over all pairs of views of a comparison.

    Attributes:
        placement, task, participant: as in `ComparedViews`.
        pairs: number of pairs of views.
        sums: (joints,) sums of Δd over the pairs [m].
        counts: (joints,) number of pairs in each sum.
        histogram: (joints, `BINS`) number of distances in each bin of `BIN_M`.
        timeline_sums, timeline_counts: (bins, joints) sums of Δd [m] and their numbers, in bins of `TIMELINE_S`.
        order: of the study's tasks and placements.
    """

    placement: str
    task: str
    participant: str
    pairs: int
    sums: Float64
    counts: Int64
    histogram: Int64
    timeline_sums: Float64
    timeline_counts: Int64
    order: StudyOrder = StudyOrder()

    @cached_property
    def joints_cm(self) -> Float64:
        """(joints,) mean Δd [cm]; NaN for a joint that is never in both views."""
        return ratio(self.sums, self.counts) * CM

    @cached_property
    def dd_cm(self) -> float:
        """Mean Δd over the joints [cm], each joint with equal weight; NaN if no joint is ever in both views."""
        known = self.joints_cm[np.isfinite(self.joints_cm)]
        return float(known.mean()) if len(known) else float("nan")

    @cached_property
    def over_time_cm(self) -> Float64:
        """(bins,) mean Δd over all joints and pairs in each bin [cm]; NaN for a bin without pairs."""
        return ratio(self.timeline_sums.sum(axis=1), self.timeline_counts.sum(axis=1)) * CM

    @cached_property
    def slope_cm_per_min(self) -> float:
        """Slope of Δd over the task's time, least squares over the bins [cm/min]; NaN for fewer than ten bins."""
        known = np.isfinite(self.over_time_cm)
        if known.sum() < _FEWEST_BINS:
            return float("nan")
        at = np.flatnonzero(known) * TIMELINE_S / 60.0
        at = at - at.mean()
        return float(at @ self.over_time_cm[known] / (at @ at))


def ratio(sums: Float64, counts: Int64) -> Float64:
    """Return sums ÷ counts, elementwise; NaN where nothing was counted."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(counts > 0, sums / counts, np.nan)


def pooled_tasks(results: StudyResults) -> dict[StudyComparison, tuple[PooledTask, ...]]:
    """Pool a study's differences, in the order of tasks, placements and participants.

    All pairs of sensors are one comparison, and all pairs of a sensor and the fused person another one.
    """
    groups: dict[StudyComparison, dict[tuple[str, str, str], list[DifferenceSums]]] = {}
    for one in results.summaries:
        key = one.key
        views = TO_FUSED if FUSED in (key.first, key.second) else BETWEEN_SENSORS
        cells = groups.setdefault(StudyComparison(key.method, views), {})
        cells.setdefault((key.task, key.placement, key.participant), []).append(one)

    def rank(cell: tuple[str, str, str]) -> tuple[object, ...]:
        task, placement, participant = cell
        return task_rank(results.order, task), placement_rank(results.order, placement), natural_order(participant)

    return {
        comparison: tuple(_pooled(cells[cell], results.order) for cell in sorted(cells, key=rank))
        for comparison, cells in sorted(groups.items())
    }


def _pooled(parts: Sequence[DifferenceSums], order: StudyOrder) -> PooledTask:
    key = parts[0].key
    return PooledTask(
        key.placement,
        key.task,
        key.participant,
        sum(one.pairs for one in parts),
        sum((one.sums[:, _DD] for one in parts[1:]), start=parts[0].sums[:, _DD]),
        sum((one.counts for one in parts[1:]), start=parts[0].counts),
        sum((one.histogram for one in parts[1:]), start=parts[0].histogram),
        reduce(added, (one.timeline_sums for one in parts)),
        reduce(added, (one.timeline_counts for one in parts)),
        order,
    )


def added(one: NDArray[Any], other: NDArray[Any]) -> NDArray[Any]:
    """Add two timelines (bins, joints); the shorter one has zeros behind it."""
    longer, shorter = (one, other) if len(one) >= len(other) else (other, one)
    total = longer.copy()
    total[: len(shorter)] += shorter
    return total


def task_order(task: str) -> tuple[int, tuple[tuple[int, str], ...]]:
    """Rank of a task: the thesis' scenarios by number, then other tasks by name."""
    return SCENARIOS.get(task, len(SCENARIOS) + 1), natural_order(task)


def natural_order(name: str) -> tuple[tuple[int, str], ...]:
    """Rank of a name whose numbers count as numbers, and come after words: parallel, 45, 90, P2, P10."""
    parts = re.findall(r"\d+|\D+", name)
    rank = tuple((int(part), "") if part.isdecimal() else (-1, part.casefold()) for part in parts)
    return (*rank, (-2, name))


def task_rank(order: StudyOrder, task: str) -> tuple[int, object]:
    """Rank of a task in a study: by the study's order, then by `task_order`."""
    return (order.tasks.index(task), ()) if task in order.tasks else (len(order.tasks), task_order(task))


def placement_rank(order: StudyOrder, placement: str) -> tuple[int, object]:
    """Rank of a placement in a study: by the study's order, then by `natural_order`."""
    known = placement in order.placements
    return (order.placements.index(placement), ()) if known else (len(order.placements), natural_order(placement))


def placements_of(tasks: Iterable[PooledTask]) -> tuple[str, ...]:
    """Return the placements in their order."""
    ranks = {one.placement: placement_rank(one.order, one.placement) for one in tasks}
    return tuple(sorted(ranks, key=ranks.__getitem__))


def tasks_of(tasks: Iterable[PooledTask]) -> tuple[str, ...]:
    """Return the tasks in their order."""
    ranks = {one.task: task_rank(one.order, one.task) for one in tasks}
    return tuple(sorted(ranks, key=ranks.__getitem__))


def participants_of(tasks: Iterable[PooledTask]) -> tuple[str, ...]:
    """Return the participants in their order."""
    return tuple(sorted({one.participant for one in tasks}, key=natural_order))
