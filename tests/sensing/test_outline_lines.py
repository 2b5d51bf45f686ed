"""The border of a silhouette as lines: laws of where its points are."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mocapella.model.silhouettes import Silhouette
from mocapella.sensing.outline_lines import border_lines, border_samples, mask_lines

origins = st.tuples(st.integers(-20, 200), st.integers(-20, 200))


def silhouette(mask, origin=(0, 0), step=1, outside=-0.5):
    return Silhouette(origin, step, np.where(mask, np.float32(0.5), np.float32(outside)))


def lines_of(points):
    """Split where a row is NaN."""
    parts, begin = [], 0
    for k in [*np.flatnonzero(np.isnan(points[:, 0])).tolist(), len(points)]:
        parts.append(points[begin:k])
        begin = k + 1
    return [part for part in parts if len(part)]


@given(arrays(bool, st.tuples(st.integers(1, 30), st.integers(1, 30))), origins, st.integers(1, 4))
def test_points_are_samples_that_are_covered_or_beside_a_hole(mask, origin, step):
    points = border_lines(silhouette(mask, origin, step))
    assert points.dtype == np.float32
    assert points.shape[1:] == (2,)
    for line in lines_of(points):
        columns, rows = ((line - np.array(origin)) / step).T.astype(int)
        assert mask[rows, columns].all()
    whole = [line for line in border_samples(silhouette(mask, origin, step)) if len(line) >= 3]
    if sum(map(len, whole)) <= 300:
        assert len(lines_of(points)) == len(whole)
        for line, of_all in zip(lines_of(points), whole, strict=True):
            np.testing.assert_array_equal(line, of_all)


@given(arrays(bool, (8, 9)))
def test_a_sample_that_is_just_on_the_zero_is_outside(mask):
    just, clearly = silhouette(mask, outside=0.0), silhouette(mask)
    np.testing.assert_array_equal(border_lines(just), border_lines(clearly))
    for one, other in zip(border_samples(just), border_samples(clearly), strict=True):
        np.testing.assert_array_equal(one, other)


@given(st.integers(5, 400), st.integers(5, 400), st.integers(50, 400))
def test_there_are_no_more_points_than_wanted_and_they_go_all_around(width, height, most):
    mask = np.zeros((height + 2, width + 2), np.uint8)
    mask[1:-1, 1:-1] = 1
    points = mask_lines(mask, (7, 9), 2, most)
    assert len(points) <= most
    lowest, highest = points.min(axis=0), points.max(axis=0)
    every = -(-2 * (width + height) // most)
    assert (lowest - [9, 11] <= 2 * every).all()
    assert ([7 + 2 * width, 9 + 2 * height] - highest <= 2 * every).all()


def test_nothing_has_no_border_and_specks_have_none():
    assert border_lines(silhouette(np.zeros((4, 5), bool))).shape == (0, 2)
    speck = np.zeros((4, 5), bool)
    speck[1, 1] = True
    assert border_lines(silhouette(speck)).shape == (0, 2)
