"""From a picture's pixels to the scene, and back along a browser's ray."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.viewer import layout
from mocapella.viewer.palette import Rgb
from mocapella.viewer.picture_plane import Plane, rings

PLANE = Plane(np.array([1.0, 60.0, 2.0]), 4.0, (640, 480))
coordinates = st.floats(-30.0, 30.0)


@given(st.floats(-0.5, 639.5), st.floats(-0.5, 479.5), coordinates, coordinates, st.floats(-20.0, 1.5))
def test_a_ray_through_a_pixel_meets_it(x: float, y: float, ox: float, oy: float, oz: float) -> None:
    origin = np.array([ox, oy + 60.0, oz])
    direction = 0.3 * (PLANE.place(np.array([x, y])) - origin)
    at = PLANE.pixel(origin, direction)
    edge = min(x + 0.5, 639.5 - x, y + 0.5, 479.5 - y) < 1e-6
    assert (at is None and edge) or at == pytest.approx((x, y), abs=1e-6)


def test_a_ray_that_misses_the_picture_meets_nothing() -> None:
    origin, ahead = np.array([1.0, 60.0, -5.0]), np.array([0.0, 0.0, 1.0])
    assert PLANE.pixel(origin, ahead) == pytest.approx((319.5, 239.5))
    assert PLANE.pixel(origin, -ahead) is None
    assert PLANE.pixel(origin, np.array([1.0, 0.0, 0.0])) is None
    for x, y in ((-0.6, 5.0), (639.6, 5.0), (5.0, -0.6), (5.0, 479.6)):
        assert PLANE.pixel(origin, PLANE.place(np.array([x, y])) - origin) is None


def test_the_picture_is_seen_upright_and_as_wide_as_it_is() -> None:
    corners = PLANE.corners
    assert np.ptp(corners[:, 0]) == pytest.approx(PLANE.wide_m)
    assert np.ptp(corners[:, 1]) == pytest.approx(PLANE.high_m) == pytest.approx(3.0)
    assert corners[0, 0] > corners[1, 0]  # +x is to the left of the screen
    assert corners[0, 1] > corners[3, 1]
    look = layout.frame(corners, fov=0.6, aspect=1.2, elevation=0.0)
    assert look.position[2] < PLANE.middle[2]


def test_circles_are_around_their_points_before_the_picture() -> None:
    lines, colours = rings(
        PLANE, {"a": (10.0, 20.0), "b": (600.0, 400.0)}, {"a": Rgb(255, 0, 0), "b": Rgb(0, 255, 0)}, 8
    )
    assert lines.shape == colours.shape
    half = len(lines) // 2
    radii = np.linalg.norm((lines[:half] - PLANE.place(np.array([10.0, 20.0])))[..., :2], axis=-1)
    assert radii == pytest.approx(8 * PLANE.px_m, rel=1e-4)
    assert (lines[..., 2] < PLANE.middle[2]).all()
    assert tuple(colours[0, 0]) == (255, 0, 0)
    assert tuple(colours[-1, 0]) == (0, 255, 0)
    assert rings(PLANE, {}, {}, 8.0)[0].shape == (0, 2, 3)
