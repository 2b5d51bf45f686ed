"""Read detections from tables: DeepLabCut's CSV, SLEAP's analysis CSV, Caliscope's and Mocapella's.

DeepLabCut's has three header rows, or four with several individuals: scorer, individuals, bodyparts, coords. SLEAP's
has a row for each instance, with the columns ``track, frame_idx, instance.score`` and three for each node. Mocapella's
has a row for each point that a camera saw in a frame, with the columns ``frame, camera, point, x_px, y_px`` and
optionally ``person``, ``confidence`` and ``time_s``; docs/triangulation.md describes it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import MOST_TABLE_BYTES, check_filled, decode_csv_rows, read_whole
from mocapella.errors import InputError
from mocapella.model.keypoints import NO_ID
from mocapella.model.topology import topology
from mocapella.recording.detection_json import frame_of
from mocapella.recording.detections import CameraDetections, Detections, by_frame, check_detections, detections
from mocapella.recording.image_tracks_file import read_csv

Float64 = NDArray[np.float64]
Row = tuple[int, list[str]]

_FIX: Final = "give a CSV in UTF-8"
_PARTS: Final = {"x": 0, "y": 1, "likelihood": 2}
_SLEAP: Final = ("track", "frame_idx", "instance.score")


class _Column(NamedTuple):
    """A data column: its place and its content."""

    at: int
    individual: str
    point: str
    part: int


def read_detection_table(path: Path, camera: str) -> list[CameraDetections]:
    """Read a table; the columns tell the format.

    Args:
        path: the file.
        camera: name of the camera; unused for tables of several cameras.

    Returns:
        One camera, or all cameras of a table of Mocapella or Caliscope, in natural order.

    Raises:
        InputError: the file is invalid; names file, row, field and value.
    """
    rows = decode_csv_rows(read_whole(path, fix=_FIX, most_bytes=MOST_TABLE_BYTES), file=path, fix=_FIX)
    first = next(rows, (1, []))
    cells = [cell.strip() for cell in first[1]]
    if cells and cells[0] == "scorer":
        return [_deeplabcut(path, camera, first, rows)]
    if set(_SLEAP[:2]) <= set(cells):
        return [_sleap(path, camera, cells, rows)]
    if "person" in cells:
        return _people(path, cells, rows)
    return _tracks(path)


def _deeplabcut(path: Path, camera: str, first: Row, rows: Iterator[Row]) -> CameraDetections:
    """Read a table of DeepLabCut, of one individual or several."""
    heads = {"scorer": first[1]}
    for _, cells in rows:
        heads[cells[0].strip()] = cells
        if cells[0].strip() == "coords" or len(heads) > 4:
            break
    if not {"bodyparts", "coords"} <= heads.keys():
        raise InputError(
            "no header rows of DeepLabCut", file=path, row=2, value=", ".join(heads),
            fix="its rows are scorer, bodyparts and coords, with individuals before bodyparts if there are several",
        )  # fmt: skip
    columns = list(_columns(heads))
    if not columns:
        raise InputError("no columns x, y and likelihood", file=path, field="coords", fix="give DeepLabCut's CSV")
    individuals = tuple(dict.fromkeys(one.individual for one in columns))
    points = tuple(dict.fromkeys(one.point for one in columns))
    index = np.array([(individuals.index(one.individual), points.index(one.point), one.part) for one in columns])
    has_likelihood = any(one.part == 2 for one in columns)
    frames: dict[int, Detections] = {}
    for k, (number, cells) in enumerate(rows):
        name = cells[0] if cells[0].strip().isdecimal() else Path((" ".join(cells[:3])).strip()).stem
        frame = frame_of(name, file=path, fix="the first column is the frame's number, or its image")
        if frame in frames:
            raise InputError("the frame is there twice", file=path, row=number, value=frame)
        if k == 0:
            check_filled(len(individuals) * len(points), len(columns), file=path)
        values = np.full((len(individuals), len(points), 3), np.nan)
        values[..., 2] = np.nan if has_likelihood else 1.0
        values[index[:, 0], index[:, 1], index[:, 2]] = [
            _cell(path, number, heads["bodyparts"], cells, one.at) for one in columns
        ]
        check_detections(values, file=path, field=f"row {number}")
        frames[frame] = detections(values, np.arange(len(individuals)))
    return by_frame(camera, points, frames, individuals=individuals if "individuals" in heads else ())


def _columns(heads: Mapping[str, Sequence[str]]) -> Iterator[_Column]:
    several = heads.get("individuals")
    for at, (point, part) in enumerate(zip(heads["bodyparts"], heads["coords"], strict=False)):
        if part.strip() in _PARTS and (several is None or at < len(several)):
            yield _Column(at, "" if several is None else several[at].strip(), point.strip(), _PARTS[part.strip()])


def _cell(path: Path, row: int, heads: Sequence[str], cells: Sequence[str], at: int) -> float:
    """Return a number of a cell; NaN for an empty one, and where the row has ended."""
    text = cells[at].strip() if at < len(cells) else ""
    try:
        return float(text) if text else math.nan
    except ValueError:
        field = heads[at] if at < len(heads) else str(at)
        raise InputError(
            "not a number", file=path, row=row, field=field, value=text[:80], fix="leave the cell empty if not seen"
        ) from None


def _sleap(path: Path, camera: str, columns: Sequence[str], rows: Iterator[Row]) -> CameraDetections:
    """Read an analysis CSV of SLEAP."""
    at = {name: i for i, name in enumerate(columns)}
    points = [name.removesuffix(".x") for name in columns if name.endswith(".x")]
    missing = [f"{point}.{part}" for point in points for part in ("y", "score") if f"{point}.{part}" not in at]
    if not points or missing:
        raise InputError(
            "columns of SLEAP are missing", file=path, row=1, value=", ".join(missing or ["….x"]),
            fix="export with sleap-convert --format analysis.csv",
        )  # fmt: skip
    places = [at[f"{point}.{part}"] for point in points for part in ("x", "y", "score")]
    names: list[str] = []
    found: dict[int, list[tuple[Float64, int]]] = {}
    for number, cells in rows:
        frame = _cell(path, number, columns, cells, at["frame_idx"])
        if not (math.isfinite(frame) and frame == int(frame) and abs(frame) < 2**53):
            raise InputError("not a whole number", file=path, row=number, field="frame_idx", value=frame)
        track = cells[at["track"]].strip() if at["track"] < len(cells) else ""
        if track and track not in names:
            names.append(track)
        values = np.array([_cell(path, number, columns, cells, place) for place in places]).reshape(-1, 3)
        values[np.isnan(values[:, 2]), 2] = 1.0  # of a label that a person made
        check_detections(values[None], file=path, field=f"row {number}")
        found.setdefault(int(frame), []).append((values, names.index(track) if track else NO_ID))
    frames = {
        frame: detections(np.array([values for values, _ in row]), [own for _, own in row])
        for frame, row in found.items()
    }
    tracked = all((frame.ids >= 0).all() for frame in frames.values())
    return by_frame(camera, points, frames, individuals=names if tracked else ())


def _people(path: Path, columns: Sequence[str], rows: Iterator[Row]) -> list[CameraDetections]:
    """Read Mocapella's CSV of several people."""
    at = {name: i for i, name in enumerate(columns)}
    missing = {"frame", "camera", "point", "x_px", "y_px"} - at.keys()
    if missing:
        raise InputError(
            "columns of 2D points are missing", file=path, row=1, value=", ".join(sorted(missing)),
            fix="the columns are frame, camera, person, point, x_px, y_px",
        )  # fmt: skip
    seen: dict[str, dict[int, dict[str, dict[str, tuple[float, float, float]]]]] = {}
    times: dict[str, dict[int, float]] = {}
    points: dict[str, None] = {}
    for number, cells in rows:
        texts = {name: cells[i].strip() if i < len(cells) else "" for name, i in at.items()}
        values = {
            name: _cell(path, number, columns, cells, at[name]) if name in at else default
            for name, default in (("frame", 0.0), ("x_px", 0.0), ("y_px", 0.0), ("confidence", 1.0), ("time_s", 0.0))
        }
        frame, sure = values["frame"], values["confidence"]
        if not (math.isfinite(frame) and frame == int(frame) and abs(frame) < 2**53):
            raise InputError("not a whole number", file=path, row=number, field="frame", value=frame)
        for name in ("camera", "person", "point"):
            if not texts[name]:
                raise InputError("empty", file=path, row=number, field=name, fix="give it a name")
        if not 0 <= sure <= 1:
            raise InputError("not between 0 and 1", file=path, row=number, field="confidence", value=sure)
        own = seen.setdefault(texts["camera"], {}).setdefault(int(frame), {}).setdefault(texts["person"], {})
        if texts["point"] in own:
            raise InputError(
                "the point is there twice", file=path, row=number, field="point", value=texts["point"],
                fix="keep one row for a frame, camera, person and point",
            )  # fmt: skip
        own[texts["point"]] = (values["x_px"], values["y_px"], sure)
        points[texts["point"]] = None
        if "time_s" in at and math.isfinite(values["time_s"]):
            times.setdefault(texts["camera"], {})[int(frame)] = values["time_s"]
    names = tuple(dict.fromkeys(name for camera in seen.values() for frame in camera.values() for name in frame))
    place = {point: i for i, point in enumerate(points)}
    people = sum(len(frame) for camera in seen.values() for frame in camera.values())
    check_filled(people * len(place), people, file=path)
    made = []
    for camera, by_number in seen.items():
        frames = {}
        for frame, individuals in by_number.items():
            values_of = np.full((len(individuals), len(place), 3), np.nan)
            for i, own in enumerate(individuals.values()):
                for point, value in own.items():
                    values_of[i, place[point]] = value
            check_detections(values_of, file=path, field=f"frame {frame}")
            frames[frame] = detections(values_of, [names.index(name) for name in individuals])
        made.append(by_frame(camera, tuple(points), frames, individuals=names, times_s=times.get(camera)))
    return made


