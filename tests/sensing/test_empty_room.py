"""What is not in the empty room, and what moves."""

from __future__ import annotations

import numpy as np
import pytest

from mocapella.model.silhouettes import Silhouette
from mocapella.sensing.empty_room import EmptyRoom, MovedSince

SIZE = (80, 60)
RNG = np.random.default_rng(0)
WALL = RNG.integers(100, 200, (60, 80, 3), dtype=np.uint8)


def shape(x, y=20, wide=12, high=30):
    phi = np.full((60, 80), -0.5, np.float32)
    phi[y : y + high, x : x + wide] = 0.5
    return Silhouette((0, 0), 1, phi)


def image(x=None):
    out = np.clip(WALL + RNG.normal(0, 2, WALL.shape), 0, 255).astype(np.uint8)
    if x is not None:
        out[shape(x).mask(SIZE)] = [20, 20, 220]
    return out


def test_somebody_differs_from_the_empty_room_and_nobody_does_not():
    room = EmptyRoom()
    assert np.isnan(room.differs("a", image(10), shape(10)))
    room.learn({"a": image()})
    assert room.differs("a", image(10), shape(10)) == 1.0
    assert room.differs("a", image(), shape(10)) < 0.05
    assert np.isnan(room.differs("b", image(10), shape(10)))


def test_the_silhouette_is_what_is_not_in_the_empty_room():
    room = EmptyRoom()
    assert room.silhouette("a", image(10)) is None
    room.learn({"a": image()})
    found = room.silhouette("a", image(30)).mask(SIZE)
    truth = shape(30).mask(SIZE)
    assert np.count_nonzero(found & truth) / np.count_nonzero(found | truth) > 0.8
    assert room.silhouette("a", WALL) is None


def test_what_moves_is_where_the_body_was_or_is():
    for follows in (True, False):
        moved = MovedSince()
        assert np.isnan(moved.at_body("a", image(10), shape(10)))
        assert np.isnan(moved.at_body("a", image(10), shape(10)))
        share = moved.at_body("a", image(40), shape(40 if follows else 10))
        assert share == 1.0 if follows else share < 0.6


def test_single_wrong_pixels_do_not_move():
    """15 % of the pixels have random values, in every image others."""

    def noisy(x):
        out = image(x)
        hit = RNG.random(out.shape[:2]) < 0.15
        out[hit] = RNG.integers(0, 256, (np.count_nonzero(hit), 3), dtype=np.uint8)
        return out

    moved = MovedSince()
    assert np.isnan(moved.at_body("a", noisy(10), shape(10)))
    assert np.isnan(moved.at_body("a", noisy(10), shape(10)))
    assert moved.at_body("a", noisy(40), shape(40)) > 0.85  # which is when a rig is not doubted


def test_what_is_behind_somebody_is_learnt_once_they_are_elsewhere():
    room, somebody_there = EmptyRoom(), WALL.copy()
    left, right = shape(5), shape(60)
    somebody_there[left.mask(SIZE)] = 20
    room.learn({"c1": somebody_there}, {"c1": left})
    assert np.isnan(room.differs("c1", WALL, left))
    assert room.differs("c1", WALL, right) == 0.0
    somebody_there = WALL.copy()
    somebody_there[right.mask(SIZE)] = 20
    assert room.differs("c1", somebody_there, right) == 1.0
    room.learn({"c1": somebody_there}, {"c1": right})
    assert room.differs("c1", WALL, left) == 0.0
    assert room.differs("c1", WALL, right) == 0.0  # as before: nothing was learnt of who is there


def test_what_differs_where_others_are_is_not_of_the_body():
    room, image, taken = EmptyRoom(), WALL.copy(), shape(20, wide=12)
    room.learn({"c1": WALL})
    other = shape(20, wide=4).mask(SIZE)
    image[other] = 20
    assert room.differs("c1", image, taken) == pytest.approx(1 / 3)
    assert room.differs("c1", image, taken, other) == 0.0
    assert np.isnan(room.differs("c1", image, taken, taken.mask(SIZE)))


def test_as_many_things_are_found_as_there_are_people():
    room, image = EmptyRoom(), WALL.copy()
    room.learn({"c1": WALL})
    for one in (shape(5), shape(60, wide=8)):
        image[one.mask(SIZE)] = 20
    for things, columns in ((1, [5]), (2, [5, 60]), (3, [5, 60])):
        found = room.silhouette("c1", image, things)
        assert found is not None
        mask = found.mask(SIZE)
        assert [x for x in (5, 60) if mask[30, x + 3]] == columns
