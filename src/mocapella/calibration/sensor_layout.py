"""The sensor layout: poses of body sensors from people's motion, and the state that calibration continues from.

A layout file is JSON. Users read ``sensors``; the program continues from the sums in ``pairs``. A loaded layout is used
at once, and checked against the sensors' frames (`people`).

A camera rig is something else: lenses and poses of calibrated cameras (`mocapella.model.camera.CameraRig`, TOML).
Both were once called rig; takes still hold the sensor layout under that name (`RECORDED_AS` of a class).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.calibration import pair_memory as at
from mocapella.calibration.pair_calibration import PairCalibration, PairSettings
from mocapella.decoding import decode_json, read_whole
from mocapella.errors import InputError, SettingsError
from mocapella.geometry.alignment import MOMENTS
from mocapella.model.observations import check_sensor_name
from mocapella.model.whole_file import write_whole

Float64 = NDArray[np.float64]

VERSION: Final = 1
"""Version of the file's format."""


class LayoutPair(msgspec.Struct, frozen=True):
    """State of the `PairCalibration` of two sensors, as stored in a layout file.

    Attributes:
        a, b: names of the sensors.
        quality: description for users.
        T_a_b: (4, 4) from b's camera space to a's.
        moments, scatter, scalars: arrays of the `PairCalibration`.
    """

    RECORDED_AS: ClassVar[str] = "RigPair"

    a: str
    b: str
    quality: str
    T_a_b: list[list[float]]
    moments: list[float]
    scatter: list[list[float]]
    scalars: list[float]


class LayoutSensor(msgspec.Struct, frozen=True):
    """A sensor's pose, as stored in a layout file.

    Attributes:
        T_world_sensor: (4, 4) [m].
        position_sd_mm: standard deviation of its position [mm].
        rotation_sd_deg: standard deviation of its rotation [°].
    """

    RECORDED_AS: ClassVar[str] = "RigSensor"

    T_world_sensor: list[list[float]]
    position_sd_mm: float
    rotation_sd_deg: float


class SensorLayout(msgspec.Struct, frozen=True):
    """Poses of all sensors, and the pairs they were computed from.

    Attributes:
        version: version of the file's format.
        floor_known: whether y = 0 is the floor.
        sensors: pose of each sensor by name.
        pairs: state of the calibration of each pair of sensors.
    """

    RECORDED_AS: ClassVar[str] = "Rig"

    version: int
    floor_known: bool
    sensors: dict[str, LayoutSensor]
    pairs: list[LayoutPair]


def layout_pair(a: str, b: str, quality: str, pair: PairCalibration) -> LayoutPair:
    """Return the part of a pair's state to save, without the clock offset, which is estimated again at every start.

    Args:
        a, b: names of the sensors.
        quality: description of the pair for users.
        pair: the pair's state.
    """
    scalars = pair.scalars.copy()
    scalars[at.REFERENCE_OFFSET] = scalars[at.OFFSET] = 0.0
    return LayoutPair(
        a, b, quality, pair.T_a_b.tolist(), pair.moments.tolist(), pair.scatter.tolist(), scalars.tolist()
    )


def restored_pair(pair: LayoutPair, settings: PairSettings) -> PairCalibration:
    """Return a new estimator that continues from a saved pair, with these settings and an unknown clock offset."""
    return PairCalibration(
        settings,
        np.array(pair.T_a_b),
        np.array(pair.moments),
        np.array(pair.scatter),
        np.array(pair.scalars),
    )


def encode_layout(layout: SensorLayout) -> bytes:
    """Encode a layout as indented JSON."""
    return msgspec.json.format(msgspec.json.encode(layout), indent=1)


def decode_layout(data: bytes, *, file: object = None) -> SensorLayout:
    """Decode a sensor layout from a JSON file's content.

    Args:
        data: the content.
        file: named in errors; None leaves it out.

    Raises:
        InputError: it is no layout, has another version, or contains an invalid number; names the field.
    """
    fix = "save it anew: mocapella serve --set save_layout=FILE"
    layout = decode_json(data, SensorLayout, what="sensor layout", file=file, fix=fix)
    if layout.version != VERSION:
        fix = f"this program reads version {VERSION}: calibrate anew and save"
        raise InputError(
            "is a sensor layout of another version", file=file, field="version", value=layout.version, fix=fix
        )
    for name, sensor in layout.sensors.items():
        _check_name(name, file)
        _check_motion(sensor.T_world_sensor, f"sensors.{name}.T_world_sensor", file)
    for i, pair in enumerate(layout.pairs):
        field = f"pairs[{i}]"
        for name in (pair.a, pair.b):
            _check_name(name, file)
            if name not in layout.sensors:
                raise InputError("is none of the layout's sensors", file=file, field=field, value=name, fix=_ANEW)
        _check_motion(pair.T_a_b, f"{field}.T_a_b", file)
        shapes = {"moments": (MOMENTS,), "scatter": (7, 7), "scalars": (at.PAIR_SCALARS,)}
        for what, shape in shapes.items():
            _array(getattr(pair, what), shape, f"{field}.{what}", file)
        for what, weight in (("moments", pair.moments[0]), ("scalars", pair.scalars[at.COST_WEIGHT])):
            if not weight > 0:
                raise InputError("has no weight", file=file, field=f"{field}.{what}", value=weight, fix=_ANEW)
    return layout


_ANEW: Final = "calibrate anew and save"


def _check_name(name: str, file: object) -> None:
    try:
        check_sensor_name(name)
    except SettingsError as error:
        raise InputError(str(error), file=file, field="sensors", value=name, fix=_ANEW) from None


def _array(value: Any, shape: tuple[int, ...], field: str, file: object) -> Float64:
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.zeros(0)
    if array.shape != shape or not np.isfinite(array).all():
        raise InputError(f"is no array {shape} of finite numbers", file=file, field=field, fix=_ANEW)
    return array


def _check_motion(value: Any, field: str, file: object) -> None:
    T = _array(value, (4, 4), field, file)
    R = T[:3, :3]
    rigid = np.allclose(R @ R.T, np.eye(3), atol=1e-6) and np.linalg.det(R) > 0
    if not rigid or not np.allclose(T[3], [0, 0, 0, 1]):
        raise InputError("is no rigid motion", file=file, field=field, fix=_ANEW)


def is_layout(data: bytes) -> bool:
    """Return whether the bytes are a layout (JSON with ``sensors``), valid or not."""
    try:
        return "sensors" in decode_json(data, dict[str, msgspec.Raw])
    except InputError:
        return False


def save_layout(path: Path | str, layout: SensorLayout) -> None:
    """Write a layout as a JSON file, atomically: the file is complete or unchanged.

    Raises:
        InputError: it cannot be written there.
    """
    write_whole(path, encode_layout(layout))


def load_layout(path: Path | str) -> SensorLayout:
    """Read a sensor layout from a JSON file of `save_layout`.

    Raises:
        InputError: the file does not exist, or is no layout.
    """
    return decode_layout(read_whole(path, fix="save one first: mocapella serve --set save_layout=FILE"), file=path)
