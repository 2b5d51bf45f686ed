"""Anatomical points among the keypoints of any topology: hips, knees, ankles, and so on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from types import MappingProxyType
from typing import Final

from mocapella.model.skeleton import SKELETON
from mocapella.model.topology import Topology, topology, topology_names

Anatomy = Mapping[str, Mapping[int, float]]
"""Name of an anatomical point → index of each contributing keypoint → its weight; weights sum to 1."""

MOST_STRAY: Final = 0.12
"""Largest usual distance of a knee or elbow from its place along the limb, as a share of the limb's length; see
docs/decisions/0114-misplaced-knees.md."""
THIGH_SHARE: Final = 0.5
"""Length of the thigh as a share of thigh and shank, of an average person as a Kinect v2 sees them."""
_CENTRAL: Final = {"pelvis": "SpineBase", "chest": "SpineShoulder"}
_SIDED: Final = {
    "hip": "Hip", "knee": "Knee", "ankle": "Ankle", "shoulder": "Shoulder", "elbow": "Elbow", "wrist": "Wrist",
}  # fmt: skip
_SIDES: Final = {"r": ("Right", "right"), "l": ("Left", "left")}
_BETWEEN: Final = {"pelvis": "hip", "chest": "shoulder"}
"""Points that are midway between left and right where their own joints are missing."""
_OWN_PARTS: Final = ("heel", "index", "little")


def anatomy_of(keypoints: Sequence[str]) -> Anatomy:
    """Return the anatomical points that the keypoints determine; none if they are of no topology with a body.

    The names are pelvis (the midpoint of the hips, roughly), lumbar (the middle of the spine, if it is a joint of its
    own and no mean of others), chest (the top of the spine), and with ``_r`` or ``_l``: hip, knee, ankle, heel, toe,
    shoulder, elbow, wrist, index and little (knuckles). A point without all its contributors is left out; pelvis
    and chest are then midway between hips and between shoulders.

    Args:
        keypoints: names of the keypoints, a topology's in any order; others are ignored. Of several topologies,
            it is the one with most of its joints among them.
    """
    name = topology_of(keypoints)
    if name is None:
        return MappingProxyType({})
    own = topology(name)
    place = {joint: k for k, joint in reversed(tuple(enumerate(keypoints)))}
    found = {}
    for point, terms in _points(own.name).items():
        if all(own.joints[joint] in place for joint in terms):
            found[point] = {place[own.joints[joint]]: weight for joint, weight in terms.items()}
    for point, pair in _BETWEEN.items():
        if point not in found and all(f"{pair}_{side}" in found for side in _SIDES):
            found[point] = {k: 0.5 * w for side in _SIDES for k, w in found[f"{pair}_{side}"].items()}
    return MappingProxyType(found)


def topology_of(keypoints: Sequence[str]) -> str | None:
    """Return the name of the body topology with most of its joints among keypoints; None below three joints."""
    known = set(keypoints)
    count, _, name = max((len(known.intersection(topology(name).joints)), len(known) - len(topology(name)), name)
                         for name in with_body())  # fmt: skip
    return name if count >= 3 else None


@cache
def with_body() -> tuple[str, ...]:
    """Return the names of the topologies that have a body's joints, sorted."""
    return tuple(name for name in topology_names() if name == SKELETON.name or SKELETON.name in topology(name).mappings)


@cache
def _points(name: str) -> dict[str, dict[int, float]]:
    """Return each anatomical point of a topology as weights of its joints."""
    own = topology(name)
    points = {point: terms for point, joint in _CENTRAL.items() if (terms := _terms(own, joint))}
    middle = _terms(own, "SpineMid")
    if len(middle) == 1:
        points["lumbar"] = middle
    for side, (upper, lower) in _SIDES.items():
        for point, joint in _SIDED.items():
            if terms := _terms(own, joint + upper):
                points[f"{point}_{side}"] = terms
        for point in _OWN_PARTS:
            if f"{point}_{lower}" in own.parts:
                points[f"{point}_{side}"] = {own.parts[f"{point}_{lower}"]: 1.0}
        if _terms(own, "Foot" + upper):
            points[f"toe_{side}"] = {own.parts[f"foot_{lower}"]: 1.0}
    return points


def _terms(own: Topology, joint: str) -> dict[int, float]:
    """Return the weights of a topology's joints for a joint of people; none if it has no such joint."""
    target = SKELETON.index(joint)
    return {target: 1.0} if own.name == SKELETON.name else dict(own.mappings[SKELETON.name].get(target, {}))
