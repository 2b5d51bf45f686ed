"""Analyse a study's recordings: clean them, pair the views, and sum the differences (docs/studies.md).

A recording that cannot be used, or only in part, is a finding and never an error: the rest is analysed.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, Final

import numpy as np

from mocapella.conventions import NOT_AVAILABLE
from mocapella.errors import InputError, MocapellaError, SettingsError
from mocapella.recording.study_columns import TOPOLOGY
from mocapella.sources.study_sensors import STUDY_SENSORS, sensor_name
from mocapella.studies.cleaning import METRES, REPEATED, SINGLETONS, UNREADABLE, RowCleaner, conditions, only
from mocapella.studies.differences import (
    AlignedPairs,
    ViewsOfMethods,
    added,
    by_key,
    difference_sums,
    no_other_methods,
)
from mocapella.studies.naming import RecordingNames
from mocapella.studies.pairing import PairedRows, RowPairing, kinects_of
from mocapella.studies.pooled_tasks import FUSED
from mocapella.studies.recordings import LOGGED, RecordedRows, kind_of
from mocapella.studies.results import (
    ComparedViews,
    DifferenceSums,
    FileResults,
    StudyFinding,
    StudyOrder,
    StudyResults,
)

_Condition = tuple[int, int, int]
"""Study_Id, Kinect_Config and Scenario_Id."""

_KEPT_PARTS: Final = 16
"""Number of blocks' sums of one key that are kept apart; each takes half a megabyte."""
_LEFT_OUT: Final = "the file is left out"


def analyze_file(
    path: Path,
    *,
    participants: Collection[str] | None = None,
    views_of_methods: ViewsOfMethods = no_other_methods,
    names: RecordingNames | None = None,
) -> FileResults:
    """Analyse one recording: a study log or a take.

    Args:
        path: its file.
        participants: codes of those who are analysed; None for all.
        views_of_methods: gives the views as other methods align them, beside the recorded ones.
        names: of the recording's numbers; None for the thesis' names.
    """
    file = _File(path, participants, names or RecordingNames())
    fault: InputError | None = None
    try:
        kind = kind_of(path)
        if kind is None:
            return file.results(InputError("is no recording of a study", file=path), ())
        for block in kind.blocks(path, file.leave_out):
            file.add(block)
    except InputError as error:
        fault = error
    file.end()
    others: list[DifferenceSums] = []
    try:
        others += [difference_sums(views) for views in views_of_methods(path) if file.used]
    except MocapellaError as error:
        file.tell(f"another method cannot align it: {error}", "only the recorded views are analysed")
    return file.results(fault, others)


