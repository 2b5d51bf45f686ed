"""Rows of a take for the analysis: its sensors' views and its fused people, named by its labels or its tasks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from mocapella.conventions import NOT_AVAILABLE
from mocapella.errors import DamagedTakeError, MocapellaError
from mocapella.evaluation.study_pairs import PLACEMENT_NAMES
from mocapella.geometry import rigid
from mocapella.model.scene import Phase, Scene
from mocapella.model.session import PLACEMENTS, SCENARIOS, Setup
from mocapella.model.study_log import YEAR_1_TO_1970_MS, StudyLog, StudyRow
from mocapella.recording.study_export import as_logged, reference_first, rows_of
from mocapella.recording.take import Run
from mocapella.recording.take_reader import Take, read_take
from mocapella.studies.naming import RecordingNames, shown
from mocapella.studies.participants import number_of
from mocapella.studies.pooled_tasks import FUSED
from mocapella.studies.protocol import PlannedTask
from mocapella.studies.recordings import RecordedRows
from mocapella.studies.state_file import load_session
from mocapella.studies.study_folder import LOGS, SESSION
from mocapella.studies.task_log import task_scenes
from mocapella.studies.task_runs import TaskRun, valid_runs

OWN_NUMBER: Final = 1 << 40
"""First number of tasks and placements that have a name and no number."""
_MS: Final = 1_000_000
_BLOCK_ROWS: Final = 1000


class _Labels(msgspec.Struct, frozen=True):
    """Participant, placement and task of a row, as numbers."""

    participant: int
    placement: int
    task: int


def take_rows(path: Path) -> Iterator[RecordedRows]:
    """Yield the views and fused people of a take's results, as rows.

    Results in another phase than *tracking* are left out, as are views and persons without a joint. Rows are in the
    camera space of the take's first sensor, where it sees the person, with the sensors' own left and right labels.

    The names of a row are the labels of its run. Of a take beside a study's session, the results of the running tasks
    alone are yielded, named by the session.

    Raises:
        InputError: the take cannot be read; the rows before have been yielded.
    """
    take = read_take(path)
    runs, fused_only = _tasks(path), _has_logs(path)
    if runs is None:
        names, labels = _names_of_labels(take)
        scenes = (
            (run, labels[run.number], scene.at_ns + _wall_ns(run), scene)
            for run in take.runs
            for _, scene in take.scenes(run.number)
        )
    else:
        names, labels = _names_of_tasks(runs)
        scenes = (
            (own, labels[run.index], log_unix_ns, scene)
            for run, _ in runs
            for own, _, log_unix_ns, scene in task_scenes(take, run)
        )
    yield from _blocks(take, scenes, names, fused_only=fused_only)
    if take.damaged:
        raise DamagedTakeError("; ".join(take.problems), file=path, fix="mocapella take recover makes a clean copy")


def _has_logs(path: Path) -> bool:
    logs = path.parent / LOGS
    return logs.is_dir() and any(logs.iterdir())


def _tasks(path: Path) -> list[tuple[TaskRun, PlannedTask]] | None:
    """Return the analysed attempts of the session beside a take; None if there is no session."""
    session = path.parent / SESSION
    try:
        saved = load_session(session) if session.is_file() else None
    except MocapellaError:  # the analysis names it
        return None
    return None if saved is None else [(run, saved.state.plan[run.index]) for run in valid_runs(saved.events)]


def _names_of_tasks(runs: Sequence[tuple[TaskRun, PlannedTask]]) -> tuple[RecordingNames, dict[int, _Labels]]:
    """Return names, and the numbers of each attempt by its place in the plan: each repetition has its own time."""
    labels = {
        run.index: _Labels(number_of(run.participant), planned.placement.number, OWN_NUMBER + run.index)
        for run, planned in runs
    }
    names = RecordingNames(
        {number_of(run.participant): run.participant for run, _ in runs},
        {planned.placement.number: shown(planned.placement) for _, planned in runs},
        {OWN_NUMBER + run.index: run.task for run, _ in runs},
    )
    return names, labels


def _names_of_labels(take: Take) -> tuple[RecordingNames, dict[int, _Labels]]:
    """Return names, and the numbers of each run."""
    setups = {run.number: run.info.setup for run in take.runs}
    placements = _numbered((setup.placement for setup in setups.values()), PLACEMENTS)
    tasks = _numbered((setup.scenario for setup in setups.values()), SCENARIOS)
    labels = {
        number: _Labels(setup.participant, placements[setup.placement], tasks[setup.scenario])
        for number, setup in setups.items()
    }
    own = {number: PLACEMENT_NAMES.get(name, name) for name, number in placements.items() if number >= OWN_NUMBER}
    return RecordingNames({}, own, {number: name for name, number in tasks.items() if number >= OWN_NUMBER}), labels


def _numbered(names: Iterator[str], known: dict[str, int]) -> dict[str, int]:
    """Return a number of each name; an empty one is not available."""
    distinct = dict.fromkeys(names)
    return {name: known.get(name, OWN_NUMBER + place) if name else NOT_AVAILABLE for place, name in enumerate(distinct)}


def _wall_ns(run: Run) -> int:
    return run.info.started_unix_ns - run.info.started_ns


def _blocks(
    take: Take, scenes: Iterator[tuple[Run, _Labels, int, Scene]], names: RecordingNames, *, fused_only: bool
) -> Iterator[RecordedRows]:
    reference = min(take.sensors, default="")
    rows: list[StudyRow] = []
    last: Run | None = None

    def block(run: Run) -> RecordedRows:
        setup = run.info.setup
        origin = {"version": run.info.version, "method": setup.method, "settings": run.info.method_settings}
        return RecordedRows(_log_of(str(take.path), rows), setup.method, origin, names, fused_only)

    for run, labels, unix_ns, scene in scenes:
        if last is not None and rows and (last.number != run.number or len(rows) >= _BLOCK_ROWS):
            yield block(last)
            rows = []
        last = run
        rows += _rows_of_scene(scene, run.info.setup, labels, reference, unix_ns // _MS + YEAR_1_TO_1970_MS)
    if last is not None and rows:
        yield block(last)


def _rows_of_scene(scene: Scene, setup: Setup, labels: _Labels, reference: str, tracker_time_ms: int) -> list[StudyRow]:
    if scene.state.phase != Phase.TRACKING:
        return []
    rows = rows_of(scene, setup=setup, reference=reference or None, tracker_time_ms=tracker_time_ms)
    for person in scene.people:
        if not person.views:
            continue
        views = reference_first(person, reference)
        positions = rigid.apply(rigid.inverse(views[0].T_world_sensor), person.positions)
        own = next(row for row in rows if row.person_id == person.id)
        rows.append(
            msgspec.structs.replace(
                own,
                skeleton_id=len(views),
                kinect_id=FUSED,
                positions=as_logged(positions, scene.topology),
            )
        )
    numbers = {
        "study_id": labels.participant, "kinect_config": labels.placement, "scenario_id": labels.task
    }  # fmt: skip
    return [msgspec.structs.replace(row, **numbers) for row in rows]


def _log_of(source: str, rows: list[StudyRow]) -> StudyLog:
    return StudyLog(
        source, **{name: np.array([getattr(row, name) for row in rows]) for name in StudyRow.__struct_fields__}
    )
