"""All that methods and measures find in one study log: aligned views, figures, skeletons for pictures, and faults."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

import msgspec

from mocapella.errors import MocapellaError, visible
from mocapella.evaluation.study_pairs import StudySession
from mocapella.model.study_log import StudyLog
from mocapella.studies.log_sessions import sessions_of_log
from mocapella.studies.measures.measure import INTERACTIONS, MEASURES, OBSTACLE, Measure
from mocapella.studies.method_views import MethodViews, TrackedRecording
from mocapella.studies.naming import RecordingNames
from mocapella.studies.pose_strips import pose_strip
from mocapella.studies.results import MeasuredFigure, PoseStrip, StudyFinding
from mocapella.studies.task_views import TaskViews


class MethodResults(msgspec.Struct, frozen=True, eq=False):
    """What methods and measures find in one recording.

    Attributes:
        views: the aligned pairs, of each method that could be used.
        measured: figures of the measures.
        strips: skeletons of obstacle and interaction tasks.
        findings: methods and measures that could not be used, and views that cannot be compared.
    """

    views: tuple[MethodViews, ...] = ()
    measured: tuple[MeasuredFigure, ...] = ()
    strips: tuple[PoseStrip, ...] = ()
    findings: tuple[StudyFinding, ...] = ()


def results_of_methods(
    log: StudyLog,
    methods: Sequence[str],
    measures: Sequence[str] | None = None,
    *,
    names: RecordingNames | None = None,
    participants: Collection[str] | None = None,
) -> MethodResults:
    """Track a study log with each method, and apply measures to its tasks.

    Each participant with each placement is tracked alone. A method or measure that fails is named in ``findings``, as
    is one of several participants or placements that cannot be replayed; the others go on.

    Args:
        log: the study log.
        methods: names, optionally with settings, such as ``default:people.smoothing=kalman``.
        measures: names of measures; None for all that are registered.
        names: of the log's numbers; None for the thesis' names.
        participants: codes of the chosen participants; None for all.

    Raises:
        InputError: the log has one participant with one placement, and cannot be replayed.
        SettingsError, PluginError: a measure is unknown or cannot be used.
    """
    chosen = list(MEASURES.values()) if measures is None else [MEASURES.find(name) for name in measures]
    numbers = names or RecordingNames()
    parts = list(sessions_of_log(log))
    found = []
    for part in parts:
        code, placement = numbers.code(part.participant), numbers.placement(part.placement)
        if participants is not None and code not in participants:
            continue
        try:
            session = StudySession(part.log, by_angle=part.by_angle)
        except MocapellaError as error:
            if len(parts) == 1:
                raise
            what = f"participant {code}, {placement}: methods and measures cannot use it: {error}"
            finding = StudyFinding(Path(log.source).name, what, "only the recorded views are analysed")
            found.append(MethodResults(findings=(finding,)))
            continue
        if part.left_out:
            what = f"participant {code}, {placement}: results with another reference sensor"
            finding = StudyFinding(Path(log.source).name, what, "methods and measures leave them out", part.left_out)
            found.append(MethodResults(findings=(finding,)))
        found.append(_results_of_session(session, methods, chosen, numbers))
    return MethodResults(
        *(tuple(one for each in found for one in getattr(each, field)) for field in MethodResults.__struct_fields__)
    )


def _results_of_session(
    session: StudySession, methods: Sequence[str], measures: Sequence[Measure], names: RecordingNames
) -> MethodResults:
    file = session.name
    views: list[MethodViews] = []
    measured: list[MeasuredFigure] = []
    strips: list[PoseStrip] = []
    findings: list[StudyFinding] = []
    for method in methods:
        try:
            recording = TrackedRecording(session, method, names)
            pairs = recording.pairs()
            tasks = list(recording.tasks(hide=any(one.hides for one in measures)))
        except MocapellaError as error:
            findings.append(StudyFinding(file, f"method {method}: {error}", "the method is left out for this file"))
            continue
        views.append(pairs)
        findings += [
            StudyFinding(
                file,
                f"method {method}, {task}: {problem}",
                "its differences cannot be compared with other methods'",
                int((pairs.unaligned & (pairs.task == task)).sum()),
            )
            for task, problem in pairs.problems.items()
        ]
        for task in tasks:
            for measure in measures:
                if measure.measures(task.task):
                    figures, fault = measure_task(measure, task)
                    measured += figures
                    findings += [StudyFinding(file, fault, "its figures of this task are left out")] if fault else []
            if task.task in (*OBSTACLE, *INTERACTIONS):
                strips += [pose_strip(task, person) for person in task.people]
    return MethodResults(tuple(views), tuple(measured), tuple(strips), tuple(findings))


def measure_task(measure: Measure, task: TaskViews) -> tuple[tuple[MeasuredFigure, ...], str]:
    """Apply a measure to a task.

    Returns:
        Its figures and an empty text, or no figures and its fault in one line: an error that it raised, or figures that
        its descriptor does not have.
    """
    try:
        figures = tuple(measure.find(task))
    except Exception as error:  # noqa: BLE001 - a plug-in may raise anything
        return (), _fault(measure, task, f"{type(error).__name__}: {error}".partition("\n")[0])
    for figure in figures:
        if not isinstance(figure, MeasuredFigure):
            return (), _fault(measure, task, f"returned a {type(figure).__name__}, not a MeasuredFigure")
        if figure.measure != measure.name or measure.quantities.get(figure.quantity) != figure.unit:
            return (), _fault(
                measure, task, f"{figure.measure}, {figure.quantity} [{figure.unit}] is not one of its quantities"
            )
    return figures, ""


def _fault(measure: Measure, task: TaskViews, what: str) -> str:
    package = MEASURES.package(measure.name)
    return visible(f"measure {measure.name}{f' of {package}' if package else ''}, {task.task}: {what}")
