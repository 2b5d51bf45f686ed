from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from mocapella.detectors.fattening_guess import CLEARLY, FATTENING_PX, PLAINLY, FatteningGuess

COSTS = st.lists(st.floats(0.01, 1.0), max_size=3)


def near_wall() -> np.ndarray:
    depth = np.full((20, 20), 2.0, np.float32)
    depth[5:15, 5:15] = 0.5
    return depth


def state(guess: FatteningGuess) -> tuple[int, bool]:
    return guess.px, guess.known


MANY = 12
"""Comparisons with the same result that are enough, whatever came before."""


def learnt(guess: FatteningGuess, narrower: float, measured: float, times: int = 1) -> list[int]:
    """Return the guessed number of pixels after each of so many comparisons of these costs."""
    told = []
    for _ in range(times):
        costs = [narrower, measured] if guess.px else [measured, narrower]
        guess.learn(len(told), [costs[0]], [costs[1]])
        told.append(guess.px)
    return told


def test_a_camera_whose_arms_fit_narrower_images_better_makes_things_wider() -> None:
    guess = FatteningGuess(-1)
    assert state(guess) == (0, False)
    assert guess.learn(0, [0.3, 0.28], [0.2])
    assert state(guess) == (FATTENING_PX, False)
    assert not guess.learn(1, [0.2], [0.28, 0.3])
    learnt(guess, 0.2, 0.28, MANY)
    assert state(guess) == (FATTENING_PX, True)


def test_an_arm_that_is_found_in_narrower_images_alone_is_evidence_for_them() -> None:
    guess = FatteningGuess(-1)
    assert guess.learn(0, [], [0.29])
    assert guess.px == FATTENING_PX


def textured(kind: str) -> np.ndarray:
    """Return an image (120, 120) of a slanted wall [m], with the texture of a kind of camera."""
    rng = np.random.default_rng(3)
    wall = np.tile(0.6 + 0.0005 * np.arange(120), (120, 1))
    noise = rng.standard_normal(wall.shape)
    blocks = ndimage.gaussian_filter(noise, 2.0)
    sd_m = {"smooth": 0.00005, "independent": 0.001, "blocks": 0.0}[kind]
    return (wall + sd_m * noise + (0.003 * blocks / blocks.std() if kind == "blocks" else 0.0)).astype(np.float32)


@pytest.mark.parametrize(("kind", "told"), [("smooth", 0), ("independent", 0), ("blocks", FATTENING_PX)])
def test_a_texture_that_is_no_stereo_cameras_is_evidence_against_narrower_things(kind: str, told: int) -> None:
    guess = FatteningGuess(-1)
    guess.look(textured(kind), 2.0)
    assert learnt(guess, 0.16, 0.22) == [told]
    assert learnt(guess, 0.16, 0.3, MANY)[-1] == FATTENING_PX  # fits decide in the end


def test_a_texture_that_may_be_a_stereo_cameras_lets_the_better_fit_decide() -> None:
    guess, unknown = FatteningGuess(-1), FatteningGuess(-1)
    guess.look(textured("blocks"), 2.0)
    assert learnt(guess, 0.2, 0.21, 2) == [FATTENING_PX] * 2
    assert learnt(unknown, 0.2, 0.21, 2) == [0] * 2


def test_the_texture_counts_once_and_images_without_surfaces_not_at_all() -> None:
    once, often = FatteningGuess(-1), FatteningGuess(-1)
    once.look(textured("smooth"), 2.0)
    for depth in (np.zeros((120, 120), np.float32), *[textured("smooth")] * 5):
        often.look(depth, 2.0)
    assert not often.known
    assert learnt(once, 0.2, 0.3, 3) == learnt(often, 0.2, 0.3, 3)


def test_a_texture_that_says_nothing_is_not_replaced_by_that_of_a_later_image() -> None:
    guess = FatteningGuess(-1)
    guess.look(textured("blocks"), 2.0)
    guess.look(textured("smooth"), 2.0)
    assert learnt(guess, 0.16, 0.22) == [FATTENING_PX]


@pytest.mark.parametrize("narrower", [1.0, 0.3 * CLEARLY + 0.001, 0.3, 0.5])
def test_a_camera_whose_arms_fit_narrower_images_worse_does_not(narrower: float) -> None:
    guess = FatteningGuess(-1)
    assert learnt(guess, narrower, 0.3, 500) == [0] * 500
    assert guess.known


@pytest.mark.parametrize("nothing", [[], [1.0], [float("inf")]])
def test_images_without_an_arm_say_nothing(nothing: list[float]) -> None:
    guess = FatteningGuess(-1)
    for image in range(MANY):
        assert not guess.learn(image, nothing, nothing)
    assert state(guess) == (0, False)


def test_a_hand_that_fits_well_as_it_is_is_no_evidence_for_wider_things_however_well_it_fits_otherwise() -> None:
    guess = FatteningGuess(-1)
    assert set(learnt(guess, 0.01, PLAINLY - 0.001, MANY)) == {0}
    assert state(guess) == (0, True)
    other = FatteningGuess(-1)
    assert set(learnt(other, 0.01, PLAINLY + 0.001, MANY)) == {FATTENING_PX}


def test_wrong_postures_in_some_images_are_no_evidence() -> None:
    guess = FatteningGuess(-1)
    for image in range(30):  # of the measured image, two of three fits are wrong
        guess.learn(image, [0.3 if image % 3 else 0.16], [0.15])
        assert guess.px == 0


@given(st.lists(st.tuples(COSTS, COSTS), max_size=40), st.booleans())
def test_whatever_came_before_arms_of_either_kind_of_camera_win(
    before: Sequence[tuple[list[float], list[float]]], wider: bool
) -> None:
    guess = FatteningGuess(-1)
    for image, (costs, otherwise) in enumerate(before):
        guess.learn(image, costs, otherwise)
    assert learnt(guess, *((0.16, 0.25) if wider else (0.2, 0.1)), MANY)[-1] == (FATTENING_PX if wider else 0)
    assert guess.known


def test_arms_are_compared_often_until_the_kind_is_known_and_seldom_then_and_no_image_twice() -> None:
    guess = FatteningGuess(-1)
    assert all(guess.due(k, urgent=True) for k in range(1000))
    before = sum(guess.due(k) for k in range(1000))
    guess.learn(20, [0.2], [0.2])
    assert not guess.due(20, urgent=True)
    assert guess.due(25)
    learnt(guess, 0.2, 0.1, MANY)
    after = sum(guess.due(k, urgent=k % 2 == 0) for k in range(1000))
    assert before >= 5 * after > 0


@pytest.mark.parametrize("px", [0, 2])
def test_a_number_that_is_given_is_used_from_the_first_image_on(px: int) -> None:
    guess = FatteningGuess(px)
    assert state(guess) == (px, True)
    guess.look(textured("smooth"), 2.0)
    assert not guess.learn(0, [0.3], [0.1])
    assert not any(guess.due(k) for k in range(1000))
    assert (guess.corrected(near_wall()) == 0.5).sum() == (10 - 2 * px) ** 2


def test_the_other_kind_of_image_is_the_measured_one_or_a_narrower_one() -> None:
    guess, depth = FatteningGuess(-1), near_wall()
    assert guess.corrected(depth) is depth
    narrower = guess.otherwise(depth)
    assert (narrower == 0.5).sum() == (10 - 2 * FATTENING_PX) ** 2
    guess.learn(0, [0.3], [0.1])
    assert guess.otherwise(depth) is depth
    np.testing.assert_array_equal(guess.corrected(depth), narrower)
