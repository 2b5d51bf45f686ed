"""Laws of the point that rays agree on."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from support.ray_bodies import around

from mocapella.kinematics.ray_point_kernels import agree

Float64 = NDArray[np.float64]
SD = 0.003
POINT = np.array([0.3, 1.1, -0.2])
seeds = st.integers(0, 2**32 - 1)
pytestmark = pytest.mark.slow  # a kernel is compiled for these tests alone


def rays_to_point(cameras: int, rng: np.random.Generator, point: Float64 = POINT) -> Float64:
    """(cameras, 8) noisy rays."""
    rays = np.empty((cameras, 8))
    rays[:, :3] = around(cameras)
    d = point - rays[:, :3]
    rays[:, 3:6] = d / np.linalg.norm(d, axis=1, keepdims=True) + rng.normal(0, SD, (cameras, 3))
    rays[:, 3:6] /= np.linalg.norm(rays[:, 3:6], axis=1, keepdims=True)
    rays[:, 6:] = SD**2, 1e-6
    return rays


def agreed(rays: Float64, sd_m: float = np.inf, predicted: Float64 = POINT) -> tuple[int, Float64, Float64]:
    """The number of agreeing rays, the point with its covariance, and the weights."""
    out, weights = np.full(9, np.nan), np.full(len(rays), np.nan)
    count = agree(rays, np.arange(len(rays)), 0, len(rays), sd_m**2, predicted, weights, out)
    return count, out, weights


@settings(max_examples=20, deadline=None)
@given(seeds, st.integers(2, 8), st.booleans())
def test_rays_of_one_point_find_it_with_its_covariance(seed: int, cameras: int, predicted: bool) -> None:
    rays = rays_to_point(cameras, np.random.default_rng(seed))
    count, found, weights = agreed(rays, 0.05 if predicted else np.inf)
    assert count == cameras
    assert (weights > 0.3).all()
    upper = np.zeros((3, 3))
    upper[np.triu_indices(3)] = found[3:]
    covariance = upper + np.triu(upper, 1).T
    off = found[:3] - POINT
    assert off @ np.linalg.solve(covariance, off) < 40
    assert np.linalg.eigvalsh(covariance)[0] > 0


@settings(max_examples=20, deadline=None)
@given(seeds, st.integers(3, 8))
def test_a_ray_that_contradicts_two_that_agree_counts_nothing(seed: int, cameras: int) -> None:
    rng = np.random.default_rng(seed)
    rays = rays_to_point(cameras, rng)
    wrong = int(rng.integers(cameras))
    rays[wrong, 3:6] += np.cross(rays[wrong, 3:6], [0.1, 0.2, 0.1])
    rays[wrong, 3:6] /= np.linalg.norm(rays[wrong, 3:6])
    for sd_m in (np.inf, 0.05):
        count, found, weights = agreed(rays, sd_m)
        assert count == cameras - 1
        assert weights[wrong] == 0.0
        assert np.linalg.norm(found[:3] - POINT) < 0.08


def test_of_two_rays_that_contradict_each_other_the_predicted_one_counts() -> None:
    rays = rays_to_point(2, np.random.default_rng(1))
    rays[1] = rays_to_point(2, np.random.default_rng(2), POINT + np.array([0.0, 0.4, 0.0]))[1]
    count, _, weights = agreed(rays, 0.02)
    assert count < 2
    assert weights[0] > 0.5
    assert weights[1] < 0.1
    assert agreed(rays)[0] == 0


def test_two_rays_that_meet_far_from_the_prediction_do_not_agree_on_it() -> None:
    rays = rays_to_point(2, np.random.default_rng(1))
    rays[1] = rays_to_point(2, np.random.default_rng(2), POINT + np.array([0.3, 0.0, 0.3]))[1]
    count, _, weights = agreed(rays, 0.02)
    assert count < 2
    assert weights.max() > 0.5


def test_nothing_is_behind_a_camera_or_on_parallel_rays() -> None:
    rays = rays_to_point(2, np.random.default_rng(1))
    rays[:, 3:6] *= -1
    assert agreed(rays)[0] == 0
    rays = rays_to_point(2, np.random.default_rng(1))
    rays[1, 3:6] = rays[0, 3:6]
    assert agreed(rays)[0] == 0
