"""Read and write camera rigs: our TOML format, and formats of other programs.

Our format is lossless to the bit. `load_camera_rig` recognises the format of a file:

- ours, with ``format = "mocapella camera rig"``;
- Caliscope's ``camera_array.toml`` (a table ``cameras``) and ``config.toml`` (tables ``cam_…``);
- Pose2Sim's ``Calib_*.toml``, also converted from Qualisys, OpenCap or Vicon, and Anipose's ``calibration.toml`` (a
  table for each camera, with a rotation vector);
- OpenCV's file storage, XML or YAML, of OpenPose, EasyMocap and others, see `mocapella.model.opencv_storage`; also a
  folder with a file for each camera, or with ``intri.yml`` and ``extri.yml``;
- Qualisys' ``.qca.txt``.

World frames of other formats are kept: only in ours y is known to be up. If a translation is longer than 100, the
translations of the file are taken as millimetres, the unit of boards in Anipose and others.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import decode_text, decode_toml, decode_xml, read_whole
from mocapella.errors import InputError, SettingsError
from mocapella.geometry.rigid import rigid
from mocapella.geometry.twists import exp_twist
from mocapella.model.camera import Camera, CameraRig, PlacedCamera
from mocapella.model.observations import check_sensor_name
from mocapella.model.opencv_storage import camera_tables, decode_opencv_storage, is_opencv_storage, qualisys_tables
from mocapella.model.whole_file import write_whole

Float64 = NDArray[np.float64]

FORMAT: Final = "mocapella camera rig"
VERSION: Final = 1
"""Version of the file's layout."""
FARTHEST_M: Final = 100.0
"""Translations of other programs' files are millimetres if one is longer [m]."""
_STORAGES: Final = (".xml", ".yml", ".yaml")
_PARTNERS: Final = {"intri": "extri", "extri": "intri", "intrinsics": "extrinsics", "extrinsics": "intrinsics"}
_KNOWN: Final = (
    "use a file of mocapella calibrate, Caliscope, Pose2Sim, Anipose, OpenCV (XML, YAML), EasyMocap (folder of "
    "intri.yml and extri.yml) or Qualisys (.qca.txt)"
)
_ANEW: Final = "calibrate anew: mocapella calibrate cameras"
_MISSING: Final = "name the file or folder of a rig, or calibrate: mocapella calibrate cameras"
_FIELDS: Final = ("size_px", "focal_px", "centre_px", "distortion", "T_camera_world")
_OPTIONAL: Final = ("covariance", "readout_s", "clock_s")


def save_camera_rig(path: Path | str, rig: CameraRig) -> None:
    """Write a rig as a TOML file in Mocapella's format, atomically: the file is complete or unchanged.

    Raises:
        InputError: it cannot be written there.
    """
    write_whole(path, encode_camera_rig(rig).encode())


def _table(placed: PlacedCamera) -> dict[str, Any]:
    camera = placed.camera
    lens = [float(value) for value in camera.lens]
    table: dict[str, Any] = {
        "size_px": list(camera.size_px),
        "focal_px": lens[:2],
        "centre_px": lens[2:4],
        "distortion": lens[4:],
        "readout_s": float(camera.readout_s),
        "clock_s": float(placed.clock_s),
        "T_camera_world": np.asarray(placed.T_camera_world, dtype=np.float64).tolist(),
    }
    if np.isfinite(placed.covariance).all():
        table["covariance"] = np.asarray(placed.covariance, dtype=np.float64).tolist()
    return table


def load_camera_rig(path: Path | str) -> CameraRig:
    """Read a rig from a file, or a folder, of one of the formats above; the format is recognised.

    The world frame stays the file's; only in Mocapella's format y is known to be up. Numbers that a format lacks are
    NaN (covariance) or 0. Cameras that Caliscope ignores are left out, and its numbered ones are called ``cam_0``, ….

    Raises:
        InputError: the file does not exist, or has another format; states the field, its value and a remedy.
    """
    path = Path(path)
    if not os.path.exists(path):  # noqa: PTH110  Path.exists raises an error for a NUL in the name
        raise InputError("is not there", file=path, fix=_MISSING)
    if path.is_dir():
        return _of_storages(_storage_files(path), path)
    partner = _PARTNERS.get(path.stem.lower())
    if partner is not None and path.suffix.lower() in _STORAGES:
        both = (partner, path.stem.lower())
        return _of_storages([one for one in _files_like(path.parent) if one.stem.lower() in both], path)
    return decode_camera_rig(read_whole(path, fix=_ANEW), file=path)


def _storage_files(folder: Path) -> list[Path]:
    """Return the files of a folder in OpenCV's file storage; of EasyMocap's two files these alone."""
    files = _files_like(folder)
    return [one for one in files if one.stem.lower() in ("intri", "extri")] or files


def _files_like(folder: Path) -> list[Path]:
    return sorted(one for one in folder.iterdir() if one.suffix.lower() in _STORAGES)


