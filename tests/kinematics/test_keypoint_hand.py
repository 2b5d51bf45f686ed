"""A hand followed from all its landmarks: exact landmarks are found, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest
from support.kinematic_hands import FULL, LEFT, RIGHT, random_motion

from mocapella.errors import InputError, WireError
from mocapella.kinematics.hand_chain import hand_chain, landmarks
from mocapella.kinematics.hand_tracker import HandTracker, base_layout
from mocapella.kinematics.keypoint_hand import KeypointHand
from mocapella.model.hand import HandPose, HandShape
from mocapella.model.observations import JointState


@pytest.mark.parametrize("side", ["left", "right"])
def test_exact_landmarks_are_found_again_on_their_own_side(side: str) -> None:
    rng = np.random.default_rng(3)
    shape = FULL.shape(side)  # type: ignore[arg-type]
    truth = landmarks(hand_chain(FULL, shape), HandPose(FULL.natural, random_motion(rng)))
    one, other = KeypointHand(shape.handedness), KeypointHand("right" if side == "left" else "left")
    covariances = np.broadcast_to(np.eye(3) * 1e-6, (21, 3, 3))
    for k in range(5):
        hand = one.update(truth, covariances, np.ones(21, dtype=np.bool_), k / 30)
        wrong = other.update(truth, covariances, np.ones(21, dtype=np.bool_), k / 30)
    np.testing.assert_allclose(hand.landmarks, truth, atol=2e-3)
    assert (hand.states == JointState.TRACKED).all()
    assert np.abs(wrong.landmarks - truth).max() > 2.0 * np.abs(hand.landmarks - truth).max()


@pytest.mark.parametrize("shape", [RIGHT, LEFT], ids=["right", "left"])
def test_a_tracker_of_joints_refuses_markers_without_them(shape: HandShape) -> None:
    tracker = HandTracker(FULL, shape, base_layout(shape, 3), joints=True)
    with pytest.raises(InputError, match="10 joints"):
        tracker.update(np.zeros((8, 3)), 0.0)


def test_a_memory_of_another_hand_is_refused() -> None:
    hand = KeypointHand("left")
    memory = hand.memory()
    with pytest.raises(WireError, match="other values"):
        hand.recall({**memory, "lengths": np.zeros(3)})
    memory["report"].missing = [0]
    with pytest.raises(InputError, match="no state of this hand"):
        hand.recall(memory)
