"""Depth images in metres."""

from __future__ import annotations

import numpy as np
import pytest

from mocapella.model.depth import IMAGES_SUFFIX, DepthFrame, depth_frame

UNITS = np.array([[0, 1, 700], [1000, 8000, 65535]], np.uint16)


def of_unit(unit_m: float, sensor: str = "depth") -> DepthFrame:
    return depth_frame(sensor, UNITS, unit_m=unit_m, lens=[476.0, 476.0, 1.0, 0.5], time_ns=1)


@pytest.mark.parametrize("unit_m", [0.001, 0.000125, 0.1])
def test_a_distance_is_so_many_units_and_what_was_not_measured_stays_0(unit_m: float) -> None:
    frame = of_unit(unit_m)
    assert frame.metres.dtype == np.float32
    np.testing.assert_allclose(frame.metres, unit_m * UNITS.astype(float), rtol=1e-6)
    assert frame.metres[0, 0] == 0.0
    assert frame.size_px == (3, 2)


def test_metres_are_a_new_array_each_time() -> None:
    frame = of_unit(0.001)
    frame.metres[:] = 0.0
    assert frame.metres[0, 2] == pytest.approx(0.7)
    np.testing.assert_array_equal(frame.depth, UNITS)


def test_only_a_sensor_whose_name_ends_so_is_for_the_take() -> None:
    assert of_unit(0.001, "left" + IMAGES_SUFFIX).for_the_take
    assert not of_unit(0.001, "left" + IMAGES_SUFFIX + "s").for_the_take
