"""One camera: bodies come back to where they were seen from; sizes by stature and floor."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.fusion.one_camera import (
    CHAIN,
    FEWEST,
    camera_of_view,
    place_by_rays,
    scale_by_floor,
    stature_of,
)
from mocapella.geometry.lens import project
from mocapella.geometry.twists import exp_twist

PLACES = st.tuples(st.floats(-2, 2), st.floats(-1, 1), st.floats(1.5, 8))
AHEAD = np.array([0.0, 0.0, 3.0])
SCALES = st.floats(0.5, 1.5)
FLOOR = {"height_sd": 0.02, "tilt_sd": 0.02, "size_sd": 0.06}


def body(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-0.5, 0.5, (20, 3)) * [0.8, 1.7, 0.5]


@given(PLACES, SCALES, st.integers(0, 9))
def test_a_body_comes_back_to_its_place(place: tuple[float, float, float], scale: float, seed: int) -> None:
    relative, t = scale * body(seed), np.array(place)
    slopes = (relative + t)[:, :2] / (relative + t)[:, 2:]
    found = place_by_rays(slopes, relative, np.full(20, 1e-3))
    assert found is not None
    np.testing.assert_allclose(found.translation, t, atol=1e-6)
    twice = place_by_rays(slopes, 2 * relative, np.full(20, 1e-3))
    assert twice is not None
    np.testing.assert_allclose(twice.translation, 2 * t, atol=1e-5)  # the same image
    eigenvalues = np.linalg.eigvalsh(found.covariance)
    assert (eigenvalues > 0).all()


@given(PLACES)
def test_a_wrong_joint_without_weight_changes_little(place: tuple[float, float, float]) -> None:
    relative, t = body(), np.array(place)
    slopes = (relative + t)[:, :2] / (relative + t)[:, 2:]
    slopes[3] += 0.5
    sds = np.full(20, 1e-3)
    sds[3] = 1e3
    found = place_by_rays(slopes, relative, sds)
    assert found is not None
    np.testing.assert_allclose(found.translation, t, atol=1e-4)


def test_the_stated_scatter_is_the_true_one() -> None:
    rng, relative, t = np.random.default_rng(5), body(), np.array([0.3, 0.1, 3.0])
    slopes = (relative + t)[:, :2] / (relative + t)[:, 2:]
    sds = np.full(20, 2e-3)
    places = [place_by_rays(slopes + rng.normal(0, 2e-3, (20, 2)), relative, sds) for _ in range(400)]
    errors = np.array([found.translation - t for found in places if found is not None])
    (sample,) = (found for found in places[:1] if found is not None)
    np.testing.assert_allclose(errors.std(axis=0), np.sqrt(np.diag(sample.covariance)), rtol=0.35)


def test_too_few_rays_and_bodies_behind_the_camera_are_refused() -> None:
    relative = body()
    slopes = (relative + AHEAD)[:, :2] / (relative + AHEAD)[:, 2:]
    slopes[FEWEST - 1 :] = np.nan
    assert place_by_rays(slopes, relative, np.full(20, 1e-3)) is None
    behind = (relative - AHEAD)[:, :2] / (relative - AHEAD)[:, 2:]
    assert place_by_rays(behind, relative, np.full(20, 1e-3)) is None
    same = np.tile(relative[:1], (20, 1))
    assert place_by_rays(np.zeros((20, 2)), 0 * same, np.full(20, 1e-3)) is None


@given(st.floats(1.2, 2.1), st.floats(-2, 2), st.floats(-2, 2), st.floats(-2, 2))
def test_a_stature_is_that_of_the_stretched_body_in_any_posture(h: float, a: float, b: float, c: float) -> None:
    lengths = np.array([0.246, 0.245, 0.288]) * h
    steps = [exp_twist(np.array([a * k, b, c, 0, 0, 0]))[:3, :3] @ [0, -length, 0] for k, length in enumerate(lengths)]
    points = np.cumsum([[0.0, 0.0, 0.0], *steps], axis=0)
    both = np.concatenate([points, np.full((4, 3), np.nan)])
    chains = np.array([[0, 1, 2, 3], [4, 5, 6, 7]])
    assert stature_of(both, chains) == pytest.approx(h * 0.779 / CHAIN)
    assert np.isnan(stature_of(np.full((8, 3), np.nan), chains))


@given(st.floats(0.8, 1.25), st.floats(1.0, 2.5), st.floats(1.0, 5.0))
def test_the_floor_corrects_a_wrong_stature(true_scale: float, camera_height: float, away: float) -> None:
    lowest = np.array([0.2, camera_height, away]) / true_scale  # as seen with the assumed stature
    down = np.array([0.0, 1.0, 0.0])
    sure = {"height_sd": 1e-4, "tilt_sd": 1e-5, "size_sd": 0.2}
    factor, sd = scale_by_floor(lowest, down, camera_height, **sure)
    assert factor == pytest.approx(true_scale, rel=2e-3)
    assert sd < 0.2
    between, _ = scale_by_floor(lowest, down, camera_height, **FLOOR)
    assert min(1.0, true_scale) - 1e-9 <= between <= max(1.0, true_scale) + 1e-9


@pytest.mark.parametrize("camera_height", [float("nan"), 0.0, 20.0])
def test_without_a_floor_below_the_stature_decides(camera_height: float) -> None:
    lowest = np.array([0.0, 1.0, 3.0])
    assert scale_by_floor(lowest, np.array([0.0, 1.0, 0.0]), camera_height, **FLOOR) == (1.0, 0.06)


@pytest.mark.parametrize("size_px", [(640, 480), (480, 640), (1920, 1080)])
def test_a_lens_sees_its_field_of_view(size_px: tuple[int, int]) -> None:
    lens, half = camera_of_view(size_px, 1.0), np.tan(0.5)
    long = 0 if size_px[0] > size_px[1] else 1
    edge = np.array([0.0, 0.0, 1.0])
    edge[long] = half
    assert project(edge, lens)[long] == pytest.approx(max(size_px) - 0.5)
