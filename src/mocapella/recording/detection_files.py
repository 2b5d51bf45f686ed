"""Read the detections of several cameras from files and folders of other programs; their content tells the format."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from mocapella.errors import InputError
from mocapella.recording.detection_h5 import read_detection_h5
from mocapella.recording.detection_json import is_of_one_image, read_json, read_json_folder, read_json_video
from mocapella.recording.detection_tables import read_detection_table
from mocapella.recording.detections import AUTO, CameraDetections

Progress = Callable[[str], None]

SUFFIXES: Final = (".json", ".csv", ".h5", ".hdf5")
FILMS: Final = (".avi", ".m4v", ".mkv", ".mov", ".mp4", ".mpg", ".webm")
"""Endings of films, which have no keypoints yet."""
POSE_FOLDERS: Final = ("pose-sync", "pose")
"""Folders with the detections in a folder of Pose2Sim, the preferred first: synchronised ones, raw ones."""
_KINDS: Final = "JSON of OpenPose, MMPose or AlphaPose, CSV or H5 of DeepLabCut or SLEAP, or Mocapella's CSV"
_ONE_EACH: Final = f"name a folder with a folder or file for each camera: {_KINDS}"


def read_detections(
    paths: Sequence[Path], *, order: str = AUTO, progress: Progress = lambda _text: None
) -> list[CameraDetections]:
    """Read the detections of all cameras.

    Args:
        paths: folders with a folder or a file for each camera, folders with a file for each image of a camera, and
            files of a camera or of all. A folder with Pose2Sim's folder ``pose`` stands for that one.
        order: order of keypoints without names, a key of `mocapella.recording.detections.ORDERS`, or `AUTO`.
        progress: receives the name of each file before it is read.

    Returns:
        The cameras, with different names.

    Raises:
        InputError: a path does not exist or has nothing that can be read, a file is invalid, or two cameras have the
            same name; names file, field and value.
    """
    if not paths:
        raise InputError("no detections are named", fix=_ONE_EACH)
    found = [camera for path in paths for camera in _of_path(Path(path), order, progress)]
    names = [one.camera for one in found]
    for one in found:
        if names.count(one.camera) > 1:
            raise InputError(
                "two cameras have this name", file=one.camera, fix="name each folder or file after its camera"
            )
    if not any(len(one.numbers) for one in found):
        raise InputError("the files have no frame", file=paths[0], fix=_ONE_EACH)
    return found


def camera_name(path: Path) -> str:
    """Return the name of the camera of a file: without DeepLabCut's scorer and SLEAP's ``analysis``."""
    stem = re.sub(r"(\.predictions|\.analysis|\.slp)+$", "", path.stem)
    return re.sub(r"(?<=.)DLC_.*$", "", stem) or path.stem


def _of_path(path: Path, order: str, progress: Progress) -> list[CameraDetections]:
    if not path.exists():
        raise InputError("there is no such file or folder", file=path, fix=_ONE_EACH)
    if not path.is_dir():
        return _of_file(path, order, progress)
    entries = sorted(entry for entry in path.iterdir() if not entry.name.startswith("."))
    files = [entry for entry in entries if entry.is_file() and entry.suffix.lower() in SUFFIXES]
    jsons = [entry for entry in files if entry.suffix.lower() == ".json"]
    if jsons and is_of_one_image(read_json(jsons[0])):
        return [read_json_folder(path, order=order, progress=progress)]
    if files:
        return [camera for file in _without_twins(files) for camera in _of_file(file, order, progress)]
    folders = [entry for entry in entries if entry.is_dir()]
    for name in POSE_FOLDERS:
        if path / name in folders:
            return _of_path(path / name, order, progress)
    cameras = [folder for folder in folders if any(folder.glob("*.json"))]
    if not cameras:
        if any(entry.suffix.lower() in FILMS for entry in entries):
            fix = "these are films: mocapella people detects and tracks the people in them"
            raise InputError("no detections in this folder", file=path, fix=fix)
        raise InputError("no detections in this folder", file=path, fix=_ONE_EACH)
    return [camera for folder in cameras for camera in _of_path(folder, order, progress)]


def _without_twins(files: Sequence[Path]) -> list[Path]:
    """Leave out a file that has the same name as another in a preferred format, as DeepLabCut and SLEAP write both."""
    tables = {file.stem for file in files if file.suffix.lower() == ".csv"}
    return [file for file in files if file.suffix.lower() in (".csv", ".json") or file.stem not in tables]


def _of_file(path: Path, order: str, progress: Progress) -> list[CameraDetections]:
    progress(path.name)
    suffix = path.suffix.lower()
    if suffix == ".csv":
        return read_detection_table(path, camera_name(path))
    if suffix in (".h5", ".hdf5"):
        return [read_detection_h5(path, camera_name(path))]
    if suffix == ".json":
        return [read_json_video(path, camera_name(path), order=order)]
    raise InputError("no file of detections", file=path, value=suffix, fix=f"give {_KINDS}")
