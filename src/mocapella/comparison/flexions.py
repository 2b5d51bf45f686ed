"""Angles at joints from positions, by one definition for a recording and a reference."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.comparison.joint_names import COMMON, MatchedJoint
from mocapella.model.hand import LANDMARKS
from mocapella.model.topology import topology
from mocapella.model.trajectories import HAND_BONES, Bones

Float64 = NDArray[np.float64]


class Flexion(NamedTuple):
    """A joint between two bones: its name, and the indices of its parent, itself and its child."""

    name: str
    parent: int
    joint: int
    child: int


def hinges(joints: Sequence[MatchedJoint], keypoints: Sequence[str], bones: Bones) -> tuple[Flexion, ...]:
    """Return the joints with one bone to a parent and one to a child, all three compared.

    Args:
        joints: the compared joints.
        keypoints, bones: keypoints and bones of the recording; the common layout's bones if it has none.
    """
    if bones:
        place = {keypoints.index(next(iter(one.ours))): k for k, one in enumerate(joints) if len(one.ours) == 1}
        tree = [(place[a], place[b]) for a, b in bones if a in place and b in place]
    if not bones or not tree:
        own = {one.common: k for k, one in enumerate(joints) if one.common}
        layouts = ((topology(COMMON).joints, topology(COMMON).bones), (LANDMARKS, HAND_BONES))
        tree = [(own[names[a]], own[names[b]]) for names, edges in layouts for a, b in edges
                if names[a] in own and names[b] in own]  # fmt: skip
    parents = {child: parent for parent, child in tree}
    children: dict[int, list[int]] = {}
    for parent, child in tree:
        children.setdefault(parent, []).append(child)
    return tuple(
        Flexion(joints[joint].name, parents[joint], joint, below[0])
        for joint, below in sorted(children.items())
        if len(below) == 1 and joint in parents
    )


def flexions(positions: Float64, of: Sequence[Flexion]) -> Float64:
    """Return the angle between the two bones of each hinge (..., hinges), 0 where the limb is straight [rad].

    Args:
        positions: (..., joints, 3) [m]; NaN gives NaN.
        of: the hinges.
    """
    if not of:
        return np.empty((*positions.shape[:-2], 0))
    places = np.array([(one.parent, one.joint, one.child) for one in of])
    parent, joint, child = (positions[..., places[:, k], :] for k in range(3))
    upper, lower = joint - parent, child - joint
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(upper, lower), axis=-1), np.sum(upper * lower, axis=-1)))
