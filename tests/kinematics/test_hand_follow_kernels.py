"""Kernels that follow a hand: each step equals its definition, written with arrays."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from support.kinematic_hands import FULL, LEFT, RIGHT, random_motion

from mocapella.geometry.alignment import align, moments
from mocapella.geometry.rigid import apply, inverse
from mocapella.geometry.twists import exp_twist, log_motion
from mocapella.kinematics.hand_chain import hand_chain, landmarks
from mocapella.kinematics.hand_follow_kernels import MovingHand, direct_start, informed, move, predict
from mocapella.kinematics.hand_solvers import ClosedForm
from mocapella.kinematics.hand_tracker import HandTracker, base_layout
from mocapella.kinematics.keypoint_hand_kernels import CORNERS, measure
from mocapella.model.hand import BASES, TIPS, HandPose, HandShape

Float64 = NDArray[np.float64]
SEEDS = st.integers(0, 2**32 - 1)


def covariances(rng: np.random.Generator, count: int, n: int = 3) -> Float64:
    A = rng.normal(size=(count, n, n))
    return A @ np.swapaxes(A, 1, 2) + 0.1 * np.eye(n)


@given(SEEDS)
def test_markers_without_a_place_or_a_covariance_have_no_information(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, C = rng.normal(size=(6, 3)), covariances(rng, 6)
    points[1, 2], C[2, 0, 1], C[3] = np.nan, np.inf, np.diag([1.0, -1.0, 1.0])
    C[4] = np.diag([1.0, 1.0, 1e-12])
    clean, information = np.empty((6, 3)), np.empty((6, 3, 3))
    informed(points, C, clean, information)
    for i in (0, 5):
        np.testing.assert_allclose(information[i], np.linalg.inv(C[i]), rtol=1e-7, atol=1e-7)
    assert not information[1:5].any()
    assert np.isfinite(clean).all()
    np.testing.assert_array_equal(clean[[0, 5]], points[[0, 5]])


def followed(shape: HandShape, seed: int) -> tuple[HandTracker, MovingHand, np.random.Generator]:
    """A tracker, and a hand that moves in any way."""
    rng = np.random.default_rng(seed)
    tracker = HandTracker(FULL, shape, base_layout(shape, 4))
    n = len(tracker._mean)
    z = tracker._mean + rng.normal(size=n) * 0.05
    (covariance,) = covariances(rng, 1, 6 + n)
    return tracker, MovingHand(random_motion(rng), z, rng.normal(size=6 + n) * 0.3, covariance), rng


@pytest.mark.parametrize("shape", [RIGHT, LEFT], ids=["right", "left"])
@given(SEEDS)
def test_a_prediction_goes_on_with_a_velocity_that_decays(shape: HandShape, seed: int) -> None:
    tracker, last, rng = followed(shape, seed)
    n, dt, memory = len(last.z), float(rng.uniform(0.001, 0.2)), tracker.settings.velocity_memory_s
    new = MovingHand(np.empty((4, 4)), np.empty(n), np.empty(6 + n), np.empty((6 + n, 6 + n)))
    certainty = np.empty((6 + n, 6 + n))
    predict(tracker._numbers, last, dt, new, certainty)
    part = memory * -np.expm1(-dt / memory) * last.velocity
    turn = exp_twist(np.concatenate([np.zeros(3), part[3:6]]))[:3, :3]
    np.testing.assert_allclose(new.T[:3, :3], last.T[:3, :3] @ turn, atol=1e-9)
    np.testing.assert_allclose(new.T[:3, 3], last.T[:3, 3] + last.T[:3, :3] @ part[:3], atol=1e-12)
    np.testing.assert_allclose(new.velocity, last.velocity * np.exp(-dt / memory), rtol=1e-12)
    np.testing.assert_allclose(certainty @ new.covariance, np.eye(6 + n), atol=1e-6)
    angles = tracker._angles(new.z)
    np.testing.assert_allclose(angles, FULL.limited(angles), atol=1e-9)


@given(SEEDS)
def test_a_velocity_that_is_measured_forever_is_reached(seed: int) -> None:
    tracker, last, rng = followed(RIGHT, seed)
    dt, step, z = 0.02, rng.normal(size=6) * 0.02, last.z + rng.normal(size=len(last.z)) * 0.02
    T = last.T @ exp_twist(step)
    moved = inverse(last.T) @ T
    true = np.concatenate([moved[:3, 3], log_motion(moved)[3:], z - last.z]) / dt
    velocity = last.velocity
    for _ in range(200):
        new = np.empty_like(velocity)
        move(tracker._numbers, last._replace(velocity=velocity), dt, T, z, new)
        velocity = new
    np.testing.assert_allclose(velocity, true, atol=1e-6)


@pytest.mark.parametrize("shape", [RIGHT, LEFT], ids=["right", "left"])
@given(SEEDS)
def test_the_direct_start_aligns_the_palm_and_solves_the_fingers(shape: HandShape, seed: int) -> None:
    tracker, last, rng = followed(shape, seed)
    truth = landmarks(hand_chain(FULL, shape), HandPose(FULL.natural, last.T))
    layout = base_layout(shape, 4) * shape.mirror
    points = np.concatenate([truth[list(TIPS)], apply(last.T, layout)]) + rng.normal(size=(9, 3)) * 1e-3
    information = np.repeat(np.eye(3)[None] * 1e6, 9, axis=0)
    information[2] = 0.0  # the middle finger's tip is not seen
    T, z = np.empty((4, 4)), np.empty(len(last.z))
    assert direct_start(tracker._numbers, points, information, tracker._mean, T, z)
    np.testing.assert_allclose(T, align(moments(points[5:], layout)), atol=1e-9)
    tips = points[:5].copy()
    tips[2] = np.nan
    expected = ClosedForm(FULL, shape).solve(apply(inverse(T), tips), tracker._angles(tracker._mean)).angles
    np.testing.assert_allclose(tracker._angles(z), expected, atol=1e-7)


def test_markers_in_a_line_or_too_few_give_no_direct_start() -> None:
    tracker = HandTracker(FULL, RIGHT, [[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.03, 0.0, 0.0]])
    T, z = np.empty((4, 4)), np.empty(len(tracker._mean))
    points, information = np.random.default_rng(0).normal(size=(8, 3)), np.repeat(np.eye(3)[None], 8, axis=0)
    assert not direct_start(tracker._numbers, points, information, tracker._mean, T, z)
    tracker = HandTracker(FULL, RIGHT, base_layout(RIGHT, 3))
    information[6] = 0.0
    assert not direct_start(tracker._numbers, points, information, tracker._mean, T, z)


@pytest.mark.parametrize("shape", [RIGHT, LEFT], ids=["right", "left"])
@given(SEEDS)
def test_a_measured_hand_has_the_size_that_it_was_made_with(shape: HandShape, seed: int) -> None:
    pose = HandPose(FULL.natural, random_motion(np.random.default_rng(seed)))
    points = landmarks(hand_chain(FULL, shape), pose)
    corners = np.concatenate([np.zeros((1, 3)), shape.bases])
    lengths, own = np.empty((5, 3)), np.empty((CORNERS, 3))
    other = corners + np.array([0.0, 0.0, 0.01]) * np.arange(6)[:, None] / 6
    assert measure(points, corners, float(shape.mirror[0]), lengths, own) < 1e-9
    np.testing.assert_allclose(lengths, shape.lengths, atol=1e-12)
    np.testing.assert_allclose(own, corners, atol=1e-9)
    away = measure(points, other, float(shape.mirror[0]), lengths, own)
    T = align(moments(other * shape.mirror, points[[0, *BASES]]))
    expected = apply(T, points[[0, *BASES]]) * shape.mirror
    np.testing.assert_allclose(own, expected, atol=1e-9)
    assert away == pytest.approx(float(np.sqrt(((expected - other) ** 2).sum(axis=1).mean())))
