"""The scan of an MCAP file takes time in proportion to its length, whatever lengths its records claim."""

from __future__ import annotations

import io
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.recording.mcap_file import MAGIC
from mocapella.recording.mcap_scan import Damage, End, _next_chunk, _read_tail, _record_at, scan

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


@pytest.mark.parametrize("record", [metadata(0), EMPTY, metadata(2) + b"ab"])
def test_a_record_that_ends_with_the_file_is_read_and_one_byte_less_is_none(record: bytes) -> None:
    """Also one without content, and a chunk without messages."""
    for before in (0, 8):
        file, end = io.BytesIO(bytes(before) + record), before + len(record)
        assert _record_at(file, before, end) == record
        assert _record_at(file, before, end - 1) is None


@pytest.mark.parametrize("before", [0, 20, 5000])
def test_the_next_chunk_is_one_that_ends_before_the_end(before: int) -> None:
    whole = b"\x06" + struct.pack("<QQQQIIQ", 50, 0, 0, 10, 0, 0, 10) + bytes(10)
    file, end = io.BytesIO(bytes(before) + whole + bytes(100)), before + len(whole)
    assert _next_chunk(file, 0, end) == before
    assert _next_chunk(file, 0, end + 100) == before
    assert _next_chunk(file, 0, end - 1) is None
    assert _next_chunk(file, before + 1, end) is None


@given(st.integers(1, 200), st.booleans(), st.booleans())
def test_damage_ends_where_the_next_chunk_begins_or_with_the_data_of_a_closed_file(
    length: int, chunk_behind: bool, closed: bool
) -> None:
    start = len(MAGIC) + len(EMPTY)
    data = MAGIC + EMPTY + b"\x77" * length + (EMPTY if chunk_behind else b"")
    if closed:
        data += b"\x0f" + struct.pack("<QI", 4, 0) + b"\x02" + struct.pack("<QQQI", 20, 0, 0, 0) + MAGIC
    *damages, last = scan(io.BytesIO(data), len(data), "made.mcap")
    if chunk_behind or closed:
        assert [(one.start, one.end) for one in damages if isinstance(one, Damage)] == [(start, start + length)]
    else:
        assert damages == []  # what is torn off at the end of a file that is still written is no damage
    assert last == End(closed, 0 if chunk_behind or closed else length)


@pytest.mark.parametrize("behind", [b"", EMPTY], ids=["the file ends", "a chunk follows"])
def test_what_was_read_is_not_read_again(behind: bytes) -> None:
    """The last byte of a good record and the damaged bytes behind it look like a chunk."""
    header = b"\x01" + struct.pack("<Q", 1) + EMPTY[:1]
    data = MAGIC + header + EMPTY[1:] + behind
    start, end = len(MAGIC + header), len(MAGIC + header + EMPTY[1:])
    told = list(scan(io.BytesIO(data), len(data), "made.mcap"))
    if behind:
        assert told == [Damage(start, end, "no record can be read there"), End(False, 0)]
    else:
        assert told == [End(False, end - start)]


@pytest.mark.parametrize(("before", "there"), [(8, True), (7, False), (0, False)])
def test_the_end_of_a_file_is_behind_its_magic(before: int, there: bool) -> None:
    """The end of the data, without a summary, is nowhere else."""
    end = b"\x0f" + struct.pack("<QI", 4, 0) + b"\x02" + struct.pack("<QQQI", 20, 0, 0, 0) + MAGIC
    data = bytes(before) + end
    tail = _read_tail(io.BytesIO(data), len(data))
    assert (tail is not None) == there
    if tail is not None:
        assert tail.data_end == before


def test_the_end_of_the_data_and_the_foot_of_the_file_do_not_overlap() -> None:
    end = b"\x0f" + struct.pack("<Q", 4)
    foot = b"\x02" + struct.pack("<QQQI", 20, 8 + 13, 0, 0) + MAGIC
    data = MAGIC + end + foot  # whose first bytes are the checksum of the data
    assert _read_tail(io.BytesIO(data), len(data)) is None
