"""Read calibrations in OpenCV's file storage, XML or YAML: of OpenPose, EasyMocap, and programs that use OpenCV.

OpenCV has no names for these values, so each program chooses its own. Known are:

- EasyMocap's ``intri.yml`` and ``extri.yml``: ``names``, and for each camera ``K_…``, ``dist_…``, ``Rot_…`` or ``R_…``,
  ``T_…``;
- OpenPose's XML for each camera: ``CameraMatrix`` (3 × 4, world to camera), ``Intrinsics``, ``Distortion``;
- OpenCV's stereo sample, ``M1 D1 M2 D2 R T``, and several cameras, ``camera_matrix_0``, ``camera_pose_0``, …;
- one camera in a file: ``camera_matrix``, ``distortion_coefficients``, a rotation and a translation.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any, Final
from xml.etree.ElementTree import Element

import numpy as np

from mocapella.decoding import decode_xml
from mocapella.errors import InputError
from mocapella.geometry.rigid import inverse, rigid

Storage = Mapping[str, Any]
"""Values of a file by name: arrays of matrices, lists, numbers and texts."""

MOST_VALUES: Final = 1 << 16
"""Largest number of values of a matrix."""
_FIX: Final = "give the calibration as OpenCV's file storage wrote it"
_KEY: Final = re.compile(r"^([A-Za-z_][\w.-]*):(.*)$")
_MATRIX: Final = re.compile(r"rows:\s*(\d+)\s+cols:\s*(\d+)\s+dt:\s*\S+\s+data:\s*\[([^\]]*)\]")
_MATRICES: Final = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "intrinsic_matrix", "intrinsic", "K", "M")
_DISTORTIONS: Final = (
    "distortion_coefficients", "distCoeffs", "dist_coeffs", "dist_coeff", "distortion", "Distortion_Coefficients",
    "camera_distortion", "dist", "D",
)  # fmt: skip
_ROTATIONS: Final = ("Rot", "R", "rotation_matrix", "rotation", "rvec")
_TRANSLATIONS: Final = ("T", "t", "tvec", "translation_vector", "translation")
_POSES: Final = ("camera_pose", "extrinsic_matrix", "extrinsics", "RT")
_WIDTHS: Final = ("image_width", "image_Width", "W", "width")
_HEIGHTS: Final = ("image_height", "image_Height", "H", "height")


def is_opencv_storage(text: str) -> bool:
    """Return whether a text begins as OpenCV's file storage does."""
    start = text.lstrip()[:400]
    return start.startswith("%YAML") or "<opencv_storage" in start


def decode_opencv_storage(text: str, *, file: object = None) -> dict[str, Any]:
    """Return the values of OpenCV's file storage, XML or YAML, by name: only of its first level.

    Raises:
        InputError: the text is none, or a matrix has another number of values than rows and columns.
    """
    if text.lstrip().startswith("<"):
        return {one.tag: _xml_value(one, file) for one in decode_xml(text, file=file, fix=_FIX)}
    return dict(_yaml_values(text, file))


def _xml_value(element: Element, file: object) -> Any:
    rows, cols, data = (element.findtext(name) for name in ("rows", "cols", "data"))
    if rows is not None and cols is not None and data is not None:
        return _matrix(rows, cols, data, element.tag, file)
    text = (element.text or "").strip()
    if len(element):
        return [(one.text or "").strip() for one in element]
    return _plain(text)


def _yaml_values(text: str, file: object) -> Iterator[tuple[str, Any]]:
    """Yield the entries of the first level of OpenCV's YAML."""
    name, lines = "", list[str]()
    for line in [*text.splitlines(), "end:"]:
        found = _KEY.match(line)
        if found is None:
            lines.append(line)
            continue
        if name:
            yield name, _yaml_value(name, "\n".join(lines), file)
        name, lines = found[1], [found[2]]


def _yaml_value(name: str, text: str, file: object) -> Any:
    if "!!opencv-matrix" in text:
        found = _MATRIX.search(text)
        if found is None:
            raise InputError("is no matrix", file=file, field=name, fix=_FIX)
        return _matrix(found[1], found[2], found[3].replace(",", " "), name, file)
    items = re.findall(r"^\s*-\s*(.+?)\s*$", text, flags=re.MULTILINE)
    if items:
        return [_unquoted(item) for item in items]
    flow = text.strip()
    if flow.startswith("["):
        return [_unquoted(item.strip()) for item in flow.strip("[]\n ").split(",") if item.strip()]
    return _plain(_unquoted(flow))


