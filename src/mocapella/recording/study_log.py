"""Read and write the study log: comma-separated text, 87 columns, plain or gzip-compressed (docs/study-log.md).

Columns are found by name, because the known files have three headers. A compiled kernel parses all numbers of a block
at once; only if that fails, a second, slow pass finds the row and the field of the error.
"""

from __future__ import annotations

import csv
import gzip
import io
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache
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
from mocapella.recording.study_row_kernels import FLOAT, INTEGER, TEXT, place_joints, read_rows

_TIME: Final = "Tracker_Time"
"""A title that all study logs have, and no other table."""
_FIRST_PIECE: Final = 1 << 14
"""Number of bytes to read at once for a first row."""
FARTHEST: Final = abs(NOT_AVAILABLE)
"""Largest coordinate, below the code of a missing one [m]."""
AT_THE_LENS: Final = 1e-6
"""Distance within which a joint is at the origin: the thesis' program moved its zeros to the world and back [m]."""


def is_study_log(path: Path) -> bool:
    """Whether the first row of a table is that of a study log; False if it cannot be read."""
    try:
        return begins_study_log(path)
    except InputError:
        return False


def begins_study_log(path: Path) -> bool:
    """Whether the first row of a table is that of a study log.

    Raises:
        InputError: the file cannot be read.
    """
    return _TIME in next(text_blocks(path, fix=_WANTED, piece=_FIRST_PIECE), "").partition("\n")[0]


def read_study_log(path: Path | str) -> StudyLog:
    """Read a study log, ``.csv`` or ``.csv.gz``, with any of the three known headers.

    Joints with all three coordinates −9999, or all three within 10⁻⁶ m of 0, are missing and become NaN, as does −9999
    in other columns of floats. ``Study_Id`` and ``Kinect_Config``, which the oldest files lack, become −9999.

    Raises:
        InputError: the file cannot be read, has no rows, or has an invalid row or field, such as a joint with only some
            coordinates −9999; or a column of the header is unknown, repeated or missing. Names row and field.
    """
    parts = list(study_log_blocks(path))
    if not parts:
        fix = "log at least one result, or leave it out"
        raise InputError("the file has a header and no rows", file=str(path), fix=fix)
    return joined_blocks(parts)


def study_log_blocks(path: Path | str, leave_out: Callable[[InputError], None] | None = None) -> Iterator[StudyLog]:
    """Yield the rows of a study log in blocks of about a megabyte of text, as `read_study_log` returns them.

    Args:
        path: the file.
        leave_out: called with the error of each invalid row, which is then left out; at most `MOST_LEFT_OUT` times.
            None to raise the first error.

    Raises:
        InputError: as in `read_study_log`, but not for a file without rows. With ``leave_out``, the rows before the
            fault have been yielded; in a file with quotation marks, the rows of earlier blocks.
    """
    file = str(path)
    blocks = text_blocks(Path(path), fix=_WANTED)
    head, newline, body = next(blocks, "").partition("\n")
    if not head.strip():
        raise InputError("the file is empty" if not newline else "the first row is empty", file=file, fix=_WANTED)
    reader = _RowReader(file, columns.layout(_header_cells(head, file), file), leave_out)
    for block in chain([body] if newline else [], blocks):
        yield from reader.read(block)


class _RowReader:
    """Reads blocks of rows, one after the other; see `study_log_blocks`."""

    def __init__(self, file: str, places: dict[str, int], leave_out: Callable[[InputError], None] | None) -> None:
        self._file, self._places, self._leave_out = file, places, leave_out
        self._next_row = 2
        self._left_out = 0

    def read(self, block: str) -> Iterator[StudyLog]:
        """Yield the rows of a block, in one value or none.

        Raises:
            InputError: a row is invalid, and is not left out.
        """
        try:
            log = _parse(self._file, block, self._places)
        except _INVALID as error:
            self._next_row += block.count("\n") + 1
            if self._leave_out is None or '"' in block:
                raise self._fault(block, error) from error
        else:
            self._next_row += len(log)
            yield log
            return
        yield from self._without_invalid(block.split("\n"), self._leave_out)

    def _without_invalid(self, lines: list[str], leave_out: Callable[[InputError], None]) -> Iterator[StudyLog]:
        valid = 0
        while lines:
            try:
                yield _parse(self._file, "\n".join(lines), self._places)
                return
            except _INVALID as error:
                rest = lines[valid:]
                fault = self._fault("\n".join(rest), error)
            # Rows are left out before this place only.
            valid += 0 if fault.row is None else fault.row - (self._next_row - len(rest))
            if fault.row is None or self._left_out == MOST_LEFT_OUT:
                if valid:
                    yield _parse(self._file, "\n".join(lines[:valid]), self._places)
                raise fault
            leave_out(fault)
            self._left_out += 1
            del lines[valid]

    def _fault(self, lines: str, error: Exception) -> InputError:
        """Return the error of the first invalid row of the last lines of the block."""
        first = self._next_row - lines.count("\n") - 1
        found = _culprit(self._file, lines, first, self._places)
        return found or InputError(f"the rows cannot be read: {error}", file=self._file)


