"""The tables of a study: differences by task and placement, by joint, by side and part of the body, and overall.

A participant's mean of a joint is over all pairs of a task and placement, whatever recording they are in. M is the
unweighted mean of these over the participants. Avg and Std are the mean and the standard deviation (N − 1) of M over
the joints, as in the thesis.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.evaluation.study_tables import TORSO, mean_and_std
from mocapella.model.session import SCENARIOS
from mocapella.recording.study_columns import TOPOLOGY
from mocapella.studies.results import BIN_M, DifferenceSums, StudyOrder, StudyResults
from mocapella.studies.tables import StudyTable, TableColumn

Float64 = NDArray[np.float64]
Cell = str | float | int | None

PLACEMENT_ORDER: Final = ("parallel", "45", "90")
DEGREES: Final = {"45": "45°", "90": "90°"}
NUMBERS: Final = {
    "stationary": ("1", "2", "9.1"),
    "steps": ("3", "4", "9.2"),
    "walk": ("5", "6", "9.3"),
}
"""Numbers of the paper's tables by placement and by joint, and of the thesis' table, by task."""
WEI: Final = ((4.25, (0.0, 1.0, 2.0)), (44.37, (1.0, 1.0, 1.5)))
"""Angle between two Kinects [°] and |Δx|, |Δy|, |Δz| [cm] by Wei et al., which the thesis compares with."""

_CM: Final = 100.0
_AXES: Final = ("Δx", "Δy", "Δz", "Δd")
_SIDES: Final = {
    side: [k for k, name in enumerate(TOPOLOGY.joints) if name.endswith(side)] for side in ("Left", "Right")
}
_LIMBS: Final = [k for k in range(len(TOPOLOGY)) if k not in TORSO]
_OVER_JOINTS: Final = "Avg and Std (N − 1) are over the joints of the means over the participants."
_AVERAGE: Final = "Average: mean of the placements, and the standard deviation (N − 1) of their Avg."


class ViewComparison(msgspec.Struct, frozen=True, eq=False):
    """What the tables of one pair of views by one method are made of.

    Attributes:
        method, first, second: as in `ComparedViews`.
        cells: sums of each participant, by task and placement, in the tables' order.
        order: of the study's tasks and placements.
    """

    method: str
    first: str
    second: str
    cells: dict[tuple[str, str], tuple[DifferenceSums, ...]]
    order: StudyOrder = StudyOrder()

    @property
    def tasks(self) -> tuple[str, ...]:
        """The tasks, in their order."""
        return tuple(dict.fromkeys(task for task, _ in self.cells))

    def placements(self, task: str | None = None) -> tuple[str, ...]:
        """Return the placements of a task, or of all, in their order."""
        found = {placement for each, placement in self.cells if task in (None, each)}
        return tuple(sorted(found, key=partial(_placement_order, self.order)))

    def joint_means(self, task: str, placement: str) -> Float64:
        """Return M (joints, 4) of |Δx|, |Δy|, |Δz| and Δd [m]; NaN for a joint that no person's two views have."""
        return _mean([part.means for part in self.cells[task, placement]])

    def of_participants(self, task: str, placement: str) -> Float64:
        """Return each participant's mean of Δd over the joints (participants,) [m]."""
        return np.array([_mean(part.means[:, 3]) for part in self.cells[task, placement]])


def compared_of(results: StudyResults) -> tuple[ViewComparison, ...]:
    """Return what the tables are made of, for each method and pair of views."""
    found: defaultdict[tuple[str, str, str], defaultdict[tuple[str, str], list[DifferenceSums]]]
    found = defaultdict(lambda: defaultdict(list))
    for part in results.summaries:
        key = part.key
        found[key.method, key.first, key.second][key.task, key.placement].append(part)
    rank = partial(_cell_order, results.order)
    return tuple(
        ViewComparison(*views, {cell: tuple(parts[cell]) for cell in sorted(parts, key=rank)}, results.order)
        for views, parts in found.items()
    )


def tables_of(results: StudyResults) -> tuple[StudyTable, ...]:
    """Return all tables of a study, the recordings' tables last."""
    compared = compared_of(results)
    tables = [table for one in compared for table in _tables_of(one, _said(one, compared))]
    return (*tables, _recordings(results), _cleaning(results), _findings(results))


