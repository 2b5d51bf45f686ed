"""The hand as a kinematic chain of twists: forward kinematics and its Jacobian, by products of exponentials.

Source: R. Murray, Z. Li, S. Sastry, *A Mathematical Introduction to Robotic Manipulation* (1994), sections 3.2 and 3.4.
It shares nothing with the solvers but the model, so that they can be checked against it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.rigid import apply
from mocapella.geometry.twists import adjoint, exp_twist
from mocapella.model.hand import ANGLES, BASES, DIGIT_ANGLES, LANDMARKS, HandModel, HandPose, HandShape

Float64 = NDArray[np.float64]
ROOT_DOFS = 6


@dataclass(frozen=True, eq=False)
class HandChain:
    """A hand's twists and landmarks in the pose with all angles 0, in the palm's frame; mirrored for a left hand.

    Attributes:
        twists: (21, 6) twist of each angle in the order of `ANGLES`: translation part [m], then the unit axis.
        parents: (21,) for each angle, the index of the previous angle of its digit; -1 for the first.
        at_zero: (21, 3) positions of the landmarks [m].
        last: (21,) for each landmark, the index of the last angle that moves it; -1 if none does.
    """

    twists: Float64
    parents: NDArray[np.int64]
    at_zero: Float64
    last: NDArray[np.int64]

    @property
    def moves(self) -> NDArray[np.bool_]:
        """Whether each landmark (rows) is moved by each angle (columns), (21, 21)."""
        out = np.zeros((len(LANDMARKS), len(ANGLES)), dtype=np.bool_)
        for landmark, last in enumerate(self.last):
            angle = int(last)
            while angle >= 0:
                out[landmark, angle] = True
                angle = int(self.parents[angle])
        return out


def hand_chain(model: HandModel, shape: HandShape) -> HandChain:
    """Make the chain of a hand. At a two-axis joint, abduction comes first, about an axis of the previous bone.

    Args:
        model: the hand's joints and couplings.
        shape: the hand's side and bone lengths.
    """
    twists, at_zero = np.zeros((len(ANGLES), 6)), np.zeros((len(LANDMARKS), 3))
    parents, last = np.full(len(ANGLES), -1), np.full(len(LANDMARKS), -1)
    mirror = shape.mirror
    for digit in range(5):
        R, point = model.frames[digit], shape.bases[digit].copy()
        flexion, abduction, middle, distal, second_abduction = DIGIT_ANGLES[digit]
        joints = [[abduction, flexion], [second_abduction, middle] if second_abduction >= 0 else [middle], [distal]]
        before, landmark = -1, BASES[digit]
        at_zero[landmark] = mirror * point
        for bone, angles in enumerate(joints):
            for k, angle in enumerate(angles):
                about = R[:, 1] if k == 0 and len(angles) == 2 else R[:, 0]
                axis = mirror.prod() * mirror * about  # a rotation's axis is a pseudovector
                twists[angle] = [*np.cross(mirror * point, axis), *axis]
                parents[angle], before = before, angle
            point = point + R[:, 2] * shape.lengths[digit, bone]
            landmark += 1
            at_zero[landmark], last[landmark] = mirror * point, before
    return HandChain(twists, parents, at_zero, last)


def landmarks(chain: HandChain, pose: HandPose) -> Float64:
    """Compute the landmarks of a posed hand: forward kinematics.

    Args:
        chain: the hand.
        pose: its posture; leading axes are batches.

    Returns:
        (..., 21, 3), world [m].
    """
    return apply(np.asarray(pose.T_world_palm), palm_landmarks(chain, pose.angles))


def palm_landmarks(chain: HandChain, angles: Any) -> Float64:
    """Compute the landmarks in the palm's frame: forward kinematics of the digits.

    Args:
        chain: the hand.
        angles: (..., 21) in the order of `ANGLES` [rad].

    Returns:
        (..., 21, 3) [m].
    """
    T = _products(chain, np.asarray(angles, dtype=np.float64))
    out = np.empty((*T.shape[:-3], len(LANDMARKS), 3))
    for i, (zero, angle) in enumerate(zip(chain.at_zero, chain.last, strict=True)):
        out[..., i, :] = zero if angle < 0 else apply(T[..., angle, :, :], zero[None])[..., 0, :]
    return out


def jacobian(chain: HandChain, pose: HandPose) -> Float64:
    """Return the derivatives of the landmarks' world positions by the palm's motion and the angles.

    Args:
        chain: the hand.
        pose: its posture; leading axes are batches.

    Returns:
        (..., 21, 3, 27): by a twist of the palm in its own frame (T ← T exp(x): translation [m], rotation [rad]), then
        by the 21 angles [rad].
    """
    angles, T_world = np.asarray(pose.angles, dtype=np.float64), np.asarray(pose.T_world_palm)
    T, x = _products(chain, angles), palm_landmarks(chain, angles)
    J = np.zeros((*x.shape, ROOT_DOFS + len(ANGLES)))
    J[..., :3] = np.eye(3)
    for k, axis in enumerate(np.eye(3)):
        J[..., 3 + k] = np.cross(axis, x)
    moves = chain.moves
    for i, twist in enumerate(chain.twists):
        before = chain.parents[i]
        moved = twist if before < 0 else (adjoint(T[..., before, :, :]) @ twist[:, None])[..., 0]
        velocity = moved[..., None, :3] + np.cross(moved[..., None, 3:], x)
        J[..., ROOT_DOFS + i] = np.where(moves[:, i, None], velocity, 0.0)
    return np.asarray(T_world[..., None, :3, :3] @ J)


def _products(chain: HandChain, angles: Float64) -> Float64:
    """(..., 21, 4, 4) the product of exponentials up to each angle."""
    out = exp_twist(angles[..., None] * chain.twists)
    for i in np.argsort([_depth(chain, i) for i in range(len(ANGLES))], kind="stable"):
        if chain.parents[i] >= 0:
            out[..., i, :, :] = out[..., chain.parents[i], :, :] @ out[..., i, :, :]
    return out


def _depth(chain: HandChain, angle: int) -> int:
    return 0 if chain.parents[angle] < 0 else 1 + _depth(chain, int(chain.parents[angle]))