MOST_LEFT_OUT: Final = 100
"""Most invalid rows of a file that are left out."""
_INVALID: Final = (ValueError, OverflowError, csv.Error)
_WANTED: Final = "a study log begins with the row " + ", ".join(columns.HEADER[:3]) + ", …"


def joined_blocks(parts: Sequence[StudyLog]) -> StudyLog:
    """Return the rows of all blocks of a file; there is at least one."""
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
    text = (_unquoted(body) if '"' in body else body).encode("ascii") + b"\n"
    data = np.frombuffer(text, dtype=np.uint8)
    count = int(np.count_nonzero(data == ord("\n")))
    integers = np.full((count, len(columns.INTEGERS)), NOT_AVAILABLE, dtype=np.int64)
    floats = np.empty((count, len(columns.FLOATS) + len(columns.POSITIONS)))
    codes, texts = np.empty(count, dtype=np.int64), np.empty((count, 2), dtype=np.int64)
    odd = np.empty((count * len(places), 4), dtype=np.int64)
    layout = _layout(tuple(places.items()))
    rows, text_count, odd_count = read_rows(data, *layout, integers, floats, codes, texts, odd)
    if rows != count:
        raise ValueError("an empty row, or one with another number of cells")
    _read_odd(text, odd[:odd_count], layout, integers, floats)
    positions = np.empty((count, len(columns.JOINTS), 3), dtype=np.float32)
    cells = floats[:, len(columns.FLOATS) :]
    if not place_joints(cells, float(NOT_AVAILABLE), float(FARTHEST), AT_THE_LENS, positions):
        raise ValueError("a joint with a part of its coordinates, or too far away")
    numbers: dict[str, Any] = dict(zip(columns.INTEGERS, integers.T.copy(), strict=True))
    numbers |= dict(zip(columns.FLOATS, _available(floats[:, : len(columns.FLOATS)].T.copy()), strict=True))
    kinects = _kinects([text[begin:end].decode("ascii") for begin, end in texts[:text_count].tolist()])
    return StudyLog(source=file, **numbers, kinect_id=kinects[codes], positions=positions)


@lru_cache(maxsize=16)
def _layout(places: tuple[tuple[str, int], ...]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return kind and column of the output (columns,) of each column of the file, as `read_rows` takes them.

    Joints are in the topology's order in the output.
    """
    kinds, targets = np.full(len(places), FLOAT), np.zeros(len(places), dtype=np.int64)
    whole = list(columns.INTEGERS.values())
    others = {TITLES[name]: k for k, name in enumerate(columns.FLOATS)}
    for title, place in places:
        if title == columns.KINECT:
            kinds[place] = TEXT
        elif title in whole:
            kinds[place], targets[place] = INTEGER, whole.index(title)
        elif title in others:
            targets[place] = others[title]
        else:
            joint, axis = divmod(columns.POSITIONS.index(title), 3)
            targets[place] = len(others) + 3 * columns.JOINT_PLACES[joint] + axis
    return kinds, targets


def _read_odd(
    text: bytes,
    odd: NDArray[np.int64],
    layout: tuple[NDArray[np.int64], NDArray[np.int64]],
    integers: NDArray[np.int64],
    floats: NDArray[np.float64],
) -> None:
    """Read the cells that the kernel leaves, such as numbers of 17 digits."""
    kinds, targets = layout
    for row, column, begin, end in odd.tolist():
        whole = kinds[column] == INTEGER
        number = _number(text[begin:end].decode("ascii"), int if whole else float)
        if number is None or not np.isfinite(float(number)):
            raise ValueError("no finite number")
        if whole and not -(2**63) <= number < 2**63:
            raise ValueError("more than 64 bits")  # NumPy wraps some of them around
        (integers if whole else floats)[row, targets[column]] = number


def _unquoted(body: str) -> str:
    """Remove the quotation marks that spreadsheets put around cells that do not need them."""
    rows = list(csv.reader(io.StringIO(body, newline=""), skipinitialspace=True, strict=True))
    if any("," in cell or "\n" in cell for cells in rows for cell in cells):
        raise ValueError("a cell with a separator in it")
    return "\n".join(map(",".join, rows))


def _available(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(values == NOT_AVAILABLE, np.nan, values)


def _kinects(cells: list[str]) -> NDArray[np.str_]:
    plain = [of_cell(cell) for cell in cells]
    if any(map(columns.kinect_problem, plain)):
        raise ValueError("no id of a Kinect")
    return np.array(plain)


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
    return "" if abs(number) < FARTHEST else f"is {FARTHEST} m away or farther", "positions are in metres"


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
    far = (np.abs(positions) >= FARTHEST).any(axis=-1)
    if far.any():
        joint = columns.JOINTS[int(np.argmax(far))]
        raise RecordingError(f"row {number}: {joint} is {FARTHEST} m away or farther; positions are in metres")
    cells = positions.astype(str)
    cells[missing] = str(NOT_AVAILABLE)
    # As the real logs have it: 2 for 2.0, 1E-05 for 1e-05.
    return [cell.removesuffix(".0").upper() for cell in cells.reshape(-1).tolist()]
