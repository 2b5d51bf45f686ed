"""The velocities of a rigid body are found, whatever few points do beside it."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.geometry.rigid_velocity import rigid_velocity


@given(st.integers(3, 20), st.integers(0, 999))
@settings(max_examples=40)
def test_a_rigid_motion_is_found_exactly_also_at_points_that_are_not_used(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, v, turn = rng.normal(size=(n + 2, 3)), rng.normal(size=3), rng.normal(size=3)
    true = v + np.cross(turn, points)
    told, used = true.copy(), np.ones(n + 2, dtype=np.bool_)
    told[-2:], used[-2] = np.nan, False
    np.testing.assert_allclose(rigid_velocity(points, told, used), true, atol=1e-8)


@given(st.integers(0, 999))
@settings(max_examples=20)
def test_what_is_left_has_no_rigid_motion_in_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, told, used = rng.normal(size=(9, 3)), rng.normal(size=(9, 3)), np.ones(9, dtype=np.bool_)
    left = told - rigid_velocity(points, told, used)
    np.testing.assert_allclose(rigid_velocity(points, left, used), 0.0, atol=1e-9)


def test_one_point_gives_a_translation_and_none_gives_nothing() -> None:
    points = np.array([[0.1, 0.2, 0.3], [1.0, 0.0, 0.0], [np.nan] * 3])
    told = np.array([[1.0, 2.0, 3.0], [9.0, 9.0, 9.0], [0.0, 0.0, 0.0]])
    out = rigid_velocity(points, told, np.array([True, False, True]))
    np.testing.assert_allclose(out[:2], [[1.0, 2.0, 3.0]] * 2)
    assert np.isnan(out[2]).all()
    np.testing.assert_array_equal(rigid_velocity(points, told, np.zeros(3, np.bool_))[:2], 0.0)