def _of_storages(files: Sequence[Path], path: Path) -> CameraRig:
    """Return the rig of several files in OpenCV's file storage."""
    storages = {}
    for file in files:
        text = decode_text(read_whole(file, fix=_ANEW), file=file, fix=_ANEW)
        storages[file.stem] = decode_opencv_storage(text, file=file)
    tables = camera_tables(storages, file=path)
    if not tables:
        raise InputError("holds no cameras that are known here", file=path, fix=_KNOWN)
    return _rig(tables, path)


def encode_camera_rig(rig: CameraRig) -> str:
    """Encode a rig as TOML in Mocapella's format, without loss; a covariance that is not finite is left out."""
    import tomli_w

    cameras = {name: _table(placed) for name, placed in rig.cameras.items()}
    return tomli_w.dumps({"format": FORMAT, "version": VERSION, "cameras": cameras}, multiline_strings=False)


def decode_camera_rig(text: bytes | str, *, file: object = None) -> CameraRig:
    """Decode a rig from the TOML text of a file that `load_camera_rig` reads.

    Args:
        text: the TOML text.
        file: named in errors; None leaves it out.

    Raises:
        InputError: as `load_camera_rig`.
    """
    path = file
    whole = decode_text(text, file=path, fix=_ANEW)
    if is_opencv_storage(whole):
        tables = camera_tables({"cam": decode_opencv_storage(whole, file=path)}, file=path)
    elif whole.lstrip().startswith("<"):
        tables = qualisys_tables(decode_xml(whole, file=path, fix=_ANEW), file=path)
    else:
        data = decode_toml(whole, file=path, fix=_ANEW)
        if "format" in data:
            return _ours(data, path)
        tables = _tables_of_others(data)
    if tables:
        return _rig(tables, path)
    raise InputError("holds no cameras that are known here", file=path, fix=_KNOWN)


def is_camera_rig(text: bytes | str) -> bool:
    """Return whether a text is a camera rig in a format that `load_camera_rig` reads, complete or not.

    It is False for a text of another kind; nothing is raised.
    """
    try:
        whole = decode_text(text)
        if is_opencv_storage(whole):
            return bool(camera_tables({"cam": decode_opencv_storage(whole)}))
        if whole.lstrip().startswith("<"):
            return next(decode_xml(whole).iter("camera"), None) is not None
        data = decode_toml(whole)
    except InputError:
        return False
    return data.get("format") == FORMAT or bool(_tables_of_others(data))