class _File:
    """The analysis of one file, block after block."""

    def __init__(self, path: Path, participants: Collection[str] | None, numbers: RecordingNames) -> None:
        self._path, self._participants, self._numbers = path, participants, numbers
        self._fused_only = False
        self._cleaner, self._pairing = RowCleaner(), RowPairing()
        self._sums: defaultdict[ComparedViews, list[DifferenceSums]] = defaultdict(list)
        self._findings: list[StudyFinding] = []
        self._bad_rows: list[InputError] = []
        self._began: dict[_Condition, int] = {}
        self._paired: set[_Condition] = set()
        self._rows_of: defaultdict[_Condition, int] = defaultdict(int)
        self._names: dict[str, str] = {}
        self._method, self._origin = "", dict[str, Any]()
        self.rows = self.used = 0

    def leave_out(self, error: InputError) -> None:
        """Note a row that cannot be read."""
        self._bad_rows.append(error)

    def tell(self, what: str, effect: str, rows: int = 0) -> None:
        """Add a finding."""
        self._findings.append(StudyFinding(self._path.name, what, effect, rows))

    def add(self, block: RecordedRows) -> None:
        """Analyse the next rows; each method's pairs are complete before another's begin."""
        rows = block.rows
        method = self._numbers.method if block.method == LOGGED and self._numbers.method else block.method
        if method != self._method:
            self.end()
        self._method, self._origin, self._fused_only = method, self._origin or block.origin, block.fused_only
        if block.names is not None:
            self._numbers = block.names
        if self._participants is not None:
            codes = {study_id: self._participant(study_id) for study_id in np.unique(rows.study_id).tolist()}
            chosen = [study_id for study_id, code in codes.items() if code in self._participants]
            rows = only(rows, np.flatnonzero(np.isin(rows.study_id, chosen)))
        self.rows += len(rows)
        rows = self._cleaner.clean(rows)
        for condition, begin, end in conditions(rows):
            self._rows_of[condition] += end - begin
            self._began.setdefault(condition, int(rows.tracker_time_ms[begin]))
        self._sum(self._pairing.add(rows))

    def end(self) -> None:
        """Analyse the rows that wait for a partner."""
        found = self._pairing.end()
        if found is not None:
            self._sum(found)

    def _sum(self, found: PairedRows) -> None:
        rows, pairs = found.rows, found.pairs
        self.used += len(rows)
        if not len(pairs):
            return
        kinects, kinect = kinects_of(rows)
        names = [self._name(each) for each in kinects]
        order = sorted(range(len(names)), key=lambda k: (names[k] == FUSED, names[k]))
        sensor = np.argsort(order)[kinect]
        swapped = sensor[pairs[:, 0]] > sensor[pairs[:, 1]]
        pairs = np.where(swapped[:, None], pairs[:, ::-1], pairs)
        of_row = np.empty(len(rows), dtype=np.int64)
        found_conditions: dict[_Condition, int] = {}
        for condition, begin, end in conditions(rows):
            of_row[begin:end] = found_conditions.setdefault(condition, len(found_conditions))
        key = (of_row[pairs[:, 0]] * len(names) + sensor[pairs[:, 0]]) * len(names) + sensor[pairs[:, 1]]
        for number in np.unique(key).tolist():
            chosen = pairs[key == number]
            rest, second = divmod(number, len(names))
            which, first = divmod(rest, len(names))
            if self._fused_only and names[order[second]] != FUSED:
                continue
            condition = list(found_conditions)[which]
            self._paired.add(condition)
            views = AlignedPairs(
                key=self._key(condition, names[order[first]], names[order[second]]),
                views=rows.positions[chosen],
                at_s=(rows.tracker_time_ms[chosen[:, 0]] - self._began[condition]) / 1000.0,
            )
            parts = self._sums[views.key]
            parts.append(difference_sums(views))
            if len(parts) == _KEPT_PARTS:
                parts[:] = [added(parts)]

    def _key(self, condition: _Condition, first: str, second: str) -> ComparedViews:
        participant, placement, task = condition
        return ComparedViews(
            method=self._method,
            placement=self._numbers.placement(placement),
            task=self._numbers.task(task),
            participant=self._participant(participant),
            first=first,
            second=second,
        )

    def _participant(self, study_id: int) -> str:
        """Return the participant's code; the file's name where the file says none."""
        return self._path.name.partition(".")[0] if study_id == NOT_AVAILABLE else self._numbers.code(study_id)

    def _name(self, kinect: str) -> str:
        """Return a sensor's name; a number distinguishes two Kinects of one name."""
        if kinect not in self._names:
            name = sensor_name(kinect, STUDY_SENSORS)
            taken = name in self._names.values()
            self._names[kinect] = f"{name}-{len(self._names) + 1}" if taken else name
        return self._names[kinect]

    def results(self, fault: InputError | None, others: Iterable[DifferenceSums]) -> FileResults:
        """Return the file's results; ``fault`` is where the reading ended."""
        self._report(fault)
        counts = self._cleaner.counts
        counts[UNREADABLE] = len(self._bad_rows)
        counts[REPEATED], counts[SINGLETONS] = self._pairing.repeated, self._pairing.singletons
        return FileResults(
            file=self._path.name,
            rows=self.rows + len(self._bad_rows),
            used=self.used,
            joints=TOPOLOGY.joints,
            cleaning=self._cleaner.steps,
            findings=tuple(self._findings),
            summaries=by_key([*chain.from_iterable(self._sums.values()), *others]),
            origin=self._origin,
            whole=fault is None and not self._bad_rows,
        )

    def _report(self, fault: InputError | None) -> None:
        if self._bad_rows:
            count = len(self._bad_rows)
            more = f", and {count - 1} more rows" if count > 1 else ""
            self.tell(f"{_place(self._bad_rows[0])}{more}", "these rows are left out", count)
        if fault is not None:
            self.tell(_place(fault), f"the {self.rows} rows before are analysed" if self.rows else _LEFT_OUT)
        elif not self.rows and not self._bad_rows and self._participants is None:
            self.tell("has a header and no rows", _LEFT_OUT)
        if self._cleaner.in_cm:
            self.tell("positions are in cm, by the size of the bodies", "converted to m", self._cleaner.counts[METRES])
        people = sorted({condition[0] for condition in self._rows_of})
        if people == [NOT_AVAILABLE]:
            self.tell("says no participant", f"counted as participant {self._participant(NOT_AVAILABLE)}")
        elif len(people) > 1:
            listed = ", ".join(map(self._participant, people))
            self.tell(f"has several participants: {listed}", "each is analysed on their own")
        for condition in sorted(self._rows_of.keys() - self._paired):
            key = self._key(condition, "", "")
            what = f"no row of participant {key.participant}, {key.task}, {key.placement} has a partner"
            self.tell(what, "this task is left out", self._rows_of[condition])


