"""Read and write the study log: comma-separated text, 87 columns, plain or gzip-compressed (docs/study-log.md).

Columns are found by name, because the known files have three headers. All numbers are parsed at once; only if that
fails, a second, slow pass finds the row and the field of the error.
"""

from __future__ import annotations

import csv
import gzip
import io
import os
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NOT_AVAILABLE
from mocapella.decoding import text_blocks
from mocapella.errors import DiskFullError, InputError, RecordingError
from mocapella.model.names import of_cell
from mocapella.model.study_log import TITLES, StudyLog, StudyRow
from mocapella.model.whole_file import usual_mode
from mocapella.recording import disk
from mocapella.recording import study_columns as columns

_TIME: Final = "Tracker_Time"
"""A title that all study logs have, and no other table."""
_INTEGER_WIDTH: Final = 24
"""Longest cell of a number, in characters; the longest 64-bit number has 20."""
_FARTHEST: Final = abs(NOT_AVAILABLE)
"""Largest coordinate, below the code of a missing one [m]."""
_AT_THE_LENS: Final = 1e-6
"""Distance within which a joint is at the origin: the thesis' program moved its zeros to the world and back [m]."""


def is_study_log(path: Path) -> bool:
    """Whether the first row of a table is that of a study log; False if it cannot be read."""
    try:
        return _TIME in next(text_blocks(path, fix=_WANTED), "").partition("\n")[0]
    except InputError:
        return False


def read_study_log(path: Path | str) -> StudyLog:
    """Read a study log, ``.csv`` or ``.csv.gz``, with any of the three known headers.

    Joints with all three coordinates −9999, or all three within 10⁻⁶ m of 0, are missing and become NaN, as does −9999
    in other columns of floats. ``Study_Id`` and ``Kinect_Config``, which the oldest files lack, become −9999.

    Raises:
        InputError: the file cannot be read, has no rows, or has an invalid row or field, such as a joint with only some
            coordinates −9999; or a column of the header is unknown, repeated or missing. Names row and field.
    """
    file = str(path)
    blocks = text_blocks(Path(path), fix=_WANTED)
    head, newline, body = next(blocks, "").partition("\n")
    if not head.strip():
        raise InputError("the file is empty" if not newline else "the first row is empty", file=file, fix=_WANTED)
    places = columns.layout(_header_cells(head, file), file)
    parts: list[StudyLog] = []
    row = 2
    for block in chain([body] if newline else [], blocks):
        try:
            parts.append(_parse(file, block, places))
        except (ValueError, OverflowError, csv.Error) as error:
            fault = _culprit(file, block, row, places)
            raise fault or InputError(f"the rows cannot be read: {error}", file=file) from error
        row += len(parts[-1].person_id)
    if not parts:
        raise InputError("the file has a header and no rows", file=file, fix="log at least one result, or leave it out")
    return _joined(parts)


_WANTED: Final = "a study log begins with the row " + ", ".join(columns.HEADER[:3]) + ", …"


