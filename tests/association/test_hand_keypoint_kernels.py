"""Kernels of hands in images: projections are those of the lens, rays pass through their pixels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from mocapella.association.hand_keypoint_kernels import (
    add_rays,
    mean_mismatch,
    move_pixels,
    point_distances,
    seen_at,
    sure_landmarks,
)
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply
from mocapella.geometry.triangulation import views
from mocapella.geometry.twists import exp_twist

Float64 = NDArray[np.float64]
SEEDS = st.integers(0, 2**32 - 1)
LENS = np.array([530.0, 520.0, 319.5, 239.5, -0.05, 0.01, 0.001, -0.001, 0.0])


def room(seed: int) -> tuple[np.random.Generator, Float64, Float64, Float64]:
    """Random numbers, a camera's pose, its numbers, and landmarks (21, 3) before it [m]."""
    rng = np.random.default_rng(seed)
    T = exp_twist(rng.normal(size=6))
    points = apply(np.linalg.inv(T), rng.normal(size=(21, 3)) * 0.08 + [0.1, 0.0, 1.5])
    return rng, T, views([LENS], [T]).numbers, points


@given(SEEDS)
def test_a_point_is_seen_where_the_lens_projects_it(seed: int) -> None:
    _, T, numbers, points = room(seed)
    at = np.array([seen_at(numbers, 0, *point) for point in points])
    np.testing.assert_allclose(at[:, :2], project(apply(T, points), LENS), atol=1e-9)
    np.testing.assert_allclose(at[:, 2], apply(T, points)[:, 2], atol=1e-12)
    behind = np.linalg.inv(T) @ [0.0, 0.0, -1.0, 1.0]
    assert np.isnan(seen_at(numbers, 0, *behind[:3])[:2]).all()


@given(SEEDS)
def test_a_ray_passes_through_its_pixel_nearest_to_the_prediction(seed: int) -> None:
    rng, T, numbers, points = room(seed)
    pixels, near = project(apply(T, points), LENS), points + rng.normal(size=(21, 3)) * 0.02
    pixels[3], near[4] = np.nan, np.nan
    found, covariances = np.full((21, 3), np.nan), np.full((21, 3, 3), np.nan)
    found[5] = 7.0
    add_rays(numbers, 0, pixels, np.full(21, 2.0), near, 0.5, found, covariances)
    assert np.isnan(found[3:5]).all()
    assert (found[5] == 7.0).all()
    own = [i for i in range(21) if i not in (3, 4, 5)]
    np.testing.assert_allclose(project(apply(T, found[own]), LENS), pixels[own], atol=1e-6)
    rays = found[own] - numbers[0, 22:]
    np.testing.assert_allclose(np.einsum("ij,ij->i", near[own] - found[own], rays), 0.0, atol=1e-9)
    along = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    np.testing.assert_allclose(np.einsum("ia,iab,ib->i", along, covariances[own], along), 0.25, rtol=1e-9)


@given(SEEDS)
def test_pixels_are_moved_by_the_predicted_motion(seed: int) -> None:
    rng, T, numbers, points = room(seed)
    velocities, after_s = rng.normal(size=(21, 3)), -0.02
    then = project(apply(T, points + after_s * velocities), LENS)
    pixels = then[:, None].copy()
    move_pixels(numbers, 0, points, velocities, after_s, pixels)
    np.testing.assert_allclose(pixels[:, 0], project(apply(T, points), LENS), atol=1e-8)
    assert mean_mismatch(numbers, 0, points, velocities, after_s, 0.01, then, np.ones(21), 9.0) < 1e-12
    assert mean_mismatch(numbers, 0, points, velocities, after_s, 0.01, then + 500.0, np.ones(21), 9.0) == 9.0
    assert mean_mismatch(numbers, 0, points, velocities, after_s, 0.01, np.full((21, 2), np.nan), np.ones(21), 9.0) == 9


def test_distances_are_in_units_of_the_allowed_and_infinite_behind_the_camera() -> None:
    numbers = views([LENS], [np.eye(4)]).numbers
    away = np.empty(3)
    points = np.array([[0.0, 0.0, 2.0], [0.0, 0.0, -2.0], [np.nan, 0.0, 2.0]])
    point_distances(numbers, 0, points, 319.5 + 53.0, 239.5, 0.2, away)
    assert away[0] == pytest.approx(1.0)
    assert np.isinf(away[1:]).all()


def test_only_confident_landmarks_count_and_the_hand_size_gives_their_deviation() -> None:
    pixels, confidences = np.zeros((21, 2)), np.full(21, 0.25)
    pixels[4], confidences[5], pixels[6] = (100.0, 40.0), 0.2, (np.nan, 3.0)
    px, sds = np.empty((21, 2)), np.empty(21)
    assert sure_landmarks(pixels, confidences, 0.03, 1.0, 0.22, px, sds) == 19
    assert np.isnan(sds[[5, 6]]).all()
    assert np.isnan(px[[5, 6]]).all()
    assert sds[0] == pytest.approx(6.0)
    assert sure_landmarks(pixels, np.zeros(21), 0.03, 1.0, 0.22, px, sds) == 0
