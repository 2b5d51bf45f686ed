"""Keypoints of a simulated body: the 26 of Halpe, the keypoints of other topologies, and who hides them.

The body of `simulate.body` has the Kinect's joints, without depth of the head. Here the head and the feet have one:
nose, eyes, ears, heels and toes are in the frames of head and feet. Their offsets are ours, rounded from adults.
"""

from __future__ import annotations

from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError, one_of
from mocapella.model.topology import topology
from mocapella.sources.simulate.body import JOINT
from mocapella.sources.simulate.motion import normalised

Float64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

HALPE: Final = topology("halpe_26")
"""The keypoints of a simulated person, in the order of all arrays of these modules."""
HEAD_OF_STATURE: Final = 0.066
"""Length of the bone from neck to head, relative to stature; the head's size follows it."""

_SAME: Final = ("Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle")
"""Joints that both have under one name, on each side."""
_HEAD: Final = {
    "Nose": (0.0, -0.015, 0.062), "LEye": (0.018, 0.005, 0.052), "REye": (-0.018, 0.005, 0.052),
    "LEar": (0.042, 0.0, 0.0), "REar": (-0.042, 0.0, 0.0), "Head": (0.0, 0.064, 0.0),
}  # fmt: skip
"""Offsets from the head's joint, relative to stature: to the person's left, up, forward."""
_FOOT: Final = {"BigToe": (-0.012, -0.004, 0.118), "SmallToe": (0.03, -0.004, 0.1), "Heel": (0.0, -0.02, -0.032)}
"""Offsets from the ankle, relative to stature: out to the foot's side, along the shin upward, forward."""
GROUPS: Final = ("trunk", "face", "shoulder", "elbow", "wrist", "hip", "knee", "ankle", "foot")
"""Groups of keypoints with errors of one size."""
_GROUP_OF: Final = {
    "Nose": "face", "Eye": "face", "Ear": "face", "Head": "face", "Neck": "trunk", "Hip": "hip", "Shoulder": "shoulder",
    "Elbow": "elbow", "Wrist": "wrist", "Knee": "knee", "Ankle": "ankle", "BigToe": "foot", "SmallToe": "foot",
    "Heel": "foot",
}  # fmt: skip
_FACE_NORMALS: Final = {"Nose": (0.0, 0.0, 1.0), "LEye": (0.3, 0.0, 1.0), "REye": (-0.3, 0.0, 1.0)}
"""Directions of the surface at keypoints of the face, in the axes of `_HEAD`."""
SHOULDERS_NECK: Final = ("body_25", "coco_18")
"""Topologies whose neck is halfway between the shoulders: OpenPose was trained with this mean of COCO's shoulders."""
_EAR_HIDDEN: Final = -0.25
"""Cosine between an ear's direction and that of the camera below which the head hides the ear."""


def halpe_positions(joints: Float64) -> Float64:
    """Return the keypoints (..., 26, 3) of bodies (..., 25, 3) of `simulate.body.BODY`, in the same frame [m]."""
    out = np.empty((*joints.shape[:-2], len(HALPE), 3))
    for side, name in (("L", "Left"), ("R", "Right")):
        for joint in _SAME:
            out[..., HALPE.index(side + joint), :] = joints[..., JOINT[joint + name], :]
    out[..., HALPE.index("Hip"), :] = joints[..., JOINT["SpineBase"], :]
    out[..., HALPE.index("Neck"), :] = joints[..., JOINT["SpineShoulder"], :]
    head, neck = joints[..., JOINT["Head"], :], joints[..., JOINT["Neck"], :]
    stature = np.linalg.norm(head - neck, axis=-1)[..., None] / HEAD_OF_STATURE
    axes = head_axes(joints)
    for keypoint, offset in _HEAD.items():
        out[..., HALPE.index(keypoint), :] = head + stature * np.einsum("i,...ij->...j", np.array(offset), axes)
    for side, sign, name in (("L", 1.0, "Left"), ("R", -1.0, "Right")):
        frame = _foot_axes(joints, name, axes[..., 0, :]) * np.array([sign, 1.0, 1.0])[:, None]
        ankle = joints[..., JOINT[f"Ankle{name}"], :]
        for keypoint, offset in _FOOT.items():
            moved = ankle + stature * np.einsum("i,...ij->...j", np.array(offset), frame)
            out[..., HALPE.index(side + keypoint), :] = moved
    return out


