"""Check the fields of decoded protobuf messages.

An invalid field raises a `WireError` with the field, its value, and the valid values. An argument ``field`` is the
field's name in such errors, such as ``Hand.angles_rad``.
Untrusted text is shortened before it is compared or printed: a name of sixteen megabytes must cost nothing.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, Final

import numpy as np
from google.protobuf.message import DecodeError, Message
from numpy.typing import NDArray

from mocapella.conventions import SCHEMA_VERSION
from mocapella.errors import SchemaVersionError, SettingsError, WireError, one_of
from mocapella.model.limits import COORDINATE, FRAME_HEIGHT, SCENE_COORDINATE, TILT, Range
from mocapella.model.observations import check_sensor_name
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.topology import Topology, topology, topology_names

MAX_BODIES: Final = 1024
"""Largest number of bodies in a frame; a frame with more is refused before memory is allocated for it."""
MAX_POINTS: Final = 1024
"""Largest number of names in one field of a message, such as of markers in a frame or of points in a scene."""
MAX_NAME: Final = 80
"""Longest name in a message, such as a marker's or an object's, in characters."""
MAX_MESSAGE_BYTES: Final = 16 * 1024 * 1024
MAX_SCENE_BYTES: Final = 4 * 1024 * 1024
"""Largest encoded scene, in bytes; decoded, its nested messages take about forty times as much memory."""
MAX_COORDINATE: Final = COORDINATE.high
"""Largest absolute coordinate in a sensor's frame [m]."""

F4: Final = np.dtype("<f4")
F8: Final = np.dtype("<f8")
I8: Final = np.dtype("<i8")
U8: Final = np.dtype("<u8")
U1: Final = np.dtype("u1")
STATES: Final = bytes((0, 1, 2))
FLAGS: Final = bytes((0, 1))

_RIGID: Final = 1e-4
"""Tolerance of the orthonormality of a rotation's columns."""


def parse(kind: Any, data: bytes, limit: int) -> Any:
    """Parse the bytes of a protobuf message, and check its schema version.

    Args:
        kind: the message's class.
        data: its bytes.
        limit: largest number of bytes.

    Raises:
        WireError: the bytes are too many, or no message of this class.
        SchemaVersionError: this program does not support the message's schema version.
    """
    if len(data) > limit:
        raise WireError(f"{kind.DESCRIPTOR.name} of {len(data)} bytes; at most {limit} are read")
    try:
        message: Message = kind.FromString(data)
    except DecodeError as error:
        raise WireError(f"{len(data)} bytes that are no {kind.DESCRIPTOR.name} message ({error})") from error
    version = message.schema_version  # type: ignore[attr-defined]
    if version != SCHEMA_VERSION:
        said = f"is of schema version {version}" if version else "does not say its schema version"
        raise SchemaVersionError(
            f"{kind.DESCRIPTOR.name} {said}; this program reads version {SCHEMA_VERSION}: "
            "publish with a Mocapella of the same schema (mocapella --version)"
        )
    return message


@lru_cache(maxsize=64)
def known_topology(name: str) -> Topology:
    """Return the topology with a name.

    Raises:
        WireError: no topology has this name; lists the known ones.
    """
    try:
        return topology(name[:80])
    except SettingsError:
        raise WireError(f"topology is {name[:80]!r}; known: {one_of(name[:80], topology_names())}") from None


@lru_cache(maxsize=4096)
def sensor_name(name: str) -> str:
    """Return a sensor's name unchanged if it is valid.

    Raises:
        WireError: the name is invalid; describes valid names.
    """
    try:
        return check_sensor_name(name[:80], recorded=True)
    except SettingsError as error:
        raise WireError(str(error)) from None


def identity(frame: SensorFrame) -> dict[str, Any]:
    """Return the schema version and the common fields of a `SensorFrame`, as keyword arguments of its message."""
    return {
        "schema_version": SCHEMA_VERSION,
        "sensor": frame.sensor,
        "node_id": frame.node_id,
        "sequence": frame.sequence,
        "time_ns": frame.time_ns,
        "sent_ns": frame.sent_ns,
    }


def identity_of(m: Any) -> tuple[str, int, int, int, int]:
    """Return a message's (sensor, node_id, sequence, time_ns, sent_ns), the first fields of a `SensorFrame`.

    Raises:
        WireError: the sensor's name is invalid.
    """
    return sensor_name(m.sensor), m.node_id, m.sequence, m.time_ns, m.sent_ns


