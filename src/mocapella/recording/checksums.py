"""CRC-32 of bytes that follow each other, from the checksums of both parts."""

from __future__ import annotations

import zlib
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

_BITS_OF_LENGTHS: Final = 40


def joined_crc(first: int, second: int, length: int) -> int:
    """Return the CRC-32 of two parts together, as `zlib.crc32` of their bytes, without reading them.

    Shifting a checksum by a number of zero bytes is linear over the field of two elements, so a table of shifts by
    powers of two is enough (M. Adler, ``crc32_combine`` of zlib).

    Args:
        first, second: the checksums of the parts.
        length: size of the second part, below 2^40 [bytes].
    """
    for shift in _shifts():
        if length & 1:
            a, b, c, d = shift
            first = a[first & 255] ^ b[first >> 8 & 255] ^ c[first >> 16 & 255] ^ d[first >> 24]
        length >>= 1
    return first ^ second


@cache
def _shifts() -> list[tuple[list[int], ...]]:
    """Return, for each power of two, the shifts by so many zero bytes of each byte of a checksum."""
    # The checksum of a byte b is the shift of its complement, with the register's ones taken out again.
    shift = np.array([zlib.crc32(bytes([value ^ 255])) ^ 0xFF000000 for value in range(256)], np.uint32)
    values = np.arange(256, dtype=np.uint32)
    table = np.stack([shift, *(values << np.uint32(8 * k - 8) for k in (1, 2, 3))])
    tables = []
    for _ in range(_BITS_OF_LENGTHS):
        tables.append(tuple(table.tolist()))
        table = _shifted(table, table)
    return tables


def _shifted(table: NDArray[np.uint32], values: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Return the shifts of values, by a table of the shifts of each of their bytes."""
    parts = [table[k, values >> np.uint32(8 * k) & np.uint32(255)] for k in range(4)]
    return np.asarray(np.bitwise_xor.reduce(parts), np.uint32)