def _place(error: InputError) -> str:
    """Return an error's text without the file's path."""
    parts = [] if error.row is None else [f"row {error.row}"]
    parts += [] if error.field is None else [error.field]
    parts += [] if error.value is None else [repr(error.value)[:40]]
    return ": ".join([*parts, error.problem])


def merge(
    files: Iterable[FileResults], findings: Iterable[StudyFinding] = (), order: StudyOrder | None = None
) -> StudyResults:
    """Join the results of a study's recordings, in any order; sums are the same to the bit.

    Args:
        files: results of the recordings.
        findings: faults of the whole study that are known before, such as files that were left out.
        order: of the study's tasks and placements.

    Raises:
        SettingsError: recordings have different joints.
    """
    in_order = tuple(sorted(files, key=lambda one: (one.file, [part.key for part in one.summaries])))
    joints = {one.joints for one in in_order}
    if len(joints) > 1:
        raise SettingsError("the recordings have different joints; analyse them one by one")
    found = [*findings, *_shared(in_order), *_missing(in_order)]
    return StudyResults(
        files=in_order,
        joints=joints.pop() if joints else TOPOLOGY.joints,
        summaries=by_key(part for one in in_order for part in one.summaries),
        strips=tuple(strip for one in in_order for strip in one.strips),
        measured=tuple(figure for one in in_order for figure in one.measured),
        findings=(*found, *(finding for one in in_order for finding in one.findings)),
        order=order or StudyOrder(),
    )


def check_participants(results: StudyResults, participants: Collection[str] | None) -> None:
    """Check that each of the chosen participants is in the results; None for all who are.

    Raises:
        SettingsError: one is not.
    """
    there = {part.key.participant for part in results.summaries}
    for unknown in sorted(set(participants or ()) - there):
        raise SettingsError(
            f"the study has no pair of views of participant {unknown!r}; without --participants all are analysed"
        )


def _shared(files: Sequence[FileResults]) -> Iterator[StudyFinding]:
    """Yield a finding for each participant and placement with a task that is in several files."""
    where: defaultdict[tuple[str, str, str, str], dict[int, str]] = defaultdict(dict)
    for number, one in enumerate(files):
        for part in one.summaries:
            key = part.key
            where[key.method, key.participant, key.placement, key.task][number] = one.file
    found: dict[tuple[str, str, tuple[str, ...]], dict[str, None]] = {}
    for (_, participant, placement, task), numbered in where.items():
        if len(numbered) > 1:
            found.setdefault((participant, placement, tuple(numbered.values())), {})[task] = None
    for (participant, placement, names), tasks in found.items():
        where_is = f"{', '.join(sorted(tasks))} in {len(names)} files: {', '.join(names)}"
        what = f"participant {participant}, {placement}: {where_is}"
        yield StudyFinding("", what, "merged, as in the thesis: all pairs count alike")


def _missing(files: Sequence[FileResults]) -> Iterator[StudyFinding]:
    """Yield a finding for each participant who lacks a placement where others did the same task."""
    done: defaultdict[str, defaultdict[str, set[str]]] = defaultdict(lambda: defaultdict(set))
    for part in (part for one in files for part in one.summaries):
        done[part.key.task][part.key.participant].add(part.key.placement)
    lacking: defaultdict[tuple[str, str], list[str]] = defaultdict(list)
    for task, placements_of in sorted(done.items()):
        everywhere = set().union(*placements_of.values())
        for participant, placements in placements_of.items():
            for placement in everywhere - placements:
                lacking[participant, placement].append(task)
    for (participant, placement), tasks in sorted(lacking.items()):
        what = f"participant {participant} has no {', '.join(tasks)} in placement {placement}"
        yield StudyFinding("", what, "the placement's means are those of the others")
