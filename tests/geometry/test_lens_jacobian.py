from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mocapella.geometry.lens import project
from mocapella.geometry.lens_jacobian import project_with_jacobian

LENS = np.array([600.0, 590.0, 320.0, 240.0, -0.1, 0.05, 1e-3, -2e-3, 0.01])


@given(arrays(np.float64, (4, 3), elements=st.floats(-0.4, 0.4)))
def test_pixels_are_those_of_the_lens_and_derivatives_those_of_finite_differences(points: np.ndarray) -> None:
    points = points + np.array([0, 0, 1.0])
    pixels, by_point, by_lens = project_with_jacobian(points, LENS)
    np.testing.assert_allclose(pixels, project(points, LENS), atol=1e-9)
    step = 1e-6
    for k in range(3):
        e = step * np.eye(3)[k]
        slope = (project(points + e, LENS) - project(points - e, LENS)) / (2 * step)
        np.testing.assert_allclose(by_point[..., k], slope, rtol=1e-4, atol=1e-3)
    for k in range(9):
        e = step * np.eye(9)[k]
        slope = (project(points, LENS + e) - project(points, LENS - e)) / (2 * step)
        np.testing.assert_allclose(by_lens[..., k], slope, rtol=1e-4, atol=1e-4)


def test_behind_the_camera_there_is_nothing() -> None:
    for values in project_with_jacobian([[0.1, 0.1, -1.0]], LENS)[:2]:
        assert np.isnan(values).all()
