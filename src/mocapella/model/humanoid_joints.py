"""Joints of tracked people from the keypoints of any topology, or from the landmarks of a body model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.geometry.swing_twist import of_two_directions
from mocapella.model.body_flesh import joint_places
from mocapella.model.body_proportions import Lengths, body_shape
from mocapella.model.hand import LANDMARKS, hand_model
from mocapella.model.hand_flesh import digits_at_rest
from mocapella.model.skeleton import SKELETON, JointMapping, skeleton_mapping
from mocapella.model.topology import topology, topology_names
from mocapella.model.trajectories import Trajectories

Float64 = NDArray[np.float64]

HAND_LANDMARKS: Final = tuple(f"{side} hand {landmark}" for side in ("left", "right") for landmark in LANDMARKS)
"""Keypoints of a person's hands, such as ``left hand index MCP``; see `mocapella.model.humanoid_hands`."""
JOINTS: Final = (*SKELETON.joints, *HAND_LANDMARKS)
"""Joints that humanoids follow: the joints of tracked people, and the landmarks of both hands."""
INDEX: Final = {name: k for k, name in enumerate(JOINTS)}
FOOT: Final = (0.0, -0.28, 0.96)
"""Direction from the ankle to the foot at rest, for a flat sole."""
_OF_LANDMARKS: Final[Mapping[str, Mapping[str, float]]] = {
    "SpineBase": {"pelvis": 1.0},
    "SpineMid": {"waist": 1.0},
    "SpineShoulder": {"neck": 1.0},
    "Neck": {"neck": 0.78, "head": 0.22},
    "Head": {"neck": 0.4, "head": 0.6},
    "ShoulderLeft": {"left shoulder": 1.0},
    "ElbowLeft": {"left elbow": 1.0},
    "WristLeft": {"left wrist": 1.0},
    "HandLeft": {"left hand": 1.0},
    "HandTipLeft": {"left fingertip": 1.0},
    "HipLeft": {"left hip": 1.0},
    "KneeLeft": {"left knee": 1.0},
    "AnkleLeft": {"left ankle": 1.0},
    "FootLeft": {"left toe": 1.0},
}
"""Joints of tracked people by the landmarks of `mocapella.model.body_meshes`; its head is the top of the head, and its
neck is between the shoulders. The right side is alike."""


def joints_of(trajectories: Trajectories) -> tuple[Float64, Float64]:
    """Return `JOINTS` of one individual, and the nose.

    Where a hand's landmarks are known, they are moved so that both wrists agree, and determine hand and thumb.

    Args:
        trajectories: one individual, with the keypoints of a topology that is mapped to `SKELETON`, or with the
            landmarks of a body model, in any order; perhaps with `HAND_LANDMARKS`.

    Returns:
        Positions (frames, 67, 3) and (frames, 3) [m]; NaN where unknown, or where the keypoints do not determine it.

    Raises:
        SettingsError: no mapped topology has these keypoints.
    """
    mapping, names = _mapping(trajectories)
    at = [trajectories.keypoints.index(name) for name in names]
    joints = np.full((len(trajectories), len(JOINTS), 3), np.nan)
    joints[:, : len(SKELETON)] = mapping.positions(trajectories.positions[:, 0, at].astype(np.float64))
    for k, name in enumerate(trajectories.keypoints):
        if name in HAND_LANDMARKS:
            joints[:, INDEX[name]] = trajectories.positions[:, 0, k]
    for side in ("Left", "Right"):
        if np.isfinite(joints[:, INDEX[f"{side.lower()} hand wrist"]]).any():
            _take_hand(joints, side)
    noses = [k for k, name in enumerate(trajectories.keypoints) if name.lower() == "nose"]
    nose = trajectories.positions[:, 0, noses[0]] if noses else np.full((len(trajectories), 3), np.nan)
    return joints, nose.astype(np.float64)


def _take_hand(joints: Float64, side: str) -> None:
    """Move a hand's landmarks to the wrist, and set hand, tip and thumb by them, in ``joints`` (frames, 67, 3)."""
    own = {landmark: INDEX[f"{side.lower()} hand {landmark}"] for landmark in LANDMARKS}
    wrist = joints[:, INDEX[f"Wrist{side}"]]
    hand = joints[:, list(own.values())]
    joints[:, list(own.values())] = hand + np.nan_to_num(wrist - hand[:, 0])[:, None]
    usual = average_joints()
    directions = [
        (points[..., own[to], :] - points[..., own[start], :])
        for points in (joints, usual)
        for start, to in (("wrist", "middle MCP"), ("little MCP", "index MCP"))
    ]
    R = of_two_directions(*directions)
    known = np.all(np.isfinite(R), axis=(1, 2), keepdims=True)[..., 0]
    for joint in ("Hand", "HandTip", "Thumb"):
        at = INDEX[f"{joint}{side}"]
        offset = usual[at] - usual[INDEX[f"Wrist{side}"]]
        joints[:, at] = np.where(known, wrist + R @ offset, joints[:, at])


