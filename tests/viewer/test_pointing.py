"""One marker after the other is pointed at; names can be typed."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.viewer.pointing import MARKERS, MOST, SKIN, Pointing, asks_for, read_names, where

points = st.tuples(*(st.floats(0, most).map(lambda value: round(value, 2)) for most in (639, 479)))
moves = st.lists(st.one_of(points, st.none()), max_size=7)


def after(done: list[tuple[float, float] | None]) -> Pointing:
    pointing = Pointing()
    for at in done:
        pointing = pointing.skip() if at is None else pointing.click(at)
    return pointing


@given(moves, points)
def test_back_takes_back_what_was_done_last(done: list[tuple[float, float] | None], at: tuple[float, float]) -> None:
    pointing = after(done)
    if pointing.next is None:
        assert pointing.click(at) == pointing.skip() == pointing
    else:
        assert pointing.click(at).points[pointing.next] == at
        assert pointing.click(at).back() == pointing.skip().back() == pointing
    assert pointing.again() == Pointing(pointing.names)


@given(moves)
def test_what_is_left_out_has_no_point_and_skin_alone_is_not_enough(done: list[tuple[float, float] | None]) -> None:
    pointing = after(done)
    assert list(pointing.points.values()) == [at for at in done if at is not None]
    assert pointing.enough == any(at is not None for at in done[: len(MARKERS)])


@given(moves, st.integers(0, 6))
def test_other_names_keep_what_stands_before_them(done: list[tuple[float, float] | None], k: int) -> None:
    names = (*MARKERS[:k], "other", *MARKERS[k:], SKIN)
    assert after(done).named(names) == Pointing(names, tuple(done[:k]))
    assert after(done).named((*MARKERS, SKIN)) == after(done)


def test_all_are_asked_for_thumb_to_base_and_then_skin() -> None:
    pointing, asked = Pointing(), []
    while pointing.next is not None:
        asked.append(asks_for(pointing.next))
        pointing = pointing.click((1.0, 2.0))
    assert asked[0] == "Click on red, on the thumb"
    assert asked[5] == "Click on cyan, on the palm"
    assert asked[6] == "Click on skin, away from the markers"
    assert "Learn" in asks_for(None)
    assert asks_for("left-2") == "Click on left-2"
    assert where("left-2") == ""


def test_names_are_read_with_skin_at_last() -> None:
    assert read_names(" red,blue, skin,  big one ,") == ("red", "blue", "big one", SKIN)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "commas"),
        (" , skin", "commas"),
        ("red, red", "red is named twice"),
        ("x" * 81, "at most 80"),
        (", ".join(map(str, range(MOST + 1))), "65 markers"),
    ],
)
def test_names_that_cannot_be_are_refused(text: str, says: str) -> None:
    with pytest.raises(SettingsError, match=says):
        read_names(text)