def array(data: bytes, dtype: np.dtype[Any], shape: tuple[int, ...], field: str) -> NDArray[Any]:
    """Return a field's packed values as a read-only array of the given type and shape; the values are not checked.

    Raises:
        WireError: the number of bytes does not fit the shape.
    """
    wanted = dtype.itemsize * math.prod(shape)
    if len(data) != wanted:
        raise WireError(f"{field} has {len(data)} bytes; {shape} {dtype.name} want {wanted}")
    return np.frombuffer(data, dtype).reshape(shape)


def choices(data: bytes, allowed: bytes, count: int, field: str) -> NDArray[np.uint8]:
    """Return a field's bytes as a read-only array (count,) uint8.

    Raises:
        WireError: their number is not ``count``, or a value is none of ``allowed``.
    """
    values = array(data, U1, (count,), field)
    strange = data.translate(None, allowed)
    if strange:
        raise WireError(f"{field} has a {strange[0]}; it wants {', '.join(map(str, allowed[:-1]))} or {allowed[-1]}")
    return values


def points(data: bytes, shape: tuple[int, ...], field: str, limit: Range = SCENE_COORDINATE) -> NDArray[np.float64]:
    """Return a field's coordinates as a read-only float64 array of the given shape [m].

    Each must be NaN (not seen), or within ``limit``, a range that is symmetric about 0.

    Raises:
        WireError: the number of bytes does not fit the shape, or a coordinate is beyond ``limit``.
    """
    values = array(data, F8, shape, field)
    far = values[np.abs(values) > limit.high]
    if far.size:
        raise WireError(f"{field} has a {far[0]:g}; coordinates are within ±{limit.high:g} m, or NaN")
    return values


def deviations(data: bytes, count: int, field: str) -> NDArray[np.float32]:
    """Return a field's standard deviations as a read-only array (count,) float32; NaN is unknown.

    Raises:
        WireError: the number of bytes does not fit, or a value is negative or infinite.
    """
    sd = array(data, F4, (count,), field)
    if (sd < 0).any() or np.isinf(sd).any():
        raise WireError(f"{field} has a value that is no standard deviation; 0 or more is wanted, or NaN")
    return sd


def names(given: Any, field: str) -> tuple[str, ...]:
    """Return a field's names as a tuple; at most `MAX_POINTS`, unique, each of 1 to `MAX_NAME` characters.

    Args:
        given: the names as in the message.
        field: the field's name, for errors.

    Raises:
        WireError: the names break a rule above.
    """
    if len(given) > MAX_POINTS:
        raise WireError(f"{field} has {len(given)} names; at most {MAX_POINTS} are read")
    unique = tuple(given)
    for name in unique:
        if not 0 < len(name) <= MAX_NAME:
            raise WireError(f"{field} has the name {name[:MAX_NAME]!r}; 1 to {MAX_NAME} characters are wanted")
    if len(set(unique)) != len(unique):
        raise WireError(f"{field} has a name twice; each is wanted once")
    return unique


def transform(data: bytes, field: str, limit: Range = SCENE_COORDINATE) -> NDArray[np.float64]:
    """Return the matrix (4, 4) float64 of a rigid motion, translation in metres, as a new array.

    Args:
        data: its upper three rows, as 12 packed float64 in row-major order.
        field: the field's name, for errors.
        limit: valid range of the translation's coordinates, symmetric about 0 [m].

    Raises:
        WireError: the length is wrong, the matrix is no rotation, or the translation is beyond ``limit``.
    """
    numbers = array(data, F8, (12,), field).tolist()
    a, b, c, _, d, e, f, _, g, h, i, _ = numbers  # several times as fast as NumPy on such arrays
    rigid = (
        all(abs(number) <= limit.high for number in numbers)  # NaN compares false
        and max(abs(a * a + b * b + c * c - 1.0), abs(d * d + e * e + f * f - 1.0), abs(g * g + h * h + i * i - 1.0))
        <= _RIGID
        and max(abs(a * d + b * e + c * f), abs(a * g + b * h + c * i), abs(d * g + e * h + f * i)) <= _RIGID
        and a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) > 0.0
    )
    if not rigid:
        raise WireError(f"{field} is no rigid motion; it wants a rotation and a translation within {limit.high:g} m")
    return np.array((*numbers, 0.0, 0.0, 0.0, 1.0)).reshape(4, 4)


def sensor_pose(tilt: float, height: float, message: str) -> None:
    """Check a sensor's tilt [rad] and height above the floor [m]; ``message`` is the message's name for errors.

    Raises:
        WireError: a value is not finite or out of range.
    """
    if not (tilt in TILT and height in FRAME_HEIGHT):
        raise WireError(
            f"{message}.tilt_rad is {tilt:g} and height_m {height:g}; "
            f"they want radians within ±π and metres within ±{FRAME_HEIGHT.high:g}"
        )
