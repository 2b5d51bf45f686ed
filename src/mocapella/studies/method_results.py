"""All that methods and measures find in one study log: aligned views, figures, skeletons for pictures, and faults."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec

from mocapella.errors import MocapellaError, visible
from mocapella.evaluation.study_pairs import StudySession
from mocapella.model.study_log import StudyLog
from mocapella.studies.measures.measure import INTERACTIONS, MEASURES, OBSTACLE, Measure
from mocapella.studies.method_views import MethodViews, TrackedRecording
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


def results_of_methods(log: StudyLog, methods: Sequence[str], measures: Sequence[str] | None = None) -> MethodResults:
    """Track a study log with each method, and apply measures to its tasks.

    A method or measure that fails is named in ``findings``; the others go on.

    Args:
        log: the study log, of one participant and at most two sensors.
        methods: names, optionally with settings, such as ``default:people.smoothing=kalman``.
        measures: names of measures; None for all that are registered.

    Raises:
        InputError: the log cannot be replayed.
        SettingsError, PluginError: a measure is unknown or cannot be used.
    """
    chosen = list(MEASURES.values()) if measures is None else [MEASURES.find(name) for name in measures]
    file = Path(log.source).name
    session = StudySession(log)
    views: list[MethodViews] = []
    measured: list[MeasuredFigure] = []
    strips: list[PoseStrip] = []
    findings: list[StudyFinding] = []
    for method in methods:
        try:
            recording = TrackedRecording(session, method)
            pairs = recording.pairs()
            tasks = list(recording.tasks(hide=any(one.hides for one in chosen)))
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
            for measure in chosen:
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
