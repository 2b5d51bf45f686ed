"""Bones of named humanoids, as data: joints, rest pose, what observes the twist, and the name in each format.

**Rest pose**: a T pose in metres, y up, that looks along +z with its left on +x: arms straight to the sides, palms
down, thumbs forwards; legs straight down; feet flat, toes forwards. At rest, the axes of all bones are parallel to the
world's, so every local rotation is the identity. docs/humanoids.md has the tables.

Names: VRM Consortium, *VRMC_vrm 1.0*, humanoid; Unity, *HumanBodyBones*; Mixamo, the rigs of its auto-rigger;
Microsoft, *Kinect for Windows SDK 2.0*, JointType; M. Loper et al., *SMPL: a skinned multi-person linear model* (2015),
with the names of its joints in smplx.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Final, Literal

import numpy as np

from mocapella.errors import SettingsError, one_of
from mocapella.model.hand import DIGITS, LANDMARKS
from mocapella.model.humanoid_joints import FOOT, INDEX, average_joints

Vector = tuple[float, float, float]
Side = Literal["", "hinge", "shoulders", "thumb", "foot", "nose", "knuckles"]


@dataclass(frozen=True)
class HumanoidBone:
    """What a bone of a humanoid follows, in the joints of tracked people (`mocapella.model.skeleton.SKELETON`).

    Attributes:
        part: name of the bone in this program, such as ``left upper arm``.
        parent: part of the parent; empty for the root.
        joint: joint at which the bone begins.
        end: joint at its far end; empty if it moves with its parent.
        rest: its direction at rest, of unit length.
        side: what its twist is observed by: a hinge joint at its end, the line of the shoulders, the thumb, the foot,
            the nose or the knuckles; empty if it is not, and is zero.
        rest_side: direction at rest of what observes the twist.
        beyond: joint after ``end``, of a hinge.
        share: position of the bone's beginning between ``joint`` and ``end`` [ratio].
    """

    part: str
    parent: str
    joint: str
    end: str = ""
    rest: Vector = (0.0, 1.0, 0.0)
    side: Side = ""
    rest_side: Vector = (0.0, 0.0, 1.0)
    beyond: str = ""
    share: float = 0.0


_MIDDLE: Final = (
    HumanoidBone("hips", "", "SpineBase"),
    HumanoidBone("spine", "hips", "SpineBase", "SpineMid"),
    HumanoidBone("chest", "spine", "SpineMid", "SpineShoulder", side="shoulders", rest_side=(1.0, 0.0, 0.0)),
    HumanoidBone("upper chest", "chest", "SpineMid", "SpineShoulder", share=0.5),
    HumanoidBone("throat", "upper chest", "SpineShoulder"),
    HumanoidBone("neck", "throat", "SpineShoulder", "Neck"),
    HumanoidBone("head", "neck", "Neck", "Head", side="nose"),
    HumanoidBone("top of head", "head", "Head"),
)
_OUT: Final[Vector] = (1.0, 0.0, 0.0)
_DOWN: Final[Vector] = (0.0, -1.0, 0.0)
_KNUCKLES: Final[Vector] = tuple(
    (average_joints()[INDEX["left hand index MCP"]] - average_joints()[INDEX["left hand little MCP"]]).tolist()
)
_LEFT: Final = (
    HumanoidBone("left shoulder", "throat", "SpineShoulder", "ShoulderLeft", _OUT),
    HumanoidBone("left upper arm", "left shoulder", "ShoulderLeft", "ElbowLeft", _OUT, "hinge", _DOWN, "WristLeft"),
    HumanoidBone("left lower arm", "left upper arm", "ElbowLeft", "WristLeft", _OUT, "thumb"),
    HumanoidBone("left hand", "left lower arm", "WristLeft", "HandLeft", _OUT, "knuckles", _KNUCKLES),
    HumanoidBone("left fingers", "left hand", "HandLeft", "HandTipLeft", _OUT),
    HumanoidBone("left fingertips", "left fingers", "HandTipLeft"),
    HumanoidBone("left thumb", "left hand", "ThumbLeft"),
    HumanoidBone("left upper leg", "hips", "HipLeft", "KneeLeft", _DOWN, "hinge", _OUT, "AnkleLeft"),
    HumanoidBone("left lower leg", "left upper leg", "KneeLeft", "AnkleLeft", _DOWN, "foot"),
    HumanoidBone("left foot", "left lower leg", "AnkleLeft", "FootLeft", FOOT),
    HumanoidBone("left toes", "left foot", "FootLeft"),
)


def _left_fingers() -> tuple[HumanoidBone, ...]:
    """Return the bones of the left hand's digits, at rest as in `average_joints`."""
    bones, rest = [], average_joints()
    for digit, name in enumerate(DIGITS):
        for k in range(3):
            joint, end = (f"left hand {LANDMARKS[1 + 4 * digit + k + after]}" for after in (0, 1))
            along = rest[INDEX[end]] - rest[INDEX[joint]]
            x, y, z = (along / np.linalg.norm(along)).tolist()
            parent = f"left {name} {k}" if k else "left hand"
            bones.append(HumanoidBone(f"left {name} {k + 1}", parent, joint, end, (x, y, z)))
    return tuple(bones)


