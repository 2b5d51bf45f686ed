"""Retargeting: the bone rotations of a named humanoid that follow a person's joints or a body model's landmarks.

Each bone points from its joint to the next (`mocapella.geometry.swing_twist`). Its twist is observed by a hinge, thumb,
foot, nose or the shoulders, and zero otherwise; `HumanoidMotion.observed` tells which.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.geometry.bone_rotations import posed
from mocapella.geometry.segment_axes import unit
from mocapella.geometry.swing_twist import across, faded, of_two_directions, swung, twist_angle, twisted
from mocapella.model.humanoid_bones import BONES, FINGERS, HumanoidBone, humanoid_names, parent_of
from mocapella.model.humanoid_joints import INDEX, JOINTS, average_joints, determined, joints_of
from mocapella.model.rest_pose import RigidSkeleton, SkeletonMotion, held_rows
from mocapella.model.rigged_mesh import smooth
from mocapella.model.skin import rest_positions
from mocapella.model.trajectories import Trajectories

Float64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

SURE: Final = (float(np.sin(np.radians(15.0))), float(np.sin(np.radians(30.0))))
"""Sines of the angle between a limb and what observes its twist: up to the first it is not observed, from the second on
wholly. A joint that is 2 cm off turns the plane of a nearly straight limb by any angle."""
REACH: Final = {"thumb": float(np.radians(90.0)), "foot": float(np.radians(60.0))}
"""Twists that forearm and shank reach [rad]. A larger one loses its weight, up to a right angle beyond, because thumb
or foot is then measured wrongly. American Academy of Orthopaedic Surgeons, *Joint motion* (1965), has 80° to 90° of a
forearm."""
_ANYTHING: Final = {"top of head", "left toes", "right toes", "left fingers", "right fingers", "left fingertips",
                    "right fingertips", "left thumb", "right thumb", *FINGERS}  # fmt: skip
"""Bones whose joint a topology may lack; it is then at an average distance from its parent."""


_OF_HIPS: Final = ("HipLeft", "HipRight", "SpineBase", "SpineMid")


@dataclass(frozen=True, eq=False)
class HumanoidMotion(SkeletonMotion):
    """Poses of a named humanoid over time; the skeleton has its names, and its joints are in the order of ``parts``.

    Attributes:
        humanoid: name of the humanoid, such as ``vrm``.
        parts: the bones' names in this program, such as ``left upper arm``.
        twisting: (joints,) whether a twist of the bone can be observed at all.
        observed: (frames, joints) whether it is; where not, it is zero or fades to it.
        joints: (67, 3) `JOINTS` at rest, the root's at 0 [m].
        turns: (frames, joints, 3, 3) the rotations.
        distances_m: (frames, joints) as `error_m`.
    """

    humanoid: str
    parts: tuple[str, ...]
    twisting: Bools
    observed: Bools
    joints: Float64
    turns: Float64
    distances_m: Float64

    def rotations(self, frames: slice) -> Float64:
        """Return the rotations (frames, joints, 3, 3) of the bones in some frames."""
        return self.turns[frames]

    @property
    def error_m(self) -> Float64:
        """(frames, joints) distance of the joints from the measured ones, whose bones change; NaN where held [m]."""
        return self.distances_m


def humanoid_motion(trajectories: Trajectories, humanoid: str) -> HumanoidMotion:
    """Return the poses of a named humanoid that follow one individual; see `mocapella.model.humanoid_bones`.

    Bones have their median lengths; the directions of bones that follow their parents are the mean ones. A bone whose
    joints are unknown keeps its last rotation relative to its parent, or the first one before it was ever known, and is
    held. The root keeps its last place.

    Args:
        trajectories: one person, or one body of a body model.
        humanoid: ``vrm``, ``unity``, ``mixamo``, ``kinect`` or ``smpl``.

    Raises:
        SettingsError: an unknown humanoid, keypoints of no mapped topology or without a joint of the
            humanoid, or hips that are never known.
    """
    names = humanoid_names(humanoid)
    there = determined(trajectories)
    lacking = [joint for part in names if part not in _ANYTHING and not there[INDEX[joint := BONES[part].joint]]]
    who = trajectories.individuals[0]
    if lacking:
        raise SettingsError(f"{who}: {humanoid} needs {lacking[0]}, which the keypoints do not determine")
    joints, nose = joints_of(trajectories)
    if not np.isfinite(_hips(joints)).any():
        raise SettingsError(f"{who}: hips, SpineBase and SpineMid are never known together")
    return _Solver(joints, nose).motion(humanoid)


def hips_known(trajectories: Trajectories) -> Bools:
    """Return (frames,) whether the pose of one individual's hips is known; without it, there is no humanoid.

    Raises:
        SettingsError: no mapped topology has these keypoints.
    """
    return np.asarray(np.isfinite(_hips(joints_of(trajectories)[0])).all(axis=(1, 2)))


def _hips(joints: Float64) -> Float64:
    """Return the rotations (frames, 3, 3) of the hips, given `JOINTS` (frames, 67, 3); NaN where unknown."""
    left, right, base, middle = (joints[:, INDEX[name]] for name in _OF_HIPS)
    return of_two_directions(left - right, middle - base, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))


class _Solver:
    """Rotations of all bones, by part, from `JOINTS` (frames, 67, 3) and the nose (frames, 3).

    Attributes:
        R: (frames, 3, 3) rotations from the rest pose to the world; of the bones that the person `has`.
        known: (frames,) whether the bone's direction is known; of bones without one, their parent's.
        observed: (frames,) whether its twist is; only of bones with a ``side``.
    """

    def __init__(self, joints: Float64, nose: Float64) -> None:
        self.joints, self.nose = joints, nose
        self.R: dict[str, Float64] = {}
        self.known: dict[str, Bools] = {}
        self.observed: dict[str, Bools] = {}
        R = _hips(joints)
        self.known["hips"] = np.all(np.isfinite(R), axis=(1, 2))
        self.R["hips"] = held_rows(R, self.known["hips"])
        for bone in list(BONES.values())[1:]:
            if not self.has(bone.part):
                continue
            if bone.end:
                self._limb(bone)
            else:
                self.R[bone.part], self.known[bone.part] = self.R[bone.parent], self.known[bone.parent]

    def has(self, part: str) -> bool:
        """Return whether a humanoid of this person has a bone: fingers only on a hand that is seen."""
        return part not in FINGERS or bool(np.isfinite(self.at(f"{part.split(maxsplit=1)[0]} hand wrist")).any())

    def at(self, joint: str) -> Float64:
        return np.asarray(self.joints[:, INDEX[joint]])

    def _limb(self, bone: HumanoidBone) -> None:
        before, rest = self.R[bone.parent], np.array(bone.rest)
        axis = unit(self.at(bone.end) - self.at(bone.joint))
        known = np.all(np.isfinite(axis), axis=1)
        R = swung(before, rest, np.where(known[:, None], axis, before @ rest))
        if bone.side:
            side, weight = self._side(bone, axis)
            angle = twist_angle(R, axis, np.array(bone.rest_side), side)
            turn, self.observed[bone.part] = _twist(bone, angle, weight)
            R = twisted(R, np.where(known[:, None], axis, before @ rest), turn)
        local = np.swapaxes(before, 1, 2) @ R
        held = held_rows(local, known) if known.any() else np.broadcast_to(np.eye(3), R.shape)
        self.R[bone.part], self.known[bone.part] = before @ held, known

    def _side(self, bone: HumanoidBone, axis: Float64) -> tuple[Float64, Float64]:
        """Return the direction (frames, 3) that observes a bone's twist, and its weight (frames,), 0 to 1."""
        start, end = self.at(bone.joint), self.at(bone.end)
        if bone.side == "hinge":
            side = np.cross(axis, unit(self.at(bone.beyond) - end))
            return side, smooth(np.linalg.norm(side, axis=1), *SURE)
        if bone.side == "shoulders":
            side = self.at("ShoulderLeft") - self.at("ShoulderRight")
        elif bone.side == "nose":
            side = self.nose - start
        elif bone.side == "knuckles":
            side = self.at(f"{bone.part} index MCP") - self.at(f"{bone.part} little MCP")
        elif bone.side == "foot":
            side = self.at(bone.end.replace("Ankle", "Foot")) - end
        else:
            thumb = self.at(bone.end.replace("Wrist", "Thumb")) - end
            hand = unit(self.at(bone.end.replace("Wrist", "Hand")) - end)
            side = np.where(np.isfinite(hand), across(thumb, hand), thumb)
            apart = smooth(np.linalg.norm(across(unit(thumb), np.where(np.isfinite(hand), hand, axis)), axis=1), *SURE)
            return side, apart * smooth(np.linalg.norm(across(unit(side), axis), axis=1), *SURE)
        return side, smooth(np.linalg.norm(across(unit(side), axis), axis=1), *SURE)

    def motion(self, humanoid: str) -> HumanoidMotion:
        """Return the motion of a humanoid."""
        names = {part: name for part, name in humanoid_names(humanoid).items() if self.has(part)}
        parts, bones = tuple(names), [BONES[part] for part in names]
        parents = np.array([-1, *(parts.index(parent_of(humanoid, part)) for part in parts[1:])])
        R = np.stack([self.R[part] for part in parts], axis=1)
        begins = np.stack([self._beginning(bone) for bone in bones], axis=1)
        known = np.all(np.isfinite(begins), axis=2)
        usual, size = average_joints(), self._size()
        offsets = np.zeros((len(parts), 3))
        for k in range(1, len(parts)):
            own = np.einsum("fji,fj->fi", R[:, parents[k]], begins[:, k] - begins[:, parents[k]])
            average = _beginning(usual, bones[k]) - _beginning(usual, bones[parents[k]])
            offsets[k] = _rigid_offset(own, size * average)
        root = held_rows(begins[:, 0], known[:, 0])
        placed = posed(parents, offsets, root, R)
        held = ~np.stack([self.known[part] for part in parts], axis=1)
        ends = np.array([not bone.end for bone in bones])
        held |= ends & ~known
        skeleton = RigidSkeleton(
            tuple(-1 if bone.share else INDEX[bone.joint] for bone in bones), tuple(names.values()), parents,
            offsets,
        )  # fmt: skip
        error = np.where(known, np.linalg.norm(placed - begins, axis=2), np.nan)
        unobserved = np.zeros(len(R), np.bool_)
        return HumanoidMotion(
            skeleton, root, held, humanoid, parts, np.array([part in self.observed for part in parts]),
            np.stack([self.observed.get(part, unobserved) for part in parts], axis=1), self._at_rest(skeleton, size),
            R, error,
        )  # fmt: skip

    def _beginning(self, bone: HumanoidBone) -> Float64:
        return _beginning(self.joints, bone)

    def _at_rest(self, skeleton: RigidSkeleton, size: float) -> Float64:
        """Return `JOINTS` (67, 3) at rest, the root's at 0: the skeleton's, and the missing ones beside them."""
        usual, rest = average_joints(), np.full((len(JOINTS), 3), np.nan)
        for joint, place in zip(skeleton.keypoints, rest_positions(skeleton), strict=True):
            if joint >= 0:
                rest[joint] = place
        for bone in BONES.values():
            steps = [(BONES[bone.parent].joint, bone.joint, bone.parent)] if bone.parent else []
            for start, end, part in [*steps, *([(bone.joint, bone.end, bone.part)] if bone.end else [])]:
                a, b = INDEX[start], INDEX[end]
                if np.isnan(rest[b]).any() and not self.has(part):
                    rest[b] = rest[a] + size * (usual[b] - usual[a])
                elif np.isnan(rest[b]).any():
                    own = np.einsum("fji,fj->fi", self.R[part], self.joints[:, b] - self.joints[:, a])
                    rest[b] = rest[a] + _rigid_offset(own, size * (usual[b] - usual[a]))
        return rest

    def _size(self) -> float:
        """Return the person's size relative to the average one: the median over the known bones; 1 without any."""
        usual, ratios = average_joints(), []
        for bone in BONES.values():
            if bone.end and not bone.share and bone.part not in FINGERS:
                length = np.linalg.norm(self.at(bone.end) - self.at(bone.joint), axis=1)
                average = np.linalg.norm(usual[INDEX[bone.end]] - usual[INDEX[bone.joint]])
                ratios += [float(np.nanmedian(length) / average)] if np.isfinite(length).any() else []
        return float(np.median(ratios)) if ratios else 1.0


