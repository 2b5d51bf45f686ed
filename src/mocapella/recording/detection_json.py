"""Read detections of people from JSON of OpenPose, MMPose and RTMLib, and AlphaPose.

OpenPose writes a file for each image, as Pose2Sim does, of any set of keypoints; MMPose a file for each image or video;
AlphaPose a file for each video. The formats are distinguished by their content.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import MOST_TABLE_BYTES, decode_json, read_whole
from mocapella.errors import InputError
from mocapella.model.keypoints import NO_ID
from mocapella.model.topology import topology
from mocapella.recording.detections import (
    AUTO,
    ORDERS,
    CameraDetections,
    Detections,
    by_frame,
    check_detections,
    detections,
    no_detections,
    topology_by_count,
)

Float64 = NDArray[np.float64]
Progress = Callable[[str], None]
_AGAIN: Final = "leave it out or write it again"
_SAMPLE: Final = 200
"""Number of detections that decide the order of 25 points."""
_BIG: Final = 2**62


class _Person(NamedTuple):
    """A detection: (points, 3) x, y [px] and confidence, its id, and where the file has it."""

    values: Float64
    id: int
    field: str


def read_json(path: Path) -> Any:
    """Return the content of a JSON file.

    Raises:
        InputError: the file cannot be read, or is no JSON.
    """
    return decode_json(read_whole(path, fix=_AGAIN, most_bytes=MOST_TABLE_BYTES), file=path, fix=_AGAIN)


def is_of_one_image(data: Any) -> bool:
    """Return whether a file's content is of one image, so that a camera has a folder of such files."""
    if isinstance(data, dict):
        return "people" in data
    return isinstance(data, list) and (not data or _is_instance(data[0]))


def read_json_folder(folder: Path, *, order: str = AUTO, progress: Progress = lambda _text: None) -> CameraDetections:
    """Read a camera's folder with a file for each image, whose last number is that of the frame.

    Args:
        folder: the folder; the camera gets its name.
        order: order of the keypoints, a key of `ORDERS` or `AUTO`.
        progress: receives the name of each file before it is read.

    Raises:
        InputError: the folder has no JSON, a file is none of one image, two are of one frame, or their points are not
            in the declared order.
    """
    files = sorted(folder.glob("*.json"))
    if not files:
        raise InputError("no JSON in this folder", file=folder, fix="name a folder that OpenPose wrote for one camera")
    people: dict[int, list[_Person]] = {}
    of_file: dict[int, Path] = {}
    for path in files:
        progress(f"{folder.name}/{path.name}")
        number = frame_of(path.stem, file=path, fix="name it like NAME_000012_keypoints.json")
        if number in people:
            raise InputError("two files of one frame", file=path, value=number, fix="give a camera a folder of its own")
        people[number], of_file[number] = _people(read_json(path), path), path
    return _camera(folder.name, people, order, lambda number: of_file[number], folder)


def read_json_video(path: Path, camera: str, *, order: str = AUTO) -> CameraDetections:
    """Read a file with all images of a camera, of MMPose or AlphaPose.

    Args:
        path: the file.
        camera: name of the camera.
        order: order of the keypoints, a key of `ORDERS` or `AUTO`.

    Raises:
        InputError: the file has another format, an invalid value, or points that are not in the declared order.
    """
    data = read_json(path)
    people: dict[int, list[_Person]] = {}
    if isinstance(data, dict) and isinstance(data.get("instance_info"), list):
        data = data["instance_info"]
    if not isinstance(data, list) or not data or not all(isinstance(row, dict) for row in data):
        raise InputError(
            "no keypoints of people that are known here", file=path,
            fix="give JSON of OpenPose, MMPose or AlphaPose, CSV or H5 of DeepLabCut or SLEAP, or Mocapella's CSV",
        )  # fmt: skip
    for i, row in enumerate(data):
        if "instances" in row:
            number = _whole(row.get("frame_id"), path, f"[{i}].frame_id")
            if number in people:
                raise InputError("the frame is there twice", file=path, field=f"[{i}].frame_id", value=number)
            people[number] = _instances(row["instances"], path, f"[{i}].instances")
        else:
            field = f"[{i}].image_id"
            image = row.get("image_id")
            fix = "give the file that AlphaPose or MMPose wrote for one camera"
            number = (
                _whole(image, path, field) if isinstance(image, int) else frame_of(
                    Path(image).stem if isinstance(image, str) else "", file=path, fix=fix, field=field
                )
            )  # fmt: skip
            people.setdefault(number, []).append(_alphapose(row, path, f"[{i}]"))
    return _camera(camera, people, order, lambda number: path, path)