def _unquoted(text: str) -> str:
    return text[1:-1] if len(text) > 1 and text[0] == text[-1] and text[0] in "\"'" else text


def _plain(text: str) -> Any:
    words = text.split()
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        return text
    return text if not numbers else numbers[0] if len(numbers) == 1 else numbers


def _matrix(rows: str, cols: str, data: str, field: str, file: object) -> Any:
    words = data.split()
    sizes = [int(word) if word.strip().isdecimal() and len(word.strip()) < 6 else 0 for word in (rows, cols)]
    if not 0 < sizes[0] * sizes[1] == len(words) <= MOST_VALUES:
        raise InputError(
            "has another number of values than rows and columns", file=file, field=field, value=len(words), fix=_FIX
        )
    try:
        return np.array([float(word) for word in words]).reshape(sizes)
    except ValueError:
        raise InputError("has a value that is no number", file=file, field=field, fix=_FIX) from None


def camera_tables(storages: Mapping[str, Storage], *, file: object = None) -> dict[str, dict[str, Any]]:
    """Return the tables ``size, matrix, distortions, rotation, translation`` of each camera in some files, by name.

    Args:
        storages: the values of each file, by its name without the ending. Files of one camera each give its name.
        file: named in errors.

    Raises:
        InputError: a matrix has another shape, or no names of the values are known.
    """
    merged = {name: value for one in storages.values() for name, value in one.items()}
    names = _texts(merged.get("names"))
    if names:
        return {name: _numbered(merged, f"_{name}", name, file) for name in names}
    for matrices in ("M", "cameraMatrix", "K", "camera_matrix"):
        if {f"{matrices}1", f"{matrices}2"} <= merged.keys():
            return _stereo(merged, file)
    numbered = {
        found[1]
        for name in merged
        for matrix in _MATRICES
        if (found := re.fullmatch(rf"{matrix}_(\w+)", name)) is not None
    }
    if numbered:
        return {f"cam_{one}": _numbered(merged, f"_{one}", one, file) for one in sorted(numbered)}
    alone = {stem: one for stem, one in storages.items() if _first(one, _ALONE, "") is not None}
    return {stem: _numbered(one, "", stem, file) for stem, one in alone.items()}


_ALONE: Final = ("Intrinsics", *_MATRICES)


def _texts(value: Any) -> list[str]:
    texts = [str(one) for one in value] if isinstance(value, list) else str(value).split() if value is not None else []
    return [text.removesuffix(".0") if re.fullmatch(r"\d+\.0", text) else text for text in texts]


def _first(storage: Storage, names: tuple[str, ...], suffix: str) -> Any:
    return next((storage[name + suffix] for name in names if name + suffix in storage), None)


def _numbered(storage: Storage, suffix: str, name: str, file: object) -> dict[str, Any]:
    """Return the table of a camera whose values have names with a suffix."""
    K = _array(_first(storage, _ALONE, suffix), (3, 3), f"matrix of {name}", file)
    rotation, translation = _first(storage, _ROTATIONS, suffix), _first(storage, _TRANSLATIONS, suffix)
    pose = _first(storage, ("CameraMatrix", *_POSES), suffix)
    if pose is not None and np.shape(pose) in ((3, 4), (4, 4)):
        rotation, translation = pose[:3, :3], pose[:3, 3]
    table = {"size": _size(storage, suffix, K), "matrix": K.tolist(), "distortions": _distortions(storage, suffix)}
    return table | {
        key: np.asarray(value, dtype=np.float64).squeeze().tolist()
        for key, value in (("rotation", rotation), ("translation", translation))
        if isinstance(value, np.ndarray)
    }


def _size(storage: Storage, suffix: str, K: Any) -> list[float]:
    """Return the image size; if the file has none, twice the principal point, as Pose2Sim takes it."""
    width, height = _first(storage, _WIDTHS, suffix), _first(storage, _HEIGHTS, suffix)
    if isinstance(width, float) and isinstance(height, float):
        return [width, height]
    both = _first(storage, ("image_size", "imageSize", "size"), suffix)
    both = _first(storage, ("image_size", "imageSize", "size"), "") if both is None else both
    values = np.asarray(both if both is not None else [], dtype=object).ravel().tolist()
    if len(values) == 2 and all(str(one).replace(".", "", 1).isdecimal() for one in values):
        return [float(one) for one in values]
    return [float(np.round(2.0 * K[0, 2])), float(np.round(2.0 * K[1, 2]))]


