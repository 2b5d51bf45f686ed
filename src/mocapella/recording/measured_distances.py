"""Read stereo disparities at distances measured with a ruler from a CSV, to calibrate depth from disparity."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import MOST_TABLE_BYTES, decode_csv, read_whole
from mocapella.errors import InputError

Float64 = NDArray[np.float64]
COLUMNS = ("distance_cm", "disparity_px")


def read_measured_distances(path: Path) -> tuple[Float64, Float64]:
    """Read a CSV with `COLUMNS` in any order; return distances (rows,) [m] and disparities (rows,) [px].

    The rows keep the order of the file; both arrays are empty if it has none.

    Raises:
        InputError: the file is invalid, or a distance is not above 0; names file, row, field and value.
    """
    fix = "give a CSV in UTF-8"
    columns, rows = decode_csv(read_whole(path, fix=fix, most_bytes=MOST_TABLE_BYTES), file=path, fix=fix)
    missing = [column for column in COLUMNS if column not in columns]
    if missing:
        raise InputError("a column is missing", file=path, row=1, field=missing[0], fix=f"give {', '.join(COLUMNS)}")
    values = [[_number(path, row, column, cells.get(column)) for column in COLUMNS] for row, cells in rows]
    table = np.array(values).reshape(-1, 2)
    return table[:, 0] / 100.0, table[:, 1]


def _number(path: Path, row: int, field: str, text: str | None) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or (field == "distance_cm" and value <= 0):
        wanted = "a number above 0" if field == "distance_cm" else "a number of pixels"
        raise InputError(f"not {wanted}", file=path, row=row, field=field, value=text, fix="correct or remove the row")
    return value
