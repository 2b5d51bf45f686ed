"""A sample's mean, written out, beside that of any square of pixels."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mocapella.sensing import background_memory_kernels as k


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