def _tables_of_others(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return Caliscope's or Pose2Sim's table of each camera, by name; empty without any."""
    tables = data.get("cameras")
    if isinstance(tables, dict) and tables:
        return {f"cam_{name}" if name.isdecimal() else name: table for name, table in tables.items()}
    found = {name: table for name, table in data.items() if isinstance(table, dict) and "matrix" in table}
    own = {name: table.get("name") for name, table in found.items()}
    usable = all(isinstance(one, str) and _is_name(one) for one in own.values())
    if not usable or len(set(own.values())) < len(own):
        return found
    return {str(own[name]): table for name, table in found.items()}  # Anipose numbers its tables


def _is_name(text: str) -> bool:
    try:
        check_sensor_name(text)
    except SettingsError:
        return False
    return True


def _ours(data: Mapping[str, Any], path: object) -> CameraRig:
    if data["format"] != FORMAT:
        raise InputError("is something else", file=path, field="format", value=data["format"], fix=f"it is {FORMAT!r}")
    if data.get("version") != VERSION:
        fix = f"this program reads version {VERSION}: calibrate anew"
        raise InputError("is of another version", file=path, field="version", value=data.get("version"), fix=fix)
    tables = data.get("cameras")
    if not isinstance(tables, dict) or not tables:
        raise InputError("has no cameras", file=path, field="cameras", fix=_ANEW)
    cameras = {}
    for name, table in tables.items():
        where = f"cameras.{name}"
        _check_name(name, where, path)
        if not isinstance(table, dict):
            raise InputError("is no table", file=path, field=where, value=table, fix=_ANEW)
        for key in table:
            if key not in _FIELDS + _OPTIONAL:
                known = ", ".join(_FIELDS + _OPTIONAL)
                raise InputError("is not known", file=path, field=f"{where}.{key}", fix=f"a camera has {known}")
        for key in _FIELDS:
            if key not in table:
                raise InputError("is missing", file=path, field=f"{where}.{key}", fix=_ANEW)
        read = _Table(table, where, path)
        lens = np.concatenate(
            [read.array("focal_px", (2,)), read.array("centre_px", (2,)), read.array("distortion", (5,))]
        )
        covariance = read.array("covariance", (6, 6)) if "covariance" in table else np.full((6, 6), np.nan)
        camera = Camera(name, read.size("size_px"), _checked_lens(lens, where, path), read.seconds("readout_s"))
        T = _motion(read.array("T_camera_world", (4, 4)), f"{where}.T_camera_world", path)
        cameras[name] = PlacedCamera(camera, T, covariance, read.seconds("clock_s"))
    return CameraRig(cameras)


def _rig(tables: Mapping[str, Any], path: object) -> CameraRig:
    """Return the rig of such tables: OpenCV's matrix, distortions, rotation and translation."""
    cameras = {}
    for name, table in tables.items():
        _check_name(name, name, path)
        if not isinstance(table, dict):
            raise InputError("is no table", file=path, field=name, value=table, fix=_ANEW)
        if table.get("ignore") is True:
            continue
        if table.get("fisheye") is True:
            fix = "calibrate this camera with mocapella calibrate cameras"
            raise InputError("is of a lens model that is not known here", file=path, field=f"{name}.fisheye", fix=fix)
        for key in ("size", "matrix", "distortions", "rotation", "translation"):
            if table.get(key) is None:
                fix = "finish the calibration in the program that wrote it"
                raise InputError("is missing", file=path, field=f"{name}.{key}", fix=fix)
        cameras[name] = _foreign(name, table, path)
    if not cameras:
        raise InputError("all its cameras are ignored", file=path, fix="name a rig with a camera")
    return CameraRig(_in_metres(cameras))


def _in_metres(cameras: Mapping[str, PlacedCamera]) -> dict[str, PlacedCamera]:
    """Return cameras whose translations are divided by 1000 if one is longer than any room in metres."""
    longest = max(float(np.linalg.norm(one.T_camera_world[:3, 3])) for one in cameras.values())
    if longest <= FARTHEST_M:
        return dict(cameras)
    made = {}
    for name, one in cameras.items():
        T = one.T_camera_world.copy()
        T[:3, 3] /= 1000.0
        made[name] = PlacedCamera(one.camera, T, one.covariance, one.clock_s)
    return made


def _foreign(name: str, table: Mapping[str, Any], path: object) -> PlacedCamera:
    read = _Table(table, name, path)
    K = read.array("matrix", (3, 3))
    if K[0, 1] or not np.array_equal(K[2], [0, 0, 1]):
        raise InputError("is no camera matrix without skew", file=path, field=f"{name}.matrix", value=K.tolist())
    distortions = read.array("distortions", None).ravel()
    if len(distortions) not in (4, 5):
        fix = "four (k1 k2 p1 p2) or five (and k3)"
        raise InputError("are not as many as are known here", file=path, field=f"{name}.distortions", fix=fix)
    lens = np.concatenate([[K[0, 0], K[1, 1], K[0, 2], K[1, 2]], distortions, np.zeros(5 - len(distortions))])
    turned = read.array("rotation", None)
    if turned.size == 3:
        R = exp_twist(np.r_[np.zeros(3), turned.ravel()])[:3, :3]
    elif turned.shape == (3, 3):
        R = turned
    else:
        fix = "a vector of 3 or a matrix of 3 × 3 numbers"
        raise InputError("is no rotation", file=path, field=f"{name}.rotation", value=turned.tolist(), fix=fix)
    t = read.array("translation", None).ravel()
    if len(t) != 3:
        raise InputError("is no place", file=path, field=f"{name}.translation", value=t.tolist(), fix="3 numbers, in m")
    T = _motion(rigid(R, t), f"{name}.rotation", path)
    camera = Camera(name, read.size("size"), _checked_lens(lens, name, path))
    return PlacedCamera(camera, T, np.full((6, 6), np.nan))


class _Table:
    """Reads the fields of one camera's table."""

    def __init__(self, table: Mapping[str, Any], where: str, path: object) -> None:
        self.table, self.where, self.path = table, where, path

    def array(self, key: str, shape: tuple[int, ...] | None) -> Float64:
        try:
            array = np.array(self.table[key], dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            array = np.full(1, np.nan)
        if (shape is not None and array.shape != shape) or not np.isfinite(array).all():
            wanted = "numbers" if shape is None else " × ".join(map(str, shape)) + " numbers"
            raise InputError(
                "cannot be used",
                file=self.path,
                field=f"{self.where}.{key}",
                value=self.table[key],
                fix=f"it has {wanted}",
            )
        return array

    def size(self, key: str) -> tuple[int, int]:
        width, height = self.array(key, (2,))
        if not (width >= 1 and height >= 1 and width == int(width) and height == int(height)):
            raise InputError(
                "is no size of a picture",
                file=self.path,
                field=f"{self.where}.{key}",
                value=self.table[key],
                fix="width and height in whole pixels",
            )
        return int(width), int(height)

    def seconds(self, key: str) -> float:
        return float(self.array(key, ())) if key in self.table else 0.0


def _check_name(name: str, where: str, path: object) -> None:
    try:
        check_sensor_name(name)
    except SettingsError as error:
        raise InputError(str(error), file=path, field=where) from None


def _checked_lens(lens: Float64, where: str, path: object) -> Float64:
    if not (lens[:2] > 0).all():
        raise InputError("no focal length is 0 or less", file=path, field=where, value=lens[:2].tolist(), fix=_ANEW)
    return lens


def _motion(T: Float64, field: str, path: object) -> Float64:
    R = T[:3, :3]
    rigid_motion = np.allclose(R @ R.T, np.eye(3), atol=1e-4) and np.linalg.det(R) > 0
    if not rigid_motion or not np.allclose(T[3], [0, 0, 0, 1]):
        raise InputError("is no rigid motion", file=path, field=field, value=T.tolist(), fix=_ANEW)
    return T
