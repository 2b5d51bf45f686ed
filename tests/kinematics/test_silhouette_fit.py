"""Where a camera sees points, and where it does not."""

from __future__ import annotations

import numpy as np
import pytest

from mocapella.kinematics.silhouette_fit import eye, seen_at
from mocapella.model.camera import Camera, PlacedCamera

SIZE = (640, 480)
LENS = np.array([500.0, 500.0, 319.5, 239.5, -0.3, 0, 0, 0, 0])  # one-to-one up to a radius of √(1 / 0.9)
EYE = eye(PlacedCamera(Camera("front", SIZE, LENS), np.eye(4), np.zeros((6, 6))))


def test_a_point_on_the_axis_is_in_the_middle_of_the_image() -> None:
    np.testing.assert_allclose(seen_at(np.array([[0.0, 0.0, 2.0]]), EYE), [[319.5, 239.5]])


@pytest.mark.parametrize(
    "point",
    [
        (0.0, 0.0, -2.0),  # behind the camera
        (0.0, 0.0, 0.0),
        (0.0, 0.0, 0.049),  # nearer than 5 cm
        (1.1, 0.0, 1.0),  # beyond what the distortion model describes
        (np.nan, 0.0, 2.0),
        (0.0, 0.0, np.nan),
    ],
)
def test_a_point_that_cannot_be_seen_is_far_outside_of_the_image(point: tuple[float, float, float]) -> None:
    shown = (0.1, 0.1, 2.0)
    pixels = seen_at(np.array([shown, point, shown]), EYE)
    np.testing.assert_array_equal(pixels[1], [-1e6, -1e6])
    assert ((pixels[::2] > 0) & (pixels[::2] < SIZE)).all()