def detected_positions(joints: Float64, name: str) -> Float64:
    """Return where a detector of a topology looks for the keypoints (..., 26, 3) of bodies (..., 25, 3) [m].

    These are `halpe_positions`, except that OpenPose's neck (`SHOULDERS_NECK`) is halfway between the shoulders.
    """
    out = halpe_positions(joints)
    if name in SHOULDERS_NECK:
        shoulders = [HALPE.index(f"{side}Shoulder") for side in "LR"]
        out[..., HALPE.index("Neck"), :] = out[..., shoulders, :].mean(axis=-2)
    return out


def head_axes(joints: Float64) -> Float64:
    """Return the axes (..., 3, 3) of heads, by rows: to the person's left, up, forward; for bodies (..., 25, 3)."""
    up = normalised(joints[..., JOINT["Head"], :] - joints[..., JOINT["Neck"], :])
    across = joints[..., JOINT["ShoulderLeft"], :] - joints[..., JOINT["ShoulderRight"], :]
    left = normalised(across - up * np.einsum("...i,...i->...", across, up)[..., None])
    return np.stack([left, up, np.cross(left, up)], axis=-2)


def face_hidden(joints: Float64, eye: Float64) -> Bools:
    """Return whether the head hides each of its own keypoints (..., 26) from a camera.

    Args:
        joints: (..., 25, 3) bodies, world [m].
        eye: (3,) position of the camera, world [m].
    """
    axes, out = head_axes(joints), np.zeros((*joints.shape[:-2], len(HALPE)), dtype=np.bool_)
    view = normalised(eye - joints[..., JOINT["Head"], :])
    seen_from = np.einsum("...ij,...j->...i", axes, view)  # direction to the camera in the head's axes
    for keypoint, normal in _FACE_NORMALS.items():
        out[..., HALPE.index(keypoint)] = seen_from @ normalised(np.array(normal)) < 0
    out[..., HALPE.index("LEar")] = seen_from[..., 0] < _EAR_HIDDEN
    out[..., HALPE.index("REar")] = -seen_from[..., 0] < _EAR_HIDDEN
    return out


@cache
def hiding_joint() -> NDArray[np.int64]:
    """Return for each keypoint (26,) the joint of `simulate.body.BODY` that is hidden when the keypoint is."""
    named = {"Hip": "SpineBase", "Neck": "SpineShoulder"}
    for side, name in (("L", "Left"), ("R", "Right")):
        named |= {side + joint: joint + name for joint in _SAME}
        named |= {f"{side}{keypoint}": f"Foot{name}" for keypoint in ("BigToe", "SmallToe")}
        named[f"{side}Heel"] = f"Ankle{name}"
    return np.array([JOINT[named.get(keypoint, "Head")] for keypoint in HALPE.joints])


@cache
def group_of() -> NDArray[np.int64]:
    """Return the index in `GROUPS` of each keypoint (26,)."""
    found = [("trunk" if name == "Hip" else _GROUP_OF[_plain(name)]) for name in HALPE.joints]
    return np.array([GROUPS.index(name) for name in found])


@cache
def keypoint_weights(name: str) -> Float64:
    """Return weights (keypoints, 26) that make the keypoints of a topology of Halpe's.

    Keypoints are matched by their names, also those with ``left_`` and ``right_``; OpenPose's middle of the hips is
    Halpe's hip. Where a detector's keypoint differs from Halpe's, see `detected_positions`.

    Raises:
        SettingsError: unknown topology, or it has a keypoint that a simulated body does not have.
    """
    wanted, out = topology(name), np.zeros((len(topology(name)), len(HALPE)))
    plain = {joint.lower(): i for i, joint in enumerate(HALPE.joints)}
    for row, joint in enumerate(wanted.joints):
        key = joint.lower().replace("left_", "l").replace("right_", "r").replace("midhip", "hip")
        if key in plain:
            out[row, plain[key]] = 1.0
        else:
            known = ("halpe_26", "body_25", "body_25b", "coco_17", "coco_18")
            raise SettingsError(f"topology {name} has {joint!r}, which is not simulated; take {one_of(name, known)}")
    return out


def _foot_axes(joints: Float64, name: str, left: Float64) -> Float64:
    """Axes (..., 3, 3) of a foot, by rows: to the person's left, up, forward; its sole is flat from ankle to toes."""
    ankle, toes = joints[..., JOINT[f"Ankle{name}"], :], joints[..., JOINT[f"Foot{name}"], :]
    forward = normalised(toes - ankle)
    side = normalised(left - forward * np.einsum("...i,...i->...", left, forward)[..., None])
    return np.stack([side, np.cross(forward, side), forward], axis=-2)


def _plain(name: str) -> str:
    return name[1:] if name[0] in "LR" and name[1:] in _GROUP_OF else name
