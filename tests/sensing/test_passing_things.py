"""Foreground that is none of the person."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.sensing.passing_things import APART, LEAST, MOVES, PassingThings

BODY = np.zeros((60, 80), np.bool_)
BODY[10:50, 20:30] = True
NOTHING = np.zeros_like(BODY)


def with_box(left, wide=8, top=20, high=10):
    mask = BODY.copy()
    mask[top : top + high, left : left + wide] = True
    return mask


def test_a_person_alone_is_no_thing_nor_is_what_hangs_on_the_person():
    assert not PassingThings().update(BODY, NOTHING, BODY).any()
    assert not PassingThings().update(with_box(30), NOTHING, BODY).any()


def test_foreground_apart_from_the_person_is_a_thing_and_stays_one_beside_the_person():
    things = PassingThings()
    for left in range(50, 29, -MOVES):
        found = things.update(with_box(left), NOTHING, BODY)
        assert np.array_equal(found, with_box(left) & ~BODY)
    assert not (found & BODY).any()


def test_a_thing_that_goes_is_forgotten():
    things = PassingThings()
    things.update(with_box(50), NOTHING, BODY)
    assert not things.update(BODY, NOTHING, BODY).any()
    assert not things.update(with_box(30), NOTHING, BODY).any(), "which would be a limb"
    assert not things.update(np.zeros_like(BODY), NOTHING, BODY).any()


@given(gap=st.integers(APART + 1, 30), seen=st.integers(0, 29))
def test_a_thing_begins_only_where_background_is_seen_between(gap, seen):
    """An arm that swings before what was never seen hangs on."""
    unknown = with_box(30, wide=gap) & ~BODY
    unknown[:, 30 + seen] = False
    assert PassingThings().update(with_box(30 + gap), unknown, BODY).any() == (APART <= seen < gap)


@given(gap=st.integers(APART + 1, 30))
def test_of_unknown_samples_none_is_of_a_thing(gap):
    box, beside = with_box(30 + gap), with_box(38 + gap)
    assert np.array_equal(PassingThings().update(box, beside & ~box, BODY), box & ~BODY)


@pytest.mark.parametrize(("high", "is_one"), [(LEAST // 5 - 1, False), (LEAST // 5, True)])
def test_a_few_samples_are_no_thing(high, is_one):
    assert PassingThings().update(with_box(60, wide=5, high=high), NOTHING, BODY).any() == is_one


def test_a_thing_begins_apart_from_the_person():
    for gap, is_one in ((APART - 1, False), (APART + 1, True)):
        assert PassingThings().update(with_box(30 + gap), NOTHING, BODY).any() == is_one


def test_things_go_on_from_their_memory():
    one, other = PassingThings(), PassingThings()
    one.update(with_box(32 + APART), NOTHING, BODY)
    other.recall(one.memory())
    assert other.update(with_box(30), NOTHING, BODY).any()
