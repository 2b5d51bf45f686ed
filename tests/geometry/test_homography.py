from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mocapella.geometry.homography import focal_length, homography, plane_pose
from mocapella.geometry.rigid import apply
from mocapella.geometry.twists import exp_twist

PLANE = np.mgrid[0:4, 0:3].reshape(2, -1).T * 0.05
turns = arrays(np.float64, 3, elements=st.floats(-0.8, 0.8))


def directions(T: np.ndarray) -> np.ndarray:
    points = apply(T, np.column_stack([PLANE, np.zeros(len(PLANE))]))
    return np.asarray(points[:, :2] / points[:, 2:])


@given(turns, arrays(np.float64, 3, elements=st.floats(-0.2, 0.2)))
def test_a_plane_is_found_where_it_is(turn: np.ndarray, at: np.ndarray) -> None:
    T = exp_twist(np.r_[0, 0, 0, turn])
    T[:3, 3] = at + np.array([0, 0, 1.0])
    np.testing.assert_allclose(plane_pose(PLANE, directions(T)), T, atol=1e-7)


@given(st.integers(0, 10_000))
def test_a_plane_about_its_middle_is_in_front_of_the_camera_however_wrong_its_image_is(seed: int) -> None:
    wrong = np.random.default_rng(seed).uniform(-1, 1, (len(PLANE), 2))
    assert plane_pose(PLANE - PLANE.mean(axis=0), wrong)[2, 3] > 0


@given(turns)
def test_a_homography_brings_the_plane_to_its_picture(turn: np.ndarray) -> None:
    T = exp_twist(np.r_[0, 0, 1.0, turn])
    seen = directions(T)
    h = np.column_stack([PLANE, np.ones(len(PLANE))]) @ homography(PLANE, seen).T
    np.testing.assert_allclose(h[:, :2] / h[:, 2:], seen, atol=1e-9)


@pytest.mark.parametrize("f", [300.0, 900.0, 3000.0])
def test_the_focal_length_follows_from_tilted_views(f: float) -> None:
    centre = np.array([320.0, 240.0])
    views = [exp_twist(np.array([0, 0, 1.0, *turn])) for turn in ([0.5, 0, 0], [0, -0.4, 0.2], [0.3, 0.3, 0])]
    maps = [homography(PLANE, f * directions(T) + centre) for T in views]
    assert focal_length(maps, centre) == pytest.approx(f, rel=1e-6)


def test_parallel_views_determine_no_focal_length() -> None:
    centre = np.array([320.0, 240.0])
    flat = exp_twist(np.array([0, 0, 1.0, 0, 0, 0.4]))
    noise = np.random.default_rng(0).normal(0, 1e-3, PLANE.shape)
    f = focal_length([homography(PLANE, 600 * directions(flat) + centre + noise)], centre)
    assert not abs(f / 600 - 1) < 0.5