def _mirrored(bone: HumanoidBone) -> HumanoidBone:
    """Return a bone of the right side. Axes of hinges are axial: their mirror image turns the other way."""
    names = {
        name: getattr(bone, name).replace("left", "right").replace("Left", "Right")
        for name in ("part", "parent", "joint", "end", "beyond")
    }
    x, y, z = bone.rest_side
    side = (x, -y, -z) if bone.side == "hinge" else (-x, y, z)
    return replace(bone, **names, rest=(-bone.rest[0], *bone.rest[1:]), rest_side=side)


_SIDE: Final = (*_LEFT, *_left_fingers())
BONES: Final[Mapping[str, HumanoidBone]] = {bone.part: bone for bone in (*_MIDDLE, *_SIDE, *map(_mirrored, _SIDE))}
"""All bones by their part; parents come before their children."""
FINGERS: Final = tuple(part for part in BONES if part.split()[-1].isdigit())
"""The bones of both hands' digits, such as ``left index 1``, from the palm outwards."""

_NAMES: Final = """
part             vrm            unity           mixamo            kinect         smpl
hips             hips           Hips            mixamorig:Hips    SpineBase      pelvis
spine            spine          Spine           mixamorig:Spine   -              spine1
chest            chest          Chest           mixamorig:Spine1  SpineMid       spine2
upper_chest      upperChest     UpperChest      mixamorig:Spine2  -              spine3
throat           -              -               -                 SpineShoulder  -
neck             neck           Neck            mixamorig:Neck    -              neck
head             head           Head            mixamorig:Head    Neck           head
top_of_head      -              -               mixamorig:HeadTop_End  Head      -
left_shoulder    leftShoulder   LeftShoulder    mixamorig:LeftShoulder  -        left_collar
left_upper_arm   leftUpperArm   LeftUpperArm    mixamorig:LeftArm  ShoulderLeft  left_shoulder
left_lower_arm   leftLowerArm   LeftLowerArm    mixamorig:LeftForeArm  ElbowLeft  left_elbow
left_hand        leftHand       LeftHand        mixamorig:LeftHand  WristLeft    left_wrist
left_fingers     -              -               -                 HandLeft       left_hand
left_fingertips  -              -               -                 HandTipLeft    -
left_thumb       -              -               -                 ThumbLeft      -
left_upper_leg   leftUpperLeg   LeftUpperLeg    mixamorig:LeftUpLeg  HipLeft     left_hip
left_lower_leg   leftLowerLeg   LeftLowerLeg    mixamorig:LeftLeg  KneeLeft      left_knee
left_foot        leftFoot       LeftFoot        mixamorig:LeftFoot  AnkleLeft    left_ankle
left_toes        leftToes       LeftToes        mixamorig:LeftToeBase  FootLeft  left_foot
left_thumb_1     leftThumbMetacarpal LeftThumbProximal mixamorig:LeftHandThumb1 - left_thumb1
left_thumb_2     leftThumbProximal LeftThumbIntermediate mixamorig:LeftHandThumb2 - left_thumb2
left_thumb_3     leftThumbDistal LeftThumbDistal mixamorig:LeftHandThumb3 - left_thumb3
left_index_1     leftIndexProximal LeftIndexProximal mixamorig:LeftHandIndex1 - left_index1
left_index_2     leftIndexIntermediate LeftIndexIntermediate mixamorig:LeftHandIndex2 - left_index2
left_index_3     leftIndexDistal LeftIndexDistal mixamorig:LeftHandIndex3 - left_index3
left_middle_1    leftMiddleProximal LeftMiddleProximal mixamorig:LeftHandMiddle1 - left_middle1
left_middle_2    leftMiddleIntermediate LeftMiddleIntermediate mixamorig:LeftHandMiddle2 - left_middle2
left_middle_3    leftMiddleDistal LeftMiddleDistal mixamorig:LeftHandMiddle3 - left_middle3
left_ring_1      leftRingProximal LeftRingProximal mixamorig:LeftHandRing1 - left_ring1
left_ring_2      leftRingIntermediate LeftRingIntermediate mixamorig:LeftHandRing2 - left_ring2
left_ring_3      leftRingDistal LeftRingDistal mixamorig:LeftHandRing3 - left_ring3
left_little_1    leftLittleProximal LeftLittleProximal mixamorig:LeftHandPinky1 - left_pinky1
left_little_2    leftLittleIntermediate LeftLittleIntermediate mixamorig:LeftHandPinky2 - left_pinky2
left_little_3    leftLittleDistal LeftLittleDistal mixamorig:LeftHandPinky3 - left_pinky3
"""
"""Names of the bones; on the right side, "right" replaces "left"."""


