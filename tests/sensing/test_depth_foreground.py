"""What came nearer since it was looked at: laws, and what is no news."""

from __future__ import annotations

import numpy as np
import pytest
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


def test_places_are_on_the_surface_at_the_middles_of_their_cells() -> None:
    """A cell of the grid is seen at its fifth pixel; only cells with all neighbours are told."""
    lens = np.array([190.0, 230.0, 77.0, 66.0])
    seen = DepthForeground(lens, ArmRegionSettings())
    seen.learn(room())
    found = seen.places(room(slice(96, 136)), [])
    pixels = found[:, :2] / found[:, 2:] * lens[:2] + lens[2:]
    inner = {(x, y) for x in (108, 116, 124) for y in (52, 60, 68)}
    assert set(map(tuple, np.round(pixels, 6).tolist())) == inner


@pytest.mark.parametrize(("metres", "valid"), [(0.25, True), (0.2499, False), (1.75, True), (1.7501, False)])
def test_what_is_out_of_the_range_counts_as_unmeasured(metres: float, valid: bool) -> None:
    seen = DepthForeground(LENS, ArmRegionSettings(near_m=0.25, far_m=1.75))
    seen.learn(np.zeros((120, 160), np.float32))
    assert bool(len(seen.places(room(slice(96, 136), metres, wall_m=0.0), []))) == valid


@pytest.mark.parametrize(("nearer_m", "new"), [(0.051, True), (0.049, False)])
def test_a_surface_is_new_from_five_centimetres_on(nearer_m: float, new: bool) -> None:
    seen = nearer()
    seen.learn(room())
    assert bool(len(seen.places(room(slice(96, 136), 1.6 - nearer_m), []))) == new


def test_the_background_recedes_at_once_and_comes_nearer_only_slowly() -> None:
    seen = nearer()
    seen.learn(room())
    seen.places(room(wall_m=1.9), [])
    assert len(seen.places(room(wall_m=1.8), [])) > 0
    again = nearer()
    again.learn(room())
    again.places(room(wall_m=1.57), [])  # not new, and not remembered
    assert len(again.places(room(wall_m=1.54), [])) > 0


def test_the_first_image_is_the_background() -> None:
    seen = nearer()
    assert seen.places(room(), []).shape == (0, 3)
    assert len(seen.places(room(slice(96, 136)), [])) > 0


def test_what_is_by_any_of_the_arms_is_not_new() -> None:
    seen = nearer()
    seen.learn(room())
    x = (116 - 80) / 200 * 0.8
    arm, elsewhere = (np.array([[at, 0.0, 0.8, 0.12, 1.0]]) for at in (x, x - 0.4))
    for arms in ([arm, elsewhere], [elsewhere, arm]):
        assert len(seen.places(room(slice(96, 136)), arms)) == 0


@pytest.mark.parametrize(("cells", "shadow"), [(12, True), (15, False)])
def test_a_gap_is_a_shadow_up_to_a_width(cells: int, shadow: bool) -> None:
    """What is in its middle is three cells wide, each six cells or less from its edge, or seven or more."""
    wide = np.full((120, 240), 1.6, np.float32)
    gap = wide.copy()
    gap[:, 48 : 48 + 8 * cells] = 0
    seen = DepthForeground(LENS, ArmRegionSettings())
    seen.learn(gap)
    thin = np.zeros_like(wide)
    middle = 48 + 8 * (cells // 2)
    thin[:, middle - 8 : middle + 16] = 1.6
    assert (len(seen.places(thin, [])) == 0) == shadow
