"""Analyse the recordings of a study with several methods and measures, on an engine, and write all results."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Final, TypeVar

import msgspec
import numpy as np

from mocapella.errors import MocapellaError
from mocapella.evaluation.methods import AS_LOGGED, scored_tracker
from mocapella.model.topology import topology
from mocapella.studies.analysis import analyze_file
from mocapella.studies.differences import AlignedPairs, difference_sums
from mocapella.studies.engines import Failed, run_each
from mocapella.studies.measures.measure import INTERACTIONS, OBSTACLE
from mocapella.studies.method_results import results_of_methods
from mocapella.studies.method_views import MethodViews
from mocapella.studies.naming import RecordingNames, StudyNames
from mocapella.studies.recordings import whole_log
from mocapella.studies.results import (
    ComparedViews,
    DifferenceSums,
    FileResults,
    MeasuredFigure,
    PoseStrip,
    StudyFinding,
    StudyResults,
)
from mocapella.studies.tables import StudyTable, TableColumn

RECORDED: Final = (AS_LOGGED,)
"""Methods of an analysis that names none: the logged rows alone."""


def check_methods(methods: Sequence[str]) -> None:
    """Check names and settings of methods before the first recording is read.

    Raises:
        SettingsError: a method or setting is unknown, or cannot be scored.
    """
    for method in methods:
        if method != AS_LOGGED:
            scored_tracker(method)


def analyze_recordings(
    paths: Sequence[Path],
    *,
    participants: Collection[str] | None = None,
    methods: Sequence[str] = RECORDED,
    engine: str = "local",
    names: StudyNames | None = None,
    on_done: Callable[[str], None] = lambda name: None,
) -> list[FileResults]:
    """Analyse recordings, each by itself, and return their results in the order of the paths.

    The results are the same to the bit on all engines. A recording that cannot be analysed becomes a finding.

    Args:
        paths: study logs and takes.
        participants: codes of the analysed participants; recordings of others give no result. None for all.
        methods: methods whose alignment is scored; the logged rows always are.
        engine: as in `mocapella.studies.engines`.
        names: of the study's tasks, placements and codes; None without a study's folder.
        on_done: called with the name of each file that is done.

    Raises:
        SettingsError, EngineError: the engine is unknown, or cannot be used.
    """
    chosen = None if participants is None else tuple(participants)
    function = partial(analyze_recording, participants=chosen, methods=tuple(methods), names=names)
    found = run_each(function, list(paths), engine, lambda index, result: on_done(paths[index].name))
    results = [_left_out(path, one) if isinstance(one, Failed) else one for path, one in zip(paths, found, strict=True)]
    return [one for one in results if participants is None or one.rows or one.findings]


def analyze_recording(
    path: Path, *, participants: Collection[str] | None, methods: Sequence[str], names: StudyNames | None = None
) -> FileResults:
    """Analyse one recording: its logged rows, its rows by other methods, and the measures of its tasks.

    Args:
        path: a study log or a take; methods and measures apply to study logs only.
        participants, methods, names: as in `analyze_recordings`.
    """
    numbers = names.of(path) if names is not None else RecordingNames()
    found = analyze_file(path, participants=participants, names=numbers)
    recorded = sorted((_recorded_apart(one, methods) for one in found.summaries), key=lambda one: one.key)
    found = msgspec.structs.replace(found, summaries=tuple(recorded))
    tasks = {one.key.task for one in found.summaries}
    measured = not tasks.isdisjoint((*OBSTACLE, *INTERACTIONS))
    if not tasks or (set(methods) <= set(RECORDED) and not measured):
        return found
    try:
        log = whole_log(path)
        if log is None:
            return found
        every = list(dict.fromkeys((AS_LOGGED, *methods)))
        own = results_of_methods(log, every, names=numbers, participants=participants)
    except MocapellaError as error:
        what = f"methods and measures cannot use it: {error}"
        return msgspec.structs.replace(
            found, findings=(*found.findings, StudyFinding(path.name, what, "only the recorded views are analysed"))
        )
    sums = [sums for views in own.views if views.method != AS_LOGGED for sums in sums_of_method(views)]
    logged = _recorded_name(numbers.method or AS_LOGGED, methods)
    return msgspec.structs.replace(
        found,
        findings=(*found.findings, *own.findings),
        summaries=tuple(sorted((*found.summaries, *sums), key=lambda one: one.key)),
        strips=tuple(_by(one, logged) for one in own.strips),
        measured=tuple(_by(one, logged) for one in own.measured),
    )


Tracked = TypeVar("Tracked", PoseStrip, MeasuredFigure)


def _by(one: Tracked, logged: str) -> Tracked:
    """Return a strip or figure of logged rows as that of the method which they were recorded with."""
    return msgspec.structs.replace(one, method=logged) if one.method == AS_LOGGED else one


def _recorded_name(method: str, methods: Sequence[str]) -> str:
    """Return the name of a method's recorded views; the same method may also track the log again."""
    return f"recorded-{method}" if method != AS_LOGGED and method in methods else method


def _recorded_apart(sums: DifferenceSums, methods: Sequence[str]) -> DifferenceSums:
    name = _recorded_name(sums.key.method, methods)
    return (
        sums
        if name == sums.key.method
        else msgspec.structs.replace(sums, key=msgspec.structs.replace(sums.key, method=name))
    )


def sums_of_method(views: MethodViews) -> Iterator[DifferenceSums]:
    """Yield the sums of differences of a method's aligned pairs, by task and sensors in the order of their names."""
    names = np.array(views.sensors)[views.sensor]
    swapped = names[:, 0] > names[:, 1]
    pairs = np.where(swapped[:, None, None, None], views.views[:, ::-1], views.views)
    names = np.where(swapped[:, None], names[:, ::-1], names)
    keys = np.column_stack([views.task, names])
    for task, first, second in np.unique(keys, axis=0).tolist():
        chosen = (keys == (task, first, second)).all(axis=1)
        began = views.at_s[views.task == task].min()
        key = ComparedViews(views.method, views.placement, task, views.participant, first, second)
        yield difference_sums(AlignedPairs(key, pairs[chosen], views.at_s[chosen] - began))


def measured_tables(results: StudyResults) -> tuple[StudyTable, ...]:
    """Return the table of the figures of measures; none if there are no figures."""
    if not results.measured:
        return ()
    names = ("Measure", "Figure", "Unit", "Method", "Placement", "Task", "Participant", "Of")
    columns = (*map(TableColumn, names), TableColumn("Value"), TableColumn("Samples", digits=0))
    rows = tuple(
        (one.measure, one.quantity, one.unit, one.method, one.placement, one.task, one.participant, one.subject,
         one.value, one.samples)
        for one in results.measured
    )  # fmt: skip
    note = "docs/studies-methods.md says how each figure is measured; a dash is unknown."
    return (StudyTable("measured", "Figures of obstacle and interaction tasks", columns, rows, (note,)),)


def _left_out(path: Path, failed: Failed) -> FileResults:
    finding = StudyFinding(path.name, failed.problem, "the file is left out")
    joints = topology("kinect_v2").joints
    return FileResults(path.name, 0, 0, joints, (), (finding,), whole=False)
