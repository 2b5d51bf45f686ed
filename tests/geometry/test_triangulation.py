from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.stats import chi2

from mocapella.errors import SettingsError
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_x, rotation_about_y
from mocapella.geometry.triangulation import PointState, TriangulationSettings, Views, triangulate, views

LENS = np.array([600.0, 590.0, 320.0, 240.0, -0.25, 0.08, 1e-3, -2e-3, -0.01])
seeds = st.integers(0, 2**32 - 1)


def ring(count: int, radius_m: float = 2.0) -> tuple[np.ndarray, np.ndarray]:
    """Lenses (count, 9) and T_camera_world (count, 4, 4) of cameras around the origin that look at it."""
    angles = 0.4 + np.arange(count) * 2.0 * np.pi / max(count, 3)
    T = np.stack([rigid(rotation_about_x(0.2) @ rotation_about_y(a), [0.0, 0.0, radius_m]) for a in angles])
    return np.tile(LENS, (count, 1)), T


def seen(points: np.ndarray, lenses: np.ndarray, T: np.ndarray) -> np.ndarray:
    """(points, views, 2) without noise [px]."""
    return np.stack([project(apply(t, points), lens) for lens, t in zip(lenses, T, strict=True)], axis=-2)


def scene(seed: int, count: int = 4, points: int = 6) -> tuple[np.random.Generator, np.ndarray, np.ndarray, Views]:
    rng = np.random.default_rng(seed)
    lenses, T = ring(count)
    truth = rng.uniform(-0.3, 0.3, (points, 3))
    return rng, truth, seen(truth, lenses, T), views(lenses, T)


@given(seeds, st.integers(2, 9))
def test_without_noise_a_point_comes_back_exactly(seed: int, count: int) -> None:
    _, truth, pixels, cameras = scene(seed, count)
    result = triangulate(pixels, cameras)
    np.testing.assert_allclose(result.points, truth, atol=1e-9)
    assert result.used.all()
    assert (result.states == PointState.SEEN).all()
    assert result.residuals_px.max() < 1e-6


@given(seeds, st.floats(-3, 3), st.floats(-3, 3))
def test_moving_the_world_moves_points_and_covariances_along(seed: int, a: float, b: float) -> None:
    rng, _, pixels, _ = scene(seed)
    pixels += rng.normal(0, 1, pixels.shape)
    lenses, T = ring(4)
    move = rigid(rotation_about_x(a) @ rotation_about_y(b), [1.0, -2.0, 3.0])
    here, there = triangulate(pixels, views(lenses, T)), triangulate(pixels, views(lenses, T @ inverse(move)))
    np.testing.assert_allclose(there.points, apply(move, here.points), atol=1e-7)
    R = move[:3, :3]
    np.testing.assert_allclose(there.covariances, R @ here.covariances @ R.T, rtol=1e-4, atol=1e-10)
    np.testing.assert_array_equal(there.used, here.used)


@given(seeds, st.permutations(range(4)))
def test_the_order_of_the_cameras_does_not_matter(seed: int, order: list[int]) -> None:
    rng, _, pixels, _ = scene(seed)
    pixels += rng.normal(0, 1, pixels.shape)
    pixels[0, 1] += 80.0
    lenses, T = ring(4)
    here, there = triangulate(pixels, views(lenses, T)), triangulate(pixels[:, order], views(lenses[order], T[order]))
    np.testing.assert_allclose(there.points, here.points, atol=1e-7)
    np.testing.assert_array_equal(there.used, here.used[:, order])


@given(seeds)
def test_points_do_not_disturb_each_other(seed: int) -> None:
    rng, _, pixels, cameras = scene(seed)
    pixels += rng.normal(0, 1, pixels.shape)
    pixels[rng.random(pixels.shape[:2]) < 0.2] = np.nan
    together = triangulate(pixels, cameras)
    for k in range(len(pixels)):
        alone = triangulate(pixels[k], cameras)
        np.testing.assert_allclose(alone.points, together.points[k], atol=1e-12)
        assert alone.states == together.states[k]


