"""Cameras that have all in the picture, lanes that do not overlap."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.walkers import in_picture

from mocapella.viewer import layout


@given(st.floats(0.5, 3.0), st.floats(0.05, 1.2), st.integers(0, 9))
def test_a_framed_camera_has_all_points_in_its_picture_and_fills_it(aspect, elevation, sensors):
    points = np.concatenate([layout.tracking_box().corners, layout.sensors_box(sensors).corners])
    look = layout.frame(points, fov=0.7, aspect=aspect, elevation=elevation)
    xy = in_picture(look, points, aspect)
    assert np.abs(xy).max() <= 1 + 1e-6
    assert np.ptp(xy, axis=0).max() > 1.7


def test_to_the_left_of_the_screen_is_plus_x_as_in_camera_space():
    look = layout.frame(layout.tracking_box().corners, fov=0.7, aspect=1.5, elevation=0.3)
    assert in_picture(look, np.array([[1.0, 1.0, 2.0]]), 1.5)[0, 0] < 0


@pytest.mark.parametrize("count", range(1, 10))
def test_lanes_do_not_overlap(count):
    origins = layout.lane_origins(count)
    assert origins.shape == (count, 3)
    width, depth = layout.LANE_WIDTH_M * layout.SENSORS_SCALE, layout.LANE_DEPTH_M * layout.SENSORS_SCALE
    for i in range(count):
        for j in range(i):
            apart = np.abs(origins[i] - origins[j])
            assert apart[0] >= width or apart[1] > 1.0 or apart[2] >= depth


def test_without_sensors_there_are_no_lanes():
    assert len(layout.lane_origins(0)) == 0


def test_a_sensors_eyes_are_where_it_is_and_look_where_it_does():
    look = layout.eyes(0.2, 1.4, 1.0)
    assert look.position == pytest.approx([0, 1.4, 0])
    direction = (look.target - look.position) / np.linalg.norm(look.target - look.position)
    assert direction == pytest.approx([0, np.sin(0.2), np.cos(0.2)])
