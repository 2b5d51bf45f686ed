"""Poses of other trackers by OSC over UDP: datagrams in, rigid bodies out; errors are counted and never raised.

OSC 1.0 (M. Wright, *The Open Sound Control 1.0 Specification*, 2002): an address, a string of types, and arguments, all
padded to four bytes and big-endian; or a bundle of such messages. Supported addresses:

| address | arguments | protocol |
|---|---|---|
| ``/mocapella/pose`` | name x y z qx qy qz qw | ours: right-handed, metres, any up |
| ``/VMC/Ext/Tra/Pos``, ``/Con/``, ``/Hmd/``, each also with ``/Local`` | serial x y z qx qy qz qw | VMC protocol |
| ``/tracking/trackers/N/position`` and ``…/rotation`` | x y z; x y z in degrees | VRChat; N is 1 to 8 or head |

VMC and VRChat use Unity's axes: left-handed, x right, y up, z forward. The z axis is reversed, which gives OpenVR's
axes (x right, y up, z to the back): p' = (x, y, −z), q' = (−qx, −qy, qz, qw). Unity's Euler angles rotate about z, then
x, then y. If VMC sends a device's pose both ways, the ``/Local`` one is used: only that has the device's own scale.
"""

from __future__ import annotations

import math
import struct
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.rigid import rotation_about_x, rotation_about_y
from mocapella.model.poses import PoseFrame, pose_frame, quaternion_of

Float64 = NDArray[np.float64]

MOST_BYTES: Final = 65_507
"""Largest payload of a UDP datagram [bytes]."""
_MOST_MESSAGES: Final = 1024
_DEEPEST: Final = 4
_MOST_BODIES: Final = 256
_MOST_NAME: Final = 80
_FARTHEST_M: Final = 1000.0
_NO_ROTATION: Final = (1.0, 0.0, 0.0, 0.0)
_VMC: Final = {f"/VMC/Ext/{kind}/Pos{local}": bool(local) for kind in ("Tra", "Con", "Hmd") for local in ("", "/Local")}


class BadOscError(ValueError):
    """A datagram that is not valid OSC; `OscPoses` counts it and does not raise it."""


class OscMessage(NamedTuple):
    """An address and its arguments: int, float, str, bytes, bool or None."""

    address: str
    arguments: tuple[Any, ...]


def messages(data: bytes, depth: int = 0) -> Iterator[OscMessage]:
    """Decode a datagram's messages one by one, also in nested bundles; bundles' time tags are ignored.

    Args:
        data: the datagram.
        depth: the present nesting; leave it at 0.

    Raises:
        BadOscError: the datagram is not valid OSC, or its bundles are nested more than four deep. Messages before the
            invalid one have been yielded.
    """
    if data[:8] != b"#bundle\0":
        yield _message(data)
        return
    if depth >= _DEEPEST or len(data) < 16:
        raise BadOscError("a bundle that is cut off, or too deep")
    at = 16
    while at < len(data):
        (size,) = _unpacked(">i", data, at)
        if not 0 < size <= len(data) - at - 4:
            raise BadOscError("a bundle whose part is longer than the datagram")
        yield from messages(data[at + 4 : at + 4 + size], depth + 1)
        at += 4 + size


def _message(data: bytes) -> OscMessage:
    address, at = _text(data, 0)
    if not address.startswith("/"):
        raise BadOscError("an address that does not begin with /")
    if at == len(data):  # old senders omit the types of a message without arguments
        return OscMessage(address, ())
    types, at = _text(data, at)
    if not types.startswith(","):
        raise BadOscError("no types")
    arguments: list[Any] = []
    for kind in types[1:]:
        if kind in _FIXED:
            layout = _FIXED[kind]
            arguments.append(_unpacked(layout, data, at)[0])
            at += struct.calcsize(layout)
        elif kind in "sS":
            text, at = _text(data, at)
            arguments.append(text)
        elif kind == "b":
            (size,) = _unpacked(">i", data, at)
            if not 0 <= size <= len(data) - at - 4:
                raise BadOscError("a blob that is longer than the datagram")
            arguments.append(data[at + 4 : at + 4 + size])
            at += 4 + (size + 3) // 4 * 4
        elif kind in _CONSTANTS:
            arguments.append(_CONSTANTS[kind])
        else:
            raise BadOscError(f"arguments of the type {kind!r}")
    return OscMessage(address, tuple(arguments))


