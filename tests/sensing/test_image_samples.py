"""Samples of an image are the means of its squares of pixels."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mocapella.sensing.image_samples import image_samples


@given(st.integers(1, 4), st.integers(1, 20), st.integers(1, 20), st.sampled_from([1, 3]), st.integers(0, 9))
def test_each_sample_is_the_mean_of_its_square(step: int, rows: int, columns: int, channels: int, seed: int) -> None:
    shape = (step * rows + step - 1, step * columns + step - 1, channels)
    image = np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)
    found = image_samples(image[..., 0] if channels == 1 else image, step)
    assert found.shape == (rows, columns, channels)
    squares = image[: rows * step, : columns * step].reshape(rows, step, columns, step, channels)
    np.testing.assert_allclose(found, squares.mean(axis=(1, 3)), atol=0.51)
