"""Depth of a Kinect v1's disparities: only what can be is believed."""

from __future__ import annotations

import numpy as np
import pytest

from mocapella.geometry.kinect_depth import FARTHEST_M, NEAREST_M, UNIT_M, kinect_metres, kinect_units


@pytest.mark.parametrize("raw", [0, 1084, 1085, 2046, 2047, 2048, 65_535, -1])
def test_what_cannot_be_is_nothing(raw: int) -> None:
    """0 is nearer than the sensor sees, 1084 at 533 m, 1085 and 2046 behind it; 2047 is its own sign for nothing."""
    assert kinect_metres(raw) == 0.0
    assert kinect_units(np.array([max(raw, 0)], np.uint16)).tolist() == [0]


def test_without_the_range_the_pole_is_still_kept_out() -> None:
    assert kinect_metres(1084, 0.0, 1e9) == pytest.approx(533.3, rel=1e-3)
    for raw in (-1, 1085, 2046, 2047, 2048, 65_535):
        assert kinect_metres(raw, 0.0, 1e9) == 0.0
    assert kinect_metres(0, 0.0, 1e9) == pytest.approx(1 / 3.3309495161)


def test_depth_rises_with_the_disparity_and_nothing_else_is_believed() -> None:
    depth = kinect_metres(np.arange(2048))
    there = np.flatnonzero(depth)
    assert np.array_equal(there, np.arange(there[0], there[-1] + 1))
    assert (np.diff(depth[there]) > 0).all()
    assert depth[there[0]] >= NEAREST_M
    assert depth[there[-1]] <= FARTHEST_M
    assert 900 < there[-1] < 1084


def test_known_disparities() -> None:
    np.testing.assert_allclose(kinect_metres([500, 800, 1000]), [0.5569793, 1.1440754, 3.8484049], rtol=1e-5)


def test_units_are_the_metres_to_half_a_unit() -> None:
    raw = np.arange(2048, dtype=np.uint16).reshape(32, 64)
    units = kinect_units(raw)
    assert (units.dtype, units.shape) == (np.uint16, raw.shape)
    np.testing.assert_allclose(units * UNIT_M, kinect_metres(raw), atol=0.5001 * UNIT_M)