def _joined(parts: Sequence[StudyLog]) -> StudyLog:
    names = [name for name in StudyLog.__struct_fields__ if name != "source"]
    return StudyLog(
        parts[0].source, **{name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    )


def _header_cells(head: str, file: str) -> list[str]:
    try:
        return [cell.strip() for cell in next(csv.reader([head], skipinitialspace=True))]
    except csv.Error as error:
        raise InputError(f"the header cannot be read: {error}", file=file, row=1, value=head, fix=_WANTED) from error


def _parse(file: str, body: str, places: dict[str, int]) -> StudyLog:
    """Parse all rows at once.

    Raises:
        ValueError, OverflowError, csv.Error: some cell is invalid.
    """
    titles = sorted(places, key=places.__getitem__)
    kinds = dict.fromkeys(columns.INTEGERS.values(), f"U{_INTEGER_WIDTH}")
    kinds[columns.KINECT] = (
        f"U{columns.MAX_KINECT_LENGTH + 2}"  # one more for an apostrophe, one to notice what is longer
    )
    table = np.loadtxt(
        io.StringIO(_unquoted(body) if '"' in body else body),
        dtype=[(title, kinds.get(title, "f8")) for title in titles],
        delimiter=",",
        comments=None,
        ndmin=1,
    )
    if len(table) != body.count("\n") + 1:
        raise ValueError("an empty row, or one that goes over several lines")
    numbers: dict[str, Any] = {name: _integers(table, title) for name, title in columns.INTEGERS.items()}
    numbers |= {name: _available(_finite(table[TITLES[name]])) for name in columns.FLOATS}
    kinects, positions = _kinects(table[columns.KINECT]), _positions(table)
    return StudyLog(source=file, **numbers, kinect_id=kinects, positions=positions)


def _unquoted(body: str) -> str:
    """Remove the quotation marks that spreadsheets put around cells that do not need them."""
    rows = list(csv.reader(io.StringIO(body, newline=""), skipinitialspace=True, strict=True))
    if any("," in cell or "\n" in cell for cells in rows for cell in cells):
        raise ValueError("a cell with a separator in it")
    return "\n".join(map(",".join, rows))


def _integers(table: NDArray[Any], title: str) -> NDArray[np.int64]:
    if title not in (table.dtype.names or ()):
        return np.full(len(table), NOT_AVAILABLE, dtype=np.int64)
    cells: list[str] = table[title].tolist()
    if any("_" in cell or len(cell) == _INTEGER_WIDTH for cell in cells):
        raise ValueError("no whole number")
    return np.array(list(map(int, cells)), dtype=np.int64)


def _finite(values: NDArray[np.float64]) -> NDArray[np.float64]:
    if not np.isfinite(values).all():
        raise ValueError("no finite number")
    return values


def _available(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(values == NOT_AVAILABLE, np.nan, values)


def _kinects(cells: NDArray[np.str_]) -> NDArray[np.str_]:
    plain = {cell: of_cell(cell.strip()) for cell in set(cells.tolist())}
    if any(map(columns.kinect_problem, plain.values())):
        raise ValueError("no id of a Kinect")
    return np.array([plain[cell] for cell in cells.tolist()])


def _positions(table: NDArray[Any]) -> NDArray[np.float32]:
    flat = np.stack([table[title] for title in columns.POSITIONS], axis=-1)
    cells = _finite(flat).reshape(len(table), len(columns.JOINTS), 3)
    absent = cells == NOT_AVAILABLE
    if (absent.any(axis=-1) != absent.all(axis=-1)).any() or (np.abs(np.where(absent, 0, cells)) >= _FARTHEST).any():
        raise ValueError("a joint with a part of its coordinates, or too far away")
    missing = absent[..., 0] | (np.abs(cells) < _AT_THE_LENS).all(axis=-1)
    positions = np.empty(cells.shape, dtype=np.float32)
    positions[:, columns.JOINT_PLACES] = np.where(missing[..., None], np.nan, cells)
    return positions


def _culprit(file: str, block: str, first: int, places: dict[str, int]) -> InputError | None:
    """Return the error of the first invalid field of the rows from number ``first``; None if all seem valid."""
    reader = csv.reader(io.StringIO(block, newline=""), skipinitialspace=True, strict=True)
    row = first - 1
    try:
        for row, cells in enumerate(reader, start=first):
            if len(cells) != len(places):
                return InputError(
                    f"the row has {len(cells)} fields and the header {len(places)}",
                    file=file,
                    row=row,
                    fix="remove the row or complete it",
                )
            for title, place in places.items():
                problem, fix = _problem(title, cells, places)
                if problem:
                    return InputError(problem, file=file, row=row, field=title, value=cells[place].strip(), fix=fix)
    except csv.Error as error:
        return InputError(f"the row cannot be read: {error}", file=file, row=row + 1)
    return None


def _problem(title: str, cells: list[str], places: dict[str, int]) -> tuple[str, str]:
    """Return the fault of a field and its fix; empty texts if it has none."""
    cell = cells[places[title]].strip()
    if title == columns.KINECT:
        return columns.kinect_problem(of_cell(cell)), "write the sensor's name or address"
    whole = title in columns.INTEGERS.values()
    number = _number(cell, int if whole else float)
    if number is None:
        return f"is no {'whole ' if whole else ''}number", f"write a number, or {NOT_AVAILABLE} where there is none"
    if whole:
        return "" if -(2**63) <= number < 2**63 else "has more than 64 bits", "write a number of that column's unit"
    if not np.isfinite(number):
        return "is not finite", f"write {NOT_AVAILABLE} where there is no value"
    if title in columns.POSITIONS:
        return _coordinate_problem(title, number, cells, places)
    return "", ""


def _coordinate_problem(title: str, number: float, cells: list[str], places: dict[str, int]) -> tuple[str, str]:
    joint = title.rsplit("_", 1)[0]
    others = [_number(cells[places[f"{joint}_{axis}"]], float) for axis in "XYZ"]
    if number == NOT_AVAILABLE:
        whole = all(other in (NOT_AVAILABLE, None) for other in others)
        return (
            "" if whole else f"{joint} has a part of its coordinates",
            f"write {NOT_AVAILABLE} in all three or in none",
        )
    return "" if abs(number) < _FARTHEST else f"is {_FARTHEST} m away or farther", "positions are in metres"


def _number(cell: str, kind: type[int] | type[float]) -> float | None:
    try:
        return None if "_" in cell else kind(cell)
    except ValueError:
        return None


def write_study_log(path: Path | str, rows: Iterable[StudyRow]) -> int:
    """Write a study log, ``.csv`` or ``.csv.gz``; the file appears complete or not at all.

    Positions have the fewest digits that restore the same float32.

    Args:
        path: path of the new file.
        rows: the rows, read one at a time.

    Returns:
        The number of written rows.

    Raises:
        TakeExistsError: the file exists; it is not overwritten.
        DiskFullError, RecordingError: it cannot be written there, there are no rows, or a value cannot be written.
        SettingsError: a Kinect's id cannot be a cell of the log.
    """
    path = Path(path)
    if not path.name.endswith((".csv", ".csv.gz")):
        raise RecordingError(f"cannot write {path}: a study log's name ends in .csv or .csv.gz")
    disk.check_folder(path.parent, 0)
    if os.path.lexists(path):
        raise disk.name_taken(path)
    try:
        return _write_new(path, rows)
    except OSError as error:
        kind = DiskFullError if disk.is_full(error) else RecordingError
        raise kind(f"cannot write {path}: {error.strerror}; choose another folder") from error


def _write_new(path: Path, rows: Iterable[StudyRow]) -> int:
    fd, name = tempfile.mkstemp(prefix=f".{path.name[:100]}.", suffix=".tmp", dir=path.parent)
    temporary = Path(name)
    try:
        with os.fdopen(fd, "wb") as raw:
            count = _write_lines(raw, path.name.endswith(".gz"), _lines(rows))
            raw.flush()
            disk.sync(raw.fileno())
        if not count:
            raise RecordingError(f"cannot write {path}: there are no rows; log at least one result")
        _publish(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    disk.sync_folder(path.parent)
    return count


def _write_lines(raw: io.BufferedWriter, compress: bool, lines: Iterator[str]) -> int:
    count = 0
    # No name and time in the compressed file: the same rows give the same bytes.
    packed = gzip.GzipFile(filename="", mode="wb", fileobj=raw, compresslevel=6, mtime=0) if compress else raw
    packed.write((", ".join(columns.HEADER) + "\n").encode("ascii"))
    for line in lines:
        packed.write(line.encode("ascii"))
        count += 1
    if compress:
        packed.close()
    return count


def _publish(temporary: Path, path: Path) -> None:
    """Rename the finished file, unless another file has the name by now."""
    temporary.chmod(usual_mode())
    try:
        os.link(temporary, path)
    except FileExistsError:
        raise disk.name_taken(path) from None
    except OSError:  # a file system without hard links: reserve the name, then replace what reserves it
        os.close(disk.create_new(path))
        temporary.replace(path)


def _lines(rows: Iterable[StudyRow]) -> Iterator[str]:
    for number, row in enumerate(rows, start=2):
        yield ", ".join((*_cells(row), *_coordinates(row, number))) + "\n"


def _cells(row: StudyRow) -> Iterator[str]:
    for name in TITLES:
        value = getattr(row, name)
        if name in columns.INTEGERS:
            yield str(int(value))
        elif name in columns.FLOATS:
            yield _shortest(value)
        else:
            yield columns.kinect_cell(value)


def _shortest(value: float) -> str:
    return str(NOT_AVAILABLE) if np.isnan(value) else repr(float(value)).removesuffix(".0")


def _coordinates(row: StudyRow, number: int) -> list[str]:
    positions = np.asarray(row.positions, dtype=np.float32)[list(columns.JOINT_PLACES)]
    missing = np.isnan(positions).any(axis=-1)
    far = (np.abs(positions) >= _FARTHEST).any(axis=-1)
    if far.any():
        joint = columns.JOINTS[int(np.argmax(far))]
        raise RecordingError(f"row {number}: {joint} is {_FARTHEST} m away or farther; positions are in metres")
    cells = positions.astype(str)
    cells[missing] = str(NOT_AVAILABLE)
    # As the real logs have it: 2 for 2.0, 1E-05 for 1e-05.
    return [cell.removesuffix(".0").upper() for cell in cells.reshape(-1).tolist()]