def _distortions(storage: Storage, suffix: str) -> list[float]:
    found = _first(storage, ("Distortion", *_DISTORTIONS), suffix)
    values = np.asarray(found).ravel() if isinstance(found, np.ndarray) else np.zeros(4)
    while len(values) > 5 and values[-1] == 0:
        values = values[:-1]
    padded = np.r_[values, np.zeros(max(0, 4 - len(values)))]
    return [float(one) for one in padded]


def _stereo(storage: Storage, file: object) -> dict[str, dict[str, Any]]:
    """Return the tables of a pair whose ``R`` and ``T`` go from the first camera to the second."""
    made = {}
    for number in "12":
        table = _numbered(storage, number, number, file)
        table.pop("rotation", None)
        table.pop("translation", None)
        made[f"cam_{number}"] = table
    made["cam_1"] |= {"rotation": np.eye(3).tolist(), "translation": [0.0, 0.0, 0.0]}
    R, T = storage.get("R"), storage.get("T")
    if isinstance(R, np.ndarray) and isinstance(T, np.ndarray):
        made["cam_2"] |= {"rotation": R.squeeze().tolist(), "translation": T.ravel().tolist()}
    return made


def _array(value: Any, shape: tuple[int, ...], what: str, file: object) -> Any:
    if not isinstance(value, np.ndarray) or value.shape != shape:
        wanted = " × ".join(map(str, shape))
        raise InputError(f"has no {what} of {wanted}", file=file, fix=_FIX)
    return value


def qualisys_tables(root: Element, *, file: object = None) -> dict[str, dict[str, Any]]:
    """Return the tables of each camera of a calibration that Qualisys Track Manager exported (``.qca.txt``).

    Positions are in millimetres. Lenses are in 1/64 px; the distortion is of the normalised image and has no unit: the
    chessboard photographs of Pose2Sim's demonstration give the same radial distortion. The rotation is the camera's in
    the world with the camera's y up and z backwards, which is turned to y down and z into the scene. Cameras are
    matched by their serial number.

    Raises:
        InputError: a value is missing or no number, or a camera is rotated in its view.
    """
    found: dict[str, dict[str, Any]] = {}
    for camera in root.iter("camera"):
        name = camera.get("serial") or f"cam_{len(found) + 1}"
        if (camera.get("viewrotation") or "0") not in ("0", "0.0"):
            raise InputError(
                "is rotated in its view", file=file, field=f"{name}.viewrotation", value=camera.get("viewrotation"),
                fix="convert the file with Pose2Sim, or calibrate without a rotation of the view",
            )  # fmt: skip
        lens, pose = camera.find("intrinsic"), camera.find("transform")
        view = camera.find("fov_video")
        view = camera.find("fov_marker") if view is None else view
        if lens is None or pose is None or view is None:
            raise InputError("has no intrinsic, transform or fov_video", file=file, field=name, fix=_EXPORT)
        left, top, right, bottom = (_number(view, key, name, file) for key in ("left", "top", "right", "bottom"))
        fx, fy, cx, cy = (
            _number(lens, key, name, file) / 64.0
            for key in ("focalLengthU", "focalLengthV", "centerPointU", "centerPointV")
        )
        distortions = [
            _number(lens, key, name, file)
            for key in ("radialDistortion1", "radialDistortion2", "tangentalDistortion1", "tangentalDistortion2",
                        "radialDistortion3")
        ]  # fmt: skip
        R = np.diag([1.0, -1.0, -1.0]) @ [[_number(pose, f"r{i}{j}", name, file) for j in (1, 2, 3)] for i in (1, 2, 3)]
        place = np.array([_number(pose, axis, name, file) for axis in "xyz"]) / 1000.0
        T = inverse(rigid(R.T, place))
        found[name] = {
            "size": [right - left + 1, bottom - top + 1],
            "matrix": [[fx, 0.0, cx - left], [0.0, fy, cy - top], [0.0, 0.0, 1.0]],
            "distortions": distortions, "rotation": T[:3, :3].tolist(), "translation": T[:3, 3].tolist(),
        }  # fmt: skip
    if not found:
        raise InputError("holds no camera", file=file, fix=_EXPORT)
    return found


_EXPORT: Final = "export the calibration from Qualisys Track Manager again"


def _number(element: Element, key: str, camera: str, file: object) -> float:
    text = element.get(key)
    try:
        value = float(text) if text is not None else np.nan
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError("is no number", file=file, field=f"{camera}.{element.tag}.{key}", value=text, fix=_EXPORT)
    return value
