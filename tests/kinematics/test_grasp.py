"""Distances from a box, and when a hand that touches it holds it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from support.kinematic_hands import random_motion

from mocapella.errors import SettingsError
from mocapella.geometry.rigid import apply
from mocapella.kinematics.grasp import Grasp, GraspSettings, distance_to_box

HALF = np.array([0.03, 0.05, 0.1])
seeds = st.integers(0, 2**32 - 1)
distances = arrays(np.float64, (30, 5), elements=st.floats(-0.01, 0.06) | st.just(np.nan))
HZ = 60.0


def fingers(thumb: float, index: float, others: float = 1.0) -> np.ndarray:
    return np.array([thumb, index, others, others, others])


def held(path: Any, settings: GraspSettings | None = None) -> list[bool]:
    grasp = Grasp(settings)
    return [grasp.update(np.asarray(d), k / HZ) for k, d in enumerate(path)]


@given(seeds)
def test_moving_box_and_points_together_changes_no_distance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, T, motion = rng.normal(0, 0.1, (2, 9, 3)), random_motion(rng), random_motion(rng)
    before = distance_to_box(points, T, HALF)
    assert before.shape == (2, 9)
    np.testing.assert_allclose(distance_to_box(apply(motion, points), motion @ T, HALF), before, atol=1e-12)


@given(seeds)
def test_outside_it_is_the_distance_to_the_nearest_point_of_the_box(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(0, 0.1, (50, 3))
    nearest = np.clip(points, -HALF, HALF)
    inside = (nearest == points).all(axis=-1)
    d = distance_to_box(points, np.eye(4), HALF)
    np.testing.assert_allclose(d[~inside], np.linalg.norm(points - nearest, axis=-1)[~inside], atol=1e-15)
    assert (d[~inside] > 0).all()
    # Inside, the nearest of the six faces.
    np.testing.assert_allclose(d[inside], -(HALF - np.abs(points[inside])).min(axis=-1), atol=1e-15)
    assert (d[inside] <= 0).all()


@given(seeds)
def test_a_distance_changes_no_faster_than_the_point_moves(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a = rng.normal(0, 0.06, (200, 3))
    b = a + rng.normal(0, 0.02, a.shape)
    T = random_motion(rng)
    change = distance_to_box(apply(T, a), T, HALF) - distance_to_box(apply(T, b), T, HALF)
    assert (np.abs(change) <= np.linalg.norm(a - b, axis=-1) + 1e-12).all()


def test_a_point_that_is_not_known_has_no_distance() -> None:
    d = distance_to_box(np.array([[0.0, np.nan, 0.0], [0.0, 0.0, 0.2]]), np.eye(4), HALF)
    np.testing.assert_allclose(d, [np.nan, 0.1])


@given(distances)
def test_a_finger_touches_from_near_until_far(path: np.ndarray) -> None:
    s, grasp, touching = GraspSettings(), Grasp(), np.zeros(5, dtype=bool)
    for k, d in enumerate(path):
        grasp.update(d, k / HZ)
        near, far, unknown = d <= s.touch_m, d > s.leave_m, np.isnan(d)
        assert grasp.touching[near].all()
        assert not grasp.touching[far].any()
        keeps = unknown | ~(near | far)
        np.testing.assert_array_equal(grasp.touching[keeps], touching[keeps])
        touching = grasp.touching.copy()


@given(distances)
def test_without_a_wait_it_is_held_where_the_thumb_and_another_finger_touch_it(path: np.ndarray) -> None:
    grasp = Grasp(GraspSettings(after_s=0.0))
    for k, d in enumerate(path):
        now = grasp.update(d, k / HZ)
        assert now == grasp.held == (grasp.touching[0] and grasp.touching[1:].any())


def test_it_is_held_after_a_while_and_let_go_after_a_while() -> None:
    touch, away = fingers(0.0, 0.0), fingers(0.05, 0.05)
    assert held([touch] * 10) == [k / HZ >= 0.1 for k in range(10)]
    assert held([touch] * 10 + [away] * 10)[10:] == [k / HZ < 0.1 for k in range(10)]


def test_a_short_touch_is_no_grasp_and_a_short_leave_no_letting_go() -> None:
    touch, away = fingers(0.0, 0.0), fingers(0.05, 0.05)
    assert not any(held(([touch] * 4 + [away]) * 6))
    assert all(held([touch] * 10 + ([away] * 4 + [touch]) * 6)[9:])


@pytest.mark.parametrize("d", [fingers(1.0, 0.0, 0.0), fingers(0.0, 1.0), fingers(np.nan, 0.0), fingers(0.02, 0.02)])
def test_neither_fingers_without_the_thumb_nor_the_thumb_alone_hold(d: np.ndarray) -> None:
    assert not any(held([d] * 30))


def test_what_is_not_seen_any_more_stays_held() -> None:
    assert all(held([fingers(0.0, 0.0)] * 10 + [np.full(5, np.nan)] * 60)[9:])


def test_a_time_that_goes_back_begins_the_wait_anew() -> None:
    grasp, touch = Grasp(), fingers(0.0, 0.0)
    grasp.update(touch, 5.0)
    assert not grasp.update(touch, 1.0)
    assert not grasp.update(touch, 1.09)
    assert grasp.update(touch, 1.11)


@given(distances)
def test_reset_is_as_newly_made(path: np.ndarray) -> None:
    grasp = Grasp()
    first = [grasp.update(d, k / HZ) for k, d in enumerate(path)]
    grasp.reset()
    assert first == [grasp.update(d, k / HZ) for k, d in enumerate(path)]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("touch_m", 0.0), ("touch_m", 1.0), ("touch_m", np.nan), ("leave_m", 0.01), ("leave_m", 1.0)),
        *(("after_s", -0.1), ("after_s", 11.0)),
    ],
)
def test_settings_out_of_range_are_refused(name: str, value: float) -> None:
    with pytest.raises(SettingsError, match=f"{name} is {value}"):
        GraspSettings(**{name: value})
