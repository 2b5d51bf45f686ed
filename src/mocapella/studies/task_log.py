"""Logs of a participant's tasks, cut out of the takes: the thesis' 87 columns, fused people, and events.

The take is the complete record. A task's files begin with the same name, such as ``logs/003-parallel-walk-1``:

    .csv.gz           the study log (docs/study-log.md)
    .people.parquet   fused people: the table of `mocapella export parquet`
    .events.parquet   the task's events
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import DamagedTakeError, RecordingError, WireError
from mocapella.exports.needs import needed
from mocapella.exports.new_file import new_file
from mocapella.exports.trajectory_tables import write_parquet
from mocapella.model.scene import Phase, Scene
from mocapella.model.study_log import YEAR_1_TO_1970_MS, StudyRow
from mocapella.model.trajectories import trajectories_of
from mocapella.recording.study_export import rows_of
from mocapella.recording.study_log import write_study_log
from mocapella.recording.take import Run
from mocapella.recording.take_reader import Take, read_take
from mocapella.recording.take_refs import AT_NS, LOG_NS, RUN
from mocapella.schema import decode_scene
from mocapella.studies.participants import number_of
from mocapella.studies.progress import NOTHING_TRACKED, StudyEvent
from mocapella.studies.state_file import SavedSession, load_session
from mocapella.studies.study_folder import LOGS, SESSION, StudyFolder, add_files
from mocapella.studies.task_runs import TaskRun, valid_runs

_PARTS: Final = ".part"
"""In names of later files of an interrupted take, which are read with its first one."""


class TaskLog(msgspec.Struct, frozen=True):
    """The log of one task, as written.

    Attributes:
        run: the attempt that it is of.
        take: name of the take that it was cut out of; empty if no take has results of the task.
        results: number of results with tracked people.
        rows: number of rows of the study log.
        files: the files; empty if they were there already, or there is nothing to write.
        empty: whether no result of the task has a tracked person; there is no study log of it then, only its events.
    """

    run: TaskRun
    take: str
    results: int
    rows: int
    files: tuple[Path, ...] = ()
    empty: bool = False


def write_logs(study: StudyFolder, code: str, *, by: str, at: datetime) -> tuple[TaskLog, ...]:
    """Write the logs of a participant's finished tasks that have none, and add takes, session and logs to the manifest.

    Args:
        study: the study.
        code: the participant's code.
        by: code of the operator.
        at: time of now.

    Returns:
        One for each finished task and each take with results of it, and one without a take for a task without any. The
        manifest has a task's events without a study log, with a remark, if no person was tracked in it.

    Raises:
        SettingsError: the study has no such participant, or polars is not installed.
        InputError, DamagedTakeError: the session or a take cannot be read.
        TakeExistsError, DiskFullError, RecordingError: a file cannot be written.
    """
    needed("polars", extra="studies")
    folder = study.participant(code)
    session = load_session(folder / SESSION)
    if session.state.participant != code:
        raise RecordingError(f"{folder / SESSION} is of another participant; restore it from a copy")
    paths = [path for path in sorted(folder.glob("*.mcap")) if _PARTS not in path.name]
    takes = [read_take(path) for path in paths]
    logs = folder / LOGS
    logs.mkdir(mode=0o700, exist_ok=True)
    written: list[TaskLog] = []
    for run in valid_runs(session.events):
        found = [take for take in takes if len(_numbers(take, run))]
        written += [
            _write(take, run, session, logs / (_name(run) + (f"-part{number}" if number > 1 else "")))
            for number, take in enumerate(found, 1)
        ]
        if not found:
            written.append(_without_results(run, "", session, logs / _name(run)))
    add_files(study, [*sorted(folder.glob("*.mcap")), folder / SESSION], by=by, at=at)
    methods = sorted({run.info.method for take in takes for run in take.runs})
    for empty, remark in ((False, {}), (True, {"problem": NOTHING_TRACKED})):
        made = [file for log in written if log.empty == empty for file in log.files]
        add_files(study, made, by=by, at=at, settings={"methods": methods, **remark})
    return tuple(written)


def write_task_log(take: Take, run: TaskRun, session: SavedSession, base: Path) -> TaskLog:
    """Write the three files of one task.

    Each file appears complete or not at all; the study log appears last, so that a task with a study log is whole.

    Args:
        take: the take, of the time of the task.
        run: the task's attempt; only results captured in its running parts are written.
        session: the session, for the placement's number and the events.
        base: path of the files without their endings.

    Raises:
        TakeExistsError: a file exists.
        SettingsError: polars is not installed.
        DamagedTakeError: a result of the take cannot be read.
        DiskFullError, RecordingError: a file cannot be written.
    """
    numbers = {one.placement.name: one.placement.number for one in session.state.plan}
    labels = {"participant": run.participant, "placement": run.placement, "scenario": run.task}
    people = trajectories_of(
        ((number.number, unix_ns, _without_names(scene)) for number, unix_ns, _, scene in task_scenes(take, run)),
        ("people",),
    ).get("people")
    results = [
        found
        for _, _, log_unix_ns, scene in task_scenes(take, run)
        if (found := list(_rows_of_task(scene, take, run, numbers, log_unix_ns)))
    ]
    if people is None or not results:  # no person was there, or the tracker was calibrating
        return _without_results(run, take.path.name, session, base)
    named = replace(people, labels={number.number: labels for number in take.runs})
    csv, tables = _with(base, ".csv.gz"), (_with(base, ".people.parquet"), _with(base, ".events.parquet"))
    for half in tables:
        half.unlink(missing_ok=True)  # of a run that was interrupted before the study log
    with new_file(tables[0]) as part:
        write_parquet(named, part)
    with new_file(tables[1]) as part:
        write_events([event for event in session.events if _is_of(event, run)], part)
    rows = write_study_log(csv, (row for found in results for row in found))
    return TaskLog(run, take.path.name, len(results), rows, (csv, *tables))


def task_scenes(take: Take, run: TaskRun) -> Iterator[tuple[Run, int, int, Scene]]:
    """Yield (run, unix_ns, log_unix_ns, scene) of the take's results that were captured while a task was running.

    ``unix_ns`` is the capture time and ``log_unix_ns`` the time of the result, both since 1970.

    Raises:
        DamagedTakeError: a result cannot be read.
    """
    table, runs = take.scene_table, {one.number: one for one in take.runs}
    for numbers, data, begins, lengths in take.scene_blocks(_numbers(take, run)):
        for number, begin, length in zip(numbers.tolist(), begins.tolist(), lengths.tolist(), strict=True):
            own = runs[int(table[number, RUN])]
            wall_ns = own.info.started_unix_ns - own.info.started_ns
            try:
                scene = decode_scene(data[begin : begin + length])
            except WireError as error:
                raise DamagedTakeError(f"result {number} cannot be read: {error}", file=take.path) from error
            yield own, int(table[number, AT_NS]) + wall_ns, int(table[number, LOG_NS]) + wall_ns, scene


def write_events(events: Sequence[StudyEvent], path: Path) -> None:
    """Write events as Parquet: a row for each, with the fields of `StudyEvent`.

    Raises:
        SettingsError: polars is not installed; names the extra.
        OSError: the file cannot be written.
    """
    polars = needed("polars", extra="studies")
    fields = msgspec.structs.fields(StudyEvent)
    kinds = {field.name: polars.Int64 if field.type is int else polars.String for field in fields}
    columns = {name: [getattr(event, name) for event in events] for name in kinds}
    polars.DataFrame(columns, schema=kinds).write_parquet(path, compression="zstd")


def _without_results(run: TaskRun, take: str, session: SavedSession, base: Path) -> TaskLog:
    """Write the events of a task without a tracked person."""
    file = _with(base, ".events.parquet")
    if file.exists():
        return TaskLog(run, take, 0, 0, empty=True)
    with new_file(file) as part:
        write_events([event for event in session.events if _is_of(event, run)], part)
    return TaskLog(run, take, 0, 0, (file,), empty=True)


def _write(take: Take, run: TaskRun, session: SavedSession, base: Path) -> TaskLog:
    if _with(base, ".csv.gz").exists():
        return TaskLog(run, take.path.name, 0, 0)
    return write_task_log(take, run, session, base)


def _rows_of_task(
    scene: Scene, take: Take, run: TaskRun, placements: Mapping[str, int], log_unix_ns: int
) -> Iterator[StudyRow]:
    """Yield a result's rows of the study log; none while the tracker is calibrating."""
    if scene.state.phase != Phase.TRACKING:
        return
    time_ms = log_unix_ns // 1_000_000 + YEAR_1_TO_1970_MS
    labels: dict[str, Any] = {
        "study_id": number_of(run.participant),
        "kinect_config": placements[run.placement],
        "scenario_id": run.scenario,
    }
    reference = min(take.sensors, default=None)
    for row in rows_of(scene, setup=take.info.setup, reference=reference, tracker_time_ms=time_ms, fixed=True):
        yield msgspec.structs.replace(row, **labels)


def _without_names(scene: Scene) -> Scene:
    """Return a scene whose people have numbers only: a name that was given in the view stays in the take."""
    people = tuple(msgspec.structs.replace(person, name="") for person in scene.people)
    return msgspec.structs.replace(scene, parts={**scene.parts, "people": people})


def _numbers(take: Take, run: TaskRun) -> NDArray[np.int64]:
    """Return the numbers of a take's results that were captured while a task was running."""
    table = take.scene_table
    walls = {one.number: one.info.started_unix_ns - one.info.started_ns for one in take.runs}
    chosen = np.zeros(len(table), bool)
    for number, wall_ns in walls.items():
        unix_ns = table[:, AT_NS] + wall_ns
        for first, last in run.spans:
            chosen |= (table[:, RUN] == number) & (unix_ns >= first) & (unix_ns < last)
    return np.flatnonzero(chosen)


def _is_of(event: StudyEvent, run: TaskRun) -> bool:
    return (event.index, event.attempt) == (run.index, run.attempt)


def _name(run: TaskRun) -> str:
    return f"{run.index + 1:03}-{run.placement}-{run.task}-{run.repetition}"


def _with(base: Path, ending: str) -> Path:
    return base.with_name(base.name + ending)