def test_it_is_the_least_squares_of_the_distorted_pixels() -> None:
    rng, _, pixels, cameras = scene(5, 3)
    lenses, T = ring(3)
    pixels += rng.normal(0, 2, pixels.shape)
    sd = rng.uniform(1, 4, pixels.shape[:2])
    result = triangulate(pixels, cameras, sd, TriangulationSettings(gate_sd=math.inf))
    for k, point in enumerate(result.points):
        best = least_squares(
            lambda x, k=k: ((seen(x[None], lenses, T)[0] - pixels[k]) / sd[k, :, None]).ravel(), point, xtol=1e-14
        )
        np.testing.assert_allclose(point, best.x, atol=1e-6)
        np.testing.assert_allclose(result.covariances[k], np.linalg.inv(best.jac.T @ best.jac), rtol=1e-3)


@pytest.mark.parametrize("count", [2, 4])
def test_the_covariance_says_how_far_off_points_are(count: int) -> None:
    rng, truth, pixels, cameras = scene(7, count, points=4000)
    sd = rng.uniform(0.5, 2.0, pixels.shape[:2])
    result = triangulate(pixels + sd[..., None] * rng.normal(size=pixels.shape), cameras, sd)
    off = result.points - truth
    squares = np.einsum("pi,pij,pj->p", off, np.linalg.inv(result.covariances), off)
    squares = squares[np.isfinite(squares)]
    assert len(squares) > 3950
    assert abs(squares.mean() - 3.0) < 0.2  # the mean of χ² of three; its sd here is 0.04
    assert abs((squares < chi2.ppf(0.9, 3)).mean() - 0.9) < 0.02


@pytest.mark.parametrize(("count", "bad"), [(3, 1), (4, 1), (4, 2), (5, 3), (8, 5)])
def test_cameras_that_see_something_else_do_no_harm(count: int, bad: int) -> None:
    """Up to n − 2 of n; two bad ones may agree by chance, which is rare."""
    rng, truth, pixels, cameras = scene(count + 10 * bad, count, points=300)
    pixels += rng.normal(0, 0.5, pixels.shape)
    wrong = np.argsort(rng.random(pixels.shape[:2]), axis=1) < bad
    pixels[wrong] = rng.uniform([0, 0], [640, 480], (wrong.sum(), 2))
    result = triangulate(pixels, cameras, 0.5)
    off = np.linalg.norm(result.points - truth, axis=-1)
    near = off < 0.02
    assert near.mean() > (0.97 if bad <= count - 3 else 0.9)
    assert not (result.used & wrong)[near].mean() > 0.01
    assert (result.used | wrong)[near].mean() > 0.99


@pytest.mark.slow
@pytest.mark.parametrize("count", [3, 4, 6])
def test_points_with_outliers_are_those_that_are_found_one_by_one(count: int) -> None:
    """The kernel that takes many points at a time, beside `consensus`, which takes the points that it leaves."""
    from mocapella.geometry import triangulation_kernels as kernels

    rng, _, pixels, cameras = scene(3, count, 200)
    pixels = pixels + rng.normal(0, 1.0, pixels.shape)
    wrong = rng.random(pixels.shape[:2]) < 0.3
    pixels[wrong] = rng.uniform(0, 480, (int(wrong.sum()), 2))
    pixels[rng.random(pixels.shape[:2]) < 0.1] = np.nan
    found, alone = triangulate(pixels, cameras), 0
    rays, kept, tried = np.empty((count, 6)), np.empty(count), np.empty(count)
    for i in np.flatnonzero(~(found.used == np.isfinite(pixels).all(-1)).all(-1)):
        weights = np.zeros(count)
        for k in np.flatnonzero(np.isfinite(pixels[i]).all(-1)):
            u, v = (pixels[i, k] - LENS[2:4]) / LENS[:2]
            x, y = kernels.undistort(cameras.numbers, k, u, v)
            if not math.isnan(x):
                kernels.keep_ray(cameras.numbers, k, x, y, rays)
                weights[k] = 1.0
        if (weights > 0).sum() < 2:
            continue
        least = math.sin(TriangulationSettings().least_angle_rad) ** 2
        one = kernels.consensus(cameras.numbers, pixels, i, rays, weights, 16.0, least, kept, tried)
        assert (one[0] == PointState.SEEN) == (found.states[i] == PointState.SEEN)
        if one[0] == PointState.SEEN:
            np.testing.assert_allclose(found.points[i], one[1:4], rtol=0, atol=1e-9)
            np.testing.assert_array_equal(found.used[i], kept > 0)
            np.testing.assert_allclose(found.covariances[i][np.triu_indices(3)], one[4:], rtol=1e-6)
            alone += 1
    assert alone > 50


