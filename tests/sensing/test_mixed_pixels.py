"""Mixed pixels between two surfaces are removed, and nothing else is."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.sensing.mixed_pixels import FEW, without_mixed_pixels

JUMP, FAR_M = 0.025, 2.0
seeds = st.integers(0, 2**32 - 1)


def removed(depth: np.ndarray) -> np.ndarray:
    return without_mixed_pixels(np.ascontiguousarray(depth), jump=JUMP, far_m=FAR_M)


def stripes(near_m: float, far_m: float, between: list[float], upright: bool) -> np.ndarray:
    """Return a near surface, mixed pixels beside each other, and a far surface, side by side or one over the other."""
    row = np.array([near_m] * 10 + between + [far_m] * 10, np.float32)
    image = np.tile(row, (12, 1))
    return np.ascontiguousarray(image.T) if upright else image


@given(st.lists(st.floats(0.2, 0.8), min_size=1, max_size=2), st.booleans(), st.booleans())
def test_pixels_between_two_surfaces_are_removed_and_the_surfaces_stay(
    shares: list[float], upright: bool, mirrored: bool
) -> None:
    between = [0.6 + share * (1.2 - 0.6) for share in shares]
    depth = stripes(0.6, 1.2, between, upright)
    if mirrored:
        depth = np.ascontiguousarray(depth[::-1, ::-1])
    mixed = ~np.isin(depth, np.array([0.6, 1.2], np.float32))
    assert mixed.any()
    mixed[:2] = mixed[-2:] = mixed[:, :2] = mixed[:, -2:] = False  # the border has no opposite pixels
    np.testing.assert_array_equal(removed(depth), np.where(mixed, 0.0, depth))


@given(seeds)
def test_an_image_of_two_depths_or_none_stays_as_it_is(seed: int) -> None:
    depth = np.random.default_rng(seed).choice(np.array([0.0, 0.6, 1.2], np.float32), (20, 24))
    np.testing.assert_array_equal(removed(depth), depth)


@given(st.floats(-0.45, 0.45), st.floats(-0.45, 0.45))
def test_a_slanted_surface_stays(right: float, down: float) -> None:
    """Its depth changes by less than the jump in two pixels."""
    y, x = np.indices((20, 24))
    depth = (0.8 + 0.7 * JUMP * (right * x + down * y) / 2).astype(np.float32)
    np.testing.assert_array_equal(removed(depth), depth)


@pytest.mark.parametrize(
    "depth",
    [
        stripes(0.6, 0.0, [0.9], upright=False),  # an edge before nothing
        stripes(0.6, 1.2, [0.9] * 5, upright=True),  # a surface of its own
        stripes(2.2, 2.9, [2.5], upright=False),  # too far away to matter
    ],
)
def test_what_may_be_a_surface_stays(depth: np.ndarray) -> None:
    kept = removed(depth)
    middle = (depth == depth[depth.shape[0] // 2, depth.shape[1] // 2]) & (depth > 0)
    assert (kept[middle] > 0).any()
    assert (kept[depth == depth[0, 0]] > 0).all()


def test_an_image_with_a_few_mixed_pixels_is_returned_itself() -> None:
    depth = np.ones((100, 100), np.float32)
    depth[:, 50:] = 1.5
    few = int(FEW * depth.size) - 1
    depth[10 : 10 + few, 50] = 1.25
    assert removed(depth) is depth
    depth[10 : 10 + few + 2, 50] = 1.25
    assert (removed(depth) == 0).sum() == few + 2


def test_the_given_image_is_not_changed() -> None:
    depth = stripes(0.6, 1.2, [0.9], upright=False)
    before = depth.copy()
    assert (removed(depth) != before).any()
    np.testing.assert_array_equal(depth, before)
