from __future__ import annotations

import numpy as np
import pytest

from mocapella.detectors.fattening_guess import ALIKE, FATTENING_PX, MOST_TRIES, FatteningGuess


def test_a_camera_whose_arms_fit_narrower_images_better_makes_things_wider() -> None:
    guess = FatteningGuess(-1)
    assert (guess.px, guess.known) == (0, False)
    assert guess.learn([0.3, 0.28], [0.2])
    assert (guess.px, guess.known) == (FATTENING_PX, True)


def test_an_arm_that_is_found_in_narrower_images_alone_is_enough() -> None:
    guess = FatteningGuess(-1)
    assert guess.learn([], [0.29])
    assert (guess.px, guess.known) == (FATTENING_PX, True)


@pytest.mark.parametrize("narrower", [[], [0.2 / ALIKE + 0.001], [0.5]])
def test_a_camera_whose_arms_fit_narrower_images_worse_does_not(narrower: list[float]) -> None:
    guess = FatteningGuess(-1)
    assert not guess.learn([0.2], narrower)
    assert (guess.px, guess.known) == (0, True)


def test_costs_that_are_alike_decide_nothing_until_there_were_enough() -> None:
    guess = FatteningGuess(-1)
    for _ in range(MOST_TRIES):
        assert not guess.known
        assert not guess.learn([0.2], [0.19])
    assert (guess.px, guess.known) == (0, True)


def test_images_without_an_arm_say_nothing() -> None:
    guess = FatteningGuess(-1)
    for _ in range(2 * MOST_TRIES):
        assert not guess.learn([], [])
    assert not guess.known


def test_a_number_that_is_given_is_used_from_the_first_image_on() -> None:
    near_wall = np.full((20, 20), 2.0, np.float32)
    near_wall[5:15, 5:15] = 0.5
    given, none = FatteningGuess(2), FatteningGuess(0)
    assert (given.px, given.known, none.px, none.known) == (2, True, 0, True)
    assert (given.corrected(near_wall) == 0.5).sum() == 6 * 6
    assert none.corrected(near_wall) is near_wall
