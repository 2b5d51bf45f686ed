from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mocapella.errors import SettingsError
from mocapella.geometry.rigid import apply, rigid, rotation_about_x, rotation_about_y
from mocapella.smoothing.kalman import KalmanSettings, Points, correct, predict, unknown

STEPS, COUNT = 10, 3
paths = arrays(np.float64, (STEPS, COUNT, 3), elements=st.floats(-5, 5))
gaps = arrays(np.bool_, (STEPS, COUNT))
DT = 1 / 30
PLAIN = KalmanSettings(degrees_of_freedom=math.inf)


def run(path: np.ndarray, settings: KalmanSettings | None = None, variance: float = 1e-4) -> list[Points]:
    settings = settings or KalmanSettings()
    points, made = unknown(path.shape[1], 0.0), []
    for k, measured in enumerate(path):
        points = predict(points, k * DT, settings)
        points = correct(points, measured, np.full(measured.shape[:-1], variance), settings)
        made.append(points)
    return made


def blanked(path: np.ndarray, gone: np.ndarray) -> np.ndarray:
    return np.where(gone[..., None], np.nan, path)


@pytest.mark.slow
@given(paths, gaps, st.floats(-3, 3), st.floats(-3, 3))
def test_moving_the_points_moves_the_result_along(path: np.ndarray, gone: np.ndarray, a: float, b: float) -> None:
    T = rigid(rotation_about_x(a) @ rotation_about_y(b), [1, -2, 3])
    path = blanked(path, gone)
    here, there = run(path)[-1], run(apply(T, path))[-1]
    np.testing.assert_allclose(there.positions, apply(T, here.positions), atol=1e-8)
    np.testing.assert_allclose(there.variances, here.variances, atol=1e-9)


@pytest.mark.slow
@given(paths, gaps)
def test_a_covariance_is_one_and_time_only_makes_it_larger(path: np.ndarray, gone: np.ndarray) -> None:
    points = run(blanked(path, gone))[-1]
    known = np.isfinite(points.positions[..., 0])
    p, c, v = np.moveaxis(points.variances[known], -1, 0)
    assert (p > 0).all()
    assert (p * v - c * c > 0).all()
    later = predict(points, points.at_s + 0.2, KalmanSettings()).variances[known]
    assert (later[..., 0] > p).all()
    assert (later[..., 2] > v).all()


@given(paths)
def test_one_step_equals_the_textbooks_matrices(path: np.ndarray) -> None:
    before, after = run(path[:2, :1], PLAIN)
    P = np.array([[before.variances[0, 0], before.variances[0, 1]], [before.variances[0, 1], before.variances[0, 2]]])
    F = np.array([[1, DT], [0, 1]])
    Q = PLAIN.acceleration_density * np.array([[DT**3 / 3, DT**2 / 2], [DT**2 / 2, DT]])
    H, R = np.array([[1.0, 0.0]]), np.array([[1e-4]])
    P = F @ P @ F.T + Q
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    x = F @ np.stack([before.positions[0], before.velocities[0]])
    x = x + K @ (path[1, 0][None] - H @ x)
    P = (np.eye(2) - K @ H) @ P
    np.testing.assert_allclose(after.positions[0], x[0], atol=1e-10)
    np.testing.assert_allclose(after.velocities[0], x[1], atol=1e-8)
    np.testing.assert_allclose(after.variances[0], [P[0, 0], P[0, 1], P[1, 1]], rtol=1e-9)


def test_it_is_as_uncertain_as_it_is_wrong() -> None:
    """Normalised errors of points that move as the filter assumes have the mean 1 on each axis."""
    rng = np.random.default_rng(1)
    settings, people = PLAIN, 400
    velocity, position = rng.normal(0, settings.speed_sd, (people, 3)), np.zeros((people, 3))
    points = unknown(people, 0.0)
    Q = settings.acceleration_density * np.array([[DT**3 / 3, DT**2 / 2], [DT**2 / 2, DT]])
    L = np.linalg.cholesky(Q)
    for k in range(60):
        points = predict(points, k * DT, settings)
        points = correct(points, position + rng.normal(0, 0.02, position.shape), np.full(people, 0.02**2), settings)
        error = (points.positions - position) ** 2 / points.variances[..., :1]
        push = np.einsum("ij,jnk->ink", L, rng.normal(size=(2, people, 3)))
        position, velocity = position + DT * velocity + push[0], velocity + push[1]
    assert 0.85 < error.mean() < 1.15


def test_one_wild_measurement_moves_it_less_than_it_would_without_the_weight() -> None:
    path = np.zeros((40, 1, 3))
    path[-1] = 1.0
    robust, plain = run(path)[-1].positions[0, 0], run(path, PLAIN)[-1].positions[0, 0]
    assert robust < 0.5 * plain


def test_a_point_that_is_not_seen_is_predicted_and_then_forgotten() -> None:
    path = np.zeros((60, 1, 3))
    path[:, 0, 0] = np.arange(60) * DT  # 1 m/s
    path[30:] = np.nan
    made = run(path, KalmanSettings(forget_after_s=0.5))
    assert made[40].positions[0, 0] == pytest.approx(40 * DT, abs=0.05)
    assert made[40].variances[0, 0] > 4 * made[29].variances[0, 0]
    assert np.isnan(made[-1].positions).all()
    assert made[-1].seen_s[0] == pytest.approx(29 * DT)


@pytest.mark.parametrize("name", ["acceleration_density", "speed_sd", "degrees_of_freedom"])
def test_settings_out_of_range_are_refused(name: str) -> None:
    with pytest.raises(SettingsError, match=name):
        KalmanSettings(**{name: 0.0})
