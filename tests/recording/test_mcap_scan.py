"""The scan of an MCAP file takes time in proportion to its length, whatever lengths its records claim."""

from __future__ import annotations

import io
import struct

import pytest

from mocapella.recording.mcap_file import MAGIC
from mocapella.recording.mcap_scan import End, scan

EMPTY = b"\x06" + struct.pack("<QQQQIIQ", 40, 0, 0, 0, 0, 0, 0)
"""A chunk without messages."""


class Counting(io.BytesIO):
    """A file that counts the bytes that are read."""

    read_bytes = 0

    def read(self, size: int | None = -1, /) -> bytes:
        data = super().read(size)
        self.read_bytes += len(data)
        return data


def metadata(rest: int) -> bytes:
    return b"\x0c" + struct.pack("<Q", rest)


def chunk(rest: int) -> bytes:
    return b"\x06" + struct.pack("<QQQQIIQ", rest, 0, 0, 9, 0, 0, 7)


def packed_chunk(rest: int) -> bytes:
    return b"\x06" + struct.pack("<QQQQII4sQ", rest, 0, 0, 9, 0, 4, b"zstd", 7)


def unknown(rest: int) -> bytes:
    return b"\x77" + struct.pack("<Q", rest)


def file_of(head: object, length: int) -> bytes:
    """Return a file of records that each claim the rest of it, with an empty chunk behind each."""
    out = bytearray(MAGIC)
    while len(out) < length:
        out += head(max(0, length - len(out) - 9)) + EMPTY  # type: ignore[operator]
    return bytes(out[:length])


@pytest.mark.parametrize("head", [metadata, chunk, packed_chunk, unknown])
def test_records_that_claim_the_rest_of_the_file_are_read_a_few_times_at_most(head: object) -> None:
    counts = []
    for length in (1 << 15, 1 << 17):
        file = Counting(file_of(head, length))
        events = list(scan(file, length, "made.mcap"))
        assert isinstance(events[-1], End)
        counts.append(file.read_bytes)
    assert counts[1] < 5 * counts[0]  # four times the length