def _table() -> dict[str, dict[str, str]]:
    header, *rows = (line.split() for line in _NAMES.strip().splitlines())
    named: dict[str, dict[str, str]] = {humanoid: {} for humanoid in header[1:]}
    for part, *names in rows:
        for humanoid, name in zip(header[1:], names, strict=True):
            if name != "-":
                named[humanoid][part.replace("_", " ")] = name
    for names_of in named.values():
        for part, name in list(names_of.items()):
            if part.startswith("left"):
                right = name.replace("left", "right").replace("Left", "Right")
                names_of[part.replace("left", "right")] = right
    return {humanoid: {part: own[part] for part in BONES if part in own} for humanoid, own in named.items()}


HUMANOIDS: Final[Mapping[str, Mapping[str, str]]] = _table()
"""Name of each bone by its part, of each humanoid; parents come before their children."""


def humanoid_names(humanoid: str) -> Mapping[str, str]:
    """Return the names of a humanoid's bones by their parts.

    Raises:
        SettingsError: unknown humanoid; lists the known ones.
    """
    if humanoid not in HUMANOIDS:
        raise SettingsError(f"--humanoid {humanoid!r}: known: {one_of(humanoid, HUMANOIDS)}")
    return HUMANOIDS[humanoid]


@cache
def parent_of(humanoid: str, part: str) -> str:
    """Return the part of the nearest ancestor that a humanoid has; empty for the root."""
    parent = BONES[part].parent
    return parent if not parent or parent in humanoid_names(humanoid) else parent_of(humanoid, parent)


@cache
def carrier_of(humanoid: str, part: str) -> str:
    """Return the part of the humanoid that moves a bone's skin: the bone itself, or its nearest ancestor."""
    return part if part in humanoid_names(humanoid) else parent_of(humanoid, part)
