"""What is kept up as samples change sides, beside what is made anew."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from mocapella.sensing.region_cost_kernels import update_costs
from mocapella.sensing.region_density_kernels import mark_blocks, node_rows
from mocapella.sensing.region_mask_kernels import blur, flip, replace
from mocapella.sensing.region_reading_kernels import farthest

SIZE = 8
any_floats = arrays(np.float32, array_shapes(min_dims=2, max_dims=2, max_side=6), elements=st.floats(width=32))


@pytest.mark.slow
@given(any_floats)
def test_the_farthest_is_the_largest_and_none_where_one_is_none(phi: np.ndarray) -> None:
    np.testing.assert_array_equal(farthest(phi), abs(phi).max())


@given(arrays(np.uint8, (2, 40), elements=st.integers(0, 3)), st.booleans())
def test_what_becomes_something_else_says_so(both: np.ndarray, same: bool) -> None:
    old, new = both[0], both[0].copy() if same else both[1]
    other = bool((old != new).any())
    assert replace(old, new) == other
    np.testing.assert_array_equal(old, new)


@pytest.mark.slow
@settings(max_examples=20)
@given(st.integers(1, 9), st.integers(1, 4), st.integers(1, 30), st.integers(0, 10_000))
def test_a_blurred_mask_that_is_kept_up_is_that_of_the_mask(rows: int, blocks: int, flips: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    inside = rng.integers(0, 2, (rows, SIZE * blocks), np.uint8)
    place = np.arange(rows * blocks, dtype=np.int32).reshape(rows, blocks)
    place[rng.random(place.shape) < 0.3] = -1  # has nothing undecided
    before, mean, anew = (np.empty(inside.shape, np.uint16) for _ in range(3))
    blur(inside, before)
    mean[:] = before
    dirty = np.zeros(place.size, np.uint8)
    for _ in range(flips):
        flip(inside, int(rng.integers(rows)), int(rng.integers(SIZE * blocks)), SIZE, mean, place, dirty)
    blur(inside, anew)
    np.testing.assert_array_equal(mean, anew)
    changed = (mean != before).reshape(rows, blocks, SIZE).any(2)
    assert dirty[place[changed & (place >= 0)]].all()


@pytest.mark.slow
@settings(max_examples=20)
@given(st.integers(1, 30), st.integers(1, 4), st.sampled_from([1, 3]), st.integers(0, 10_000))
def test_only_blocks_beside_a_node_that_changed_cost_otherwise(
    rows: int, blocks: int, channels: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    places = np.array([(i, b) for i in range(rows) for b in range(blocks)], np.int32)
    levels = rng.normal(0, 50, (channels, len(places), SIZE)).astype(np.float32)
    along = (np.arange(SIZE, dtype=np.float32) + np.float32(0.5)) / np.float32(SIZE)
    nodes = node_rows(rows, SIZE), blocks + 1
    coefficients = rng.normal(0, 1, (*nodes, 2 + 4 * channels)).astype(np.float32)
    every, dirty, none = np.ones(len(places), np.uint8), *np.zeros((2, len(places)), np.uint8)
    before, after = (np.empty((2, len(places), SIZE), np.float32) for _ in range(2))
    update_costs(levels, places, rows, along, coefficients, every, none, *before)
    stale = np.zeros(nodes, np.uint8)
    stale[rng.integers(nodes[0]), rng.integers(nodes[1])] = 1
    coefficients[stale > 0] += 1
    update_costs(levels, places, rows, along, coefficients, every, none, *after)
    mark_blocks(stale, places, rows, SIZE, dirty)
    assert dirty[(before != after).any((0, 2))].all()
    assert dirty.sum() <= 2 * 2 * SIZE
    again = before.copy()
    update_costs(levels, places, rows, along, coefficients, dirty, none, *again)
    np.testing.assert_array_equal(again, after)
