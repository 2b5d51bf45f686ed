"""Read detections from HDF5 files: DeepLabCut's tables and SLEAP's analysis files. They need the extra ``keypoints``.

DeepLabCut's are tables that pandas wrote, whose columns are (scorer, bodypart, coordinate), or (scorer, individual,
bodypart, coordinate). SLEAP's have ``tracks`` (tracks, 2, nodes, frames), ``point_scores``, ``node_names`` and
``track_names``.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.decoding.hdf5 import Hdf5, decode_pickled_texts
from mocapella.errors import InputError
from mocapella.recording.detections import CameraDetections, by_frame, check_detections, detections

Float64 = NDArray[np.float64]

_FIX: Final = "give an H5 that DeepLabCut or SLEAP (analysis) wrote for one camera, or its CSV"
_PARTS: Final = {"x": 0, "y": 1, "likelihood": 2}


def read_detection_h5(path: Path, camera: str) -> CameraDetections:
    """Read an HDF5 file of one camera; its content tells the format.

    Args:
        path: the file.
        camera: name of the camera.

    Raises:
        InputError: the file is damaged, of another format, or has an invalid value; names the field.
        SettingsError: h5py is not installed.
    """
    with Hdf5(path, fix=_FIX) as file:
        names = file.names()
        if "tracks" in names and "node_names" in names:
            return _sleap(file, path, camera)
        for name in names:
            if file.attribute(name, "pandas_type") == b"frame_table":
                return _deeplabcut(file, path, camera, name)
    raise InputError("has no detections", file=path, value=", ".join(names[:8]) or None, fix=_FIX)


def _sleap(file: Hdf5, path: Path, camera: str) -> CameraDetections:
    tracks = _numbers(file.array("tracks"), path, "tracks", 4)
    points = _texts(file.array("node_names"), path, "node_names")
    if tracks.shape[1] != 2 or tracks.shape[2] != len(points) or len(set(points)) < len(points):
        raise InputError(
            "is not (tracks, 2, nodes, frames)", file=path, field="tracks", value=list(tracks.shape), fix=_FIX
        )
    count, _, nodes, frames = tracks.shape
    scores = np.ones((count, nodes, frames))
    if "point_scores" in file.names():
        scores = _numbers(file.array("point_scores"), path, "point_scores", 3)
        if scores.shape != (count, nodes, frames):
            raise InputError("fits not the tracks", file=path, field="point_scores", value=list(scores.shape), fix=_FIX)
        scores = np.where(np.isnan(scores), 1.0, scores)  # of labels that a person made
    names: list[str] = []
    if "track_names" in file.names():
        names = _texts(file.array("track_names"), path, "track_names")
    values = np.stack([tracks[:, 0], tracks[:, 1], scores], axis=-1)  # (tracks, nodes, frames, 3)
    check_detections(values.reshape(count, -1, 3), file=path, field="tracks")
    made = {k: detections(values[:, :, k], np.arange(count)) for k in range(frames)}
    return by_frame(camera, points, made, individuals=names if len(names) == count else ())


def _deeplabcut(file: Hdf5, path: Path, camera: str, name: str) -> CameraDetections:
    table = file.array(f"{name}/table")
    fields = table.dtype.names or ()
    if not {"index", "values_block_0"} <= set(fields) or "values_block_1" in fields:
        raise InputError("has no table of DeepLabCut", file=path, field=name, fix=_FIX)
    kind = file.attribute(f"{name}/table", "values_block_0_kind") or b""
    columns = decode_pickled_texts(kind, file=path, fix=_FIX)
    values = _numbers(table["values_block_0"], path, f"{name}/table", 2)
    named = _columns(columns, path, name)
    if len(named) != values.shape[1]:
        raise InputError("has another number of names than columns", file=path, field=name, value=len(named), fix=_FIX)
    index = table["index"]
    if index.ndim != 1 or index.dtype.kind not in "iu":
        raise InputError("has no numbers of frames", file=path, field=f"{name}/table", fix="give the file of a video")
    numbers = index.astype(np.int64)
    if len(set(numbers.tolist())) < len(numbers):
        raise InputError("a frame is there twice", file=path, field=f"{name}/table", fix=_FIX)
    individuals = tuple(dict.fromkeys(individual for individual, _, _ in named))
    points = tuple(dict.fromkeys(point for _, point, _ in named))
    dense = np.full((len(numbers), len(individuals), len(points), 3), np.nan)
    if all(part != 2 for _, _, part in named):
        dense[..., 2] = 1.0
    for column, (individual, point, part) in enumerate(named):
        dense[:, individuals.index(individual), points.index(point), part] = values[:, column]
    frames = {}
    for number, own in zip(numbers.tolist(), dense, strict=True):
        check_detections(own, file=path, field=f"frame {number}")
        frames[number] = detections(own, np.arange(len(individuals)))
    return by_frame(camera, points, frames, individuals=individuals if individuals != ("",) else ())


def _columns(columns: Any, path: Path, field: str) -> list[tuple[str, str, int]]:
    """Return (individual, point, part) of each column; the individual is empty for a file of one."""
    found = []
    for column in columns if isinstance(columns, list) else ():
        texts = isinstance(column, tuple) and all(isinstance(one, str) for one in column)
        if not texts or len(column) not in (3, 4) or column[-1] not in _PARTS:
            raise InputError("has columns of another program", file=path, field=field, value=str(column)[:80], fix=_FIX)
        found.append((column[1] if len(column) == 4 else "", column[-2], _PARTS[column[-1]]))
    if not found or len(set(found)) < len(found):
        raise InputError("has no columns x, y and likelihood, or one twice", file=path, field=field, fix=_FIX)
    return found


def _numbers(values: Any, path: Path, field: str, dimensions: int) -> Float64:
    array = np.asarray(values)
    if array.ndim != dimensions or array.dtype.kind not in "fiu":
        raise InputError("is no array of numbers", file=path, field=field, value=list(array.shape), fix=_FIX)
    return array.astype(np.float64)


def _texts(values: Any, path: Path, field: str) -> list[str]:
    array = np.asarray(values)
    if array.ndim != 1 or array.dtype.kind not in "SO":
        raise InputError("is no list of names", file=path, field=field, fix=_FIX)
    found: Sequence[Any] = array.tolist()
    texts = [one.decode("utf-8", "replace") if isinstance(one, bytes) else str(one) for one in found]
    if not all(texts):
        raise InputError("has an empty name", file=path, field=field, fix=_FIX)
    return texts
