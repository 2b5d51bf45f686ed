"""Single wrong pixels are taken out where there are many; other images stay as they are."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.lib.stride_tricks import sliding_window_view

from mocapella.errors import InputError
from mocapella.sensing import speckles_kernels
from mocapella.sensing.speckles import FEWEST, without_speckles
from mocapella.sources.simulate.corruption import Corruption


def room(height=120, width=160):
    """(height, width, 3) edges and shades, and a little noise of a camera's."""
    rng = np.random.default_rng(0)
    rows, columns = np.indices((height, width))
    shade = 60 + rows / 2 + 60 * (columns > width // 2) + 40 * (rows > height // 3)
    return np.clip(shade[..., None] + [0, 10, 20] + rng.normal(0, 3, (height, width, 3)), 0, 255).astype(np.uint8)


@settings(max_examples=30)
@given(
    st.integers(0, 10**6),
    st.tuples(st.integers(1, 12), st.integers(1, 12), st.integers(1, 4)),
    st.sampled_from([3, 256]),
)
def test_it_is_the_median_of_three_by_three(seed, shape, most):
    image = np.random.default_rng(seed).integers(0, most, shape).astype(np.uint8)
    out = np.zeros_like(image)
    speckles_kernels.median_of_nine(image, out)
    wanted = image.copy()
    if min(shape[:2]) >= 3:
        wanted[1:-1, 1:-1] = np.median(sliding_window_view(image, (3, 3), axis=(0, 1)), axis=(-2, -1))
    np.testing.assert_array_equal(out, wanted)
    every, levels = 1 + seed % 3, most // 6
    far = abs(image.astype(int) - wanted)[1:-1:every] > levels
    assert speckles_kernels.standing_out(image, every, levels) == pytest.approx(far.mean() if far.size else 0.0)


@pytest.mark.parametrize("share", [0.05, 0.15, 0.3])
def test_most_of_what_is_wrong_is_taken_out(share):
    clean = room()
    worse = Corruption(share).of(clean, 0)
    found = without_speckles(worse)

    def wrong(image):
        return np.mean(np.abs(image.astype(int) - clean).max(axis=-1) > 25)

    assert wrong(worse) > 0.9 * share
    assert wrong(found) < 0.2 * wrong(worse)


@pytest.mark.parametrize("image", [room(), room()[..., 0], Corruption(FEWEST / 3).of(room(), 0)])
def test_what_has_few_of_them_stays_as_it_is(image):
    assert without_speckles(image) is image


def test_what_has_nothing_else_is_no_image_and_stays_as_it_is():
    garbage = np.random.default_rng(0).integers(0, 256, (120, 160, 3)).astype(np.uint8)
    assert without_speckles(garbage) is garbage


def test_gray_is_as_colour():
    worse = Corruption(0.15).of(np.repeat(room()[..., :1], 3, axis=2), 0)[..., 0]
    np.testing.assert_array_equal(without_speckles(worse), without_speckles(worse[..., None])[..., 0])


def test_parts_of_larger_images_do():
    worse = Corruption(0.15).of(room(), 0)
    np.testing.assert_array_equal(without_speckles(worse[10:90, 20:140]), without_speckles(worse[10:90, 20:140].copy()))


@pytest.mark.parametrize("image", [np.zeros((4, 4)), np.zeros(4, np.uint8), np.zeros((2, 4, 4, 3), np.uint8)])
def test_what_is_no_image_is_said(image):
    with pytest.raises(InputError, match="no image"):
        without_speckles(image)
