"""A sample's mean, written out, beside that of any square of pixels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.sensing import background_memory_kernels as k


@pytest.mark.slow
@given(
    st.tuples(st.integers(1, 9), st.integers(1, 9), st.sampled_from([1, 3])), st.integers(1, 5), st.integers(0, 10_000)
)
def test_nine_pixels_have_the_mean_of_their_square_and_are_all_in_the_image(
    shape: tuple[int, int, int], step: int, seed: int
) -> None:
    image = np.random.default_rng(seed).integers(0, 256, shape, np.uint8)
    for i in range(-(-shape[0] // step)):
        for j in range(-(-shape[1] // step)):
            top, left, half = i * step - 1, j * step - 1, step // 2
            rows = slice(max(i * step - half, 0), i * step + half + 1)
            columns = slice(max(j * step - half, 0), j * step + half + 1)
            square = image[rows, columns].reshape(-1, shape[2])
            mean, nine = np.empty(shape[2]), np.empty(3)
            k._mean(image, step, i, j, mean)
            np.testing.assert_allclose(mean, square.mean(axis=0), rtol=1e-12)
            there = top >= 0 and left >= 0 and top + 3 <= shape[0] and left + 3 <= shape[1]
            assert k._usual(image.shape, step, i, j) == (shape[2] == 3 and half <= 1 and there)
            if k._usual(image.shape, step, i, j):
                k._nine(image, step, top, left, nine)
                np.testing.assert_array_equal(nine, mean)


@given(st.sampled_from([1, 3]), st.integers(1, 40), st.sampled_from([0.05, 0.3]), st.integers(0, 10_000))
def test_what_is_learnt_is_a_mean_and_a_variance_that_single_values_hardly_move(
    channels: int, images: int, rate: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    seen = np.clip(rng.normal(120, 10, (images, 4, 5, channels)) + 100 * (rng.random((images, 4, 5, 1)) < 0.1), 0, 255)
    seen = seen.astype(np.uint8)
    mean, variance, count = (np.zeros(shape, kind) for shape, kind in (
        ((4, 5, channels), np.float32), ((4, 5), np.float32), ((4, 5), np.uint8)))  # fmt: skip
    learnt, nobody = k.BackgroundSamples(mean, variance, count), k.PersonWindow(np.empty((0, 0), np.float32), 0, 0, 0.0)
    uncovered, no_others = np.empty((0, 0), np.uint8), np.empty((0, 0), np.bool_)
    for image in seen:
        k.learn(image, 1, nobody, uncovered, no_others, 0, 4, 8, rate, 10.0, learnt)
    wanted, spread = seen[0].astype(float), np.full((4, 5), 100.0)
    for n, image in enumerate(seen[1:].astype(float), 1):
        r, most = max(1 / (n + 1), rate), k.WIDE * np.sqrt(spread)[..., None]
        off = np.clip(image - wanted, -most, most)
        wanted += r * off
        spread += r * (k.OF_CUT * (off**2).mean(axis=-1) - spread)
    np.testing.assert_allclose(mean, wanted, rtol=1e-4)
    np.testing.assert_allclose(variance, spread, rtol=1e-4)
    assert (count == images).all()
