"""Kernels that list the messages of a take's chunk, with identities of frames and scenes. Importing imports numba."""

# ruff: noqa: PLR0911, PLR0912, PLR0917, SIM110 - kernels take arrays by position and write loops out
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.recording.take_refs import FRAME, LENGTH, LOG_NS, OFFSET, PART, RUN, SCENE, SENSOR, STEP
from mocapella.schema.wire_kernels import DEPTH, FIELDS, read_message

Int8 = NDArray[np.int8]
Int64 = NDArray[np.int64]
UInt8 = NDArray[np.uint8]

MESSAGE_RECORD, CHANNEL_RECORD = 5, 4
HEAD_BYTES, MESSAGE_BYTES = 9, 22
"""Size of a record's head, and of a message before its data."""
UNKNOWN, PLAIN, UNUSUAL = -1, 0, 3
"""Kinds of messages besides frames and scenes: of a channel that was not described, of other topics, and frames and
scenes that protobuf has to parse."""
KIND, CHANNEL = PART, RUN
"""Columns of a row that others replace in a table of scenes; the other columns are as in the table."""
DONE, CHANNEL_NEXT, NEW_SENSOR, FULL, MALFORMED = range(5)
LONGEST_NAME = 64


@njit(cache=True, nogil=True, error_model="numpy")
def _number(data: UInt8, at: int, size: int) -> np.int64:
    value = np.uint64(0)
    for k in range(size):
        value |= np.uint64(data[at + k]) << np.uint64(8 * k)
    return np.int64(value)


@njit(cache=True, nogil=True, error_model="numpy")
def _place(data: UInt8, at: int, size: int, names: UInt8, sizes: Int64, known: int) -> int:
    """Return the index of a name among the known ones, or −1."""
    for i in range(known):
        if sizes[i] == size:
            k = 0
            while k < size and names[i, k] == data[at + k]:
                k += 1
            if k == size:
                return i
    return -1


@njit(cache=True, nogil=True, error_model="numpy")
def _is_described(data: UInt8, at: int, end: int, places: Int64, described: UInt8) -> bool:
    """Whether the description of a channel repeats the last one of the same channel."""
    if end - at < HEAD_BYTES + 2:
        return False
    begin, size = places[_number(data, at + HEAD_BYTES, 2)]
    if size != end - at:
        return False
    for k in range(size):
        if data[at + k] != described[begin + k]:
            return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def list_messages(
    data: UInt8, at: int, channels: Int8, places: Int64, described: UInt8, shapes: Int8, wanted: Int64, names: UInt8,
    sizes: Int64, known: int, count: int, rows: Int64, parts: Int64,
) -> tuple[int, int, int]:  # fmt: skip
    """Write a row for each message of a chunk, from a record on; return the next record, the number of rows, and why.

    Args:
        data: the chunk's records.
        at: the first byte of a record.
        channels: (65536,) kind of each channel's messages: UNKNOWN, PLAIN, FRAME or SCENE.
        places, described: (65536, 2) begin and size in ``described`` of each channel's last description, with its head.
        shapes: shapes of `BodyFrame` and `Scene`, as `wire_shapes.shapes_of` returns them.
        wanted: (2, 7) numbers of the fields sensor, node id, sequence, two more for the columns from STEP on, of a
            field that makes a message UNUSUAL, and of one that does so if it is repeated; 0 for none.
        names, sizes, known: (n, `LONGEST_NAME`) and (n,) names of sensors and their sizes in bytes, and how many of
            these are known. With ``n`` names, or with a longer one, a message of another sensor is UNUSUAL.
        count: number of rows written before.
        rows: (n, `SCENE_COLUMNS`) written. The offset of a message is from the start of ``data``.
        parts: (`FIELDS`,) the number of fields in all usual scenes is added.

    Returns:
        next: the record to go on with.
        count: number of rows written so far.
        why: DONE at the end; CHANNEL_NEXT before a new description of a channel, which is not read; NEW_SENSOR before a
            message of an unknown sensor, whose name is at OFFSET and LENGTH of the row that would be next; FULL;
            MALFORMED.
    """
    fields = np.empty((FIELDS, 3), np.int64)
    ends, kinds = np.empty(DEPTH, np.int64), np.empty(DEPTH, np.int64)
    length = len(data)
    while at < length:
        if length - at < HEAD_BYTES:
            return at, count, MALFORMED
        size = _number(data, at + 1, 8)
        body = at + HEAD_BYTES
        if size < 0 or size > length - body:
            return at, count, MALFORMED
        if data[at] == CHANNEL_RECORD and not _is_described(data, at, body + size, places, described):
            return at, count, CHANNEL_NEXT
        if data[at] == MESSAGE_RECORD:
            if size < MESSAGE_BYTES:
                return at, count, MALFORMED
            if count == len(rows):
                return at, count, FULL
            channel = _number(data, body, 2)
            kind = channels[channel]
            if kind == UNKNOWN:
                return at, count, MALFORMED
            row, begin, end = rows[count], body + MESSAGE_BYTES, body + size
            row[:] = 0
            row[LOG_NS], row[OFFSET], row[LENGTH] = _number(data, body + 6, 8), begin, end - begin
            if kind != PLAIN:
                root = 0 if kind == FRAME else 1
                usual = read_message(data, begin, end, shapes, root, fields, ends, kinds)
                if not usual or fields[wanted[root, 5], 0] > 0 or fields[wanted[root, 6], 0] > 1:
                    kind = UNUSUAL
                else:
                    sensor = wanted[root, 0]
                    place = _place(data, fields[sensor, 1], fields[sensor, 2], names, sizes, known)
                    if place < 0 and (known == len(names) or fields[sensor, 2] > LONGEST_NAME):
                        kind = UNUSUAL
                    elif place < 0:
                        row[OFFSET], row[LENGTH] = fields[sensor, 1], fields[sensor, 2]
                        return at, count, NEW_SENSOR
                    row[SENSOR] = place
                    for k in range(2):
                        row[SENSOR + 1 + k] = fields[wanted[root, 1 + k], 1]
                        row[STEP + k] = fields[wanted[root, 3 + k], 1]
                    if kind == SCENE:
                        for k in range(FIELDS):
                            parts[k] += fields[k, 0]
            row[KIND], row[CHANNEL] = kind, channel
            count += 1
        at = body + size
    return at, count, DONE
