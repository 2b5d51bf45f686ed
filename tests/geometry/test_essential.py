"""Essential matrices: laws of the five-point solver, the poses and the refinement."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.geometry.essential import (
    angles_between,
    best_pose,
    essential_of,
    five_point,
    poses_of,
    refine_pose,
    sampson_distance,
    triangulate_pair,
)
from mocapella.geometry.rigid import apply
from mocapella.geometry.twists import exp_twist

SEEDS = st.integers(0, 2**32 - 1)


def scene(seed: int, count: int = 40):  # type: ignore[no-untyped-def]
    """A relative pose with a translation of length 1, points before both cameras, and their directions."""
    rng = np.random.default_rng(seed)
    T = exp_twist(np.concatenate([rng.normal(size=3), rng.uniform(-0.4, 0.4, 3)]))
    T[:3, 3] /= np.linalg.norm(T[:3, 3])
    points = np.array([0.0, 0.0, 5.0]) + rng.uniform(-1, 1, (count, 3))
    other = apply(T, points)
    return T, points, points[:, :2] / points[:, 2:], other[:, :2] / other[:, 2:]


@given(SEEDS)
def test_the_true_matrix_is_among_the_solutions_of_five_points(seed: int) -> None:
    T, _, a, b = scene(seed)
    found, sample = five_point(a[None, :5], b[None, :5])
    true = essential_of(T) / np.linalg.norm(essential_of(T))
    off = np.minimum(np.abs(found - true).max(axis=(1, 2)), np.abs(found + true).max(axis=(1, 2)))
    assert off.min() < 1e-5
    assert (sample == 0).all()


@given(SEEDS)
def test_each_solution_passes_through_its_five_points_and_is_essential(seed: int) -> None:
    _, _, a, b = scene(seed)
    for E in five_point(a[None, :5], b[None, :5])[0]:
        assert np.abs(sampson_distance(E, a[:5], b[:5])).max() < 1e-6
        values = np.linalg.svd(E)[1]
        assert abs(values[0] - values[1]) < 1e-5
        assert values[2] < 1e-5


def test_equal_points_have_no_solution() -> None:
    same = np.zeros((1, 5, 2))
    assert len(five_point(same, same)[0]) == 0


def test_a_sample_with_roots_at_infinity_gives_finite_matrices_and_no_warning() -> None:
    a = [
        [0.11500900753068784, -0.05516070713611503], [0.1427165419474705, -0.13369661958506143],
        [-0.3454520115628057, 0.3019885824307279], [0.11164350726134986, -0.011395865530238814],
        [-0.31856107251293103, 0.3265644005602186],
    ]  # fmt: skip
    b = [
        [-0.5656526150708541, 0.07190631743649835], [-0.5443196305348694, -0.14966137519012912],
        [0.29281161708207076, 0.12724822855480825], [-0.5212857696878791, 0.15750952036064436],
        [0.2686666355719857, 0.13513626869269768],
    ]  # fmt: skip
    assert np.isfinite(five_point([a], [b])[0]).all()


@given(SEEDS)
def test_one_of_four_poses_has_all_points_in_front(seed: int) -> None:
    T, points, a, b = scene(seed)
    assert len(poses_of(essential_of(T))) == 4
    found, share = best_pose(essential_of(T), a, b)
    assert share == 1.0
    np.testing.assert_allclose(found, T, atol=1e-9)
    np.testing.assert_allclose(triangulate_pair(found, a, b)[0], points, atol=1e-6)


@given(SEEDS)
def test_refinement_returns_to_the_true_pose(seed: int) -> None:
    T, _, a, b = scene(seed)
    start = exp_twist(np.array([0.0, 0.0, 0.0, 0.004, -0.003, 0.004])) @ T
    start[:3, 3] /= np.linalg.norm(start[:3, 3])
    found = refine_pose(start, a, b, 0.05, steps=40)
    before, after = (np.abs(sampson_distance(essential_of(one), a, b)).max() for one in (start, found))
    assert after < max(1e-6, 0.1 * before)


def test_parallel_rays_give_no_point() -> None:
    T = np.eye(4)
    T[0, 3] = -1.0
    points, _ = triangulate_pair(T, np.zeros((1, 2)), np.zeros((1, 2)))
    assert np.isnan(points).all()


def test_the_angle_between_rays_is_that_of_the_triangle() -> None:
    T = np.eye(4)
    T[0, 3] = -1.0  # the second camera is 1 m to the right
    assert angles_between(T, np.array([[0.0, 0.0, 1.0]]))[0] == pytest.approx(np.pi / 4)
