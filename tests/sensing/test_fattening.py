from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from mocapella.sensing.fattening import JUMP_M, without_fattening

WALL_M, THING_M = 2.0, 0.6


def scene(width: int = 12, wall: float = WALL_M) -> np.ndarray:
    depth = np.full((48, 64), wall, np.float32)
    depth[14:34, 20 : 20 + width] = THING_M
    return depth


def fattened(depth: np.ndarray, px: int) -> np.ndarray:
    """Give each pixel the nearest depth around it, as the matching of blocks does at edges."""
    there = np.where(depth > 0, depth, np.inf)
    near = ndimage.minimum_filter(there, 2 * px + 1)
    return np.where(np.isfinite(near), near, 0.0).astype(np.float32)


@given(px=st.integers(1, 5), width=st.integers(1, 20), wall=st.sampled_from([0.0, 0.65, WALL_M]))
def test_things_have_their_width_again(px: int, width: int, wall: float) -> None:
    depth = scene(width, wall)
    np.testing.assert_array_equal(without_fattening(fattened(depth, px), px), depth)


@given(px=st.integers(1, 4), wide=st.integers(1, 11))
def test_holes_are_filled_up_to_twice_the_reach_and_three(px: int, wide: int) -> None:
    depth = np.full((60, 60), 1.0, np.float32)
    depth[20:45, 20 : 20 + wide] = 0.0
    whole = (without_fattening(depth, px) > 0).all()
    assert whole == (wide <= 2 * px + 3)


def test_a_filled_hole_continues_the_slope_beside_it() -> None:
    slope = np.tile(0.5 + 0.001 * np.arange(40, dtype=np.float32), (30, 1))
    holed = slope.copy()
    holed[10:14, 15:20] = 0.0
    np.testing.assert_allclose(without_fattening(holed, 1), slope, atol=1e-6)
    np.testing.assert_allclose(without_fattening(holed.T, 1), slope.T, atol=1e-6)


def test_a_gap_between_two_things_is_no_hole() -> None:
    depth = np.zeros((30, 40), np.float32)
    depth[:, :18], depth[:, 21:] = 0.6, 0.6 + JUMP_M + 0.001
    assert (without_fattening(depth, 1)[:, 18:21] == 0).all()


@pytest.mark.parametrize("step_m", [0.5 * JUMP_M, 2 * JUMP_M])
def test_steps_smaller_than_a_jump_are_no_edges(step_m: float) -> None:
    depth = np.full((30, 40), 0.6, np.float32)
    depth[:, 20:] += np.float32(step_m)
    assert np.array_equal(without_fattening(depth, 2), depth) == (step_m < JUMP_M)


def test_an_image_of_other_cameras_and_the_given_one_are_left_as_they_are() -> None:
    depth = scene()
    assert without_fattening(depth, 0) is depth
    before = depth.copy()
    without_fattening(depth, 3)
    np.testing.assert_array_equal(depth, before)
