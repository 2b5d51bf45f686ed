"""The thesis' equations against values computed by hand, and what must hold for any."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mocapella.calibration.centre_and_angle import body_centre, shoulder_angle, world_from_sensor
from mocapella.geometry.angles import wrap
from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_y

coordinates = st.floats(-10, 10)
vectors = arrays(np.float64, 3, elements=coordinates)
angles = st.floats(-3, 3)


def test_equation_7_by_hand() -> None:
    # Shoulders: D = 2.4 − 2.0 = 0.4, W = 0.3 − 0 = 0.3, so tan θ = 4/3: cos θ = 0.6, sin θ = 0.8.
    theta = shoulder_angle([0.0, 1.4, 2.0], [0.3, 1.5, 2.4])
    assert np.cos(theta) == pytest.approx(0.6)
    assert np.sin(theta) == pytest.approx(0.8)
    # p' = (2, 2.5, 5) − (1, 2, 3) = (1, 0.5, 2); x = 1·0.6 + 2·0.8 = 2.2, y = 0.5, z = 2·0.6 − 1·0.8 = 0.4.
    T_world_sensor = world_from_sensor([1.0, 2.0, 3.0], theta)
    np.testing.assert_allclose(apply(T_world_sensor, [[2.0, 2.5, 5.0]]), [[2.2, 0.5, 0.4]], atol=1e-15)
    # Equation 8, back: x' = 2.2·0.6 − 0.4·0.8 = 1, z' = 0.4·0.6 + 2.2·0.8 = 2, and C is added again.
    np.testing.assert_allclose(apply(inverse(T_world_sensor), [[2.2, 0.5, 0.4]]), [[2.0, 2.5, 5.0]], atol=1e-15)


@pytest.mark.parametrize(
    ("right", "theta"),
    [
        ((1.0, 0.0, 0.0), 0.0),
        ((1.0, 9.0, 1.0), np.pi / 4),
        ((1.0, 0.0, -1.0), -np.pi / 4),
        ((0.0, 0.0, 1.0), np.pi / 2),
        ((0.0, 0.0, -1.0), -np.pi / 2),
        ((-1.0, 0.0, 0.0), np.pi),
        ((-1.0, 0.0, 1.0), 3 * np.pi / 4),
        ((-1.0, 0.0, -1.0), -3 * np.pi / 4),
    ],
)
def test_the_shoulder_angle_goes_round_the_circle_also_where_w_is_not_positive(
    right: tuple[float, float, float], theta: float
) -> None:
    assert shoulder_angle([0.0, 0.0, 0.0], right) == pytest.approx(theta)


@given(st.floats(0.01, 5), st.floats(-5, 5))
def test_where_w_is_positive_it_is_the_arc_tangent_of_d_over_w(w: float, d: float) -> None:
    assert shoulder_angle([1.0, 2.0, 3.0], [1 + w, 2.0, 3 + d]) == pytest.approx(np.arctan(d / w))


def test_inferred_joints_count_in_the_centre_if_it_is_of_all_seen_ones() -> None:
    positions = np.array([[[0, 0, 2], [2, 4, 4], [4, 8, 9]], [[4, 0, 5], [8, 8, 8], [7, 7, 7]]], dtype=float)
    states = np.array([[2, 2, 1], [1, 0, 1]], dtype=np.uint8)
    # Frame 1: the mean of all three; frame 2 has no tracked joint and does not count.
    np.testing.assert_allclose(body_centre(positions, states, inferred=True), [2, 4, 5])
    np.testing.assert_allclose(body_centre(positions, states), [1, 2, 3])


@given(arrays(np.float64, (3, 5, 3), elements=coordinates))
def test_both_centres_are_one_if_nothing_is_inferred(positions: np.ndarray) -> None:
    states = np.full((3, 5), 2, dtype=np.uint8)
    np.testing.assert_array_equal(body_centre(positions, states, inferred=True), body_centre(positions, states))


def test_the_centre_by_hand_counts_tracked_joints_only_and_every_frame_alike() -> None:
    positions = np.array([[[0, 0, 2], [2, 4, 4], [9, 9, 9]], [[4, 0, 5], [8, 8, 8], [7, 7, 7]]], dtype=float)
    states = np.array([[2, 2, 1], [2, 0, 1]], dtype=np.uint8)
    # Frame 1: the mean of two joints is (1, 2, 3); frame 2: of one, (4, 0, 5); their mean is (2.5, 1, 4).
    np.testing.assert_allclose(body_centre(positions, states), [2.5, 1, 4])


def test_the_centre_passes_over_frames_without_a_tracked_joint() -> None:
    positions = np.full((2, 3, 3), np.nan)
    positions[1] = [[1, 2, 3]] * 3
    np.testing.assert_allclose(body_centre(positions, np.array([[0] * 3, [2] * 3], dtype=np.uint8)), [1, 2, 3])
    assert np.isnan(body_centre(positions, np.zeros((2, 3), dtype=np.uint8))).all()


@given(vectors, angles, vectors)
def test_the_way_to_the_world_takes_the_centre_to_the_origin_and_the_shoulders_to_the_x_axis(
    centre: np.ndarray, theta: float, left: np.ndarray
) -> None:
    right = left + np.array([0.4 * np.cos(theta), 0.1, 0.4 * np.sin(theta)])
    T_world_sensor = world_from_sensor(centre, shoulder_angle(left, right))
    np.testing.assert_allclose(apply(T_world_sensor, centre[None]), [[0, 0, 0]], atol=1e-12)
    a, b = apply(T_world_sensor, np.stack([left, right]))
    np.testing.assert_allclose(b - a, [0.4, 0.1, 0.0], atol=1e-12)


@given(angles, st.floats(-3, 3))
def test_turning_the_body_turns_its_angle_the_other_way_round_the_y_axis(theta: float, by: float) -> None:
    right = np.array([0.4 * np.cos(theta), 0.1, 0.4 * np.sin(theta)])
    turned = rotation_about_y(by) @ right
    assert wrap(shoulder_angle([0, 0, 0], turned) - (shoulder_angle([0, 0, 0], right) - by)) == pytest.approx(
        0, abs=1e-9
    )


@given(arrays(np.float64, (3, 4, 3), elements=coordinates), vectors)
def test_moving_the_body_moves_its_centre_along(positions: np.ndarray, by: np.ndarray) -> None:
    states = np.full((3, 4), 2, dtype=np.uint8)
    moved = apply(rigid(np.eye(3), by), positions)
    np.testing.assert_allclose(body_centre(moved, states), body_centre(positions, states) + by, atol=1e-12)
