from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mocapella.geometry import lens_kernels
from mocapella.geometry.lens import distort, farthest_r2, project, undistort

PINHOLE = np.array([600.0, 590.0, 320.0, 240.0, 0, 0, 0, 0, 0])
BARREL = np.array([600.0, 590.0, 320.0, 240.0, -0.32, 0.12, 1e-3, -2e-3, -0.02])
FOLDING = np.array([600.0, 590.0, 320.0, 240.0, -0.4, 0, 0, 0, 0])

directions = arrays(np.float64, (5, 2), elements=st.floats(-0.6, 0.6))
coefficients = st.tuples(*(st.floats(-limit, limit) for limit in (0.3, 0.1, 3e-3, 3e-3, 0.05)))


@given(directions, coefficients)
def test_a_direction_comes_back_from_where_it_is_shown(normalised: np.ndarray, found: tuple[float, ...]) -> None:
    lens = np.array([600.0, 590.0, 320.0, 240.0, *found])
    shown = distort(normalised, lens)
    inside = (normalised**2).sum(axis=-1) < 0.8 * farthest_r2(lens)
    np.testing.assert_allclose(undistort(shown, lens)[inside], normalised[inside], atol=1e-9)


@given(arrays(np.float64, (4, 2), elements=st.floats(0, 640)))
def test_a_pixel_comes_back_from_its_direction(pixels: np.ndarray) -> None:
    np.testing.assert_allclose(distort(undistort(pixels, BARREL), BARREL), pixels, atol=1e-6)


@given(arrays(np.float64, 3, elements=st.floats(0.1, 5)), st.floats(0.1, 10))
def test_all_points_of_a_ray_are_seen_at_one_pixel(point: np.ndarray, far: float) -> None:
    point[2] += 10.0
    np.testing.assert_allclose(project(point, BARREL), project(far * point, BARREL), atol=1e-9)


def test_without_distortion_a_point_is_seen_where_the_pinhole_has_it() -> None:
    assert project([0.1, -0.2, 2.0], PINHOLE).tolist() == [600 * 0.05 + 320, -590 * 0.1 + 240]


def test_nothing_is_seen_behind_the_camera_nor_on_its_plane() -> None:
    assert np.isnan(project([[0.1, 0.1, -1.0], [0.1, 0.1, 0.0]], PINHOLE)).all()


def test_what_the_model_folds_back_into_the_picture_is_not_seen() -> None:
    edge = np.sqrt(farthest_r2(FOLDING))
    assert edge == pytest.approx(np.sqrt(1 / 1.2))
    assert np.isfinite(distort([0.99 * edge, 0.0], FOLDING)).all()
    assert np.isnan(distort([1.01 * edge, 0.0], FOLDING)).all()
    assert farthest_r2(PINHOLE) == np.inf


def test_a_pixel_that_the_lens_never_shows_has_no_direction() -> None:
    edge = distort([np.sqrt(farthest_r2(FOLDING)), 0.0], FOLDING)
    assert np.isfinite(undistort(edge - [1.0, 0.0], FOLDING)).all()
    assert np.isnan(undistort(np.add(edge, [1.0, 0.0]), FOLDING)).all()
    assert np.isnan(undistort([np.nan, 3.0], FOLDING)).all()


@pytest.mark.slow
@given(
    arrays(np.float64, (9, 2), elements=st.floats(-2, 2) | st.just(np.nan)), st.sampled_from([PINHOLE, BARREL, FOLDING])
)
def test_points_that_step_together_come_where_each_alone_does(shown: np.ndarray, lens: np.ndarray) -> None:
    found, edge = np.empty((2, 9)), farthest_r2(lens)
    for farthest in (edge, 0.0):  # 0: there is none
        lens_kernels.undistorted_all(*np.ascontiguousarray(shown.T), *lens[4:], farthest, *found)
        alone = [lens_kernels.undistorted(*at, *lens[4:], farthest)[:2] for at in shown]
        np.testing.assert_allclose(found.T, alone, rtol=0, atol=1e-12)


def test_leading_axes_are_batches() -> None:
    pixels = np.random.default_rng(1).uniform(0, 480, (2, 3, 2))
    assert undistort(pixels, BARREL).shape == pixels.shape
    np.testing.assert_array_equal(undistort(pixels, BARREL)[1, 2], undistort(pixels[1, 2], BARREL))


def test_a_coefficient_of_next_to_nothing_folds_nothing() -> None:
    lens = PINHOLE.copy()
    lens[8] = -5e-324
    assert farthest_r2(lens) == np.inf
    assert distort([0.5, 0.5], lens).tolist() == distort([0.5, 0.5], PINHOLE).tolist()