def test_a_camera_without_a_pixel_or_without_an_sd_is_not_used() -> None:
    _, truth, pixels, cameras = scene(3)
    pixels[:, 0] = np.nan
    sd = np.ones(pixels.shape[:2])
    sd[:, 1], pixels[:, 1] = np.nan, 5.0
    result = triangulate(pixels, cameras, sd)
    np.testing.assert_allclose(result.points, truth, atol=1e-9)
    assert result.used.tolist() == [[False, False, True, True]] * len(truth)
    assert np.isnan(result.residuals_px[:, :2]).all()


def test_a_pixel_that_the_lens_never_shows_is_not_used() -> None:
    folding = np.array([600.0, 600.0, 320.0, 240.0, -0.4, 0, 0, 0, 0])
    _, T = ring(3)
    cameras = views(np.tile(folding, (3, 1)), T)
    pixels = seen(np.array([[0.05, 0.1, 0.0]]), np.tile(folding, (3, 1)), T)
    pixels[0, 1] = [1500.0, 240.0]
    result = triangulate(pixels, cameras)
    np.testing.assert_allclose(result.points, [[0.05, 0.1, 0.0]], atol=1e-9)
    assert result.used.tolist() == [[True, False, True]]


def stereo(distance_m: float) -> Views:
    """Two cameras beside each other which look the same way."""
    return views(np.tile(LENS, (2, 1)), rigid(np.eye(3), [[0.0, 0, 0], [-distance_m, 0, 0]]))


def test_why_there_is_no_point() -> None:
    cameras = stereo(0.1)
    one, nearly, crossed, apart = (
        [[300.0, 200.0], [np.nan, np.nan]],
        [[300.0, 200.0], [299.0, 200.0]],
        [[300.0, 200.0], [340.0, 200.0]],
        [[300.0, 200.0], [240.0, 260.0]],
    )
    result = triangulate([one, nearly, crossed, apart, np.full((2, 2), np.nan)], cameras)
    states = [PointState.ONE_VIEW, PointState.PARALLEL, PointState.BEHIND, PointState.INCONSISTENT, PointState.ONE_VIEW]
    assert result.states.tolist() == states
    assert np.isnan(result.points).all()
    assert np.isnan(result.covariances).all()
    assert np.isnan(result.residuals_px).all()
    assert not result.used.any()


def test_every_limit_is_one() -> None:
    cameras = stereo(0.1)
    apart = [[300.0, 200.0], [240.0, 203.0]]
    assert triangulate(apart, cameras, 0.2).states == PointState.INCONSISTENT
    assert triangulate(apart, cameras, 0.2, TriangulationSettings(gate_sd=20.0)).states == PointState.SEEN
    nearly = [[300.0, 200.0], [298.0, 200.0]]
    assert triangulate(nearly, cameras).states == PointState.PARALLEL
    assert triangulate(nearly, cameras, 1.0, TriangulationSettings(least_angle_rad=1e-3)).states == PointState.SEEN


def test_leading_axes_are_batches() -> None:
    _, truth, pixels, cameras = scene(1)
    result = triangulate(pixels.reshape(2, 3, 4, 2), cameras, np.ones((3, 4)))
    np.testing.assert_allclose(result.points, truth.reshape(2, 3, 3), atol=1e-9)
    assert result.covariances.shape == (2, 3, 3, 3)
    assert result.used.shape == (2, 3, 4)
    assert triangulate(np.zeros((0, 4, 2)), cameras).points.shape == (0, 3)


@pytest.mark.parametrize(("name", "value"), [("gate_sd", 0.0), ("gate_sd", math.nan), ("least_angle_rad", 2.0)])
def test_settings_out_of_range_are_refused(name: str, value: float) -> None:
    with pytest.raises(SettingsError, match=name):
        TriangulationSettings(**{name: value})
