"""The hand's forward kinematics: laws, and its derivatives against finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.kinematic_hands import FULL, LEFT, RIGHT, random_angles, random_motion

from mocapella.geometry.rigid import apply
from mocapella.geometry.twists import exp_twist
from mocapella.kinematics.hand_chain import hand_chain, jacobian, landmarks, palm_landmarks
from mocapella.model.hand import ANGLES, BASES, LANDMARKS, PARENTS, TIPS, HandPose, HandShape

seeds = st.integers(0, 2**32 - 1)
CHAINS = {"right": hand_chain(FULL, RIGHT), "left": hand_chain(FULL, LEFT)}


@given(seeds)
def test_moving_the_palm_moves_the_landmarks_along(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angles, T, motion = random_angles(FULL, rng)[0], random_motion(rng), random_motion(rng)
    moved = landmarks(CHAINS["left"], HandPose(angles, motion @ T))
    np.testing.assert_allclose(moved, apply(motion, landmarks(CHAINS["left"], HandPose(angles, T))), atol=1e-12)


@given(seeds)
def test_a_left_hand_is_the_mirror_image_of_a_right_one(seed: int) -> None:
    angles = random_angles(FULL, np.random.default_rng(seed))[0]
    right, left = (palm_landmarks(CHAINS[side], angles) for side in ("right", "left"))
    np.testing.assert_allclose(left, right * [-1, 1, 1], atol=1e-12)


@given(seeds)
def test_bones_keep_their_lengths_whatever_the_angles(seed: int) -> None:
    angles = np.random.default_rng(seed).uniform(-3, 3, len(ANGLES))
    for chain, shape in ((CHAINS["right"], RIGHT), (CHAINS["left"], LEFT)):
        x = palm_landmarks(chain, angles)
        bones = np.linalg.norm(x[1:] - x[list(PARENTS[1:])], axis=-1).reshape(5, 4)
        np.testing.assert_allclose(bones[:, 1:], shape.lengths, atol=1e-12)
        np.testing.assert_allclose(bones[:, 0], np.linalg.norm(shape.bases, axis=-1), atol=1e-12)


@settings(max_examples=10)
@given(seeds)
def test_the_jacobian_is_that_of_finite_differences(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for chain in CHAINS.values():
        pose = HandPose(rng.uniform(-1, 1, len(ANGLES)), random_motion(rng))
        J, step = jacobian(chain, pose), 1e-6
        for i in range(6 + len(ANGLES)):
            d = np.zeros(6 + len(ANGLES))
            d[i] = step
            ahead, behind = (
                landmarks(chain, HandPose(pose.angles + s * d[6:], pose.T_world_palm @ exp_twist(s * d[:6])))
                for s in (1, -1)
            )
            np.testing.assert_allclose(J[..., i], (ahead - behind) / (2 * step), atol=1e-8)


def test_batches_are_many_hands() -> None:
    rng = np.random.default_rng(0)
    angles, T = random_angles(FULL, rng, 6).reshape(2, 3, 21), np.stack([random_motion(rng) for _ in range(6)])
    poses = HandPose(angles, T.reshape(2, 3, 4, 4))
    x, J = landmarks(CHAINS["right"], poses), jacobian(CHAINS["right"], poses)
    assert (x.shape, J.shape) == ((2, 3, 21, 3), (2, 3, 21, 3, 27))
    one = HandPose(angles[1, 2], T[5])
    np.testing.assert_allclose(x[1, 2], landmarks(CHAINS["right"], one), atol=1e-15)
    np.testing.assert_allclose(J[1, 2], jacobian(CHAINS["right"], one), atol=1e-15)


def test_flexion_bends_fingers_into_the_palm_and_abduction_spreads_them_to_the_thumb() -> None:
    chain = CHAINS["right"]
    straight = palm_landmarks(chain, np.zeros(21))
    for name, (axis, sign) in {
        "index MCP flexion": (1, -1),
        "ring PIP flexion": (1, -1),
        "little MCP abduction": (0, 1),
    }.items():
        angles = np.zeros(21)
        angles[ANGLES.index(name)] = 0.2
        tip = LANDMARKS.index(name.split()[0] + " tip")
        moved = palm_landmarks(chain, angles) - straight
        assert sign * moved[tip, axis] > 0.005
        others = [i for i in range(21) if not LANDMARKS[i].startswith(name.split()[0])]
        np.testing.assert_array_equal(moved[others], 0.0)


def test_the_thumbs_two_joints_bend_it_across_the_palm() -> None:
    angles = np.zeros(21)
    angles[[ANGLES.index("thumb MCP flexion"), ANGLES.index("thumb IP flexion")]] = 0.8
    before, after = (palm_landmarks(CHAINS["right"], a)[TIPS[0]] for a in (np.zeros(21), angles))
    assert after[0] < before[0] - 0.02


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_hand_of_the_reference_is_as_long_as_it_says(side: str) -> None:
    x = CHAINS[side].at_zero
    assert x[TIPS[2], 2] == pytest.approx(FULL.hand_length_m, abs=1e-4)
    assert CHAINS[side].moves[list(TIPS)].sum() == 21
    assert not CHAINS[side].moves[[0, *BASES]].any()


def test_a_shape_that_cannot_be_is_refused() -> None:
    from mocapella.errors import SettingsError

    for lengths in (np.zeros((5, 3)), np.full((5, 3), np.nan), np.full((4, 3), 0.03)):
        with pytest.raises(SettingsError, match="lengths"):
            HandShape("left", lengths, RIGHT.bases)
    for sd in (np.full((5, 3), -0.001), np.full((5, 3), np.nan), np.full((5, 3), np.inf), np.full((4, 3), 0.001)):
        with pytest.raises(SettingsError, match="lengths_sd"):
            HandShape("left", RIGHT.lengths, RIGHT.bases, lengths_sd=sd)
    HandShape("left", RIGHT.lengths, RIGHT.bases, lengths_sd=np.zeros((5, 3)))