def _holistic_names(points: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of MediaPipe's points for Caliscope's numbers of them; other names unchanged.

    0 to 32 are the pose, from 100 the right hand, from 200 the left one, and from 500 points of the face.
    """
    pose, hand = topology("mediapipe_pose").joints, topology("hand").joints
    known = {str(i): name for i, name in enumerate(pose)}
    for first, side in ((100, "RIGHT"), (200, "LEFT")):
        known |= {str(first + i): f"{side}_HAND_{name.upper()}" for i, name in enumerate(hand)}
    faces = {point: f"FACE_{int(point) - 500}" for point in points if point.isdecimal() and 500 <= int(point) < 978}
    known |= faces
    whole = {str(i) for i in range(len(pose))} | {"100", "200"}
    return tuple(known[point] for point in points) if whole <= set(points) <= known.keys() else points


def _tracks(path: Path) -> list[CameraDetections]:
    """Read a table of points that are each there once, of Caliscope or Mocapella."""
    tracks = read_csv(path)
    names = _holistic_names(tracks.points)
    made = []
    for k, camera in enumerate(tracks.cameras):
        frames, times = {}, {}
        for i, number in enumerate(tracks.frames.tolist()):
            values = np.concatenate([tracks.pixels[i, k], tracks.confidences[i, k][:, None]], axis=1)[None]
            check_detections(values, file=path, field=f"frame {number}")
            frames[number], times[number] = detections(values), float(tracks.at_s[i, k])
        made.append(by_frame(camera, names, frames, times_s=times, notes=tracks.notes))
    return made