def _said(one: ViewComparison, compared: Sequence[ViewComparison]) -> tuple[str, str]:
    """Return the end of the tables' names and titles; empty where all tables are of the same views."""
    if len(compared) == 1:
        return "", ""
    return f"-{one.method}-{one.first}-{one.second}".replace(":", "-"), f", {one.first} and {one.second}, {one.method}"


def _tables_of(one: ViewComparison, said: tuple[str, str]) -> Iterator[StudyTable]:
    for task in one.tasks:
        yield _by_placement(one, task, said)
        yield _spread(one, task, said)
        yield _by_joint(one, task, said)
    yield _parts(one, said, "left-against-right", "Left against right", _SIDES)
    yield _parts(one, said, "torso-against-limbs", "Torso against limbs", {"Torso": list(TORSO), "Limbs": _LIMBS})
    yield _overall(one, said)
    if {"parallel", "45"} & set(one.placements()):
        yield _beside_wei(one, said)


def _cm(title: str) -> TableColumn:
    return TableColumn(title, "cm")


def _by_placement(one: ViewComparison, task: str, said: tuple[str, str]) -> StudyTable:
    rows: list[tuple[Cell, ...]] = []
    averages = []
    for placement in one.placements(task):
        parts = one.cells[task, placement]
        figures = [mean_and_std(_finite(column)) for column in one.joint_means(task, placement).T]
        averages.append([mean for mean, _ in figures])
        values = [value for pair in figures for value in pair]
        rows.append((_degrees(placement), len(parts), sum(part.pairs for part in parts), *values))
    if len(rows) > 1:
        values = [value for column in np.transpose(averages) for value in mean_and_std(column / _CM)]
        rows.append(("Average", None, None, *values))
    paper, _, thesis = NUMBERS.get(task, ("", "", ""))
    return StudyTable(
        name=f"{task}-by-placement{said[0]}",
        title=f"{task.capitalize()} by placement{said[1]}{_numbered(paper, thesis)}",
        columns=(
            TableColumn("Placement"),
            TableColumn("Participants", digits=0),
            TableColumn("Pairs", digits=0),
            *(_cm(f"{what} {axis}") for axis in _AXES for what in ("Avg", "Std")),
        ),
        rows=tuple(rows),
        notes=(_OVER_JOINTS, *([_AVERAGE] if len(averages) > 1 else [])),
    )


def _spread(one: ViewComparison, task: str, said: tuple[str, str]) -> StudyTable:
    rows: list[tuple[Cell, ...]] = []
    for placement in one.placements(task):
        parts = one.cells[task, placement]
        means = one.of_participants(task, placement)
        mean, spread = mean_and_std(means)
        worst = int(np.argmax(means))
        histogram = np.sum([part.histogram for part in parts], axis=(0, 1))
        farthest = max(
            ((value, k) for part in parts for k, value in enumerate(part.worst.tolist()) if np.isfinite(value)),
            default=(None, 0),
        )
        rows.append(
            (
                _degrees(placement), len(parts), mean, spread, float(means.min()) * _CM, float(means.max()) * _CM,
                parts[worst].key.participant, *(quantile_cm(histogram, share) for share in (0.5, 0.95)),
                *((None, None) if farthest[0] is None else (farthest[0] * _CM, TOPOLOGY.joints[farthest[1]])),
            )
        )  # fmt: skip
    return StudyTable(
        name=f"{task}-spread{said[0]}",
        title=f"{task.capitalize()}: spread of Δd over participants, pairs and joints{said[1]}",
        columns=(
            TableColumn("Placement"), TableColumn("Participants", digits=0), _cm("Mean"), _cm("SD"), _cm("Least"),
            _cm("Largest"), TableColumn("of participant"), _cm("Median"), _cm("95 %"), _cm("Worst"), TableColumn("at"),
        ),
        rows=tuple(rows),
        notes=(
            "Mean, SD (N − 1), least and largest are of the participants' means over the joints.",
            f"Median and 95 % are of all pairs and joints, to {BIN_M * 1000:g} mm; worst is the largest of these.",
        ),
    )  # fmt: skip


