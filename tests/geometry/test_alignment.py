from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.geometry import alignment_kernels
from mocapella.geometry.alignment import (
    MOMENTS,
    align,
    centred_products,
    moments,
    normal_equations,
    robust_align,
    robust_weights,
    shifted,
)
from mocapella.geometry.rigid import apply, inverse, rigid

seeds = st.integers(0, 2**32 - 1)


def random_motion(rng: np.random.Generator) -> np.ndarray:
    Q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return rigid(Q * np.sign(np.linalg.det(Q)), rng.normal(size=3) * 3)


def small_motion(twist: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return rigid(Rotation.from_rotvec(twist[3:]).as_matrix(), twist[:3])


def cloud(rng: np.random.Generator, n: int = 25) -> np.ndarray:
    return rng.normal(size=(n, 3)) * [0.3, 0.5, 0.2] + [0.2, 0.1, 2.5]


@settings(deadline=None)
@given(seeds)
def test_a_motion_is_recovered_from_points_without_noise(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T, q = random_motion(rng), cloud(rng)
    np.testing.assert_allclose(align(moments(apply(T, q), q, rng.uniform(0.1, 2, 25))), T, atol=1e-11)


@settings(deadline=None)
@given(seeds)
def test_moving_either_side_moves_the_result_with_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    p, q, A, B = cloud(rng), cloud(rng), random_motion(rng), random_motion(rng)
    T = align(moments(p, q))
    moved = align(moments(apply(A, p), apply(B, q)))
    np.testing.assert_allclose(moved, A @ T @ inverse(B), atol=1e-8)


@settings(deadline=None)
@given(seeds)
def test_it_is_least_squares_no_motion_near_it_fits_better(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T, q = random_motion(rng), cloud(rng)
    p = apply(T, q) + rng.normal(size=q.shape) * 0.05
    w = rng.uniform(0.1, 2, 25)
    best = align(moments(p, q, w))

    def cost(motion: np.ndarray) -> float:
        return float((w * ((p - apply(motion, q)) ** 2).sum(-1)).sum())

    for step in rng.normal(size=(10, 6)) * 1e-3:
        assert cost(small_motion(step) @ best) > cost(best)


@settings(deadline=None)
@given(seeds)
def test_a_mirror_image_is_fitted_by_a_rotation_all_the_same(seed: int) -> None:
    rng = np.random.default_rng(seed)
    q = cloud(rng)
    T = align(moments(q * [-1, 1, 1], q))
    np.testing.assert_allclose(np.linalg.det(T[:3, :3]), 1.0)


@pytest.mark.slow
@settings(max_examples=30, deadline=None)
@given(seeds, st.integers(1, 60), st.floats(0.0, 1.0))
def test_recursive_is_the_batch_of_all_frames_with_weights_that_fade(seed: int, frames: int, keep: float) -> None:
    rng = np.random.default_rng(seed)
    p, q = (np.stack([cloud(rng) for _ in range(frames)]) for _ in range(2))
    w = rng.uniform(0, 1, (frames, 25))
    M, T = np.zeros(MOMENTS), np.full((4, 4), np.nan)
    for i in range(frames):
        forget_add_fit(M, T, p[i], q[i], w[i], keep)
    fading = w * keep ** np.arange(frames)[::-1, None]
    batch = moments(p.reshape(-1, 3), q.reshape(-1, 3), fading.reshape(-1))
    np.testing.assert_allclose(M, batch, rtol=1e-12, atol=1e-12)
    # The motion itself, where it is determined: unrelated clouds can have a double eigenvalue.
    well = robustly_determined(batch)
    if well:
        np.testing.assert_allclose(T, align(batch), atol=1e-12 / well)


def forget_add_fit(  # noqa: PLR0917 - as the kernels take them
    M: np.ndarray, T: np.ndarray, p: np.ndarray, q: np.ndarray, w: np.ndarray, keep: float
) -> None:
    """A step of the compiled refinement, as the calibration of a pair takes it: in place."""
    M *= keep
    alignment_kernels.accumulate(M, p, q, np.zeros_like(q), w, np.arange(len(w)))
    if M[0] > 0:
        alignment_kernels.align(M, 0.0, T)


def robustly_determined(M: np.ndarray) -> float:
    """How far apart the best rotation and the next best are, as a part of the whole; 0 where it is not worth asking."""
    S = centred_products(M)
    s = np.linalg.svd(S, compute_uv=False)
    gap = (s[1] + np.sign(np.linalg.det(S)) * s[2]) / M[0]
    return float(gap) if gap > 1e-3 else 0.0


@pytest.mark.slow
def test_recursive_equals_batch_to_1e_12_on_a_walk_of_ten_minutes() -> None:
    rng = np.random.default_rng(0)
    T_true = random_motion(rng)
    keep, frames = np.exp(-1 / 30 / 30), 18_000
    body = cloud(rng)
    t = np.arange(frames) / 30
    q = body + np.stack([np.sin(t / 3), 0 * t, np.cos(t / 5)], axis=-1)[:, None] + rng.normal(size=(frames, 25, 3)) / 50
    p = apply(T_true, q) + rng.normal(size=q.shape) / 50
    w = rng.uniform(0, 1, (frames, 25))
    M, T = np.zeros(MOMENTS), np.full((4, 4), np.nan)
    for i in range(frames):
        forget_add_fit(M, T, p[i], q[i], w[i], keep)
    fading = (w * keep ** np.arange(frames)[::-1, None]).reshape(-1)
    np.testing.assert_allclose(T, align(moments(p.reshape(-1, 3), q.reshape(-1, 3), fading)), atol=1e-12)


@pytest.mark.parametrize("kernel", ["l1", "geman-mcclure"])
@settings(max_examples=30, deadline=None)
@given(seed=seeds)
def test_a_third_of_outliers_does_not_matter(kernel: Any, seed: int) -> None:
    rng = np.random.default_rng(seed)
    T, q = random_motion(rng), np.concatenate([cloud(rng) for _ in range(4)])
    p = apply(T, q) + rng.normal(size=q.shape) * 1e-3
    wrong = rng.permutation(100)[:30]
    p[wrong] += rng.normal(size=(30, 3)) * 0.5
    d = inverse(T) @ robust_align(p, q, kernel=kernel, scale=0.01)
    assert np.linalg.norm(apply(d, q) - q, axis=-1).max() < 0.006


@settings(deadline=None)
@given(seeds)
def test_the_normal_equations_are_the_derivatives_of_the_residual(seed: int) -> None:
    rng = np.random.default_rng(seed)
    p, q, v, w = cloud(rng), cloud(rng), rng.normal(size=(25, 3)), rng.uniform(0.1, 1, 25)
    T, offset = random_motion(rng), float(rng.normal()) * 0.1
    H, g = normal_equations(moments(p, q, w, v), T, offset)

    def residual(d: np.ndarray) -> np.ndarray:
        return np.asarray(p - apply(small_motion(d[:6]) @ T, q + (offset + d[6]) * v)).reshape(-1)

    e = 1e-6
    J = -np.stack([(residual(e * axis) - residual(-e * axis)) / (2 * e) for axis in np.eye(7)], axis=-1)
    W = np.repeat(w, 3)[:, None]
    np.testing.assert_allclose(H, J.T @ (W * J), atol=1e-5)
    np.testing.assert_allclose(g, J.T @ (W[:, 0] * residual(np.zeros(7))), atol=1e-6)


@given(seeds, st.floats(-0.5, 0.5))
def test_shifted_moments_are_those_of_shifted_points(seed: int, by: float) -> None:
    rng = np.random.default_rng(seed)
    p, q, v, w = cloud(rng), cloud(rng), rng.normal(size=(25, 3)), rng.uniform(0.1, 1, 25)
    np.testing.assert_allclose(shifted(moments(p, q, w, v), by), moments(p, q + by * v, w, v), atol=1e-10)


@given(seeds, st.floats(-0.5, 0.5))
def test_an_offset_moves_each_point_along_its_own_velocity(seed: int, offset: float) -> None:
    rng = np.random.default_rng(seed)
    T, q, v, w = random_motion(rng), cloud(rng), rng.normal(size=(25, 3)), rng.uniform(0.1, 1, 25)
    moved = q + offset * v
    p = apply(T, moved)
    M = moments(p, q, w, v)
    np.testing.assert_allclose(align(M, offset), T, atol=1e-9)
    np.testing.assert_allclose(centred_products(M, offset), centred_products(moments(p, moved, w)), atol=1e-9)


def test_points_that_are_missing_or_weigh_nothing_do_not_count() -> None:
    rng = np.random.default_rng(1)
    p, q, w = cloud(rng), cloud(rng), np.ones(25)
    expected = moments(p[3:], q[3:])
    p[0, 1], q[1, 2], w[2] = np.nan, np.inf, 0.0
    np.testing.assert_allclose(moments(p, q, w), expected)
    assert np.isnan(align(np.zeros(MOMENTS))).any()
    assert np.isnan(robust_align(np.full((5, 3), np.nan), q[:5])).any()


def test_batches_are_what_each_alone_is() -> None:
    rng = np.random.default_rng(2)
    p, q = (np.stack([cloud(rng) for _ in range(4)]) for _ in range(2))
    together = align(moments(p, q))
    for i in range(4):
        np.testing.assert_allclose(together[i], align(moments(p[i], q[i])), atol=1e-12)


def test_robust_weights_fall_with_the_residual_and_an_unknown_kernel_is_refused() -> None:
    r = np.array([0.0, 0.01, 0.02, 0.2])
    np.testing.assert_allclose(robust_weights(r, "l1", 0.02), [50, 50, 50, 5])
    np.testing.assert_allclose(robust_weights(r, "huber", 0.02), [1, 1, 1, 0.1])
    np.testing.assert_allclose(robust_weights(r, "geman-mcclure", 0.02), [1, 0.64, 0.25, 1 / 101**2])
    with pytest.raises(SettingsError, match=r"l1, huber"):
        robust_weights(r, "cauchy", 0.02)  # type: ignore[arg-type]
    with pytest.raises(SettingsError, match="scale"):
        robust_align(np.zeros((3, 3)), np.zeros((3, 3)), scale=0.0)
