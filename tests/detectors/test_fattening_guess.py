from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.detectors.fattening_guess import CLEARLY, FATTENING_PX, MOST_VOTES, FatteningGuess

COSTS = st.lists(st.floats(0.01, 1.0), max_size=3)


def near_wall() -> np.ndarray:
    depth = np.full((20, 20), 2.0, np.float32)
    depth[5:15, 5:15] = 0.5
    return depth


def state(guess: FatteningGuess) -> tuple[int, bool]:
    return guess.px, guess.known


def test_a_camera_whose_arms_fit_narrower_images_better_makes_things_wider() -> None:
    guess = FatteningGuess(-1)
    assert state(guess) == (0, False)
    assert guess.learn([0.3, 0.28], [0.2])
    assert state(guess) == (FATTENING_PX, False)
    for _ in range(MOST_VOTES - 1):
        assert not guess.known
        assert not guess.learn([0.2], [0.28, 0.3])
    assert state(guess) == (FATTENING_PX, True)


def test_an_arm_that_is_found_in_narrower_images_alone_votes_for_them() -> None:
    guess = FatteningGuess(-1)
    assert guess.learn([], [0.29])
    assert guess.px == FATTENING_PX


@pytest.mark.parametrize("narrower", [[], [0.2 * CLEARLY + 0.001], [0.2], [0.5]])
def test_a_camera_whose_arms_fit_narrower_images_worse_does_not(narrower: list[float]) -> None:
    guess = FatteningGuess(-1)
    for _ in range(MOST_VOTES):
        assert not guess.known
        assert not guess.learn([0.2], narrower)
    assert state(guess) == (0, True)


@pytest.mark.parametrize("nothing", [[], [1.0], [float("inf")]])
def test_images_without_an_arm_say_nothing(nothing: list[float]) -> None:
    guess = FatteningGuess(-1)
    for _ in range(3 * MOST_VOTES):
        assert not guess.learn(nothing, nothing)
    assert state(guess) == (0, False)


def test_a_guess_that_rests_on_one_arm_is_taken_back_if_the_next_fits_both_images_alike() -> None:
    guess = FatteningGuess(-1)
    guess.learn([0.3], [0.2])
    assert guess.px == FATTENING_PX
    assert guess.learn([0.2], [0.2])
    assert state(guess) == (0, False)


@given(st.lists(st.tuples(COSTS, COSTS), max_size=40), st.booleans())
def test_whatever_came_before_arms_of_either_kind_of_camera_win(
    before: Sequence[tuple[list[float], list[float]]], wider: bool
) -> None:
    guess = FatteningGuess(-1)
    for costs, otherwise in before:
        guess.learn(costs, otherwise)
    for _ in range(2 * MOST_VOTES):
        as_it_is = (guess.px > 0) == wider
        guess.learn([0.1 if as_it_is else 0.2], [0.2 if as_it_is else 0.1])
    assert state(guess) == (FATTENING_PX if wider else 0, True)


def test_arms_are_compared_often_until_the_kind_is_known_and_seldom_then() -> None:
    guess = FatteningGuess(-1)
    before = sum(guess.due(k) for k in range(1000))
    for _ in range(MOST_VOTES):
        guess.learn([0.1], [0.2])
    after = sum(guess.due(k) for k in range(1000))
    assert before >= 5 * after > 0


@pytest.mark.parametrize("px", [0, 2])
def test_a_number_that_is_given_is_used_from_the_first_image_on(px: int) -> None:
    guess = FatteningGuess(px)
    assert state(guess) == (px, True)
    assert not guess.learn([0.3], [0.1])
    assert not any(guess.due(k) for k in range(1000))
    assert (guess.corrected(near_wall()) == 0.5).sum() == (10 - 2 * px) ** 2


def test_the_other_kind_of_image_is_the_measured_one_or_a_narrower_one() -> None:
    guess, depth = FatteningGuess(-1), near_wall()
    assert guess.corrected(depth) is depth
    narrower = guess.otherwise(depth)
    assert (narrower == 0.5).sum() == (10 - 2 * FATTENING_PX) ** 2
    guess.learn([0.3], [0.1])
    assert guess.otherwise(depth) is depth
    np.testing.assert_array_equal(guess.corrected(depth), narrower)
