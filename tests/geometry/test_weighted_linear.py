from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, rigid, rotation_about_y
from mocapella.geometry.triangulation import PointState
from mocapella.geometry.weighted_linear import WeightedLinearSettings, weighted_linear

LENS = np.array([600.0, 590.0, 320.0, 240.0, -0.2, 0.05, 1e-3, -2e-3, 0])
T = np.stack([rigid(rotation_about_y(a), [0.0, 0.0, 2.0]) for a in (0.0, 0.9, 1.8, 2.7)])
LENSES = np.tile(LENS, (4, 1))


def scene(seed: int, points: int = 5) -> tuple[np.random.Generator, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    truth = rng.uniform(-0.3, 0.3, (points, 3))
    return rng, truth, np.stack([project(apply(t, truth), LENS) for t in T], axis=1)


@given(st.integers(0, 1000))
def test_without_noise_a_point_comes_back_whatever_the_confidences(seed: int) -> None:
    rng, truth, pixels = scene(seed)
    result = weighted_linear(pixels, rng.uniform(0.31, 1, (5, 4)), LENSES, T)
    np.testing.assert_allclose(result.points, truth, atol=1e-7)
    assert result.used.all()
    assert result.residuals_px.max() < 1e-4


def test_a_camera_that_is_off_is_dropped_and_two_if_they_must_be() -> None:
    _, truth, pixels = scene(1)
    pixels[0, 2] += 80.0
    pixels[1, 0], pixels[1, 3] = pixels[1, 0] + 90.0, pixels[1, 3] - [70.0, 90.0]
    result = weighted_linear(pixels, np.ones((5, 4)), LENSES, T, WeightedLinearSettings(largest_error_px=1.0))
    np.testing.assert_allclose(result.points, truth, atol=1e-7)
    assert result.used[:2].tolist() == [[True, True, False, True], [False, True, True, False]]
    assert result.residuals_px[0, 2] > 60


def test_without_dropping_there_is_no_point() -> None:
    _, _, pixels = scene(1)
    pixels[0, 2] += 80.0
    result = weighted_linear(pixels, np.ones((5, 4)), LENSES, T, WeightedLinearSettings(drop_cameras=False))
    assert result.states.tolist() == [PointState.INCONSISTENT] + [PointState.SEEN] * 4
    assert np.isnan(result.points[0]).all()
    assert not result.used[0].any()
    assert np.isnan(result.residuals_px[0]).all()


def test_unsure_and_missing_detections_do_not_count() -> None:
    _, truth, pixels = scene(2)
    confidences = np.ones((5, 4))
    confidences[:, 0], pixels[:, 0] = 0.3, 5.0
    pixels[:, 1] = np.nan
    pixels[4, 2] = np.nan
    result = weighted_linear(pixels, confidences, LENSES, T)
    np.testing.assert_allclose(result.points[:4], truth[:4], atol=1e-7)
    assert result.states[4] == PointState.ONE_VIEW
    assert np.isnan(result.covariances).all()


@pytest.mark.parametrize(("name", "value"), [("least_confidence", 1.0), ("largest_error_px", 0.0)])
def test_settings_out_of_range_are_refused(name: str, value: float) -> None:
    with pytest.raises(SettingsError, match=name):
        WeightedLinearSettings(**{name: value})
