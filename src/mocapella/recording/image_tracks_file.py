"""Read 2D points from files: folders of OpenPose, CSV of Caliscope and FreeMoCap-like tools, and Mocapella's CSV.

Mocapella's CSV has a row for each point that a camera saw in a frame, with the columns ``frame, camera, point, x_px,
y_px`` and optionally ``confidence`` and ``time_s``, in any order; docs/triangulation.md describes it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import MOST_TABLE_BYTES, check_filled, decode_csv, read_whole
from mocapella.errors import InputError
from mocapella.model.point_tracks import ImageTracks
from mocapella.recording.detection_json import read_json_folder
from mocapella.recording.detections import AUTO, image_tracks

Float64 = NDArray[np.float64]
Progress = Callable[[str], None]

OWN_COLUMNS: Final = ("frame", "camera", "point", "x_px", "y_px")
CALISCOPE_COLUMNS: Final = ("sync_index", "port", "point_id", "img_loc_x", "img_loc_y")


def read_image_tracks(
    paths: Sequence[Path], *, order: str = AUTO, progress: Progress = lambda _text: None
) -> ImageTracks:
    """Read 2D points from one folder of OpenPose JSON per camera, or from one CSV.

    Args:
        paths: the folders, or the one CSV file.
        order: order of OpenPose's keypoints, a key of `mocapella.recording.detections.ORDERS` or `AUTO`; unused for a
            CSV.
        progress: receives the name of each file before it is read.

    Returns:
        As `read_openpose` or `read_csv`.

    Raises:
        InputError: a file is missing or invalid; names file, row, field and value.
    """
    if not paths:
        raise InputError("no points are named", fix="name a CSV, or a folder of OpenPose JSON for each camera")
    for path in paths:
        if not path.exists():
            raise InputError(
                "there is no such file or folder", file=path, fix="name a CSV or a folder of OpenPose JSON"
            )
    folders = [path.is_dir() for path in paths]
    if all(folders):
        return read_openpose(paths, order=order, progress=progress)
    if any(folders) or len(paths) > 1:
        raise InputError(
            "points are several folders, or one file",
            file=paths[1 if len(paths) > 1 else 0],
            fix="name one CSV with all cameras, or a folder of OpenPose JSON for each camera",
        )
    progress(paths[0].name)
    return read_csv(paths[0])


def read_openpose(
    folders: Sequence[Path], *, order: str = AUTO, progress: Progress = lambda _text: None
) -> ImageTracks:
    """Read OpenPose JSON, a folder per camera and a file per frame.

    Of several people in a file, the one with the largest sum of confidences is used, with a note in ``notes``. Times
    are NaN. A frame that a camera lacks, and a point with confidence 0, is NaN with confidence 0.

    Args:
        folders: a folder for each camera; the camera gets its name.
        order: order of the keypoints, a key of `mocapella.recording.detections.ORDERS` or `AUTO`.
        progress: receives the name of each file before it is read.

    Raises:
        InputError: a folder has no JSON, or a file is not OpenPose's or has other points.
    """
    cameras = [read_json_folder(folder, order=order, progress=progress) for folder in folders]
    kinds = {one.topology.name: one for one in cameras if one.topology is not None}
    if len(kinds) > 1:
        raise InputError(
            f"the cameras have different keypoints: {', '.join(kinds)}", file=folders[0],
            fix="write the files of all cameras with one model",
        )  # fmt: skip
    return image_tracks(cameras)


def read_csv(path: Path) -> ImageTracks:
    """Read 2D points from Caliscope's CSV or Mocapella's, recognised by the columns.

    Returns:
        Cameras and points are in natural order (``cam_2`` before ``cam_10``). A point without a row, or with
        confidence 0, is NaN with confidence 0. Without their columns, confidences are 1 and times NaN.

    Raises:
        InputError: the file is invalid; names file, row, field and value.
    """
    fix = "give a CSV in UTF-8"
    columns, rows = decode_csv(read_whole(path, fix=fix, most_bytes=MOST_TABLE_BYTES), file=path, fix=fix)
    if set(OWN_COLUMNS) <= set(columns):
        fields = dict(zip(("frame", "camera", "point", "x", "y"), OWN_COLUMNS, strict=True))
        fields |= {"time": "time_s"} if "time_s" in columns else {}
        fields |= {"confidence": "confidence"} if "confidence" in columns else {}
    elif set(CALISCOPE_COLUMNS) <= set(columns):
        fields = dict(zip(("frame", "camera", "point", "x", "y"), CALISCOPE_COLUMNS, strict=True))
        fields |= {"time": "frame_time"} if "frame_time" in columns else {}
    else:
        raise InputError(
            "columns of 2D points are missing",
            file=path,
            row=1,
            value=", ".join(columns),
            fix=f"give it {', '.join(OWN_COLUMNS)} (Mocapella) or {', '.join(CALISCOPE_COLUMNS)} (Caliscope)",
        )
    return _table(path, fields, rows)


def _table(path: Path, fields: Mapping[str, str], rows: Iterator[tuple[int, Mapping[str, str]]]) -> ImageTracks:
    numbers: list[tuple[int, str, str, float, float, float, float]] = []
    for row, cells in rows:
        frame = _number(path, row, fields["frame"], cells)
        if not (frame == int(frame) and abs(frame) < 2**53):
            raise InputError("not a whole number", file=path, row=row, field=fields["frame"], value=frame)
        numbers.append(
            (
                int(frame),
                _text(path, row, fields["camera"], cells),
                _text(path, row, fields["point"], cells),
                _number(path, row, fields["x"], cells),
                _number(path, row, fields["y"], cells),
                _number(path, row, fields["confidence"], cells) if "confidence" in fields else 1.0,
                _number(path, row, fields["time"], cells, empty=np.nan) if "time" in fields else np.nan,
            )
        )
    if not numbers:
        raise InputError("no rows below the header", file=path, fix="give it a row for each point that a camera saw")
    frames = sorted({n[0] for n in numbers})
    cameras, points = (sorted({str(n[k]) for n in numbers}, key=_naturally) for k in (1, 2))
    places = [{value: i for i, value in enumerate(values)} for values in (frames, cameras, points)]
    shape = len(frames), len(cameras), len(points)
    check_filled(math.prod(shape), len(numbers), file=path)
    pixels, confidences, at_s = np.full((*shape, 2), np.nan), np.zeros(shape), np.full(shape[:2], np.nan)
    there = np.zeros(shape, dtype=np.bool_)
    for row, (frame, camera, point, x, y, confidence, time) in enumerate(numbers, start=2):
        i, k, p = places[0][frame], places[1][camera], places[2][point]
        if there[i, k, p]:
            raise InputError(
                "the point is there twice", file=path, row=row, field=fields["point"], value=point,
                fix="keep one row for a frame, camera and point",
            )  # fmt: skip
        if not 0 <= confidence <= 1:
            raise InputError("not between 0 and 1", file=path, row=row, field="confidence", value=confidence)
        pixels[i, k, p], confidences[i, k, p], at_s[i, k] = (x, y), confidence, time
        there[i, k, p] = True
    pixels[confidences == 0] = np.nan
    return ImageTracks(tuple(cameras), tuple(points), np.array(frames, dtype=np.int64), at_s, pixels, confidences)


def _number(path: Path, row: int, field: str, cells: Mapping[str, str], empty: float | None = None) -> float:
    text = cells.get(field, "").strip()
    if not text and empty is not None:
        return empty
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(
            "not a number", file=path, row=row, field=field, value=text, fix="leave the row out if not seen"
        )
    return value


def _text(path: Path, row: int, field: str, cells: Mapping[str, str]) -> str:
    text = cells.get(field, "").strip()
    if not text:
        raise InputError("empty", file=path, row=row, field=field, fix="give it a name")
    return text


def _naturally(name: str) -> list[tuple[int, int, str]]:
    """Return a sort key that puts cam_2 before cam_10."""
    parts = [part.lstrip("0") if part.isdecimal() else part for part in re.split(r"(\d+)", name) if part]
    return [(0, len(part), part) if part.isdecimal() or not part else (1, 0, part) for part in parts]