def _camera(
    name: str, people: Mapping[int, Sequence[_Person]], order: str, file_of: Callable[[int], Path], whole: Path
) -> CameraDetections:
    """Return the detections of a camera, whose topology follows from the number of points."""
    first = next(((number, one) for number, row in people.items() for one in row), None)
    count = _count_of_none(order) if first is None else len(first[1].values)
    file, field = (whole, None) if first is None else (file_of(first[0]), first[1].field)
    for number, row in people.items():
        for one in row:
            if len(one.values) != count:
                raise InputError(
                    f"has {len(one.values)} points, and others have {count}", file=file_of(number), field=one.field,
                    fix="write all files of a camera with one model",
                )  # fmt: skip
    known = [one.values for row in people.values() for one in row]
    sample = np.array(known[:: max(1, len(known) // _SAMPLE)]).reshape(-1, count, 3)
    own = topology_by_count(count, order, sample, file=file, field=field)
    frames: dict[int, Detections] = {}
    for number, row in people.items():
        values = np.array([one.values for one in row]).reshape(-1, count, 3)
        check_detections(values, file=file_of(number), field="keypoints")
        frames[number] = detections(values, [one.id for one in row]) if row else no_detections(count)
    return by_frame(name, own.joints, frames, own=own)


def _count_of_none(order: str) -> int:
    """Return the number of points of files without any person: that of the declared order, or 25."""
    return len(topology(ORDERS[order.upper()])) if order.upper() in ORDERS else 25


def frame_of(text: str, *, file: object, fix: str, field: str | None = None) -> int:
    """Return the number of a frame, the last one in a name.

    Raises:
        InputError: there is none, or it is too large.
    """
    numbers = re.findall(r"\d+", text)
    if not numbers:
        raise InputError("no frame number in its name", file=file, field=field, value=text or None, fix=fix)
    if len(numbers[-1]) > 18:
        raise InputError("no number of a frame", file=file, field=field, value=numbers[-1][:20], fix=fix)
    return int(numbers[-1])


def _whole(value: Any, path: Path, field: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not -_BIG < value < _BIG:
        raise InputError("no number of a frame", file=path, field=field, value=value, fix="a whole number")
    return value


def _people(data: Any, path: Path) -> list[_Person]:
    """Return the people in a file of one image."""
    if isinstance(data, list):
        return _instances(data, path, "")
    people = data.get("people") if isinstance(data, dict) else None
    if not isinstance(people, list):
        raise InputError("no list of people", file=path, field="people", fix="give files of OpenPose's --write_json")
    found = []
    for i, person in enumerate(people):
        field = f"people[{i}].pose_keypoints_2d"
        values = person.get("pose_keypoints_2d", []) if isinstance(person, dict) else None
        if values == []:
            continue  # a person without keypoints, as programs write who they do not see
        if not isinstance(values, list) or len(values) % 3:
            count = len(values) if isinstance(values, list) else None
            raise InputError(
                "not x, y and confidence of each point", file=path, field=field, value=count, fix="write it again"
            )
        keypoints = _numbers(values, path, field).reshape(-1, 3)
        if not np.isfinite(keypoints).all() or (keypoints[:, 2] < 0).any():
            raise InputError(
                "not finite numbers, or a confidence below 0", file=path, field=field, fix="write it again"
            )
        found.append(_Person(keypoints, _id(person.get("person_id")), field))
    return found


def _instances(instances: Any, path: Path, field: str) -> list[_Person]:
    """Return the people of MMPose's list of instances."""
    if not isinstance(instances, list):
        raise InputError("is no list of people", file=path, field=field, fix="give MMPose's predictions")
    found = []
    for i, one in enumerate(instances):
        where = f"{field}[{i}]"
        if not _is_instance(one):
            raise InputError("has no keypoints and keypoint_scores", file=path, field=where, fix="give MMPose's file")
        points, scores = (_numbers(one[key], path, f"{where}.{key}") for key in ("keypoints", "keypoint_scores"))
        if points.ndim != 2 or points.shape[1] != 2 or scores.shape != points.shape[:1] or not len(points):
            raise InputError(
                "is not x and y of each point, with a score each", file=path, field=f"{where}.keypoints",
                value=list(points.shape), fix="give predictions in the image, not in space",
            )  # fmt: skip
        own_id = _id(one.get("track_id", one.get("instance_id")))
        found.append(_Person(np.column_stack([points, scores]), own_id, f"{where}.keypoints"))
    return found


def _is_instance(value: Any) -> bool:
    return isinstance(value, dict) and "keypoints" in value and "keypoint_scores" in value


def _alphapose(row: Mapping[str, Any], path: Path, field: str) -> _Person:
    values = row.get("keypoints")
    if not isinstance(values, list) or not values or len(values) % 3:
        count = len(values) if isinstance(values, list) else None
        raise InputError(
            "not x, y and confidence of each point", file=path, field=f"{field}.keypoints", value=count,
            fix="give AlphaPose's alphapose-results.json in its default format",
        )  # fmt: skip
    field = f"{field}.keypoints"
    return _Person(_numbers(values, path, field).reshape(-1, 3), _id(row.get("idx")), field)


def _id(value: Any) -> int:
    """Return the id that a program gave a person: a number, or a list of one; `NO_ID` without."""
    if isinstance(value, list):
        value = value[0] if len(value) == 1 else None
    usable = isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value < _BIG
    return int(value) if usable and value == int(value) else NO_ID


def _numbers(values: Any, path: Path, field: str) -> Float64:
    try:
        found = np.array(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError("not numbers", file=path, field=field, fix="write it again") from error
    return found