_FIXED: Final = {"i": ">i", "f": ">f", "h": ">q", "d": ">d", "t": ">Q", "c": ">I", "r": ">I", "m": ">I"}
_CONSTANTS: Final = {"T": True, "F": False, "N": None, "I": math.inf}


def _unpacked(layout: str, data: bytes, at: int) -> tuple[Any, ...]:
    try:
        return struct.unpack_from(layout, data, at)
    except struct.error:
        raise BadOscError("cut off") from None


def _text(data: bytes, at: int) -> tuple[str, int]:
    end = data.find(b"\0", at)
    if end < 0:
        raise BadOscError("a text without an end")
    try:
        return data[at:end].decode("utf-8"), at + (end - at) // 4 * 4 + 4
    except UnicodeDecodeError:
        raise BadOscError("a text that is not UTF-8") from None


@dataclass
class OscReport:
    """Counts of the datagrams.

    Attributes:
        datagrams: number of received datagrams.
        poses: number of bodies' poses passed on in frames.
        bad: number of datagrams that are not valid OSC.
        unknown: number of messages with unsupported addresses.
        refused: number of messages with a supported address and unusable arguments, by reason.
        too_soon: number of datagrams above the highest rate, which were ignored.
        addresses: the first few of the unsupported addresses.
    """

    datagrams: int = 0
    poses: int = 0
    bad: int = 0
    unknown: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    too_soon: int = 0
    addresses: list[str] = field(default_factory=list)


class OscPoses:
    """Decoder of one tracking program's datagrams into frames of poses, in the axes that the module describes.

    A VMC device's poses without ``/Local`` are ignored after its first one with it. VRChat sends rotations separately:
    a position is joined with the tracker's last rotation, or with none.

    Args:
        sensor: name of the sensor, for the frames.
        space: name of the tracking program's coordinate system, for the frames.
        most_hz: highest rate of datagrams, averaged over a second; those above it are ignored [Hz].

    Attributes:
        sensor, space: as given.
        report: counts of the datagrams; updated in place.
    """

    def __init__(self, sensor: str, space: str, *, most_hz: float = 2000.0) -> None:
        self.sensor, self.space = sensor, space
        self.report = OscReport()
        self._most_hz = most_hz
        self._allowed, self._at_ns = most_hz, -1
        self._local: set[str] = set()
        self._rotations: dict[str, Float64] = {}

    def update(self, data: bytes, at_ns: int) -> PoseFrame | None:
        """Decode a datagram into a frame of the bodies in it; nothing is raised for an invalid one.

        Args:
            data: the datagram.
            at_ns: its time of arrival, which becomes the frame's capture time [ns]; OSC's own times are not reliable.

        Returns:
            The frame; None if the datagram has no usable pose, is not valid OSC, exceeds the highest rate, or is not
            later than the last frame.
        """
        report = self.report
        report.datagrams += 1
        if not self._in_time(at_ns):
            report.too_soon += 1
            return None
        found: dict[str, tuple[Float64, Float64]] = {}
        try:
            for k, message in enumerate(messages(data)):
                if k >= _MOST_MESSAGES:
                    raise BadOscError("too many messages")
                self._take(message, found)
        except (BadOscError, RecursionError):
            report.bad += 1
            return None
        if not found or at_ns <= self._at_ns:
            return None
        self._at_ns = at_ns
        report.poses += len(found)
        p, q = zip(*found.values(), strict=True)
        return pose_frame(self.sensor, self.space, list(found), time_ns=at_ns, positions=p, orientations=q)

    def _in_time(self, at_ns: int) -> bool:
        """Whether a datagram is within the highest rate, averaged over a second (token bucket)."""
        last_ns = getattr(self, "_last_ns", at_ns)
        self._allowed = min(self._most_hz, self._allowed + self._most_hz * max(0, at_ns - last_ns) * 1e-9)
        self._last_ns = max(at_ns, last_ns)
        if self._allowed < 1.0:
            return False
        self._allowed -= 1.0
        return True

    def _take(self, message: OscMessage, found: dict[str, tuple[Float64, Float64]]) -> None:
        address, given = message
        if address == "/mocapella/pose":
            if (pose := self._pose(given)) is not None:
                name, p, q = pose
                found[name] = p, q[[3, 0, 1, 2]]
        elif address in _VMC:
            if (pose := self._pose(given)) is not None:
                name, p, q = pose
                if _VMC[address] and len(self._local) < _MOST_BODIES:
                    self._local.add(name)
                if _VMC[address] or name not in self._local:
                    found[name] = p * (1, 1, -1), q[[3, 0, 1, 2]] * (1, -1, -1, 1)
        elif address.startswith("/tracking/trackers/"):
            self._tracker(address, given, found)
        else:
            self.report.unknown += 1
            if len(self.report.addresses) < 5 and address[:80] not in self.report.addresses:
                self.report.addresses.append(address[:80])

    def _pose(self, given: tuple[Any, ...]) -> tuple[str, Float64, Float64] | None:
        """Name, position, and quaternion x, y, z, w as received; None if the arguments are unusable."""
        if len(given) < 8 or not isinstance(given[0], str) or not 0 < len(given[0]) <= _MOST_NAME:
            self.report.refused["not a name and seven numbers"] += 1
            return None
        numbers = self._numbers(given[1:8])
        if numbers is None:
            return None
        length = float(np.linalg.norm(numbers[3:]))
        if not 0.9 < length < 1.1:
            self.report.refused["its quaternion is not of length 1"] += 1
            return None
        return given[0], numbers[:3], numbers[3:]

    def _numbers(self, given: tuple[Any, ...]) -> Float64 | None:
        if not all(isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v) for v in given):
            self.report.refused["a number that is none"] += 1
            return None
        values = np.array(given, dtype=np.float64)
        if np.abs(values[:3]).max() > _FARTHEST_M:
            self.report.refused[f"a value beyond {_FARTHEST_M:g}"] += 1
            return None
        return values

    def _tracker(self, address: str, given: tuple[Any, ...], found: dict[str, tuple[Float64, Float64]]) -> None:
        """Handle a tracker's position or rotation, which are separate messages; each position gives a pose."""
        name, _, part = address.removeprefix("/tracking/trackers/").partition("/")
        if part not in ("position", "rotation") or name not in _TRACKERS:
            self.report.unknown += 1
            return
        numbers = self._numbers(given[:3]) if len(given) >= 3 else None
        if numbers is None:
            self.report.refused["not three numbers"] += len(given) < 3
            return
        if part == "rotation":
            self._rotations[name] = unity_quaternion(numbers)
            if name in found:
                found[name] = found[name][0], self._rotations[name]
        else:
            found[name] = numbers * (1, 1, -1), self._rotations.get(name, np.array(_NO_ROTATION))


