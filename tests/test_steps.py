"""Work that is done a little at a time."""

from __future__ import annotations

from mocapella.steps import Steps, at_once


def steps(n: int) -> Steps[list[int]]:
    made = []
    for k in range(n):
        made.append(k)
        yield 1
    return made


def test_all_of_it_at_once_comes_to_what_it_comes_to_a_little_at_a_time() -> None:
    for n in (0, 1, 5):
        some = steps(n)
        assert sum(some) == n
        assert at_once(steps(n)) == list(range(n))
