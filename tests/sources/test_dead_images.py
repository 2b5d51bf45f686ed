"""Cameras in whose images nothing is to be seen."""

from __future__ import annotations

import numpy as np
import pytest

from mocapella.sources.dead_images import FROZEN_AFTER, DeadImages

RNG = np.random.default_rng(0)


def lively():
    return RNG.integers(0, 255, (48, 64, 3), dtype=np.uint8)


def test_images_of_life_count():
    dead = DeadImages()
    assert all(dead.update({"a": lively(), "b": lively()}) == {} for _ in range(6))


@pytest.mark.parametrize(("level", "said"), [(3, "its image is black"), (180, "its image is of one colour")])
def test_black_and_uniform_images_do_not_count_at_once(level, said):
    noise = RNG.integers(0, 2, (48, 64, 3), dtype=np.uint8)
    assert DeadImages().update({"a": lively(), "b": level + noise}) == {"b": said}


def test_an_image_that_stays_while_others_change_is_frozen():
    dead, same = DeadImages(), lively()
    found = [dead.update({"a": lively(), "b": same.copy()}) for _ in range(FROZEN_AFTER + 1)]
    assert found[: FROZEN_AFTER - 1] == [{}] * (FROZEN_AFTER - 1)
    assert "frozen" in found[FROZEN_AFTER - 1]["b"]
    assert f"{FROZEN_AFTER + 1} frames" in found[FROZEN_AFTER]["b"]
    assert dead.update({"a": lively(), "b": lively()}) == {}


def test_images_that_come_twice_or_of_a_scene_that_is_still_count():
    dead = DeadImages()
    for _ in range(4):
        image = lively()
        assert dead.update({"a": lively(), "b": image}) == {}
        assert dead.update({"a": lively(), "b": image.copy()}) == {}
    dead, images = DeadImages(), {"a": lively(), "b": lively()}
    assert all(dead.update(images) == {} for _ in range(2 * FROZEN_AFTER))
