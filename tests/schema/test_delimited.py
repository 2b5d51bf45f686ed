"""Messages on a stream: cut anywhere, they come out as they went in."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import WireError
from mocapella.schema.delimited import DelimitedReader, delimited


@given(st.lists(st.binary(max_size=300), max_size=5), st.lists(st.integers(1, 200), min_size=1))
def test_messages_survive_any_cutting(messages: list[bytes], cuts: list[int]) -> None:
    stream = b"".join(map(delimited, messages))
    reader, found, at, turn = DelimitedReader(), [], 0, 0
    while at < len(stream):
        step = cuts[turn % len(cuts)]
        found += list(reader.feed(stream[at : at + step]))
        at, turn = at + step, turn + 1
    assert found == messages
    assert reader.pending == 0


@pytest.mark.parametrize(
    ("length", "prefix"), [(0, "00"), (127, "7f"), (128, "8001"), (300, "ac02"), (16384, "808001")]
)
def test_the_length_is_a_varint(length: int, prefix: str) -> None:
    assert delimited(b"x" * length)[: len(prefix) // 2].hex() == prefix


def test_a_length_of_five_bytes_is_read() -> None:
    assert list(DelimitedReader().feed(b"\x83\x80\x80\x80\x00abc")) == [b"abc"]


def test_a_length_above_the_limit_is_refused_before_the_message_comes() -> None:
    reader = DelimitedReader(limit=1000)
    with pytest.raises(WireError, match="1001 bytes is announced; at most 1000"):
        list(reader.feed(delimited(b"x" * 1001)[:2]))
    assert list(DelimitedReader(limit=1000).feed(delimited(b"x" * 1000))) == [b"x" * 1000]


def test_what_is_no_length_is_refused() -> None:
    with pytest.raises(WireError, match="no length before the message"):
        list(DelimitedReader().feed(b"\xff\xff\xff\xff\xff"))


def test_what_is_pending_is_counted() -> None:
    reader = DelimitedReader()
    assert list(reader.feed(b"\x05abc")) == []
    assert reader.pending == 4