def _by_joint(one: ViewComparison, task: str, said: tuple[str, str]) -> StudyTable:
    placements = one.placements(task)
    means = np.stack([one.joint_means(task, placement)[:, 3] for placement in placements], axis=1)
    rows: list[tuple[Cell, ...]]
    rows = [(name, *_with_average(values)) for name, values in zip(TOPOLOGY.joints, means, strict=True)]
    rows.sort(key=lambda row: str(row[0]))
    rows.append(("Average", *_with_average(_mean(means))))
    _, paper, thesis = NUMBERS.get(task, ("", "", ""))
    return StudyTable(
        name=f"{task}-by-joint{said[0]}",
        title=f"{task.capitalize()}: Δd by joint{said[1]}{_numbered(paper, thesis)}",
        columns=(TableColumn("Joint"), *map(_cm, _headings(placements))),
        rows=tuple(rows),
        notes=(
            "Means over the participants' means. " + _AVERAGE if len(placements) > 1 else "Means over participants.",
        ),
    )


def _parts(
    one: ViewComparison, said: tuple[str, str], name: str, title: str, parts: Mapping[str, Sequence[int]]
) -> StudyTable:
    rows: list[tuple[Cell, ...]] = []
    for task, placement in one.cells:
        means = one.joint_means(task, placement)[:, 3]
        values = [mean_and_std(_finite(means[list(joints)])) for joints in parts.values()]
        flat = [value for pair in values for value in pair]
        rows.append((task.capitalize(), _degrees(placement), *flat, values[0][0] - values[1][0]))
    first, second = parts
    return StudyTable(
        name=f"{name}{said[0]}",
        title=f"{title}: Δd{said[1]}",
        columns=(
            TableColumn("Task"),
            TableColumn("Placement"),
            *(_cm(f"{part} {what}") for part in parts for what in ("Avg", "Std")),
            _cm(f"{first} − {second}"),
        ),
        rows=tuple(rows),
        notes=(
            _OVER_JOINTS,
            *(f"{part}: {', '.join(TOPOLOGY.joints[k] for k in joints)}." for part, joints in parts.items()),
        ),
    )


def _overall(one: ViewComparison, said: tuple[str, str]) -> StudyTable:
    placements = one.placements()
    means = np.full((len(one.tasks), len(placements)), np.nan)
    for task, placement in one.cells:
        place = one.tasks.index(task), placements.index(placement)
        means[place] = _mean(one.joint_means(task, placement)[:, 3])
    rows: list[tuple[Cell, ...]]
    rows = [(task.capitalize(), *_with_average(row)) for task, row in zip(one.tasks, means, strict=True)]
    whole = means[np.isfinite(means).all(axis=1)]
    if len(whole) > 1:
        rows.append(("Average", *_with_average(_mean(whole))))
    return StudyTable(
        name=f"overall{said[0]}",
        title=f"Δd by task and placement{said[1]} (thesis, table 9.4)",
        columns=(TableColumn("Task"), *map(_cm, _headings(placements))),
        rows=tuple(rows),
        notes=(
            "The last row averages the tasks that were done in all placements.",
            "The thesis' table 9.4(b) prints the averages 6.57 and 10.57, where the means of its columns are 8.76 and "
            "14.10, as if the sum of three were divided by four.",
            "The paper's table 7 is all zeros, and its table 8 and the thesis' table 9.5 repeat other tables: nothing "
            "here stands for them.",
        ),
    )


def _beside_wei(one: ViewComparison, said: tuple[str, str]) -> StudyTable:
    rows: list[tuple[Cell, ...]] = [
        ("Wei et al.", f"{angle:g}°", *apart, float(np.linalg.norm(apart))) for angle, apart in WEI
    ]
    for task, placement in one.cells:
        if placement in ("parallel", "45"):
            means = [mean_and_std(_finite(column))[0] for column in one.joint_means(task, placement).T]
            rows.append((task.capitalize(), _degrees(placement), *means))
    return StudyTable(
        name=f"beside-wei{said[0]}",
        title=f"Beside Wei et al.{said[1]}",
        columns=(TableColumn("Source"), TableColumn("Angle"), *map(_cm, _AXES)),
        rows=tuple(rows),
        notes=("Δd of Wei et al. is √(Δx² + Δy² + Δz²) of their figures; ours is the mean of the pairs' distances.",),
    )


