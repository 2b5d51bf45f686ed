"""Encode and decode UDP datagrams with the markers of one image as a line of text, as small camera programs send them.

    x,y;x,y;…                           a pair for each marker, in an order that both sides know
    #SEQUENCE,TIME_US;x,y;x,y;…         the same, from a program that numbers and times its images

The first form is that of the RHOT thesis, which does not define lost markers, the end of the line, or capture times.
docs/wire.md describes the accepted forms, docs/decisions/0012-datagrams-of-markers.md the reasons.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from enum import StrEnum
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import WireError

Float64 = NDArray[np.float64]

MAX_DATAGRAM_BYTES: Final = 1472
"""Largest size of a datagram: the payload of one Ethernet frame. Six markers take about sixty bytes."""
MAX_MARKERS: Final = 64
"""Largest number of markers in a datagram; with coordinates of two decimals, it has space for them."""
MAX_SEQUENCE: Final = 2**63 - 1
MAX_TIME_US: Final = 2**53
"""Largest capture time: 285 years, and exact as a 64-bit float [µs]."""

_TEXT: Final = re.compile(rb"[\x20-\x7e]*\Z")
_NUMBER: Final = re.compile(r"[+-]?(?:[0-9]{1,17}(?:\.[0-9]{0,17})?|\.[0-9]{1,17})(?:[eE][+-]?[0-9]{1,3})?\Z")
_NOT_FINITE: Final = re.compile(r"[+-]?(?:inf|infinity)\Z", re.IGNORECASE)
_NAN: Final = re.compile(r"[+-]?nan\Z", re.IGNORECASE)
_COUNT: Final = re.compile(r"[0-9]{1,19}\Z")
_SHOWN: Final = 40
"""Longest untrusted text in an error, in characters."""


class DatagramProblem(StrEnum):
    """Reasons for which a datagram is refused; refused datagrams are counted by reason."""

    EMPTY = "empty"
    TOO_LONG = "too long"
    """More than `MAX_DATAGRAM_BYTES`."""
    NOT_TEXT = "not text"
    """Not a line of printable ASCII."""
    HEADER = "header"
    """Begins with ``#``, but has no valid sequence number and time."""
    NOT_A_PAIR = "not a pair of numbers"
    COUNT = "number of markers"
    """Another number of pairs than markers."""
    ONE_COORDINATE = "one coordinate"
    """A marker with one coordinate only."""
    NOT_FINITE = "not finite"
    OUTSIDE = "outside the picture"
    """A position outside the image."""


class DatagramError(WireError):
    """An invalid datagram. ``problem`` is the reason for which it is refused; the message describes the fault."""

    def __init__(self, problem: DatagramProblem, message: str) -> None:
        self.problem = problem
        super().__init__(message)


class MarkerDatagram(msgspec.Struct, frozen=True, eq=False):
    """Content of a datagram.

    Attributes:
        positions_px: (markers, 2) x to the right, y down; the middle of the first pixel is (0, 0); NaN = not seen.
        sequence: number that the sending program gave the image; None if the datagram has none.
        time_us: capture time on the sending program's clock [µs]; None if the datagram has none.
    """

    positions_px: Float64
    sequence: int | None = None
    time_us: int | None = None


def encode_marker_datagram(datagram: MarkerDatagram, decimals: int = 2) -> bytes:
    """Encode a datagram as a line of ASCII text with a line feed; the inverse of `decode_marker_datagram`.

    A marker with a coordinate that is not finite becomes a comma without numbers. A time without a sequence number is
    left out. Sizes are not checked.

    Args:
        datagram: the content.
        decimals: number of decimals of the coordinates.
    """
    pairs = [
        f"{x:.{decimals}f},{y:.{decimals}f}" if math.isfinite(x) and math.isfinite(y) else ","
        for x, y in datagram.positions_px.tolist()
    ]
    if datagram.sequence is not None:
        time = "" if datagram.time_us is None else f",{datagram.time_us}"
        pairs.insert(0, f"#{datagram.sequence}{time}")
    return ";".join(pairs).encode("ascii") + b"\n"


