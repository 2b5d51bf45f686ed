"""Read short recordings of named points, 3D or in one camera's image, for tuning filters."""

from __future__ import annotations

import math
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import MOST_TABLE_BYTES, check_filled, decode_csv, read_whole
from mocapella.errors import InputError

Float64 = NDArray[np.float64]
SPACE, PICTURE = ("x_m", "y_m", "z_m"), ("x_px", "y_px")


class PointRecording(msgspec.Struct, frozen=True, eq=False):
    """Positions of points over time.

    Attributes:
        at_s: (frames,) times, as in the file, ascending and each once [s].
        points: (frames, points, 2) image positions [px], or (frames, points, 3) positions in space [m]; NaN where not
            seen. The points are in the order of their names.
        unit: ``px`` or ``m``.
    """

    at_s: Float64
    points: Float64
    unit: str


def read_point_recording(path: Path) -> PointRecording:
    """Read a CSV with the columns ``time_s, point`` and ``x_m, y_m, z_m`` or ``x_px, y_px``.

    `mocapella track points` writes such files. A file without rows gives empty arrays.

    Raises:
        InputError: the file is invalid, or has points of two cameras; names file, row, field and value.
    """
    fix = "give a CSV in UTF-8"
    columns, table = decode_csv(read_whole(path, fix=fix, most_bytes=MOST_TABLE_BYTES), file=path, fix=fix)
    fields = next((names for names in (SPACE, PICTURE) if set(names) <= set(columns)), None)
    if fields is None or not {"time_s", "point"} <= set(columns):
        wanted = "time_s, point and x_m, y_m, z_m or x_px, y_px"
        raise InputError("columns are missing", file=path, row=1, value=", ".join(columns), fix=f"give {wanted}")
    found: dict[tuple[float, str], list[float]] = {}
    camera = None
    for row, cells in table:
        if camera is not None and cells.get("camera", camera) != camera:
            raise InputError(
                "of another camera", file=path, row=row, field="camera", value=cells["camera"],
                fix="give a file of one camera",
            )  # fmt: skip
        camera = cells.get("camera")
        at_s, *place = (_number(path, row, field, cells.get(field)) for field in ("time_s", *fields))
        key = at_s, cells.get("point", "")
        if key in found:
            raise InputError("the point is there twice", file=path, row=row, field="point", value=key[1])
        found[key] = place
    times, names = sorted({at_s for at_s, _ in found}), sorted({name for _, name in found})
    check_filled(len(times) * len(names), len(found), file=path)
    points = np.full((len(times), len(names), len(fields)), np.nan)
    rows, places = ({value: i for i, value in enumerate(values)} for values in (times, names))
    for (at_s, name), place in found.items():
        points[rows[at_s], places[name]] = place
    return PointRecording(np.array(times), points, "m" if fields is SPACE else "px")


def _number(path: Path, row: int, field: str, text: str | None) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(
            "not a number", file=path, row=row, field=field, value=text, fix="leave the row out if not seen"
        )
    return value
