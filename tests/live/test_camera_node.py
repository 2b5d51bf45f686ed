"""What a camera's node says of problems that come and go."""

from __future__ import annotations

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from mocapella.live.camera_node import STEADY_S, WARN_AFTER_S, FaultReports

BEGIN, OVER = "too few", "rate: well again"


def said(there: list[bool]) -> list[list[str]]:
    """What is said at each look, at some of which there is a problem."""
    warned = FaultReports()
    return [list(warned.update({"rate": BEGIN} if now else {}, WARN_AFTER_S * k)) for k, now in enumerate(there)]


def test_the_first_time_begin_and_end_are_said_at_once() -> None:
    assert said([False, True, True, False, False]) == [[], [BEGIN], [], [OVER], []]


def test_what_comes_and_goes_is_over_when_it_has_been_away_for_long() -> None:
    steady = round(STEADY_S / WARN_AFTER_S)
    told = said([True, False] * 50 + [False] * steady + [True, False])
    assert told[:3] == [[BEGIN], [OVER], [BEGIN]]
    assert told[3:] == [[]] * (95 + steady) + [[OVER], [], [BEGIN], []]


@given(st.lists(st.booleans(), max_size=120))
def test_beginnings_and_ends_alternate_with_a_minute_at_least_between_two_ends(there: list[bool]) -> None:
    told = said(there)
    flat = [text for texts in told for text in texts]
    assert flat == ([BEGIN, OVER] * len(flat))[: len(flat)]
    assert all(texts == [] or (texts == [BEGIN]) == now for texts, now in zip(told, there, strict=True))
    assert any(there) == (BEGIN in flat)
    ends = [k for k, texts in enumerate(told) if texts == [OVER]]
    assert all((b - a) * WARN_AFTER_S >= STEADY_S for a, b in pairwise(ends))


def test_each_kind_is_told_by_itself() -> None:
    warned = FaultReports()
    assert list(warned.update({"a": "A", "b": "B"}, 0.0)) == ["A", "B"]
    assert list(warned.update({"b": "B"}, 3.0)) == ["a: well again"]
    assert list(warned.update({"a": "A"}, 6.0)) == ["A", "b: well again"]
    assert list(warned.update({}, 9.0)) == []
    assert list(warned.update({}, 66.0)) == ["a: well again"]