_TRACKERS: Final = frozenset(["head", *map(str, range(1, 9))])


def unity_quaternion(degrees: Float64) -> Float64:
    """Convert Unity's Euler angles (3,) x, y, z [°] to a unit quaternion (4,) w, x, y, z in right-handed axes.

    The right-handed axes are Unity's with z reversed.
    """
    x, y, z = np.radians(degrees)
    c, s = math.cos(z), math.sin(z)
    about_z = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    mirror = np.diag([1.0, 1.0, -1.0])
    return quaternion_of(mirror @ rotation_about_y(y) @ rotation_about_x(x) @ about_z @ mirror)


def encode(address: str, *arguments: Any) -> bytes:
    """Encode an OSC message, such as for a test: floats as float32, ints (and bools) as int32, and strings."""

    def padded(data: bytes) -> bytes:
        return data + b"\0" * (4 - len(data) % 4)

    kinds, body = ",", b""
    for value in arguments:
        if isinstance(value, str):
            kinds, body = kinds + "s", body + padded(value.encode())
        elif isinstance(value, int):
            kinds, body = kinds + "i", body + struct.pack(">i", value)
        else:
            kinds, body = kinds + "f", body + struct.pack(">f", value)
    return padded(address.encode()) + padded(kinds.encode()) + body


def bundle(*parts: bytes) -> bytes:
    """Encode messages as one bundle, to be executed immediately."""
    return b"#bundle\0" + struct.pack(">Q", 1) + b"".join(struct.pack(">i", len(p)) + p for p in parts)


def as_json(report: OscReport) -> Mapping[str, Any]:
    """Return a report's fields by name, as JSON types, for ``--json``."""
    return {**vars(report), "refused": dict(report.refused)}
