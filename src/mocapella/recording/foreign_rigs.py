"""Rigs of cameras in other people's TOML: Caliscope's ``config.toml`` and Pose2Sim's ``Calib.toml``."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from mocapella.errors import InputError
from mocapella.geometry.rigid import rigid
from mocapella.model.camera import Camera, CameraRig, PlacedCamera


def load_camera_rig(path: Path) -> CameraRig:
    """The rig of a file: every table with a matrix, distortions, rotation and translation is a camera.

    Raises:
        InputError: names file, field and value.
    """
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"cannot be read as a rig: {error}", file=path, fix="give a rig as TOML") from error
    cameras = {name: _camera(path, name, table) for name, table in data.items() if _is_camera(table)}
    if len(cameras) < 2:
        raise InputError(f"{len(cameras)} cameras", file=path, fix="give a rig of two cameras or more")
    return CameraRig(cameras)


def _is_camera(table: Any) -> bool:
    return isinstance(table, dict) and "matrix" in table and not table.get("ignore", False)


def _camera(path: Path, name: str, table: dict[str, Any]) -> PlacedCamera:
    def numbers(field: str, *shapes: tuple[int, ...]) -> Any:
        try:
            value = np.array(table[field], dtype=np.float64)
        except (KeyError, TypeError, ValueError):
            value = np.zeros(0)
        if value.shape not in shapes or not np.isfinite(value).all():
            wanted = " or ".join("×".join(map(str, shape)) for shape in shapes)
            raise InputError("missing or not numbers", file=path, field=f"{name}.{field}", fix=f"give {wanted} numbers")
        return value

    K, d = numbers("matrix", (3, 3)), numbers("distortions", (4,), (5,))
    rotation = numbers("rotation", (3,), (3, 3))
    R = rotation if rotation.shape == (3, 3) else _rotation(rotation)
    lens = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *d[:4], d[4] if len(d) == 5 else 0.0])
    width, height = (int(n) for n in numbers("size", (2,)))
    return PlacedCamera(
        Camera(name, (width, height), lens), rigid(R, numbers("translation", (3,))), np.full((6, 6), np.nan)
    )


def _rotation(vector: Any) -> Any:
    """The matrix of a rotation vector, by Rodrigues' formula."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
