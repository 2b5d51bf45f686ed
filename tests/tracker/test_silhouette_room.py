"""The empty room is learnt from a fixed number of images, spread over a duration; how many are missing is told."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mocapella.conventions import NS_PER_S
from mocapella.tracker.silhouette_room import IMAGES, EmptyRoomLearning

IMAGE = {"c1": np.zeros((4, 6, 3), np.uint8)}
SECONDS = 3.0


class Watched:
    """A learning of a room in which nothing moves, and what it has learnt from."""

    def __init__(self, seconds: float = SECONDS) -> None:
        self.learning, self.learnt = EmptyRoomLearning(seconds), 0
        self.empty: Any = SimpleNamespace(silhouette=lambda name, image: None, learn=self._learn)
        self.fitters: Any = SimpleNamespace(learn_background=lambda images: None)

    def _learn(self, images: Any) -> None:
        self.learnt += 1

    def sees(self, at_s: float) -> int:
        """Update with an image at a time; return how many are still needed."""
        assert self.learning.update(round(at_s * NS_PER_S), IMAGE, self.empty, self.fitters) == []
        return self.learning.remaining


def test_each_image_that_is_learnt_is_one_less_that_is_needed() -> None:
    room = Watched()
    assert room.learning.remaining == IMAGES
    for k in range(IMAGES):
        assert not room.learning.done
        assert room.sees(k * SECONDS / IMAGES) == IMAGES - k - 1
        assert room.learnt == k + 1
    assert room.sees(SECONDS) == 0
    assert room.learning.done


@given(st.lists(st.floats(0, 2 * SECONDS), min_size=1).map(sorted))
def test_what_is_needed_never_grows_and_nothing_is_needed_at_the_end(times_s: list[float]) -> None:
    room = Watched()
    room.sees(0.0)
    needed = [IMAGES, *(room.sees(at_s) for at_s in times_s), room.sees(2 * SECONDS)]
    assert all(before >= after for before, after in pairwise(needed))
    assert needed[-1] == 0
    assert room.learnt <= IMAGES + 1 + sum(at_s >= SECONDS for at_s in times_s)


def test_images_that_a_pause_swallowed_are_not_made_up_for() -> None:
    room = Watched()
    room.sees(0.0)
    assert room.sees(SECONDS / 2) == IMAGES // 2
    assert room.learnt == 2
