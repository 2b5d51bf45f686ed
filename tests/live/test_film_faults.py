"""Faults of films are found in their images: black, frozen, the same film twice; faultless films have none."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest

from mocapella.sources.frame_set import FrameSet

pytest.importorskip("cv2")

from mocapella.live.film_faults import FilmFaults

Picture = Callable[[int], np.ndarray]


def noise(seed: int) -> Picture:
    return lambda k: np.random.default_rng([seed, k]).integers(0, 255, (24, 32, 3)).astype(np.uint8)


def black(_k: int) -> np.ndarray:
    return np.zeros((24, 32, 3), np.uint8)


def still(k: int) -> np.ndarray:
    """One image, which compression changes a little."""
    return np.clip(noise(9)(0).astype(int) + noise(k)(k) % 3, 0, 255).astype(np.uint8)


def sentences(count: int = 8, **films: Picture) -> list[str]:
    faults = FilmFaults(films)
    shown = [FrameSet.at_rate(k, 30.0, {name: of(k) for name, of in films.items()}) for k in range(count)]
    assert list(faults.watch(shown)) == shown
    return faults.sentences()


def test_films_that_show_something_have_no_fault() -> None:
    assert sentences(left=noise(1), right=noise(2)) == []
    assert sentences(0, left=noise(1)) == []


@pytest.mark.parametrize(
    ("of", "words"),
    [
        (black, "right: 8 of its 8 images are black: uncover the lens"),
        (lambda _k: np.full((24, 32, 3), 120, np.uint8), "right: 8 of its 8 images are of one colour"),
        (still, r"right: 7 of its 8 images do not differ from the one before \(frozen\)"),
        (noise(1), "left and right are the same film: name the film of each camera"),
    ],
)
def test_a_faulty_film_is_named_with_the_remedy(of: Picture, words: str) -> None:
    (said,) = sentences(left=noise(1), right=of)
    assert re.match(words, said), said


def test_a_film_in_which_somebody_small_moves_is_not_frozen() -> None:
    def far(k: int) -> np.ndarray:
        image = still(k)
        image[8:16, 8 + 8 * (k % 2) : 12 + 8 * (k % 2)] = 250
        return image

    assert sentences(left=noise(1), right=far) == []


def test_a_fault_of_few_images_is_none() -> None:
    assert sentences(left=noise(1), right=lambda k: black(k) if k < 3 else noise(2)(k)) == []
    assert sentences(2, left=noise(1), right=still) == []  # too few to be frozen
