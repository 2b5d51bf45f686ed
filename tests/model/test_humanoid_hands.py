"""Hands go to the person whose wrist is there, in each frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from support.humanoid_people import joints, people, random_pose, world_rotations

from mocapella.model.arms import ARM_POINTS
from mocapella.model.hand import LANDMARKS
from mocapella.model.humanoid_hands import WITHIN_M, with_hands
from mocapella.model.humanoid_joints import HAND_LANDMARKS, INDEX, JOINTS, joints_of
from mocapella.model.skeleton import SKELETON
from mocapella.model.trajectories import Trajectories

FRAMES = 6


def together(*some: Trajectories, names: tuple[str, ...]) -> Trajectories:
    """Several individuals of one kind."""
    return replace(
        some[0], individuals=names, positions=np.concatenate([one.positions for one in some], axis=1),
        states=np.concatenate([one.states for one in some], axis=1),
        sd=np.concatenate([one.sd for one in some], axis=1),
    )  # fmt: skip


def room(seed: int) -> tuple[Trajectories, np.ndarray]:
    """Two people 2 m apart, and the landmarks of their hands (frames, people, sides, 21, 3)."""
    made = []
    for k in range(2):
        R = world_rotations(random_pose(seed + k, most=0.5), FRAMES)
        made.append(joints(R, np.tile([2.0 * k, 1.0, 0.0], (FRAMES, 1)), hands=True))
    own = together(*(people(one[:, : len(SKELETON)]) for one in made), names=("anna", "bert"))
    hands = np.stack([one[:, len(SKELETON) :].reshape(FRAMES, 2, len(LANDMARKS), 3) for one in made], axis=1)
    return own, hands


@settings(deadline=None, max_examples=10)
@given(st.integers(0, 2**31))
def test_each_hand_goes_to_its_person(seed: int) -> None:
    own, hands = room(seed)
    order = [(1, 0), (0, 1), (1, 1), (0, 0)]
    names = tuple(f"hand_{k}_{('left', 'right')[side]}" for k, (_, side) in enumerate(order))
    tracked = together(*(people(hands[:, p, side] + 0.01, LANDMARKS, "hands") for p, side in order), names=names)
    tracked.positions[2, 1] = np.nan
    found = with_hands(own, {"hands": tracked})
    assert found.keypoints == (*SKELETON.joints, *HAND_LANDMARKS)
    got = found.positions[:, :, len(SKELETON) :].reshape(FRAMES, 2, 2, len(LANDMARKS), 3)
    wanted = hands + 0.01
    wanted[2, 0, 1] = np.nan
    np.testing.assert_allclose(got, wanted, atol=1e-12)
    assert not found.states[2, 0, len(SKELETON) + len(LANDMARKS) :].any()
    np.testing.assert_array_equal(found.positions[:, :, : len(SKELETON)], own.positions)


def test_an_arm_has_a_hand_too_and_a_distant_one_is_nobodys() -> None:
    own, hands = room(3)
    points = np.full((FRAMES, len(ARM_POINTS), 3), np.nan)
    points[:, : len(LANDMARKS)] = hands[:, 0, 0] + [0.0, 0.5 * WITHIN_M, 0.0]
    arm = replace(people(points, ARM_POINTS, "arms"), individuals=("arm_4_left",))
    found = with_hands(own, {"arms": arm})
    joined = joints_of(found.of("anna"))[0]
    np.testing.assert_allclose(joined[:, INDEX["left hand wrist"]], joined[:, INDEX["WristLeft"]], atol=1e-12)
    assert np.isnan(found.positions[:, 1, len(SKELETON) :]).all()
    far = replace(arm, positions=arm.positions + np.array([0.0, WITHIN_M, 0.0]))
    assert with_hands(own, {"arms": far}) is own
    assert with_hands(own, {}) is own


def test_two_hands_at_one_wrist_give_the_nearer_one() -> None:
    own, hands = room(4)
    near, far = (people(hands[:, 0, 0] + offset, LANDMARKS, "hands") for offset in (0.01, 0.05))
    tracked = together(far, near, names=("hand_1_left", "hand_2_left"))
    found = with_hands(own, {"hands": tracked})
    np.testing.assert_allclose(found.positions[:, 0, JOINTS.index("left hand wrist")], hands[:, 0, 0, 0] + 0.01)


def test_people_with_other_keypoints_stay_as_they_are() -> None:
    _, hands = room(5)
    own = people(np.zeros((FRAMES, 2, 3)), ("a", "b"))
    assert with_hands(own, {"hands": people(hands[:, 0, 0], LANDMARKS, "hands")}) is own
