"""What is not in the empty room, and what moves."""

from __future__ import annotations

import numpy as np
import pytest

from mocapella.model.silhouettes import Silhouette
from mocapella.sensing.empty_room import DIFFERS, EmptyRoom, MovedSince

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


@pytest.mark.parametrize("channel", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_pixel_differs_if_one_channel_does_by_more_than_the_limit(channel, sign):
    room, taken = EmptyRoom(), shape(20)
    room.learn({"c1": np.full((60, 80, 3), 120, np.uint8)})
    for by, share in ((DIFFERS, 0.0), (DIFFERS + 1, 1.0)):
        image = np.full((60, 80, 3), 120, np.uint8)
        image[..., channel] += np.uint8(sign * by % 256)
        assert room.differs("c1", image, taken) == share


@pytest.mark.parametrize(("wide", "high", "margin"), [(10, 20, 2), (20, 10, 1), (4, 30, 3), (6, 4, 0)])
def test_a_tenth_of_a_bodys_height_about_it_is_not_learnt(wide, high, margin):
    room, body = EmptyRoom(), shape(30, 15, wide, high)
    room.learn({"c1": WALL}, {"c1": body})
    known = room.memory()[1]["c1"]
    near = np.zeros((60, 80), bool)
    near[15 - margin : 15 + high + margin, 30 - margin : 30 + wide + margin] = True
    np.testing.assert_array_equal(known, ~near)


def test_somebody_seen_by_one_camera_hides_nothing_from_another():
    room = EmptyRoom()
    room.learn({"c1": WALL, "c2": WALL}, {"c1": shape(30)})
    assert room.memory()[1]["c2"].all()
    assert room.knows("c1")
    assert not room.knows("c3")


@pytest.mark.parametrize(("rows", "known"), [(15, False), (16, True)])
def test_more_than_half_of_a_body_must_be_before_the_known_room(rows, known):
    """Of 30 rows; what was learnt is above where somebody stood, and a margin of two rows."""
    room = EmptyRoom()
    room.learn({"c1": WALL}, {"c1": shape(0, y=20 + rows + 2, wide=80, high=20)})
    assert np.isfinite(room.differs("c1", WALL, shape(20))) == known


def test_a_silhouette_leaves_out_others_and_what_is_not_known():
    room, image = EmptyRoom(), WALL.copy()
    room.learn({"c1": WALL}, {"c1": shape(60, wide=8)})
    for one in (shape(5), shape(60, wide=8)):
        image[one.mask(SIZE)] = 20
    found = room.silhouette("c1", image, 3)
    assert found.mask(SIZE)[30, 10]
    assert not found.mask(SIZE)[30, 64]
    assert set(np.unique(found.phi)) == {-0.5, 0.5}
    assert (found.origin_px, found.step_px, found.phi.shape) == ((0, 0), 2, (30, 40))
    assert room.silhouette("c1", image, 3, shape(5).mask(SIZE)) is None


def test_the_share_at_a_body_is_of_the_pixels_that_changed_and_needs_enough_of_them():
    """Where it was and is, with a tenth of its height about it; a fifth of its area must have changed, 4 of 20 px."""
    base, body = np.full((60, 80, 3), 120, np.uint8), shape(20, y=10, wide=20, high=40)
    away = base.copy()
    away[10:50, 56:76] = 250
    near = away.copy()
    near[10:50, 20:40] = 250
    for image, share in ((away, 0.0), (near, 0.5)):
        moved = MovedSince()
        assert np.isnan(moved.at_body("c1", base, body))
        assert moved.at_body("c1", image, body) == pytest.approx(share, abs=0.02)
    for wide, enough in ((10, True), (4, False)):
        some = base.copy()
        some[10:50, 22 : 22 + wide] = 250
        moved = MovedSince()
        moved.at_body("c1", base, body)
        assert np.isfinite(moved.at_body("c1", some, body)) == enough


def test_changes_of_a_camera_without_a_body_are_at_none():
    base, nobody = np.full((60, 80, 3), 120, np.uint8), shape(0, wide=0)
    moved = MovedSince()
    moved.at_body("c1", base, nobody)
    assert np.isnan(moved.at_body("c1", base, nobody))
    changed = base.copy()
    changed[20:40, 20:40] = 250
    assert moved.at_body("c1", changed, nobody) == 0.0


def test_a_body_has_a_margin_of_its_present_height_where_it_was_and_is():
    base, changed = np.full((60, 80, 3), 120, np.uint8), np.full((60, 80, 3), 120, np.uint8)
    changed[8:54, 12:32] = 250  # about the body by a tenth of its height, and a little more
    moved, body = MovedSince(), shape(16, y=12, wide=12, high=38)
    moved.at_body("c1", base, body)
    for now in (body, shape(60, y=12, wide=12, high=38)):
        assert moved.at_body("c1", changed, now) == pytest.approx(1.0, abs=0.05)
    small = shape(60, y=12, wide=12, high=8)
    assert moved.at_body("c1", changed, small) < 0.85
