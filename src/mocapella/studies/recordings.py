"""Find a study's recordings, whatever their names, and read each as blocks of the study log's rows.

A kind of recording is one entry of `KINDS`. Another kind, such as a log in Parquet, is another entry: it needs to be
recognised, and to yield rows.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from mocapella.errors import DamagedTakeError, InputError
from mocapella.geometry import rigid
from mocapella.model.scene import Phase, Scene
from mocapella.model.session import Setup
from mocapella.model.study_log import YEAR_1_TO_1970_MS, StudyLog, StudyRow
from mocapella.recording.study_export import as_logged, reference_first, rows_of
from mocapella.recording.study_log import begins_study_log, study_log_blocks
from mocapella.studies.results import StudyFinding

LOGGED: Final = "stand-still"
"""Name of the method whose alignment a study log has: the thesis' own."""
LOGS: Final = "logs"
"""Folder of the logs of tasks, beside the takes that they were cut out of."""
FUSED: Final = "fused"
"""Name of the fused person among the compared views."""

_MS: Final = 1_000_000
_BLOCK_ROWS: Final = 1000
_LATER_PART: Final = re.compile(r"\.part\d+\.mcap$")


class RecordedRows(msgspec.Struct, frozen=True, eq=False):
    """A block of a recording's rows.

    Attributes:
        rows: the rows, in the file's order; a person's views and the fused person are in one space.
        method: tracking method that aligned the views.
        origin: what recorded it, with version and settings; empty if unknown.
    """

    rows: StudyLog
    method: str = LOGGED
    origin: dict[str, Any] = {}


Tell = Callable[[InputError], None]


class RecordingKind(msgspec.Struct, frozen=True):
    """A kind of recordings.

    Attributes:
        name: in messages.
        suffixes: ends of the files' names, in small letters.
        begins: whether a file is of this kind; raises InputError if it cannot be read.
        blocks: yields a file's rows; calls its second argument with the error of each row that is left out, and
            raises InputError where nothing more can be read.
    """

    name: str
    suffixes: tuple[str, ...]
    begins: Callable[[Path], bool]
    blocks: Callable[[Path, Tell], Iterator[RecordedRows]]


def _log_blocks(path: Path, tell: Tell) -> Iterator[RecordedRows]:
    return (RecordedRows(rows) for rows in study_log_blocks(path, tell))


def _take_blocks(path: Path, tell: Tell) -> Iterator[RecordedRows]:
    """Yield the views and fused persons of a take's results, as rows.

    Scenes in another phase than *tracking* are left out, as are views and persons without a joint. Rows are in the
    camera space of the take's first sensor, where it sees the person, with the sensors' own left and right labels.
    """
    from mocapella.recording.take_reader import read_take

    take = read_take(path)
    reference = min(take.sensors, default="")
    for run in take.runs:
        setup = run.info.setup
        wall_ms = (run.info.started_unix_ns - run.info.started_ns) // _MS + YEAR_1_TO_1970_MS
        origin = {"version": run.info.version, "method": setup.method, "settings": run.info.method_settings}
        rows: list[StudyRow] = []
        for _, scene in take.scenes(run.number):
            rows += _rows_of_scene(scene, setup, reference, wall_ms + scene.at_ns // _MS)
            if len(rows) >= _BLOCK_ROWS:
                yield RecordedRows(_log_of(str(path), rows), setup.method, origin)
                rows = []
        if rows:
            yield RecordedRows(_log_of(str(path), rows), setup.method, origin)
    if take.damaged:
        raise DamagedTakeError("; ".join(take.problems), file=path, fix="mocapella take recover makes a clean copy")


def _rows_of_scene(scene: Scene, setup: Setup, reference: str, tracker_time_ms: int) -> list[StudyRow]:
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
    return rows


def _log_of(source: str, rows: list[StudyRow]) -> StudyLog:
    return StudyLog(
        source, **{name: np.array([getattr(row, name) for row in rows]) for name in StudyRow.__struct_fields__}
    )


def _is_take(path: Path) -> bool:
    return _LATER_PART.search(path.name) is None


KINDS: Final = (
    RecordingKind("study log", (".csv", ".csv.gz"), begins_study_log, _log_blocks),
    RecordingKind("take", (".mcap",), _is_take, _take_blocks),
)


class FoundRecordings(msgspec.Struct, frozen=True):
    """The recordings of a folder.

    Attributes:
        paths: their files, sorted by name, then by folder; also unreadable files.
        findings: tables that are none.
    """

    paths: tuple[Path, ...]
    findings: tuple[StudyFinding, ...]


def kind_of(path: Path) -> RecordingKind | None:
    """Return the kind of a recording by its name and beginning; None for other files.

    Raises:
        InputError: the file cannot be read.
    """
    kinds = [kind for kind in KINDS if path.name.lower().endswith(kind.suffixes)]
    return next((kind for kind in kinds if kind.begins(path)), None)


def find_recordings(folder: Path) -> FoundRecordings:
    """Find all recordings below a folder; hidden files and folders are skipped, and links to folders.

    A take is left out where the folder `LOGS` beside it has the logs of its tasks (`mocapella.studies.task_log`).

    Raises:
        InputError: there is no such folder, or no recording in it.
    """
    if not folder.is_dir():
        raise InputError("there is no such folder", file=folder, fix="name the folder of the study's recordings")
    paths, others = [], []
    for path in _files(folder):
        if _may_be_one(path):
            paths.append(path)
        elif path.name.lower().endswith((".csv", ".csv.gz")):
            others.append(path.name)
    if not paths:
        names = ", ".join(suffix for kind in KINDS for suffix in kind.suffixes)
        raise InputError("has no recordings", file=folder, fix=f"study logs and takes end with {names}")
    logged = {path.parent.parent for path in paths if path.parent.name == LOGS}
    cut_up = [path for path in paths if path.suffix == ".mcap" and path.parent in logged]
    findings = []
    if cut_up:
        what = f"{len(cut_up)} takes have logs of their tasks"
        findings.append(StudyFinding("", what, "the logs are analysed, which only have running tasks"))
        paths = [path for path in paths if path not in cut_up]
    if others:
        some = ", ".join(sorted(others)[:3]) + (", …" if len(others) > 3 else "")
        one = len(others) == 1
        what = f"{len(others)} table{'' if one else 's'} {'is no study log' if one else 'are no study logs'}: {some}"
        findings.append(StudyFinding("", what, "left out"))
    return FoundRecordings(tuple(sorted(paths, key=lambda path: (path.name, path))), tuple(findings))


def _may_be_one(path: Path) -> bool:
    try:
        return kind_of(path) is not None
    except InputError:
        return True


def _files(folder: Path) -> Iterator[Path]:
    for where, folders, names in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        yield from (Path(where) / name for name in sorted(names) if not name.startswith("."))
