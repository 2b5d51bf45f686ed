"""The ranges behave as a set of numbers does, and what is noted at once is noted as one by one."""

import zlib

from hypothesis import given
from hypothesis import strategies as st

from mocapella.recording.checksums import joined_crc
from mocapella.recording.ledger import NodeLedger
from mocapella.recording.sequences import SequenceRanges


@given(st.lists(st.integers(0, 40)), st.integers(0, 42), st.integers(0, 42))
def test_ranges_are_a_set(numbers: list[int], begin: int, end: int) -> None:
    ranges, seen = SequenceRanges(), set[int]()
    for number in numbers:
        assert ranges.add(number) == (number not in seen)
        seen.add(number)
        assert len(ranges) == len(seen)
        assert (ranges.first, ranges.last) == (min(seen), max(seen))
    gaps = list(ranges.gaps(begin, end))
    missing = [n for n in range(begin, end) if n not in seen]
    assert [n for first, last in gaps for n in range(first, last + 1)] == missing
    assert all(first <= last for first, last in gaps)
    assert ranges.first_missing(begin) == next(n for n in range(begin, 100) if n not in seen)
    assert all((number in ranges) == (number in seen) for number in range(-1, 42))


def test_a_run_without_gaps_is_one_range_in_whatever_order_it_comes() -> None:
    ranges = SequenceRanges()
    for number in [*range(0, 1000, 2), *range(999, 0, -2)]:
        ranges.add(number)
    assert list(ranges.gaps(0, 1000)) == []
    assert len(ranges._firsts) == 1


@given(st.lists(st.integers(0, 40)), st.integers(0, 60), st.integers(1, 20))
def test_a_run_after_all_others_is_added_as_its_numbers_are(numbers: list[int], first: int, count: int) -> None:
    at_once, one_by_one = SequenceRanges(), SequenceRanges()
    for number in numbers:
        at_once.add(number)
        one_by_one.add(number)
    before = at_once.ranges
    if not at_once.extend(first, count):
        assert first <= max(numbers)
        assert at_once.ranges == before
        return
    for number in range(first, first + count):
        assert one_by_one.add(number)
    assert at_once.ranges == one_by_one.ranges
    assert len(at_once) == len(one_by_one)


@given(st.lists(st.integers(0, 40)), st.integers(0, 60), st.integers(1, 20), st.booleans(), st.booleans())
def test_a_ledger_notes_a_run_as_its_frames(
    numbers: list[int], first: int, count: int, agreed: bool, given_up: bool
) -> None:
    at_once, one_by_one = NodeLedger(), NodeLedger()
    for ledger in (at_once, one_by_one):
        if agreed:
            ledger.expect(30)
        if given_up:
            ledger.give_up(50)
        for number in numbers:
            ledger.put_back(number)
    if not at_once.put_back_run(first, count):
        assert given_up or first <= max(numbers)
        assert at_once.received() == one_by_one.received()
        return
    for number in range(first, first + count):
        assert one_by_one.put_back(number)
    for ledger in (at_once, one_by_one):
        ledger.commit()
    assert at_once.received() == one_by_one.received()
    assert at_once.row("a", 1) == one_by_one.row("a", 1)
    assert (at_once.stored, at_once.acknowledged) == (one_by_one.stored, one_by_one.acknowledged)


@given(st.binary(max_size=40), st.binary(max_size=600))
def test_joined_checksums_are_those_of_the_bytes_together(first: bytes, second: bytes) -> None:
    assert joined_crc(zlib.crc32(first), zlib.crc32(second), len(second)) == zlib.crc32(first + second)


def test_checksums_of_long_parts_are_joined() -> None:
    second = bytes(range(256)) * 70_000
    assert joined_crc(zlib.crc32(b"first"), zlib.crc32(second), len(second)) == zlib.crc32(b"first" + second)
