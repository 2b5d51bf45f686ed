"""What came nearer since it was looked at: laws, and what is no news."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mocapella.sensing.arm_region import ArmRegionSettings
from mocapella.sensing.depth_foreground import DepthForeground

LENS = np.array([200.0, 200.0, 80.0, 60.0])
images = arrays(np.float64, (40, 56), elements=st.sampled_from([0.0, 0.5, 0.8, 1.2, 1.9, 3.0]))


def nearer() -> DepthForeground:
    return DepthForeground(LENS, ArmRegionSettings())


def room(hand: slice | None = None, hand_m: float = 0.8, wall_m: float = 1.6) -> np.ndarray:
    image = np.full((120, 160), wall_m, np.float32)
    if hand is not None:
        image[40:80, hand] = hand_m
    return image


@given(images, images)
def test_what_was_looked_at_is_not_new_and_what_went_away_never(before: np.ndarray, after: np.ndarray) -> None:
    seen = nearer()
    seen.learn(before)
    assert len(seen.places(before, [])) == 0
    assert len(seen.places(np.where(before > 0, np.maximum(before, after), 0), [])) == 0


def test_a_hand_that_comes_is_new_where_it_is_until_it_was_looked_at() -> None:
    seen = nearer()
    seen.learn(room())
    for _ in range(2):
        places = seen.places(room(slice(96, 136)), [])
        assert len(places) > 0
        np.testing.assert_allclose(places[:, 2], 0.8, rtol=1e-6)
        pixels = places[:, :2] / places[:, 2:] * LENS[:2] + LENS[2:]
        assert ((pixels > [96, 40]) & (pixels < [136, 80])).all()
    seen.learn(room(slice(96, 136)))
    assert len(seen.places(room(slice(96, 136)), [])) == 0
    assert len(seen.places(room(), [])) == 0  # it is away …
    assert len(seen.places(room(slice(96, 136)), [])) > 0  # … and comes again


def test_what_is_too_small_or_too_little_nearer_is_not_new() -> None:
    seen = nearer()
    seen.learn(room())
    assert len(seen.places(room(slice(96, 108)), [])) == 0
    assert len(seen.places(room(slice(96, 136), 1.57), [])) == 0


def test_what_is_about_an_arm_is_its_own() -> None:
    seen = nearer()
    seen.learn(room())
    x = (116 - 80) / 200 * 0.8
    arm = np.array([[x, 0.0, 0.8, 0.12, 1.0]])
    assert len(seen.places(room(slice(96, 136)), [arm])) == 0
    assert len(seen.places(room(slice(96, 136)), [arm - [0.4, 0, 0, 0, 0]])) > 0


def test_what_comes_out_of_a_shadow_is_not_new_but_what_comes_before_nothing_is() -> None:
    seen = nearer()
    shadowed = room()
    shadowed[:, 96:136] = 0
    seen.learn(shadowed)
    assert len(seen.places(room(), [])) == 0
    seen.learn(np.zeros_like(shadowed))
    assert len(seen.places(room(slice(96, 136)), [])) > 0