def determined(trajectories: Trajectories) -> NDArray[np.bool_]:
    """Return (25,) whether the individuals' keypoints determine each joint of `SKELETON`.

    Raises:
        SettingsError: no mapped topology has these keypoints.
    """
    return np.asarray(_mapping(trajectories)[0].known)


def landmark_mapping(names: Sequence[str]) -> JointMapping:
    """Return the mapping from the landmarks of a body model, such as ``left knee``, to `SKELETON`."""
    weights = np.zeros((len(SKELETON), len(names)))
    for joint, terms in _OF_LANDMARKS.items():
        for side in ("Left", "Right"):
            for landmark, weight in terms.items():
                own = landmark.replace("left", side.lower())
                if own in names:
                    weights[SKELETON.index(joint.replace("Left", side)), names.index(own)] = weight
    uses = weights != 0
    return JointMapping(weights, uses, np.isclose(weights.sum(axis=1), 1.0))


def _mapping(trajectories: Trajectories) -> tuple[JointMapping, tuple[str, ...]]:
    """Return the mapping to `SKELETON`, and the names of the keypoints that it maps."""
    keypoints = frozenset(trajectories.keypoints)
    for name in _by_size():
        if keypoints >= set(topology(name).joints):
            own = JointMapping(*_identity()) if name == SKELETON.name else skeleton_mapping(name)
            if own is not None:
                return own, topology(name).joints
    if "pelvis" in keypoints:
        return landmark_mapping(trajectories.keypoints), trajectories.keypoints
    some = ", ".join(trajectories.keypoints[:3])
    raise SettingsError(
        f"{trajectories.individuals[0]} is no humanoid: {trajectories.kind} with the keypoints {some}, … have none of "
        f"the skeletons {', '.join(topology_names())}; --people can leave it out"
    )


def _identity() -> tuple[Float64, NDArray[np.bool_], NDArray[np.bool_]]:
    eye = np.eye(len(SKELETON))
    return eye, eye > 0, np.ones(len(SKELETON), dtype=np.bool_)


@cache
def _by_size() -> tuple[str, ...]:
    """Return the names of all topologies, those with most joints first."""
    return tuple(sorted(topology_names(), key=lambda name: -len(topology(name))))


@cache
def average_joints() -> Float64:
    """Return `JOINTS` (67, 3) of an average man in the T pose, the ground at y = 0 [m]; do not change them."""
    shape = body_shape("male")
    lengths = Lengths(**{name: shape.height_m * value for name, value in asdict(shape.lengths).items()})
    places = joint_places(lengths)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        out, along = np.array([sign, 0.0, 0.0]), places[f"{side} shoulder"]
        for place, length in (("elbow", lengths.upper_arm), ("wrist", lengths.forearm), ("hand", 0.5 * lengths.hand),
                              ("fingertip", 0.5 * lengths.hand)):  # fmt: skip
            along = along + length * out
            places[f"{side} {place}"] = along
    joints = landmark_mapping(tuple(places)).positions(np.array(list(places.values())))
    joints[SKELETON.index("SpineMid")] = 0.5 * (places["pelvis"] + places["neck"])
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        wrist, hand = joints[SKELETON.index(f"Wrist{side}")], lengths.hand
        joints[SKELETON.index(f"Thumb{side}")] = wrist + np.array([0.5 * sign * hand, 0.0, 0.4 * hand])
        ankle, foot = joints[SKELETON.index(f"Ankle{side}")], joints[SKELETON.index(f"Foot{side}")]
        foot[:] = ankle + np.linalg.norm(foot - ankle) * np.array(FOOT)
    model = hand_model("full")
    digits = np.vstack([np.zeros(3), digits_at_rest(model, model.shape("right", hand_length_m=lengths.hand))[1]])
    hands = [joints[SKELETON.index(f"Wrist{side}")] + digits[:, [2, 1, 0]] * [sign, 1.0, 1.0]
             for side, sign in (("Left", 1.0), ("Right", -1.0))]  # fmt: skip
    return np.concatenate([joints, *hands])
