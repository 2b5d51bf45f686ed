"""The ranges behave as a set of numbers does."""

from hypothesis import given
from hypothesis import strategies as st

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
