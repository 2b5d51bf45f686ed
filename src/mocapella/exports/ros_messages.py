"""Messages of ROS 2 as bytes: TFMessage, MarkerArray and JointState in CDR, with their definitions.

CDR is the Common Data Representation of OMG's DDS-RTPS (little endian, version 1): each number is aligned to its size,
counted from behind the four bytes of the header. The definitions have the fields of ROS 2 Humble and later.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S

Float64 = NDArray[np.float64]

TF: Final = "tf2_msgs/msg/TFMessage"
MARKERS: Final = "visualization_msgs/msg/MarkerArray"
JOINT_STATE: Final = "sensor_msgs/msg/JointState"
LINE_LIST: Final = 5
SPHERE_LIST: Final = 7
_HEADER: Final = b"\x00\x01\x00\x00"
_FIELDS: Final = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/ColorRGBA": "float32 r\nfloat32 g\nfloat32 b\nfloat32 a",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform"
    ),
    "sensor_msgs/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data",
    "visualization_msgs/UVCoordinate": "float32 u\nfloat32 v",
    "visualization_msgs/MeshFile": "string filename\nuint8[] data",
    "visualization_msgs/Marker": (
        "std_msgs/Header header\nstring ns\nint32 id\nint32 type\nint32 action\ngeometry_msgs/Pose pose\n"
        "geometry_msgs/Vector3 scale\nstd_msgs/ColorRGBA color\nbuiltin_interfaces/Duration lifetime\n"
        "bool frame_locked\ngeometry_msgs/Point[] points\nstd_msgs/ColorRGBA[] colors\nstring texture_resource\n"
        "sensor_msgs/CompressedImage texture\nvisualization_msgs/UVCoordinate[] uv_coordinates\nstring text\n"
        "string mesh_resource\nvisualization_msgs/MeshFile mesh_file\nbool mesh_use_embedded_materials"
    ),
}
_OF: Final = {
    TF: (
        "geometry_msgs/TransformStamped[] transforms",
        ("geometry_msgs/TransformStamped", "std_msgs/Header", "builtin_interfaces/Time", "geometry_msgs/Transform",
         "geometry_msgs/Vector3", "geometry_msgs/Quaternion"),
    ),
    JOINT_STATE: (
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort",
        ("std_msgs/Header", "builtin_interfaces/Time"),
    ),
    MARKERS: (
        "visualization_msgs/Marker[] markers",
        tuple(name for name in _FIELDS if name not in {"geometry_msgs/Transform", "geometry_msgs/TransformStamped"}),
    ),
}  # fmt: skip


def definition(type_name: str) -> str:
    """Return the definition of a message type of this module, with the types that it contains."""
    own, used = _OF[type_name]
    parts = [own, *(f"MSG: {name}\n{_FIELDS[name]}" for name in used)]
    return f"\n{80 * '='}\n".join(parts) + "\n"


@dataclass(frozen=True, eq=False)
class Marker:
    """A list of spheres or lines, as in ``visualization_msgs/Marker``.

    Attributes:
        space: its name space; a later marker of the same space and id replaces it.
        number: its id.
        type: `SPHERE_LIST` or `LINE_LIST`.
        points: (n, 3) centres of spheres, or ends of lines in pairs [m].
        colours: (n, 4) red, green, blue and opacity of each point, 0 to 1.
        size_m: diameter of the spheres, or width of the lines [m].
    """

    space: str
    number: int
    type: int
    points: Float64
    colours: NDArray[np.float32]
    size_m: float


class _Writer:
    """Appends values to a message, each at a multiple of its size."""

    def __init__(self) -> None:
        self.data = bytearray()

    def align(self, size: int) -> None:
        self.data += bytes(-len(self.data) % size)

    def packed(self, code: str, *values: float) -> None:
        """Append numbers of one size by their code in `struct`."""
        self.align(struct.calcsize("<" + code[-1]))
        self.data += struct.pack("<" + code, *values)

    def text(self, text: str) -> None:
        raw = text.encode() + b"\0"
        self.packed("I", len(raw))
        self.data += raw

    def array(self, values: NDArray[np.floating]) -> None:
        """Append numbers; an empty array appends nothing, not even an alignment."""
        if values.size:
            self.align(values.itemsize)
            self.data += np.ascontiguousarray(values).astype(values.dtype.newbyteorder("<"), copy=False).tobytes()

    def stamp(self, unix_ns: int, frame: str) -> None:
        self.packed("i", unix_ns // NS_PER_S)
        self.packed("I", unix_ns % NS_PER_S)
        self.text(frame)

    def bytes(self) -> bytes:
        return _HEADER + bytes(self.data)


class _Layout:
    """Bytes of a message with given texts, and the places of its stamps and numbers, which are filled in."""

    def __init__(self, data: bytes | bytearray, stamps: Sequence[int], numbers: Sequence[int], each: int) -> None:
        self._data = np.array(bytearray(data), dtype=np.uint8)
        self._stamps = np.asarray(stamps, np.int64)[:, None] + np.arange(8)
        self._numbers = np.asarray(numbers, np.int64)[:, None] + np.arange(8 * each)

    def filled(self, unix_ns: int, values: Float64) -> bytes:
        """Return the message of a time [ns] and numbers (places, each)."""
        data = self._data.copy()
        stamp = struct.pack("<iI", unix_ns // NS_PER_S, unix_ns % NS_PER_S)
        data[self._stamps] = np.array(bytearray(stamp), dtype=np.uint8)
        data[self._numbers] = np.ascontiguousarray(values, "<f8").view(np.uint8).reshape(self._numbers.shape)
        return _HEADER + data.tobytes()


@lru_cache(maxsize=64)
def _tf_layout(frame: str, children: tuple[str, ...]) -> _Layout:
    out, stamps, numbers = _Writer(), [], []
    out.packed("I", len(children))
    for child in children:
        out.align(4)
        stamps.append(len(out.data))
        out.stamp(0, frame)
        out.text(child)
        out.align(8)
        numbers.append(len(out.data))
        out.array(np.zeros(7))
    return _Layout(out.data, stamps, numbers, 7)


@lru_cache(maxsize=64)
def _joint_state_layout(names: tuple[str, ...]) -> _Layout:
    out = _Writer()
    out.stamp(0, "")
    out.packed("I", len(names))
    for name in names:
        out.text(name)
    out.packed("I", len(names))
    out.align(8 if names else 1)
    at = len(out.data)
    out.array(np.zeros(len(names)))
    out.packed("II", 0, 0)
    return _Layout(out.data, [0], [at], len(names))


def tf_message(unix_ns: int, frame: str, children: Sequence[str], poses: Float64) -> bytes:
    """Return a TFMessage.

    Args:
        unix_ns: time since 1970 [ns].
        frame: name of the parent frame.
        children: names of the n frames.
        poses: (n, 7) their positions in the parent [m] and rotations as quaternions, in the order x, y, z, w.
    """
    return _tf_layout(frame, tuple(children)).filled(unix_ns, poses)


def joint_state_message(unix_ns: int, names: Sequence[str], angles: Float64) -> bytes:
    """Return a JointState of angles (n,) [rad], without velocities and efforts."""
    return _joint_state_layout(tuple(names)).filled(unix_ns, angles)


@lru_cache(maxsize=256)
def _marker_head(start: int, frame: str, marker: tuple[str, int, int, float], lifetime_ns: int) -> bytes:
    """Return a Marker's bytes behind its stamp and before its points, for a stamp at byte ``start`` (0 or 4) of 8."""
    space, number, kind, size_m = marker
    out = _Writer()
    out.data += bytes(start + 8)
    out.text(frame)
    out.text(space)
    out.packed("3i", number, kind, 0)
    out.array(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, *3 * (size_m,)]))  # pose, scale
    out.array(np.ones(4, np.float32))
    out.packed("i", lifetime_ns // NS_PER_S)
    out.packed("I", lifetime_ns % NS_PER_S)
    out.packed("?", False)
    return bytes(out.data[start + 8 :])


@cache
def _marker_tail() -> bytes:
    """Return a Marker's bytes behind its colours: no texture, no text, no mesh."""
    out = _Writer()
    out.text("")  # texture
    out.stamp(0, "")
    out.text("")
    out.packed("II", 0, 0)  # its data, coordinates
    out.text("")
    out.text("")  # mesh
    out.text("")
    out.packed("I", 0)
    out.packed("?", False)
    return bytes(out.data)


def markers_message(unix_ns: int, frame: str, markers: Iterable[Marker], lifetime_ns: int) -> bytes:
    """Return a MarkerArray whose markers vanish after a time without newer ones [ns]."""
    out, listed = _Writer(), list(markers)
    stamp = struct.pack("<iI", unix_ns // NS_PER_S, unix_ns % NS_PER_S)
    out.packed("I", len(listed))
    for marker in listed:
        out.align(4)
        own = (marker.space, marker.number, marker.type, marker.size_m)
        out.data += stamp + _marker_head(len(out.data) % 8, frame, own, lifetime_ns)
        out.packed("I", len(marker.points))
        out.array(marker.points)
        out.packed("I", len(marker.colours))
        out.array(marker.colours)
        out.data += _marker_tail()
    return out.bytes()
