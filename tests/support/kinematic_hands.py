"""Hands of the model, in any pose within the limits, for the tests of this room."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocapella.geometry.rigid import apply, rigid
from mocapella.kinematics.hand_chain import hand_chain, landmarks, palm_landmarks
from mocapella.model.hand import ANGLES, DIGIT_ANGLES, TIPS, HandModel, HandPose, HandShape, hand_model

Float64 = NDArray[np.float64]

THESIS, FULL = hand_model("thesis"), hand_model("full")
RIGHT, LEFT = THESIS.shape("right"), THESIS.shape("left")


def random_angles(model: HandModel, rng: np.random.Generator, hands: int = 1) -> Float64:
    """(hands, 21) within the limits; the thumb's MCP does not abduct."""
    angles = model.limited(rng.uniform(model.limits[:, 0], model.limits[:, 1], (hands, len(ANGLES))))
    angles[:, DIGIT_ANGLES[0, 4]] = 0.0
    return angles


def random_motion(rng: np.random.Generator) -> Float64:
    return rigid(Rotation.random(random_state=rng).as_matrix(), rng.uniform(-1, 1, 3))


def tips(model: HandModel, shape: HandShape, angles: Float64) -> Float64:
    """(..., 5, 3) in the palm's frame."""
    return palm_landmarks(hand_chain(model, shape), angles)[..., list(TIPS), :]


def markers(model: HandModel, shape: HandShape, layout: Float64, angles: Float64, T: Float64) -> Float64:
    """(..., 5 + k, 3) world."""
    x = landmarks(hand_chain(model, shape), HandPose(angles, T))
    base = apply(T, np.broadcast_to(layout * shape.mirror, (*T.shape[:-2], *layout.shape)))
    return np.concatenate([x[..., list(TIPS), :], base], axis=-2)