def decode_marker_datagram(
    data: bytes, names: Sequence[str], size_px: tuple[int, int], *, zero_is_lost: bool = False
) -> MarkerDatagram:
    """Decode a datagram; time and memory are bounded by `MAX_DATAGRAM_BYTES`.

    Args:
        data: the datagram as received.
        names: the markers' names, in the order of the pairs.
        size_px: (width, height) of the images.
        zero_is_lost: whether the sending program writes ``0,0`` for a marker that it does not see. ``-1,-1``,
            ``nan,nan``, a comma alone and an empty pair always mean a marker that is not seen.

    Returns:
        The content, with NaN for markers that are not seen.

    Raises:
        DatagramError: it is too long, not text, of another number of markers, or has a position outside the image; its
            ``problem`` is the reason. No other error is raised.
    """
    if len(data) > MAX_DATAGRAM_BYTES:
        problem = f"{len(data)} bytes; at most {MAX_DATAGRAM_BYTES} are read"
        raise DatagramError(DatagramProblem.TOO_LONG, problem)
    line = data.strip(b" \t\r\n\0")
    if not line:
        problem = f"nothing in it; write {';' * len(names)} where no marker is seen"
        raise DatagramError(DatagramProblem.EMPTY, problem)
    if not _TEXT.match(line):
        raise DatagramError(DatagramProblem.NOT_TEXT, f"{_shown(line)} is not a line of ASCII text")
    pairs = line.decode("ascii").split(";")
    sequence, time_us = _header(pairs.pop(0)) if pairs[0].startswith("#") else (None, None)
    if len(pairs) == len(names) + 1 and not pairs[-1].strip():
        pairs.pop()  # ended by a semicolon, too
    if len(pairs) != len(names):
        if not any("," in pair for pair in pairs):
            raise DatagramError(DatagramProblem.NOT_A_PAIR, f"{_shown(line)} has no pairs x,y")
        problem = f"{len(pairs)} pairs; the markers are {len(names)}: {', '.join(names)}"
        raise DatagramError(DatagramProblem.COUNT, problem)
    positions = [_position(pair, zero_is_lost) for pair in pairs]
    width, height = size_px
    for name, (x, y) in zip(names, positions, strict=True):
        if not (math.isnan(x) or (-0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5)):
            where = f"{name} at ({x:g}, {y:g}) is not in an image of {width} × {height}"
            raise DatagramError(DatagramProblem.OUTSIDE, where)
    return MarkerDatagram(np.array(positions), sequence, time_us)


def _header(text: str) -> tuple[int, int | None]:
    """Decode sequence and time; further fields belong to later versions and are ignored."""
    first, *rest = (part.strip() for part in text[1:].split(","))
    sequence = int(first) if _COUNT.match(first) else -1
    time_us = None if not rest or not rest[0] else int(rest[0]) if _COUNT.match(rest[0]) else -1
    if not 0 <= sequence <= MAX_SEQUENCE or not (time_us is None or 0 <= time_us <= MAX_TIME_US):
        problem = f"{_shown(text.encode())} is no #SEQUENCE or #SEQUENCE,TIME_US of whole numbers from 0 on"
        raise DatagramError(DatagramProblem.HEADER, problem)
    return sequence, time_us


def _position(pair: str, zero_is_lost: bool) -> tuple[float, float]:
    """Decode a pair's numbers; NaN for each form of a marker that is not seen."""
    parts = [part.strip() for part in pair.split(",")]
    if parts == [""]:
        return math.nan, math.nan
    if len(parts) != 2:
        problem = f"{_shown(pair.encode())} is no pair x,y (decimal point, comma between)"
        raise DatagramError(DatagramProblem.NOT_A_PAIR, problem)
    x, y = (_coordinate(part) for part in parts)
    if math.isnan(x) and math.isnan(y):
        return x, y
    if math.isnan(x) or math.isnan(y):
        problem = f"{_shown(pair.encode())} has one coordinate; leave both out where a marker is not seen"
        raise DatagramError(DatagramProblem.ONE_COORDINATE, problem)
    if (x == y == -1) or (zero_is_lost and x == y == 0):
        return math.nan, math.nan
    return x, y


def _coordinate(text: str) -> float:
    if _NUMBER.match(text):
        value = float(text)
        if math.isfinite(value):
            return value
    elif not text or _NAN.match(text):
        return math.nan
    elif not _NOT_FINITE.match(text):
        raise DatagramError(DatagramProblem.NOT_A_PAIR, f"{_shown(text.encode())} is no number")
    raise DatagramError(DatagramProblem.NOT_FINITE, f"{_shown(text.encode())} is not a finite number")


def _shown(data: bytes) -> str:
    text = data[: _SHOWN + 1].decode("latin-1").encode("unicode_escape").decode("ascii")
    return f"'{text}'" if len(text) <= _SHOWN else f"'{text[: _SHOWN - 1]}…'"
