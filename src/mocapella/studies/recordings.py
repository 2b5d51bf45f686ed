"""Find a study's recordings, whatever their names, and read each as blocks of the study log's rows.

A kind of recording is one entry of `KINDS`. Another kind is another entry: it needs to be recognised, and to yield
rows.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import msgspec

from mocapella.errors import InputError, SettingsError
from mocapella.model.names import plural
from mocapella.model.study_log import StudyLog
from mocapella.recording.study_log import begins_study_log, joined_blocks, study_log_blocks
from mocapella.studies.naming import RecordingNames
from mocapella.studies.parquet_log import SUFFIX, begins_parquet_log, parquet_log_blocks
from mocapella.studies.results import StudyFinding
from mocapella.studies.study_folder import LOGS

LOGGED: Final = "stand-still"
"""Name of the method whose alignment a study log has: the thesis' own."""
_TEXTS: Final = (".csv", ".csv.gz")
_LATER_PART: Final = re.compile(r"\.part\d+\.mcap$")


class RecordedRows(msgspec.Struct, frozen=True, eq=False):
    """A block of a recording's rows.

    Attributes:
        rows: the rows, in the file's order; a person's views and the fused person are in one space.
        method: tracking method that aligned the views.
        origin: what recorded it, with version and settings; empty if unknown.
        names: of the rows' numbers; None if these are the study log's.
        fused_only: whether only the fused person is compared, because the logs of the tasks have the pairs of sensors.
    """

    rows: StudyLog
    method: str = LOGGED
    origin: dict[str, Any] = {}
    names: RecordingNames | None = None
    fused_only: bool = False


Tell = Callable[[InputError], None]


class RecordingKind(msgspec.Struct, frozen=True):
    """A kind of recordings.

    Attributes:
        name: in messages.
        suffixes: ends of the files' names, in small letters.
        begins: whether a file is of this kind; raises InputError if it cannot be read.
        blocks: yields a file's rows; calls its second argument with the error of each row that is left out, and
            raises InputError where nothing more can be read.
        is_log: whether it is a study log, which other methods can track.
    """

    name: str
    suffixes: tuple[str, ...]
    begins: Callable[[Path], bool]
    blocks: Callable[[Path, Tell], Iterator[RecordedRows]]
    is_log: bool = False


def _log_blocks(path: Path, tell: Tell) -> Iterator[RecordedRows]:
    return (RecordedRows(rows) for rows in study_log_blocks(path, tell))


def _parquet_blocks(path: Path, tell: Tell) -> Iterator[RecordedRows]:
    return (RecordedRows(rows) for rows in parquet_log_blocks(path, tell))


def _take_blocks(path: Path, tell: Tell) -> Iterator[RecordedRows]:
    from mocapella.studies.take_rows import take_rows

    return take_rows(path)


def _is_take(path: Path) -> bool:
    return _LATER_PART.search(path.name) is None


KINDS: Final = (
    RecordingKind("study log", (".csv", ".csv.gz"), begins_study_log, _log_blocks, is_log=True),
    RecordingKind("study log in Parquet", (SUFFIX,), begins_parquet_log, _parquet_blocks, is_log=True),
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


def whole_log(path: Path) -> StudyLog | None:
    """Return all valid rows of a study log, text or Parquet; None for other recordings, and for a log without rows.

    Raises:
        InputError: it cannot be read, or not to its end.
    """
    kind = kind_of(path)
    if kind is None or not kind.is_log:
        return None
    parts = [block.rows for block in kind.blocks(path, lambda error: None)]
    return joined_blocks(parts) if parts else None


def find_recordings(folder: Path) -> FoundRecordings:
    """Find all recordings below a folder; hidden files and folders are skipped, and links to folders.

    A log in Parquet is left out where the same folder has it as a text, too. Of a take whose tasks have
    logs (`mocapella.studies.task_log`), the fused people are analysed.

    Raises:
        InputError: there is no such folder, or no recording in it.
    """
    if not folder.is_dir():
        raise InputError("there is no such folder", file=folder, fix="name the folder of the study's recordings")
    paths, others, unread = [], [], []
    for path in _files(folder):
        try:
            found = kind_of(path) is not None
        except InputError:
            found = True
        except SettingsError as error:
            unread.append(error)
            continue
        if found:
            paths.append(path)
        elif path.name.lower().endswith(_TEXTS):
            others.append(path.name)
    if not paths:
        names = ", ".join(suffix for kind in KINDS for suffix in kind.suffixes)
        raise InputError("has no recordings", file=folder, fix=f"study logs and takes end with {names}")
    texts = {path.parent / path.name.partition(".csv")[0] for path in paths if path.name.lower().endswith(_TEXTS)}
    twice = [path for path in paths if path.suffix.lower() == SUFFIX and path.with_suffix("") in texts]
    findings = []
    if unread:
        findings.append(StudyFinding("", f"{len(unread)} Parquet files cannot be read: {unread[0]}", "left out"))
    if twice:
        paths = [path for path in paths if path not in twice]
        what = f"{plural(len(twice), 'log is', 'logs are')} there as text and in Parquet"
        findings.append(StudyFinding("", what, "the text is analysed"))
    logged = {path.parent.parent for path in paths if path.parent.name == LOGS}
    cut_up = [path for path in paths if path.suffix == ".mcap" and path.parent in logged]
    if cut_up:
        what = f"{plural(len(cut_up), 'take has', 'takes have')} logs of their tasks"
        effect = "the logs have the pairs of sensors, and the takes the fused people; only running tasks are analysed"
        findings.append(StudyFinding("", what, effect))
    if others:
        some = ", ".join(sorted(others)[:3]) + (", …" if len(others) > 3 else "")
        one = len(others) == 1
        what = f"{len(others)} table{'' if one else 's'} {'is no study log' if one else 'are no study logs'}: {some}"
        findings.append(StudyFinding("", what, "left out"))
    return FoundRecordings(tuple(sorted(paths, key=lambda path: (path.name, path))), tuple(findings))


def _files(folder: Path) -> Iterator[Path]:
    for where, folders, names in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        yield from (Path(where) / name for name in sorted(names) if not name.startswith("."))
