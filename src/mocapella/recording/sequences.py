"""A set of sequence numbers, stored as ranges, so that hours of received frames take a few bytes."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Iterator


class SequenceRanges:
    """A growing set of sequence numbers, stored as ranges of consecutive numbers."""

    def __init__(self) -> None:
        self._firsts: list[int] = []
        self._lasts: list[int] = []
        self._count = 0

    def add(self, number: int) -> bool:
        """Add a sequence number; return False if the set has it already."""
        firsts, lasts = self._firsts, self._lasts
        if lasts and number == lasts[-1] + 1:
            lasts[-1] = number
            self._count += 1
            return True
        i = bisect_right(firsts, number)  # the range before it is i - 1, the one after it is i
        if i and number <= lasts[i - 1]:
            return False
        self._count += 1
        joins_before = i > 0 and lasts[i - 1] + 1 == number
        joins_after = i < len(firsts) and firsts[i] == number + 1
        if joins_before and joins_after:
            lasts[i - 1] = lasts.pop(i)
            del firsts[i]
        elif joins_before:
            lasts[i - 1] = number
        elif joins_after:
            firsts[i] = number
        else:
            firsts.insert(i, number)
            lasts.insert(i, number)
        return True

    def extend(self, first: int, count: int) -> bool:
        """Add numbers that follow each other; return False, and add none, unless all are above the greatest one."""
        lasts = self._lasts
        if lasts and first <= lasts[-1]:
            return False
        if lasts and first == lasts[-1] + 1:
            lasts[-1] += count
        else:
            self._firsts.append(first)
            lasts.append(first + count - 1)
        self._count += count
        return True

    def copy(self) -> SequenceRanges:
        """Return an independent copy."""
        copied = SequenceRanges()
        copied._firsts, copied._lasts, copied._count = [*self._firsts], [*self._lasts], self._count
        return copied

    @classmethod
    def of(cls, ranges: Iterable[tuple[int, int]]) -> SequenceRanges:
        """Make a set from the first and last number of each range.

        Raises:
            ValueError: the ranges overlap, touch, or are not in ascending order.
        """
        made = cls()
        for first, last in ranges:
            if last < first or (made._lasts and first <= made._lasts[-1] + 1):
                raise ValueError(f"the range from {first} to {last} is not after those before it")
            made._firsts.append(first)
            made._lasts.append(last)
            made._count += last + 1 - first
        return made

    @property
    def ranges(self) -> list[tuple[int, int]]:
        """First and last number of each range, in ascending order."""
        return list(zip(self._firsts, self._lasts, strict=True))

    def __contains__(self, number: int) -> bool:
        i = bisect_right(self._firsts, number)
        return i > 0 and number <= self._lasts[i - 1]

    def __len__(self) -> int:
        return self._count

    @property
    def first(self) -> int:
        """The smallest number; the set must not be empty."""
        return self._firsts[0]

    @property
    def last(self) -> int:
        """The greatest number; the set must not be empty."""
        return self._lasts[-1]

    def gaps(self, begin: int, end: int) -> Iterator[tuple[int, int]]:
        """Yield the (first, last) missing number of each gap, from ``begin`` to before ``end``.

        Of an empty set, all of these numbers are one gap.
        """
        i = bisect_right(self._firsts, begin)
        at = begin if i == 0 else max(begin, self._lasts[i - 1] + 1)
        while at < end:
            following = self._firsts[i] if i < len(self._firsts) else end
            yield at, min(following, end) - 1
            if i == len(self._firsts):
                return
            at = self._lasts[i] + 1
            i += 1

    def first_missing(self, begin: int) -> int:
        """Return the smallest number from ``begin`` on that is not in the set."""
        i = bisect_right(self._firsts, begin)
        return begin if i == 0 else max(begin, self._lasts[i - 1] + 1)
