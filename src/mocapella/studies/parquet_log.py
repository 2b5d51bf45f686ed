"""Study logs in Parquet: the columns and values of the text files (docs/study-log.md), read in blocks."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NOT_AVAILABLE
from mocapella.decoding.parquet import ParquetTable
from mocapella.errors import InputError, RecordingError
from mocapella.exports.needs import needed
from mocapella.exports.new_file import new_file
from mocapella.model.names import of_cell
from mocapella.model.study_log import TITLES, StudyLog, StudyRow
from mocapella.recording import study_columns as columns
from mocapella.recording.study_log import AT_THE_LENS, FARTHEST, MOST_LEFT_OUT
from mocapella.studies.cleaning import only

SUFFIX: Final = ".parquet"
BLOCK_ROWS: Final = 1 << 16
"""Number of rows that are read at once, and that are packed together when written."""
_WANTED: Final = "a study log in Parquet has the 87 columns of docs/study-log.md"
_TOPOLOGY_TITLES: Final = tuple(f"{joint}_{axis}" for joint in columns.TOPOLOGY.joints for axis in "XYZ")
_JOINT: Final = "a joint has a part of its coordinates, or is too far away"

Bool = NDArray[np.bool_]


def begins_parquet_log(path: Path) -> bool:
    """Whether a Parquet file has the columns of a study log.

    Raises:
        InputError: the file cannot be read.
        SettingsError: polars is not installed.
    """
    return TITLES["tracker_time_ms"] in _opened(path).columns


def parquet_log_blocks(path: Path, leave_out: Callable[[InputError], None]) -> Iterator[StudyLog]:
    """Yield the rows of a study log in Parquet, as `mocapella.recording.study_log.study_log_blocks` does of a text.

    Columns are found by name, as in a text. In columns of floats, null, NaN and −9999 are missing values.

    Args:
        path: the file.
        leave_out: called with the error of each invalid row, which is then left out; at most `MOST_LEFT_OUT` times.

    Raises:
        InputError: the file cannot be read; a column is unknown, repeated, missing or of another type; or there are too
            many invalid rows. The rows before have been yielded.
        SettingsError: polars is not installed.
    """
    table = _opened(path)
    places = columns.layout(list(table.columns), str(path))
    names = {title: table.columns[place] for title, place in places.items()}
    left_out, next_row = 0, 2  # as in a text, whose header is row 1
    for block in table.blocks(table.columns, BLOCK_ROWS):
        log, faults = _parsed(block, names, path)
        for row in sorted(faults)[: MOST_LEFT_OUT - left_out]:
            leave_out(InputError(faults[row], file=path, row=next_row + row))
        left_out += len(faults)
        if left_out > MOST_LEFT_OUT:
            last = sorted(faults)[MOST_LEFT_OUT - left_out]
            yield _without(log, [row for row in range(len(log)) if row >= last or row in faults])
            raise InputError(faults[last], file=path, row=next_row + last)
        next_row += len(log)
        yield _without(log, list(faults))


def write_parquet_log(path: Path | str, rows: Iterable[StudyRow]) -> int:
    """Write a study log in Parquet; the file appears complete or not at all.

    Args:
        path: path of the new file, which ends with `SUFFIX`.
        rows: the rows, read some at a time.

    Returns:
        The number of written rows.

    Raises:
        SettingsError: polars is not installed, the file cannot be written, or a Kinect's id cannot be a cell.
        TakeExistsError: the file exists; it is not overwritten.
        RecordingError: there are no rows, or the disk is full.
    """
    polars = needed("polars", extra="studies")
    coming, count, path = iter(rows), 0, Path(path)

    def tables(*_: Any) -> Iterator[Any]:
        nonlocal count
        while some := list(islice(coming, BLOCK_ROWS)):
            count += len(some)
            yield polars.DataFrame(_cells_of(some), schema=_schema(polars))

    with new_file(path) as part:
        source = polars.io.plugins.register_io_source(tables, schema=_schema(polars))
        try:
            source.sink_parquet(part, compression="zstd", compression_level=1, row_group_size=BLOCK_ROWS)
        except polars.exceptions.PolarsError as error:
            raise RecordingError(f"cannot write {path}: {error}".partition("\n")[0]) from error
        if not count:
            raise RecordingError(f"cannot write {path}: there are no rows; log at least one result")
    return count


def _opened(path: Path) -> ParquetTable:
    return ParquetTable(needed("polars", extra="studies"), path, fix=_WANTED)


def _schema(polars: Any) -> dict[str, Any]:
    types = {columns.KINECT: polars.String, **dict.fromkeys(columns.INTEGERS.values(), polars.Int64)}
    types |= dict.fromkeys(columns.POSITIONS, polars.Float32)
    return {title: types.get(title, polars.Float64) for title in columns.HEADER}


def _cells_of(rows: list[StudyRow]) -> dict[str, Any]:
    cells: dict[str, Any] = {title: [getattr(row, name) for row in rows] for name, title in TITLES.items()}
    cells[columns.KINECT] = [columns.kinect_cell(kinect) for kinect in cells[columns.KINECT]]
    for title in (TITLES[name] for name in columns.FLOATS):
        cells[title] = np.nan_to_num(np.array(cells[title], dtype=np.float64), nan=NOT_AVAILABLE)
    positions = np.stack([row.positions for row in rows]).astype(np.float32)
    positions[np.isnan(positions).any(axis=-1)] = NOT_AVAILABLE
    return cells | dict(zip(_TOPOLOGY_TITLES, positions.reshape(len(rows), -1).T, strict=True))


def _parsed(block: Any, names: dict[str, str], path: Path) -> tuple[StudyLog, dict[int, str]]:
    """Return the rows of a block, and the fault of each invalid one by its place in the block."""
    faults: dict[int, str] = {}

    def tell(wrong: Bool, fault: str) -> None:
        faults.update(dict.fromkeys(np.flatnonzero(wrong).tolist(), fault))

    fields: dict[str, Any] = {}
    for name, title in TITLES.items():
        if title not in names:
            fields[name] = np.full(block.height, NOT_AVAILABLE, dtype=np.int64)
        elif name == "kinect_id":
            fields[name], wrong = _kinects(_typed(block, names[title], title, path))
            tell(wrong, f"{title} is no id of a Kinect")
        elif name in columns.FLOATS:
            values, wrong = _floats(_typed(block, names[title], title, path))
            fields[name] = np.where(values == NOT_AVAILABLE, np.nan, values)
            tell(wrong, f"{title} is not finite")
        else:
            column = _typed(block, names[title], title, path)
            fields[name] = column.fill_null(0).to_numpy().astype(np.int64)
            tell(column.is_null().to_numpy(), f"{title} is missing")
    cells, infinite = zip(
        *(_floats(_typed(block, names[title], title, path)) for title in _TOPOLOGY_TITLES), strict=True
    )
    joints = np.stack(cells, axis=1).reshape(block.height, -1, 3)
    absent, largest = (joints == NOT_AVAILABLE).sum(axis=-1), np.abs(joints).max(axis=-1)
    tell(((absent % 3 > 0) | ((absent == 0) & (largest >= FARTHEST))).any(axis=1), _JOINT)
    tell(np.any(infinite, axis=0), _JOINT)
    positions = joints.astype(np.float32)
    positions[(absent == 3) | (largest < AT_THE_LENS)] = np.nan
    return StudyLog(str(path), **fields, positions=positions), faults


def _typed(block: Any, name: str, title: str, path: Path) -> Any:
    """Return a column of the type that it should have.

    Raises:
        InputError: it has another type.
    """
    column, polars = block[name], needed("polars", extra="studies")
    if title == columns.KINECT:
        kind, target, fits = "texts", polars.String, column.dtype in (polars.String, polars.Categorical)
    elif title in columns.INTEGERS.values():
        kind, target, fits = "whole numbers", polars.Int64, column.dtype.is_integer()
    else:
        kind, target, fits = "numbers", polars.Float64, column.dtype.is_integer() or column.dtype.is_float()
    if not fits:
        raise InputError(f"is no column of {kind}", file=path, field=title, value=str(column.dtype)[:40], fix=_WANTED)
    try:
        return column.cast(target)
    except polars.exceptions.PolarsError:
        raise InputError("has more than 64 bits", file=path, field=title, fix=_WANTED) from None


def _floats(column: Any) -> tuple[NDArray[np.float64], Bool]:
    """Return a column with −9999 for missing values, and which are infinite."""
    values = column.fill_null(NOT_AVAILABLE).fill_nan(NOT_AVAILABLE).to_numpy()
    return values, np.isinf(values)


def _kinects(column: Any) -> tuple[NDArray[np.str_], Bool]:
    texts = column.fill_null("").to_list()
    plain = {text: of_cell(text) for text in set(texts)}
    wrong = {text for text in plain if columns.kinect_problem(plain[text])}
    return (
        np.array(["" if text in wrong else plain[text] for text in texts], dtype=np.str_),
        np.array([text in wrong for text in texts], dtype=np.bool_),
    )


def _without(log: StudyLog, left_out: list[int]) -> StudyLog:
    if not left_out:
        return log
    return only(log, np.setdiff1d(np.arange(len(log)), left_out))