def _twist(bone: HumanoidBone, angle: Float64, weight: Float64) -> tuple[Float64, Bools]:
    """Return a bone's twist (frames,) [rad], and whether it is observed; where its joints are unknown, it is held."""
    if bone.side in REACH:
        reach = REACH[bone.side]
        weight = weight * (1.0 - smooth(np.abs(np.nan_to_num(angle)), reach, reach + np.pi / 2))
    seen = np.isfinite(weight) & (np.isfinite(angle) | (weight == 0.0))
    turn = faded(np.where(seen, np.nan_to_num(angle), 0.0), np.where(seen, weight, 0.0))
    return held_rows(turn, seen) if seen.any() else turn, seen & (np.nan_to_num(weight) >= 0.5)


def _beginning(joints: Float64, bone: HumanoidBone) -> Float64:
    """Return where a bone begins (..., 3), given `JOINTS` (..., 67, 3)."""
    start = joints[..., INDEX[bone.joint], :]
    return np.asarray(start + bone.share * (joints[..., INDEX[bone.end], :] - start) if bone.share else start)


def _rigid_offset(own: Float64, average: Float64) -> Float64:
    """Return the mean direction times the median length of vectors (frames, 3); the average (3,) if all are NaN."""
    seen = own[np.all(np.isfinite(own), axis=1)]
    if not len(seen):
        return average
    mean = seen.mean(axis=0)
    length = float(np.linalg.norm(mean))
    return np.asarray(mean * np.median(np.linalg.norm(seen, axis=1)) / length if length > 1e-9 else np.zeros(3))
