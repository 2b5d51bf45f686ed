"""Kernels that read fields of encoded protobuf messages, without making objects. Importing this imports numba.

They vouch for a message, or leave it to the protobuf library: a message with a group or an unusual field is left, and
so is an invalid one. A message that they vouch for is one that the library parses.

Source: the encoding of protocol buffers, https://protobuf.dev/programming-guides/encoding.
"""

# ruff: noqa: PLR0911, PLR0912, PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Int8 = NDArray[np.int8]
Int64 = NDArray[np.int64]
UInt8 = NDArray[np.uint8]

FIELDS = 32
"""Number of the first field that the kernels do not know, in any message."""
DEPTH = 8
"""Least number of messages within each other that the kernels leave."""
OTHER, VARINT, FIXED64, FIXED32, BYTES, TEXT, MESSAGE = 0, 1, 2, 3, 4, 5, 6
"""Types of fields: an unknown one, the encoding's, and from `MESSAGE` on, messages of the type that follows."""
_BITS, _MORE = np.uint64(0x7F), 0x80
_LARGEST_KEY = np.uint64(0xFFFFFFFF)


@njit(cache=True, nogil=True, error_model="numpy")
def read_varint(data: UInt8, at: int, end: int) -> tuple[np.uint64, int]:
    """Return the whole number at a place and the place after it; −1 as the place if there is none before ``end``."""
    value = np.uint64(0)
    for k in range(9):
        if at >= end:
            return value, -1
        byte = data[at]
        at += 1
        value |= (np.uint64(byte) & _BITS) << np.uint64(7 * k)
        if byte < _MORE:
            return value, at
    if at < end and data[at] <= 1:
        return value | (np.uint64(data[at]) << np.uint64(63)), at + 1
    return value, -1


@njit(cache=True, nogil=True, error_model="numpy")
def is_text(data: UInt8, at: int, end: int) -> bool:
    """Whether bytes are UTF-8 (RFC 3629, section 4)."""
    while at < end:
        first = data[at]
        at += 1
        if first < _MORE:
            continue
        more = 1 if first < 0xE0 else 2 if first < 0xF0 else 3
        if first < 0xC2 or first > 0xF4 or at + more > end:
            return False
        second = data[at]
        low = 0xA0 if first == 0xE0 else 0x90 if first == 0xF0 else 0x80
        high = 0x9F if first == 0xED else 0x8F if first == 0xF4 else 0xBF
        if second < low or second > high:
            return False
        for k in range(at + 1, at + more):
            if data[k] & 0xC0 != 0x80:
                return False
        at += more
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def read_message(
    data: UInt8, begin: int, end: int, shapes: Int8, kind: int, fields: Int64, ends: Int64, kinds: Int64
) -> bool:
    """Read the fields of a message, and check the messages within it; return whether all are usual.

    Args:
        data: bytes with the message.
        begin, end: its first byte, and the one after it; within ``data``.
        shapes: (types, `FIELDS`) type of each field of each message type, of `wire_shapes.shapes_of`.
        kind: the message's type.
        fields: (`FIELDS`, 3) written: for each field, how often it is there, its last value or, for bytes, texts and
            messages, the place of their first byte, and their size.
        ends, kinds: (`DEPTH`,) scratch.
    """
    fields[:] = 0
    depth, at = 0, begin
    ends[0], kinds[0] = end, kind
    while True:
        while at == ends[depth]:
            if depth == 0:
                return True
            depth -= 1
        limit = ends[depth]
        key, at = read_varint(data, at, limit)
        field = np.int64(key >> np.uint64(3))
        if at < 0 or key > _LARGEST_KEY or field == 0:
            return False
        form = OTHER if field >= FIELDS else shapes[kinds[depth], field]
        value = size = np.int64(0)
        wire = np.int64(key & np.uint64(7))
        if wire == 0:
            number, at = read_varint(data, at, limit)
            if at < 0 or form not in (OTHER, VARINT):
                return False
            value = np.int64(number)
        elif wire == 1 or wire == 5:  # noqa: PLR1714 - numba is slower with a tuple
            size = np.int64(8 if wire == 1 else 4)
            if limit - at < size or form not in (OTHER, FIXED64 if wire == 1 else FIXED32):
                return False
            number = np.uint64(0)
            for k in range(size):
                number |= np.uint64(data[at + k]) << np.uint64(8 * k)
            value, at, size = np.int64(number), at + size, np.int64(0)
        elif wire == 2:
            number, at = read_varint(data, at, limit)
            if at < 0 or number > np.uint64(limit - at) or form in (VARINT, FIXED64, FIXED32):
                return False
            value, size = np.int64(at), np.int64(number)
        else:
            return False
        if depth == 0 and field < FIELDS:
            fields[field, 0] += 1
            fields[field, 1], fields[field, 2] = value, size
        if wire == 2 and form >= MESSAGE:
            if depth + 1 == DEPTH:
                return False
            depth += 1
            ends[depth], kinds[depth] = at + size, form - MESSAGE
        elif wire == 2:
            if form == TEXT and not is_text(data, at, at + size):
                return False
            at += size
