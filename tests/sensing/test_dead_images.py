"""Cameras in whose images nothing is to be seen."""

from __future__ import annotations

import numpy as np
import pytest

from mocapella.sensing.dead_images import DARK, DeadImages

RNG = np.random.default_rng(0)


def lively():
    return RNG.integers(0, 255, (48, 64, 3), dtype=np.uint8)


def test_images_of_life_count():
    dead = DeadImages()
    assert all(dead.update({"a": lively(), "b": lively()}) == {} for _ in range(6))


@pytest.mark.parametrize(
    ("colour", "said"),
    [((3, 3, 3), "its image is black"), ((180,) * 3, "its image is of one colour"), ((250, 30, 0), "of one colour")],
)
@pytest.mark.parametrize("gray", [False, True])
def test_black_and_uniform_images_do_not_count_at_once(colour, said, gray):
    image = np.array(colour, np.uint8) + RNG.integers(0, 2, (48, 64, 3), dtype=np.uint8)
    found = DeadImages().update({"a": lively(), "b": image[..., 1] if gray else image})
    assert list(found) == ["b"]
    assert said in found["b"]


def test_a_black_image_may_have_broken_pixels():
    image = np.zeros((480, 640, 3), np.uint8)
    image[::40, ::40] = 255
    assert "b" in DeadImages().update({"a": lively(), "b": image})


def test_an_image_that_stays_while_others_change_is_frozen():
    dead, same = DeadImages(), lively()
    found = [dead.update({"a": lively(), "b": same.copy()}) for _ in range(4)]
    assert found[0] == {}
    assert [one["b"] for one in found[1:]] == [
        f"its image is frozen: the same for {n} frames, while others change" for n in (2, 3, 4)
    ]
    assert dead.update({"a": lively(), "b": lively()}) == {}


def test_of_a_slower_camera_only_new_images_count():
    dead = DeadImages()
    for _ in range(4):
        image = lively()
        assert dead.update({"a": lively(), "b": image}) == {}
        assert list(dead.update({"a": lively(), "b": image.copy()})) == ["b"]


def test_images_of_a_scene_that_is_still_count():
    dead, images = DeadImages(), {"a": lively(), "b": lively()}
    assert all(dead.update(images) == {} for _ in range(6))


def sampled(values):
    """An image whose every 19th pixel of every 19th row has these values (rows, columns)."""
    image = np.zeros((19 * values.shape[0] - 18, 19 * values.shape[1] - 18, 3), np.uint8)
    image[::19, ::19] = values[..., None]
    return image


@pytest.mark.parametrize(("bright", "said"), [(1, "its image is black"), (2, None)])
def test_a_hundredth_of_a_black_image_may_be_bright(bright, said):
    values = np.full((10, 10), DARK, np.uint8)
    values[0, :bright] = 255
    assert DeadImages().update({"a": sampled(values)}).get("a") == said


@pytest.mark.parametrize(("apart", "said"), [(4, None), (3, "its image is of one colour")])
def test_an_image_of_two_grey_levels_is_uniform_if_they_are_less_than_four_apart(apart, said):
    """The standard deviation is half of their distance."""
    values = np.where(np.indices((10, 10)).sum(axis=0) % 2, 100, 100 + apart).astype(np.uint8)
    assert DeadImages().update({"a": sampled(values)}).get("a") == said


def test_an_image_of_another_size_is_not_compared():
    dead, values = DeadImages(), RNG.integers(0, 255, (10, 10), dtype=np.uint8)
    for rows in (10, 9, 10):
        assert dead.update({"a": lively(), "b": sampled(values[:rows])}) == {}
    assert list(dead.update({"a": lively(), "b": sampled(values)})) == ["b"]


def test_a_camera_that_comes_later_changes():
    dead, same = DeadImages(), lively()
    dead.update({"b": same})
    dead.update({"b": same})
    assert list(dead.update({"b": same, "a": lively()})) == ["b"]
