"""Lines: a point on its line has no residual, its length is the distance, and rigid motions change neither."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.geometry.lens import project
from mocapella.geometry.plucker import camera_rays, join, line, moved, nearest_point, residual
from mocapella.geometry.rigid import apply, inverse
from mocapella.geometry.twists import exp_twist

seeds = st.integers(0, 2**32 - 1)
LENS = np.array([600.0, 590.0, 320.0, 240.0, -0.2, 0.05, 1e-3, -1e-3, 0.0])


def scene(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two batches of points, and a rigid motion."""
    rng = np.random.default_rng(seed)
    return rng.normal(size=(4, 2, 3)), rng.normal(size=(4, 2, 3)), exp_twist(rng.normal(size=6))


@given(seeds)
def test_points_of_a_line_are_on_it(seed: int) -> None:
    p, q, _ = scene(seed)
    lines = join(p, q)
    assert lines.shape == (4, 2, 6)
    for x in (p, q, p + 3.7 * (q - p)):
        np.testing.assert_allclose(residual(x, lines), 0, atol=1e-13)
    np.testing.assert_allclose(np.linalg.norm(lines[..., :3], axis=-1), 1, atol=1e-15)
    np.testing.assert_allclose(line(q, q - p), lines, atol=1e-13)


@given(seeds)
def test_the_residual_is_as_long_as_the_point_is_far(seed: int) -> None:
    p, q, _ = scene(seed)
    x = np.random.default_rng(seed + 1).normal(size=p.shape)
    n = (q - p) / np.linalg.norm(q - p, axis=-1)[..., None]
    nearest = p + ((x - p) * n).sum(axis=-1)[..., None] * n
    lines = join(p, q)
    np.testing.assert_allclose(
        np.linalg.norm(residual(x, lines), axis=-1), np.linalg.norm(x - nearest, axis=-1), atol=1e-12
    )


@given(seeds)
def test_moving_line_and_point_together_turns_the_residual_and_leaves_its_length(seed: int) -> None:
    p, q, T = scene(seed)
    x = np.random.default_rng(seed + 1).normal(size=p.shape)
    lines, there = join(p, q), moved(T, join(p, q))
    np.testing.assert_allclose(there, join(apply(T, p), apply(T, q)), atol=1e-12)
    np.testing.assert_allclose(residual(apply(T, x), there), residual(x, lines) @ T[:3, :3].T, atol=1e-12)


@given(seeds)
def test_the_ray_of_a_pixel_goes_through_what_the_camera_shows_there(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T_camera_world = exp_twist(rng.normal(size=6))
    seen = rng.uniform([-0.6, -0.4, 1.0], [0.6, 0.4, 2.0], (5, 3))
    x = apply(inverse(T_camera_world), seen)
    rays = camera_rays(project(seen, LENS), LENS, T_camera_world)
    np.testing.assert_allclose(residual(x, rays), 0, atol=1e-9)
    centre = inverse(T_camera_world)[:3, 3]
    np.testing.assert_allclose(residual(centre, rays), 0, atol=1e-12)
    assert (((x - centre) * rays[:, :3]).sum(axis=-1) > 0).all()


@pytest.mark.parametrize("x", [np.zeros(3), np.array([1.0, -2.0, 3.0])])
def test_one_point_makes_no_line(x: np.ndarray) -> None:
    assert np.isnan(join(x, x)).all()


def test_a_pixel_that_is_not_seen_has_no_ray() -> None:
    rays = camera_rays([[np.nan, 1.0], [320.0, 240.0]], LENS, np.eye(4))
    assert np.isnan(rays[0]).all()
    np.testing.assert_allclose(rays[1], [0, 0, 1, 0, 0, 0], atol=1e-12)


@given(seeds)
def test_lines_through_one_point_meet_there_and_a_motion_moves_it_along(seed: int) -> None:
    p, q, T = scene(seed)
    lines = join(q, p[:, :1])  # two lines each through the first point
    np.testing.assert_allclose(nearest_point(lines), p[:, 0], atol=1e-5)
    np.testing.assert_allclose(nearest_point(moved(T, lines)), apply(T, p[:, 0]), atol=1e-5)


@given(seeds)
def test_no_other_point_is_nearer_to_all_lines(seed: int) -> None:
    p, q, _ = scene(seed)
    lines, rng = join(p, q), np.random.default_rng(seed)
    best = nearest_point(lines)

    def cost(x: np.ndarray) -> np.ndarray:
        return np.asarray((residual(x[:, None], lines) ** 2).sum(axis=(-2, -1)))

    for _ in range(5):
        assert (cost(best) <= cost(best + rng.normal(0, 0.1, best.shape)) + 1e-9).all()


@given(seeds)
def test_parallel_lines_one_line_and_unknown_lines_have_no_nearest_point(seed: int) -> None:
    p, q, _ = scene(seed)
    parallel = line(p, (q - p)[:, :1])
    unknown = np.where(np.arange(6) == 2, np.nan, join(p, q))
    for lines in (parallel, join(p, q)[:, :1], unknown):
        assert np.isnan(nearest_point(lines)).all()
