from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mocapella.errors import SettingsError
from mocapella.geometry.rigid import apply, rigid, rotation_about_x, rotation_about_y
from mocapella.smoothing.one_euro import OneEuro, OneEuroSettings

STEPS, POINTS = 12, 3
paths = arrays(np.float64, (STEPS, POINTS, 3), elements=st.floats(-5, 5))
gaps = arrays(np.bool_, (STEPS, POINTS))


def filtered(path: np.ndarray, settings: OneEuroSettings | None = None, hz: float = 30.0) -> np.ndarray:
    one_euro = OneEuro(settings)
    return np.stack([one_euro.update(points, k / hz) for k, points in enumerate(path)])


def blanked(path: np.ndarray, gone: np.ndarray) -> np.ndarray:
    return np.where(gone[..., None], np.nan, path)


@given(paths, gaps, st.floats(-3, 3), st.floats(-3, 3))
def test_moving_the_points_moves_the_result_along(path: np.ndarray, gone: np.ndarray, a: float, b: float) -> None:
    T = rigid(rotation_about_x(a) @ rotation_about_y(b), [1, -2, 3])
    path = blanked(path, gone)
    np.testing.assert_allclose(filtered(apply(T, path)), apply(T, filtered(path)), atol=1e-9)


@given(paths, gaps)
def test_points_do_not_disturb_each_other(path: np.ndarray, gone: np.ndarray) -> None:
    path = blanked(path, gone)
    alone = np.concatenate([filtered(path[:, k : k + 1]) for k in range(POINTS)], axis=1)
    np.testing.assert_array_equal(filtered(path), alone)


@given(paths, gaps)
def test_a_point_that_is_not_seen_has_no_result_and_any_other_has_one(path: np.ndarray, gone: np.ndarray) -> None:
    np.testing.assert_array_equal(np.isnan(filtered(blanked(path, gone))).any(axis=-1), gone)


@given(paths)
def test_the_result_stays_among_what_was_measured(path: np.ndarray) -> None:
    result = filtered(path)
    for k in range(STEPS):
        assert (result[k] >= path[: k + 1].min(axis=0) - 1e-9).all()
        assert (result[k] <= path[: k + 1].max(axis=0) + 1e-9).all()


def test_the_papers_equations_by_hand() -> None:
    settings = OneEuroSettings(min_cutoff_hz=1.0, beta_per_m=2.0, speed_cutoff_hz=1.0)
    second = filtered(np.array([[[0.0, 0, 0]], [[0.3, 0, 0.4]]]), settings, hz=10.0)[1, 0]
    alpha = 1 / (1 + (1 / (2 * math.pi * 1.0)) / 0.1)
    speed = alpha * 0.5 / 0.1
    tau = 1 / (2 * math.pi * (1.0 + 2.0 * speed))
    np.testing.assert_allclose(second, np.array([0.3, 0, 0.4]) / (1 + tau / 0.1), rtol=1e-12)


def test_rest_is_steadier_and_fast_motion_is_hardly_late() -> None:
    noise = np.random.default_rng(0).normal(0, 0.005, (300, 1, 3))
    assert filtered(noise)[100:].std() < 0.5 * noise.std()
    fast = np.zeros((90, 1, 3))
    fast[:, 0, 0] = 3.0 * np.arange(90) / 30
    late_s = (fast - filtered(fast))[-1, 0, 0] / 3.0
    assert 0 < late_s < 1 / 60


def test_after_a_long_gap_it_begins_anew_and_after_a_short_one_it_goes_on() -> None:
    one_euro = OneEuro(OneEuroSettings(forget_after_s=0.25))
    origin, away = np.zeros((1, 3)), np.ones((1, 3))
    one_euro.update(origin, 0.0)
    assert (one_euro.update(away, 0.2) < away).all()
    one_euro.update(away * np.nan, 0.4)
    np.testing.assert_array_equal(one_euro.update(5 * away, 0.6), 5 * away)


@pytest.mark.parametrize("name", ["min_cutoff_hz", "speed_cutoff_hz"])
def test_settings_out_of_range_are_refused(name: str) -> None:
    with pytest.raises(SettingsError, match=name):
        OneEuroSettings(**{name: 0.0})


@given(paths, gaps)
def test_per_component_a_coordinate_does_not_know_of_the_others(path: np.ndarray, gone: np.ndarray) -> None:
    settings = OneEuroSettings(per_component=True)
    path = blanked(path, gone)
    alone = np.concatenate([filtered(path[..., k : k + 1], settings) for k in range(3)], axis=-1)
    np.testing.assert_allclose(filtered(path, settings), alone, rtol=1e-13, atol=1e-13)


@given(paths, gaps)
def test_in_one_dimension_the_speed_of_the_point_is_that_of_the_coordinate(path: np.ndarray, gone: np.ndarray) -> None:
    path = blanked(path, gone)[..., :1]
    both = (filtered(path, OneEuroSettings(per_component=mode)) for mode in (False, True))
    np.testing.assert_allclose(*both, rtol=1e-12, atol=1e-12)


@given(paths)
def test_a_point_in_a_plane_is_filtered_as_in_space(path: np.ndarray) -> None:
    path[..., 2] = 0.0
    np.testing.assert_array_equal(filtered(path[..., :2]), filtered(path)[..., :2])


def test_per_component_a_gap_and_a_repeated_time_are_as_by_point() -> None:
    one_euro = OneEuro(OneEuroSettings(per_component=True))
    origin, away = np.zeros((2, 2)), np.ones((2, 2))
    one_euro.update(origin, 0.0)
    half = np.array([[1.0, 1.0], [np.nan, 1.0]])
    first = one_euro.update(half, 0.1)
    assert (first[0] < 1).all()
    assert np.isnan(first[1]).all()
    np.testing.assert_array_equal(one_euro.update(5 * away, 0.1)[0], first[0])
    np.testing.assert_array_equal(one_euro.update(5 * away, 0.4), 5 * away)


def test_the_authors_own_vectors(one_euro_vectors: np.ndarray) -> None:
    settings = OneEuroSettings(min_cutoff_hz=1.0, beta_per_m=0.1, speed_cutoff_hz=1.0, per_component=True)
    one_euro = OneEuro(settings)
    result = [one_euro.update(np.array([x]), t)[0] for t, _, x, _ in one_euro_vectors]
    np.testing.assert_allclose(result, one_euro_vectors[:, 3], atol=1e-4)
