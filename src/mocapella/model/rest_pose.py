"""A skeleton with rigid bones for trajectories: the tree of their bones, its rest pose, and poses without gaps."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.geometry.bone_rotations import joint_rotations, posed
from mocapella.model.trajectories import Trajectories

Float64 = NDArray[np.float64]
Floats = NDArray[np.floating]
_Float = TypeVar("_Float", bound=np.floating)
Int64 = NDArray[np.int64]

_DIRECTIONS: Final[tuple[tuple[tuple[str, ...], tuple[float, float, float]], ...]] = (
    (("heel",), (0.0, 0.0, -1.0)),
    (("foot", "toe"), (0.0, 0.0, 1.0)),
    (("knee", "ankle"), (0.0, -1.0, 0.0)),
    (("nose", "eye", "ear", "mouth"), (0.0, 0.5, 1.0)),
    (("shoulder", "elbow", "wrist", "hand", "thumb", "finger", "clavicle", "index", "pinky", "hip"), (1.0, 0.0, 0.0)),
)
"""Directions of bones in a T pose by a word in the name of the joint at their end, of the left side."""
_UP: Final = (0.0, 1.0, 0.0)
FRAMES_AT_ONCE: Final = 1024
"""Number of frames whose rotations are made at a time, so that memory stays small."""
_MOST_FRAMES: Final = 2000
"""Largest number of frames for these angles, evenly over all that are whole."""
_ROUNDS: Final = 4
"""Number of times that the rest pose is brought nearer to the measured angles between bones of one joint."""


@dataclass(frozen=True, eq=False)
class RigidSkeleton:
    """A tree of rigid bones at rest; parents come before their children.

    Attributes:
        keypoints: index of each joint's keypoint.
        names: names of the joints.
        parents: (joints,) index of the parent joint; −1 for the root, which is the first.
        offsets: (joints, 3) from the parent at rest: x to the left of the person, y up, z forward [m].
    """

    keypoints: tuple[int, ...]
    names: tuple[str, ...]
    parents: Int64
    offsets: Float64


@dataclass(frozen=True, eq=False)
class SkeletonMotion(ABC):
    """Poses of a rigid skeleton over time.

    Attributes:
        skeleton: the skeleton.
        root: (frames, 3) position of the root in the world [m].
        held: (frames, joints) whether a joint is unknown and keeps the position relative to its parent.
    """

    skeleton: RigidSkeleton
    root: Floats
    held: NDArray[np.bool_]

    @abstractmethod
    def rotations(self, frames: slice) -> Float64:
        """Return the rotations (frames, joints, 3, 3) of the joints in some frames, from the rest pose to the world."""

    @property
    def R(self) -> Float64:  # noqa: N802 - a rotation's symbol
        """(frames, joints, 3, 3) all rotations."""
        return self.rotations(slice(None))

    @property
    @abstractmethod
    def error_m(self) -> Floats:
        """(frames, joints) distance of the joints from the measured ones, whose bones change; NaN where held [m]."""


@dataclass(frozen=True, eq=False)
class RigidMotion(SkeletonMotion):
    """Poses of a rigid skeleton that follows measured joints; rotations are made when they are asked for.

    Attributes:
        joints: (frames, joints, 3) measured positions, without gaps [m].
    """

    joints: Floats
    _error_m: NDArray[np.float32] = field(init=False)
    _is_noted: NDArray[np.bool_] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_error_m", np.full(self.held.shape, np.nan, np.float32))
        object.__setattr__(self, "_is_noted", np.zeros(len(self.held), np.bool_))

    def rotations(self, frames: slice) -> Float64:
        """Return the rotations (frames, joints, 3, 3) of the joints in some frames; see `joint_rotations`."""
        parents, offsets, joints = self.skeleton.parents, self.skeleton.offsets, self.joints[frames]
        R = joint_rotations(parents, offsets, joints)
        if not self._is_noted[frames].all():  # errors cost little here, and all rotations later
            distance = np.linalg.norm(posed(parents, offsets, joints[:, 0], R) - joints, axis=2)
            self._error_m[frames] = np.where(self.held[frames], np.nan, distance)
            self._is_noted[frames] = True
        return R

    @property
    def error_m(self) -> NDArray[np.float32]:
        """(frames, joints) distance of the joints from the measured ones, whose bones change; NaN where held [m]."""
        for begin in range(0, len(self.joints), FRAMES_AT_ONCE):
            some = slice(begin, begin + FRAMES_AT_ONCE)
            if not self._is_noted[some].all():
                self.rotations(some)
        return self._error_m


def skeleton_of(trajectories: Trajectories) -> RigidSkeleton:
    """Return the skeleton of one individual: its bones with their median lengths.

    People are at rest in a T pose, others as in the frame with most known keypoints; bones of one joint keep the mean
    angles between them. A bone that is never seen has no length.

    Args:
        trajectories: one individual.

    Raises:
        SettingsError: it has no bones, or they are not one tree.
    """
    children = {child: parent for parent, child in trajectories.bones}
    roots = {parent for parent, _ in trajectories.bones} - children.keys()
    if len(roots) != 1 or len(children) != len(trajectories.bones):
        raise SettingsError(f"{trajectories.individuals[0]} has no skeleton: {trajectories.kind} have no tree of bones")
    order = [*roots]
    for joint in order:  # grows on the way
        order += [child for child, parent in children.items() if parent == joint]
    place = {joint: i for i, joint in enumerate(order)}
    parents = np.array([-1, *(place[children[joint]] for joint in order[1:])])
    positions = trajectories.positions[:, 0, order]
    known = np.all(np.isfinite(positions), axis=2)
    seen = known[:, 1:] & known[:, parents[1:]]
    lengths = np.zeros(len(order) - 1)
    for k, (parent, own) in enumerate(zip(parents[1:], seen.T, strict=True)):
        if own.any():
            lengths[k] = np.median(np.linalg.norm(positions[own, k + 1] - positions[own, parent], axis=1))
    if trajectories.kind in {"people", "views"}:
        directions = np.array([_direction(trajectories.keypoints[joint]) for joint in order[1:]])
    else:
        fullest = int(np.argmax(seen.sum(axis=1)))
        bones = positions[fullest, 1:] - positions[fullest, parents[1:]]
        directions = np.where(seen[fullest][:, None], bones, _UP)
    directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    offsets = np.vstack([np.zeros(3), directions * lengths[:, None]])
    whole = np.flatnonzero(np.all(seen, axis=1))
    some = positions[whole[:: max(1, math.ceil(len(whole) / _MOST_FRAMES))]]
    for _ in range(_ROUNDS if len(some) else 0):
        offsets = _adapted(parents, offsets, some)
    return RigidSkeleton(tuple(order), tuple(trajectories.keypoints[joint] for joint in order), parents, offsets)


def _adapted(parents: Int64, offsets: Float64, positions: Floats) -> Float64:
    """Return offsets whose angles between the bones of a joint are nearer to the measured ones (frames, joints, 3)."""
    R = joint_rotations(parents, offsets, positions)
    own: Float64 = np.einsum("fjki,fjk->fji", R[:, parents[1:]], positions[:, 1:] - positions[:, parents[1:]])
    mean = own.mean(axis=0)
    lengths = np.linalg.norm(offsets[1:], axis=1, keepdims=True)
    found = np.linalg.norm(mean, axis=1, keepdims=True)
    several = np.array([(parents == parent).sum() > 1 for parent in parents[1:]])[:, None]
    return np.vstack(
        [np.zeros(3), np.where(several & (found > 0), mean * lengths / np.maximum(found, 1e-9), offsets[1:])]
    )


def _direction(joint: str) -> tuple[float, float, float]:
    name = joint.lower()
    for words, direction in _DIRECTIONS:
        if any(word in name for word in words) and "spine" not in name:
            side = -1.0 if "right" in name or name.startswith("r_") else 1.0
            sideways = "hip" in name and direction[0] != 0
            return side * direction[0], -0.3 if sideways else direction[1], direction[2]
    return _UP


def rigid_motion(trajectories: Trajectories, skeleton: RigidSkeleton) -> RigidMotion:
    """Return the poses of a skeleton that follow one individual's keypoints.

    An unknown joint keeps its last known position relative to its parent, or the first one before it was ever known; a
    joint that was never known is at rest.

    Args:
        trajectories: one individual, whose root is known in one frame at least.
        skeleton: its `skeleton_of`.

    Raises:
        SettingsError: the root is never known.
    """
    joints = trajectories.positions[:, 0, list(skeleton.keypoints)]
    known: NDArray[np.bool_] = np.all(np.isfinite(joints), axis=2)
    if not known[:, 0].any():
        raise SettingsError(f"{trajectories.individuals[0]}: {skeleton.names[0]} is never known")
    joints[:, 0] = held_rows(joints[:, 0], known[:, 0])
    for joint in range(1, len(skeleton.parents)):
        parent, lost = skeleton.parents[joint], ~known[:, joint]
        both = known[:, joint] & known[:, parent]
        if lost.any():
            relative = joints[:, joint] - joints[:, parent]
            held = held_rows(relative, both)[lost] if both.any() else skeleton.offsets[joint]
            joints[lost, joint] = joints[lost, parent] + held
    return RigidMotion(skeleton, joints[:, 0], ~known, joints)


def held_rows(values: NDArray[_Float], known: NDArray[np.bool_]) -> NDArray[_Float]:
    """Replace unknown rows by the last known one, or by the first known one before it."""
    last = np.maximum.accumulate(np.where(known, np.arange(len(known)), -1))
    return np.asarray(values[np.where(last >= 0, last, np.argmax(known))])
