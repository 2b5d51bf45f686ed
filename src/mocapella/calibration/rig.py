"""A calibration that was found, to be kept: where the sensors stand, and all that is needed to go on from there.

A rig is JSON. People read ``sensors``; the program goes on from ``pairs``, whose sums continue as if nothing had been
in between. A rig that is loaded is believed at first, and checked against what the sensors see (`people`).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.calibration import pair_memory as at
from mocapella.calibration.pair_calibration import PairCalibration, PairSettings
from mocapella.errors import InputError, SettingsError
from mocapella.geometry.alignment import MOMENTS
from mocapella.model.observations import check_sensor_name
from mocapella.model.whole_file import read_whole, write_whole

Float64 = NDArray[np.float64]

VERSION: Final = 1
"""Of the file's layout."""


class RigPair(msgspec.Struct, frozen=True):
    """Two sensors: what `PairCalibration` remembers of them."""

    a: str
    b: str
    quality: str
    T_a_b: list[list[float]]
    moments: list[float]
    scatter: list[list[float]]
    scalars: list[float]


class RigSensor(msgspec.Struct, frozen=True):
    """A sensor's place: ``T_world_sensor`` and its standard deviations."""

    T_world_sensor: list[list[float]]
    position_sd_mm: float
    rotation_sd_deg: float


class Rig(msgspec.Struct, frozen=True):
    """A whole calibration.

    Attributes:
        version: of the layout.
        floor_known: whether y = 0 is the floor.
        sensors: by name.
        pairs: which the sensors' places were made of.
    """

    version: int
    floor_known: bool
    sensors: dict[str, RigSensor]
    pairs: list[RigPair]


def rig_pair(a: str, b: str, quality: str, pair: PairCalibration) -> RigPair:
    """What is kept of a pair. The clocks' offset is not: they are brought together anew at every start."""
    scalars = pair.scalars.copy()
    scalars[at.REFERENCE_OFFSET] = scalars[at.OFFSET] = 0.0
    return RigPair(a, b, quality, pair.T_a_b.tolist(), pair.moments.tolist(), pair.scatter.tolist(), scalars.tolist())


def restored_pair(pair: RigPair, settings: PairSettings) -> PairCalibration:
    """The estimate that goes on from what was kept."""
    return PairCalibration(
        settings,
        np.array(pair.T_a_b),
        np.array(pair.moments),
        np.array(pair.scatter),
        np.array(pair.scalars),
    )


def encode_rig(rig: Rig) -> bytes:
    """As JSON, to be read by people too."""
    return msgspec.json.format(msgspec.json.encode(rig), indent=1)


def decode_rig(data: bytes, *, file: object = None) -> Rig:
    """A rig of JSON.

    Raises:
        InputError: it is none, of another version, or a number in it cannot be; names the field.
    """
    try:
        rig = msgspec.json.decode(data, type=Rig)
    except msgspec.DecodeError as error:
        raise InputError(f"is no rig: {error}", file=file, fix="save the rig anew") from None
    if rig.version != VERSION:
        fix = f"this program reads version {VERSION}: calibrate anew and save"
        raise InputError("is a rig of another version", file=file, field="version", value=rig.version, fix=fix)
    for name, sensor in rig.sensors.items():
        _check_name(name, file)
        _check_motion(sensor.T_world_sensor, f"sensors.{name}.T_world_sensor", file)
    for i, pair in enumerate(rig.pairs):
        field = f"pairs[{i}]"
        for name in (pair.a, pair.b):
            _check_name(name, file)
            if name not in rig.sensors:
                raise InputError("is none of the rig's sensors", file=file, field=field, value=name, fix=_ANEW)
        _check_motion(pair.T_a_b, f"{field}.T_a_b", file)
        shapes = {"moments": (MOMENTS,), "scatter": (7, 7), "scalars": (at.PAIR_SCALARS,)}
        for what, shape in shapes.items():
            _array(getattr(pair, what), shape, f"{field}.{what}", file)
        if not pair.moments[0] > 0:
            raise InputError("has no weight", file=file, field=f"{field}.moments", value=pair.moments[0], fix=_ANEW)
    return rig


_ANEW: Final = "calibrate anew and save"


def _check_name(name: str, file: object) -> None:
    try:
        check_sensor_name(name)
    except SettingsError as error:
        raise InputError(str(error), file=file, field="sensors", value=name, fix=_ANEW) from None


def _array(value: Any, shape: tuple[int, ...], field: str, file: object) -> Float64:
    try:
        array = np.array(value, dtype=np.float64)
    except ValueError:
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


def save_rig(path: Path | str, rig: Rig) -> None:
    """Write a rig; the file appears complete or stays as it was.

    Raises:
        InputError: it cannot be written there.
    """
    write_whole(path, encode_rig(rig))


def load_rig(path: Path | str) -> Rig:
    """Read a rig.

    Raises:
        InputError: there is no such file, or it is no rig.
    """
    return decode_rig(read_whole(path, fix="save a rig first"), file=path)
