"""Orders of conditions: the balanced Latin square's laws, and orders that depend on nothing but their seed."""

from __future__ import annotations

import math
from collections import Counter
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from mocapella.studies.orders import balanced_square, ordered, square_rows


@given(st.integers(1, 20))
def test_each_row_has_each_condition_once(conditions: int) -> None:
    assert all(sorted(row) == list(range(conditions)) for row in balanced_square(conditions))


@given(st.integers(1, 20))
def test_each_condition_is_equally_often_at_each_place(conditions: int) -> None:
    square = balanced_square(conditions)
    for place in range(conditions):
        counts = Counter(row[place] for row in square)
        assert set(counts.values()) == {len(square) // conditions}
        assert len(counts) == conditions


@given(st.integers(2, 20))
def test_each_condition_follows_each_other_one_equally_often(conditions: int) -> None:
    square = balanced_square(conditions)
    pairs = Counter(pair for row in square for pair in pairwise(row))
    assert len(pairs) == conditions * (conditions - 1)
    assert len(set(pairs.values())) == 1


@given(st.integers(1, 20))
def test_an_odd_number_of_conditions_needs_twice_as_many_rows(conditions: int) -> None:
    assert len(balanced_square(conditions)) == conditions * (1 + conditions % 2)


@given(st.integers(1, 14), st.integers(1, 14), st.integers(0, 5))
def test_two_squares_are_crossed_and_each_is_used_evenly(placements: int, tasks: int, block: int) -> None:
    rows = [square_rows(number, placements, tasks) for number in range(placements * tasks)]
    assert len(set(rows)) == placements * tasks
    together = math.lcm(placements, tasks)
    some = [square_rows(block * together + number, placements, tasks) for number in range(together)]
    assert set(Counter(row for row, _ in some).values()) == {together // placements}
    assert set(Counter(row for _, row in some).values()) == {together // tasks}


@given(st.lists(st.text(), max_size=9), st.sampled_from(["fixed", "counterbalanced", "random"]), st.integers(0, 99))
def test_an_order_is_a_permutation(items: list[str], order: str, row: int) -> None:
    assert sorted(ordered(items, order, row=row, seed="a")) == sorted(items)  # type: ignore[arg-type]


@given(st.text(), st.integers(0, 99), st.integers(0, 99))
def test_a_random_order_depends_on_its_seed_only(seed: str, row: int, other: int) -> None:
    assert ordered("abcdef", "random", row=row, seed=seed) == ordered("abcdef", "random", row=other, seed=seed)


def test_random_orders_of_many_seeds_are_spread_evenly() -> None:
    counts = Counter(ordered("abc", "random", row=0, seed=str(seed)) for seed in range(6000))
    assert len(counts) == 6
    assert max(abs(count - 1000) for count in counts.values()) < 5 * math.sqrt(1000)
