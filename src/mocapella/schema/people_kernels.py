"""Kernels that find the fused people of encoded scenes, without making objects. Importing this imports numba."""

# ruff: noqa: PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.schema.wire_kernels import DEPTH, FIELDS, read_message, read_varint

Int8 = NDArray[np.int8]
Int64 = NDArray[np.int64]
UInt8 = NDArray[np.uint8]

SCENE, ID, TOPOLOGY, NAME, POSITIONS, STATES, SD, COLUMNS = 0, 1, 2, 4, 6, 8, 10, 12
"""Columns of a row; from `TOPOLOGY` on, each is followed by the size in bytes."""


@njit(cache=True, nogil=True, error_model="numpy")
def list_people(
    data: UInt8,
    begins: Int64,
    ends: Int64,
    shapes: Int8,
    kinds: Int64,
    fields: Int64,
    version: int,
    rows: Int64,
) -> int:
    """Write a row for each person of some scenes; return their number, −1 if a scene is unusual, −2 if rows are short.

    Args:
        data: bytes with the scenes.
        begins, ends: (scenes,) first byte of each, and the one after it; within ``data``.
        shapes: shapes of the message types, as `wire_shapes.shapes_of` returns them.
        kinds: (2,) types of a scene and of a person.
        fields: (8,) numbers of a scene's fields version, topology and people, and of a person's fields id, name,
            positions, states and standard deviations.
        version: the version that a scene has unless it is unusual.
        rows: (n, `COLUMNS`) written: number of the scene, the person's id, and place and size of the scene's topology,
            the name, positions, states and standard deviations.
    """
    found, person = np.empty((FIELDS, 3), np.int64), np.empty((FIELDS, 3), np.int64)
    scratch_ends, scratch_kinds = np.empty(DEPTH, np.int64), np.empty(DEPTH, np.int64)
    count = 0
    for scene in range(len(begins)):
        at, end = begins[scene], ends[scene]
        if not read_message(data, at, end, shapes, kinds[0], found, scratch_ends, scratch_kinds):
            return -1
        if found[fields[0], 1] != version:
            return -1
        while at < end:  # the fields are valid, as `read_message` has seen
            key, at = read_varint(data, at, end)
            wire = np.int64(key & np.uint64(7))
            if wire == 0:
                _, at = read_varint(data, at, end)
            elif wire == 1:
                at += 8
            elif wire == 5:
                at += 4
            else:
                length, at = read_varint(data, at, end)
                size = np.int64(length)
                if np.int64(key >> np.uint64(3)) == fields[2]:
                    if count == len(rows):
                        return -2
                    if not read_message(data, at, at + size, shapes, kinds[1], person, scratch_ends, scratch_kinds):
                        return -1
                    row = rows[count]
                    row[SCENE], row[ID] = scene, person[fields[3], 1]
                    row[TOPOLOGY], row[TOPOLOGY + 1] = found[fields[1], 1], found[fields[1], 2]
                    for k in range(4):
                        row[NAME + 2 * k], row[NAME + 2 * k + 1] = person[fields[4 + k], 1], person[fields[4 + k], 2]
                    count += 1
                at += size
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def gather(data: UInt8, places: Int64, out: UInt8) -> None:
    """Copy pieces of equal length to ``out`` (n, length) from their places (n,) in ``data``."""
    size = out.shape[1]
    for i in range(len(places)):
        out[i] = data[places[i] : places[i] + size]


@njit(cache=True, nogil=True, error_model="numpy")
def number_texts(data: UInt8, places: Int64, sizes: Int64, first: Int64, out: Int64) -> int:
    """Number different pieces in the order of their first use; return how many there are, −1 if ``first`` is short.

    Args:
        data: the bytes.
        places, sizes: (n,) place and size of each piece.
        first: (m,) written: index of the first piece of each number.
        out: (n,) written: number of each piece.
    """
    count = 0
    for i in range(len(places)):
        number = 0
        while number < count and not _same(data, places[i], sizes[i], places[first[number]], sizes[first[number]]):
            number += 1
        if number == count:
            if count == len(first):
                return -1
            first[count] = i
            count += 1
        out[i] = number
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def _same(data: UInt8, at: int, size: int, other: int, other_size: int) -> bool:
    if size != other_size:
        return False
    k = 0
    while k < size and data[at + k] == data[other + k]:
        k += 1
    return k == size
