"""Tables of trajectories: long ones with a row for each keypoint, and wide ones with a row for each frame."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.exports.arm_rows import STATES
from mocapella.exports.needs import needed
from mocapella.exports.run_labels import label_texts, labels_by_run
from mocapella.model.names import as_cell
from mocapella.model.trajectories import LABELS, Trajectories

COLUMNS: Final = ("time_s", "run", *LABELS, "individual", "keypoint", "state", "x_m", "y_m", "z_m", "sd_m")
"""Columns of a long table."""
ROWS_AT_ONCE: Final = 1024
"""Number of frames that are turned into rows at a time, so that memory stays small."""


_ZSTD_LEVEL: Final = 1
"""As small as with the default level 3 for these tables, and faster."""


class Texts(NamedTuple):
    """A column of texts: a code of each row, and the text of each code."""

    codes: NDArray[np.integer]
    names: tuple[str, ...]

    def texts(self) -> list[str]:
        """Return the text of each row."""
        return [self.names[code] for code in self.codes.tolist()]


Columns = Mapping[str, Texts | NDArray[Any]]
"""A table by column."""


def long_columns(trajectories: Trajectories) -> dict[str, Texts | NDArray[Any]]:
    """Return a long table by column, in the order of `COLUMNS`.

    Each keypoint of each individual that is present in a frame has a row, in the order of frames, individuals and
    keypoints. ``state`` is measured, inferred or unknown; unknown coordinates [m] are NaN, and missing labels are
    empty texts, as is a participant of −9999.
    """
    present, points = trajectories.present, len(trajectories.keypoints)
    frames, people = np.nonzero(present)
    labels = {label: labels_of_runs(trajectories.labels, label, trajectories.runs) for label in LABELS}
    x, y, z = np.ascontiguousarray(trajectories.positions[present].reshape(-1, 3).T)
    return {
        "time_s": np.repeat(trajectories.times_s[frames], points),
        "run": np.repeat(trajectories.runs[frames], points),
        **{label: Texts(np.repeat(some.codes[frames], points), some.names) for label, some in labels.items()},
        "individual": Texts(np.repeat(people.astype(np.uint32), points), trajectories.individuals),
        "keypoint": Texts(np.tile(np.arange(points, dtype=np.uint32), len(frames)), trajectories.keypoints),
        "state": Texts(trajectories.states[present].ravel(), STATES),
        "x_m": x,
        "y_m": y,
        "z_m": z,
        "sd_m": trajectories.sd[present].ravel(),
    }


def labels_of_runs(labels: Mapping[int, Mapping[str, Any]], label: str, runs: NDArray[np.int64]) -> Texts:
    """Return the column of a label, such as participant, of rows of the ``runs`` (rows,); unknown ones are empty.

    Its texts are of all runs, so that parts of a motion have the same ones.
    """
    texts = {run: label_texts(own)[label] for run, own in labels.items()}
    names = tuple(dict.fromkeys(["", *texts.values()]))
    known, rows = np.unique(runs, return_inverse=True)
    codes = np.array([names.index(texts.get(run, "")) for run in known.tolist()], dtype=np.uint32)
    return Texts(codes[rows], names)


def wide_names(trajectories: Trajectories) -> list[str]:
    """Return the columns of a wide table after time, run and labels: individual, keypoint and axis with dots.

    Each keypoint has ``….x_m``, ``….y_m``, ``….z_m`` and ``….state``.
    """
    return [
        f"{person}.{keypoint}.{value}"
        for person in trajectories.individuals
        for keypoint in trajectories.keypoints
        for value in ("x_m", "y_m", "z_m", "state")
    ]


def write_csv(trajectories: Trajectories, path: Path) -> None:
    """Write the long table as CSV; unknown values are empty.

    Raises:
        OSError: the file cannot be written.
    """
    write_table(path, COLUMNS, map(long_columns, in_steps(trajectories)))


def write_table(path: Path, names: Sequence[str], parts: Iterable[Columns]) -> None:
    """Write a table as CSV, a part of its rows after the other; unknown numbers are empty.

    Raises:
        OSError: the file cannot be written.
    """
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        for columns in parts:
            writer.writerows(zip(*(_cells(name, column) for name, column in columns.items()), strict=True))


def write_wide_csv(trajectories: Trajectories, path: Path) -> None:
    """Write the wide table as CSV, a row for each frame; unknown values are empty.

    Raises:
        OSError: the file cannot be written.
    """
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["time_s", "run", *LABELS, *map(as_cell, wide_names(trajectories))])
        by_run = {run: list(map(as_cell, own.values())) for run, own in labels_by_run(trajectories).items()}
        for some in in_steps(trajectories):
            cells = np.empty((len(some), len(some.individuals), len(some.keypoints), 4), dtype=object)
            cells[..., :3] = np.reshape(_decimals(some.positions.ravel(), 5), some.positions.shape)
            cells[..., 3] = np.asarray(STATES, dtype=object)[some.states]
            columns = zip(_decimals(some.times_s, 6), some.runs.tolist(), cells.reshape(len(some), -1), strict=True)
            writer.writerows([time, run, *by_run[run], *row] for time, run, row in columns)


def _cells(name: str, column: Any) -> list[Any]:
    if isinstance(column, Texts):
        return Texts(column.codes, tuple(map(as_cell, column.names))).texts()
    return column.tolist() if name == "run" else _decimals(column, 6 if name == "time_s" else 5)


def in_steps(trajectories: Trajectories) -> Iterator[Trajectories]:
    """Yield trajectories in parts of `ROWS_AT_ONCE` frames."""
    for begin in range(0, len(trajectories), ROWS_AT_ONCE):
        yield trajectories.at(slice(begin, begin + ROWS_AT_ONCE))


def _decimals(values: Any, digits: int) -> list[str]:
    return ["" if math.isnan(value) else f"{value:.{digits}f}" for value in values.tolist()]


def as_polars(trajectories: Trajectories) -> Any:
    """Return the long table as a polars data frame; texts are of the type Enum, and unknown numbers are null.

    Raises:
        SettingsError: polars is not installed; names the extra.
    """
    return columns_as_polars(long_columns(trajectories))


def columns_as_polars(columns: Columns) -> Any:
    """Return a table as a polars data frame, as `as_polars` does.

    Raises:
        SettingsError: polars is not installed; names the extra.
    """
    polars = needed("polars")
    frame = polars.DataFrame({name: _series(column) for name, column in columns.items()})
    return frame.with_columns(polars.selectors.float().fill_nan(None))


def _series(column: Any) -> Any:
    return _names(column.names).gather(column.codes) if isinstance(column, Texts) else column


@lru_cache(maxsize=64)
def _names(names: tuple[str, ...]) -> Any:
    """Return texts as a series of the type Enum; parts of a table share it."""
    polars = needed("polars")
    return polars.Series(names, dtype=polars.Enum(names))


def as_pandas(trajectories: Trajectories) -> Any:
    """Return the long table as a pandas data frame; texts are categories, and unknown numbers are NaN.

    Raises:
        SettingsError: pandas is not installed; names the extra.
    """
    return columns_as_pandas(long_columns(trajectories))


def columns_as_pandas(columns: Columns) -> Any:
    """Return a table as a pandas data frame, as `as_pandas` does.

    Raises:
        SettingsError: pandas is not installed; names the extra.
    """
    pandas = needed("pandas")
    return pandas.DataFrame(
        {
            name: pandas.Categorical.from_codes(column.codes, column.names) if isinstance(column, Texts) else column
            for name, column in columns.items()
        }
    )


def write_parquet(trajectories: Trajectories, path: Path) -> None:
    """Write the long table as Parquet, some frames at a time.

    Raises:
        SettingsError: polars is not installed; names the extra.
        OSError: the file cannot be written.
    """
    polars = needed("polars")

    def tables(*_: Any) -> Iterator[Any]:
        for some in in_steps(trajectories):
            yield as_polars(some)

    schema = as_polars(trajectories.at(slice(0, 1))).schema
    source = polars.io.plugins.register_io_source(tables, schema=schema)
    try:
        source.sink_parquet(path, compression="zstd", compression_level=_ZSTD_LEVEL)
    except polars.exceptions.PolarsError as error:  # a full disk, too
        raise OSError(str(error)) from error