def _recordings(results: StudyResults) -> StudyTable:
    rows: list[tuple[Cell, ...]] = []
    rank = partial(_task_order, results.order)
    for one in results.files:
        people = dict.fromkeys(part.key.participant for part in one.summaries)
        placements = dict.fromkeys(part.key.placement for part in one.summaries)
        tasks = dict.fromkeys(part.key.task for part in one.summaries)
        of = (", ".join(map(str, values)) for values in (people, placements, sorted(tasks, key=rank)))
        rows.append((one.file, *of, one.rows, one.used, len(one.findings)))
    rows.append(("All", "", "", "", sum(one.rows for one in results.files), sum(one.used for one in results.files),
                 len(results.findings)))  # fmt: skip
    whole = [TableColumn(title, digits=0) for title in ("Rows", "Used", "Findings")]
    text = [TableColumn(title) for title in ("Recording", "Participants", "Placements", "Tasks")]
    notes = ("Used: rows that are in a pair.",)
    return StudyTable("recordings", "Recordings", (*text, *whole), tuple(rows), notes)


def _cleaning(results: StudyResults) -> StudyTable:
    rows = []
    for k, step in enumerate(results.files[0].cleaning if results.files else ()):
        counts = [one.cleaning[k].rows for one in results.files]
        rows.append((step.step, sum(counts), sum(count > 0 for count in counts), "yes" if step.removed else "no"))
    columns = (
        TableColumn("Step"), TableColumn("Rows", digits=0), TableColumn("Recordings", digits=0), TableColumn("Removed")
    )  # fmt: skip
    notes = ("Rows that the step changed or removed, and the number of recordings with such rows.",)
    return StudyTable("cleaning", "Cleaning", columns, tuple(rows), notes)


def _findings(results: StudyResults) -> StudyTable:
    rows = tuple((one.file or "study", one.what, one.effect, one.rows or None) for one in results.findings)
    columns = (*map(TableColumn, ("Recording", "What", "Effect")), TableColumn("Rows", digits=0))
    return StudyTable("findings", "Findings", columns, rows)


def quantile_cm(histogram: NDArray[np.int64], share: float) -> float | None:
    """Return the distance that a share of the values does not exceed [cm]; None without values.

    Values are evenly distributed in each bin (bins,) of `BIN_M`; in the last one they are not known to be less.
    """
    total = int(histogram.sum())
    if not total:
        return None
    upto = np.cumsum(histogram)
    k = int(np.searchsorted(upto, share * total))
    inside = 0.0 if k == len(histogram) - 1 else (share * total - (upto[k] - histogram[k])) / histogram[k]
    return float((k + inside) * BIN_M * _CM)


def _with_average(values: Float64) -> tuple[float, ...]:
    """Return values [m] in cm, with their mean and standard deviation if there are several."""
    in_cm = [float(value) * _CM for value in values]
    return (*in_cm, *mean_and_std(_finite(values))) if len(values) > 1 else tuple(in_cm)


def _headings(placements: Sequence[str]) -> tuple[str, ...]:
    return (*map(_degrees, placements), *(("Average", "Std") if len(placements) > 1 else ()))


def _numbered(paper: str, thesis: str) -> str:
    return f" (paper, table {paper}; thesis, table {thesis})" if paper else ""


def _degrees(placement: str) -> str:
    return DEGREES.get(placement, placement)


def _finite(values: Float64) -> Float64:
    return values[np.isfinite(values)]


def _mean(values: Iterable[Float64] | Float64) -> Float64:
    """Return the mean over the first axis of the values that are there; NaN where none is."""
    array = np.asarray(values)
    count = np.isfinite(array).sum(axis=0)
    total = np.where(np.isfinite(array), array, 0.0).sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _placement_order(order: StudyOrder, placement: str) -> tuple[int, str]:
    known = (*order.placements, *(name for name in PLACEMENT_ORDER if name not in order.placements))
    return (known.index(placement) if placement in known else len(known), placement)


def _task_order(order: StudyOrder, task: str) -> tuple[int, int, str]:
    own = order.tasks.index(task) if task in order.tasks else len(order.tasks)
    return (own, SCENARIOS.get(task, len(SCENARIOS) + 1), task)


def _cell_order(order: StudyOrder, cell: tuple[str, str]) -> tuple[tuple[int, int, str], tuple[int, str]]:
    return _task_order(order, cell[0]), _placement_order(order, cell[1])
