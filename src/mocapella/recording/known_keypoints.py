"""The kind and the bones of keypoints whose file has only their names."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

from mocapella.model.arms import ARM_POINTS
from mocapella.model.hand import LANDMARKS
from mocapella.model.topology import topology, topology_names
from mocapella.model.trajectories import ARM_POINT_BONES, HAND_BONES, Bones


class KnownKeypoints(NamedTuple):
    """Kind of trajectories, such as ``people``, and the bones between their keypoints; ``points`` has none."""

    kind: str
    bones: Bones


def known_keypoints(names: Sequence[str]) -> KnownKeypoints:
    """Return the kind of the keypoints of a hand, an arm or a topology, in any order; ``points`` for others.

    An underscore in a name stands for a space, as in a BVH.
    """
    spaced = [name.replace("_", " ") for name in names]
    kind, keypoints, bones = _known().get(frozenset(spaced), ("points", (), ()))
    place = [spaced.index(keypoint.replace("_", " ")) for keypoint in keypoints]
    return KnownKeypoints(kind, tuple((place[parent], place[child]) for parent, child in bones))


@cache
def _known() -> dict[frozenset[str], tuple[str, tuple[str, ...], Bones]]:
    """Return kind, keypoints and bones by the set of the keypoints' names."""
    people = (topology(name) for name in topology_names())
    layouts = [
        *(("people", own.joints, own.bones) for own in people),
        ("hands", LANDMARKS, HAND_BONES),
        ("arms", ARM_POINTS, ARM_POINT_BONES),
    ]
    return {frozenset(name.replace("_", " ") for name in one[1]): one for one in layouts}
