"""Silhouettes as masks of an image."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mocapella.model.silhouettes import Silhouette, overlap

shapes = st.tuples(st.integers(1, 5), st.integers(1, 5))
places = st.tuples(st.integers(-20, 20), st.integers(-20, 20))
sizes = st.tuples(st.integers(1, 12), st.integers(1, 12))
masks = arrays(np.bool_, (3, 4))


@given(shapes.flatmap(lambda shape: arrays(np.float32, shape, elements=st.sampled_from([-1.0, 0.0, 1.0]))),
       places, st.integers(1, 4), sizes)  # fmt: skip
def test_a_mask_has_the_square_about_each_sample_that_is_inside(
    phi: np.ndarray, origin: tuple[int, int], step: int, size: tuple[int, int]
) -> None:
    """Also of a window that is partly or wholly outside the image; the contour itself, 0, is not inside."""
    wanted = set()
    for row, column in np.argwhere(phi > 0).tolist():
        x, y = origin[0] + step * column, origin[1] + step * row
        before = {1: 0, 2: 0, 3: 1, 4: 1}[step]  # of the pixels of a square, the middle one or the one before
        wanted |= {(x - before + i, y - before + j) for i in range(step) for j in range(step)}
    mask = Silhouette(origin, step, phi).mask(size)
    assert mask.shape == (size[1], size[0])
    found = {(x, y) for y, x in np.argwhere(mask).tolist()}
    assert found == {(x, y) for x, y in wanted if 0 <= x < size[0] and 0 <= y < size[1]}


@given(masks, masks)
def test_the_overlap_is_symmetric_and_1_of_equal_masks_only(a: np.ndarray, b: np.ndarray) -> None:
    assert overlap(a, b) == overlap(b, a)
    assert 0 <= overlap(a, b) <= 1
    assert (overlap(a, b) == 1) == (a.any() and (a == b).all())
    assert (overlap(a, b) == 0) == (not (a & b).any())


@given(st.integers(1, 9), st.integers(0, 9), st.integers(0, 9))
def test_the_overlap_is_the_share_of_the_pixels_of_either_that_both_have(both: int, only_a: int, only_b: int) -> None:
    a = np.repeat([True, True, False], [both, only_a, only_b])
    b = np.repeat([True, False, True], [both, only_a, only_b])
    assert overlap(a, b) == pytest.approx(both / (both + only_a + only_b))
    assert overlap(a & ~a, b & ~b) == 0
