"""Limbs between the keypoints of a topology: tree, lengths and thickness, to find keypoints in a depth image.

Lengths and breadths are fractions of the stature: R. Drillis, R. Contini, "Body Segment Parameters" (1966), as printed
in D. A. Winter, *Biomechanics and Motor Control of Human Movement*, 4th ed. (2009), fig. 4.1. Radii are half the depth
of a clothed adult's limb at the joint.
"""

from __future__ import annotations

from functools import cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.model.topology import Topology, topology

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

NO_PARENT: Final = -1
"""Parent of the joints that hang on the trunk."""
REFERENCE: Final = "halpe_26"
"""Topology whose joints have known limbs; others are mapped to it by their files."""

_SIDED: Final[dict[str, tuple[str, float, float, float]]] = {
    "Shoulder": ("", 0.20, 0.038, 0.0),
    "Hip": ("", 0.17, 0.055, 0.0),
    "Elbow": ("Shoulder", 0.186, 0.026, 0.026),
    "Wrist": ("Elbow", 0.146, 0.019, 0.019),
    "Knee": ("Hip", 0.245, 0.036, 0.036),
    "Ankle": ("Knee", 0.246, 0.026, 0.026),
    "BigToe": ("Ankle", 0.13, 0.014, 0.0),
    "SmallToe": ("Ankle", 0.12, 0.014, 0.0),
    "Heel": ("Ankle", 0.06, 0.016, 0.0),
    "Eye": ("", 0.34, 0.0, 0.0),
    "Ear": ("", 0.32, 0.0, 0.0),
}
"""By joint: parent, empty for the trunk; greatest distance from it; radius; and half the breadth of a limb that has two
edges. Distances from the trunk are those from its middle, between shoulders and hips."""
_CENTRAL: Final = {"Nose": (0.32, 0.0), "Head": (0.36, 0.03), "Neck": (0.22, 0.035), "Hip": (0.16, 0.06)}
"""By joint: greatest distance from the trunk's middle, and radius."""
_OTHER: Final = (0.12, 0.006)
"""Length and radius of any other joint, such as a finger's or a point of the face."""
_WIDTHS: Final = {"LShoulder": 0.24, "RShoulder": 0.24, "LHip": 0.1, "RHip": 0.1}
"""Distance of each joint of the trunk from its mirror image."""
_SCALED: Final = ("Elbow", "Wrist", "Knee", "Ankle")
"""Joints whose bones tell the stature."""
_SHORTEST: Final = {**dict.fromkeys(_SCALED, 0.7), "BigToe": 0.55, "SmallToe": 0.55, "Heel": 0.4}
"""Least length of a limb that is seen at both ends, relative to its usual length."""


class KeypointLimbs(NamedTuple):
    """The limbs of a topology with n keypoints, for kernels; lengths are relative to the stature.

    Attributes:
        parent: (n,) keypoint at which the limb begins; `NO_PARENT` for joints that hang on the trunk.
        order: (n,) keypoints, parents before children.
        length: (n,) greatest length of the limb, or distance from the trunk's middle.
        radius: (n,) distance from the skin to the joint's centre.
        breadth: (n,) half the breadth of the limb between its edges; 0 if it need not have edges.
        trunk: (n,) whether it is a shoulder or hip.
        width: (n,) distance of a shoulder or hip from its mirror image; 0 for other keypoints.
        shortest: (n,) least length of the limb; 0 if it may vanish.
        scaled: (n,) whether the limb's length tells the stature.
        mirror: (n,) the keypoint's mirror image; itself if it has none.
        head: (5,) nose, left ear, right ear, left eye, right eye; -1 where the topology has none.
    """

    parent: Int64
    order: Int64
    length: Float64
    radius: Float64
    breadth: Float64
    trunk: NDArray[np.bool_]
    width: Float64
    shortest: Float64
    scaled: NDArray[np.bool_]
    mirror: Int64
    head: Int64


@cache
def _named(name: str) -> KeypointLimbs:
    own = topology(name)
    place = _places(own)
    known = {index: joint for joint, index in place.items()}
    n = len(own)
    parent = np.full(n, NO_PARENT, np.int64)
    length, radius, breadth = np.full(n, _OTHER[0]), np.full(n, _OTHER[1]), np.zeros(n)
    of_bones = {child: start for start, child in own.bones}
    for index in range(n):
        joint = known.get(index)
        if joint is None:
            start = of_bones.get(index)
            parent[index] = NO_PARENT if start is None else start
        elif joint in _CENTRAL:
            length[index], radius[index] = _CENTRAL[joint]
        else:
            start_name, length[index], radius[index], breadth[index] = _SIDED[joint[1:]]
            parent[index] = place.get(joint[0] + start_name, NO_PARENT) if start_name else NO_PARENT
    length[(parent == NO_PARENT) & ~np.isin(np.arange(n), list(known))] = _CENTRAL["Head"][0]
    return KeypointLimbs(
        parent, _in_order(parent), length, radius, breadth,
        np.array([known.get(i) in _WIDTHS for i in range(n)]),
        np.array([_WIDTHS.get(known.get(i, ""), 0.0) for i in range(n)]),
        length * [_SHORTEST.get(known.get(i, "?")[1:], 0.0) for i in range(n)],
        np.array([known.get(i, "?")[1:] in _SCALED for i in range(n)]) & (parent != NO_PARENT),
        np.array(own.mirror, np.int64),
        np.array([place.get(joint, -1) for joint in ("Nose", "LEar", "REar", "LEye", "REye")], np.int64),
    )  # fmt: skip


def keypoint_limbs(own: Topology) -> KeypointLimbs:
    """Return the limbs of a topology; cached by its name, so do not change the arrays.

    A topology without a mapping to `REFERENCE` has no trunk, and nothing is found in space with it.
    """
    return _named(own.name)


def _places(own: Topology) -> dict[str, int]:
    """Index of each joint of the reference that is a single keypoint of the topology."""
    reference = topology(REFERENCE)
    return {reference.joints[joint]: source for joint, source in own.single_joints(REFERENCE).items()}


def _in_order(parent: Int64) -> Int64:
    order: list[int] = []
    while len(order) < len(parent):
        order += [i for i in range(len(parent)) if i not in order and (parent[i] == NO_PARENT or parent[i] in order)]
    return np.array(order, np.int64)
