"""The body of a simulated person: 25 joints of human proportions, each bone a capsule of flesh.

A pose is a root position and one unit direction for every bone, so that bones keep their length whatever moves them.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.model.topology import Topology, topology
from mocapella.settings import check

Float64 = NDArray[np.float64]

BODY = topology("kinect_v2")
"""The joints that a simulated body has, in this order everywhere in this room."""

JOINT = {name: i for i, name in enumerate(BODY.joints)}
ROOT = BODY.parts["root"]


@dataclass(frozen=True, eq=False)
class BodyTemplate:
    """What is the same for all people.

    Attributes:
        parents: (25,) the joint at the other end of the bone; the root's is itself.
        offsets: (25, 3) from parent to joint in fractions of stature: left, up, forward, arms out sideways.
        radii: (25,) of the bone's capsule in fractions of stature; 0 for the root.
        chain: (25, 25) 1 where the bone of the column lies between the root and the joint of the row.
        within: (25, 25) whether the joint of the row lies inside the flesh of the bone of the column, arms out.
    """

    parents: NDArray[np.int64]
    offsets: Float64
    radii: Float64
    chain: Float64
    within: NDArray[np.bool_]


@cache
def body_template() -> BodyTemplate:
    """The body of ``data/body.toml``."""
    data = body_data()
    joints = len(BODY)
    parents, chain = np.full(joints, ROOT), np.zeros((joints, joints))
    for parent, child in BODY.bones:
        parents[child] = parent
        chain[child] = chain[parent]
        chain[child, child] = 1
    offsets, radii = np.zeros((joints, 3)), np.zeros(joints)
    for name, offset in data["offsets"].items():
        i, radius = JOINT[name], data["radii"][name]
        mirror_image = BODY.mirror[i]
        offsets[mirror_image] = np.array(offset) * (-1, 1, 1)
        offsets[i], radii[i], radii[mirror_image] = offset, radius, radius
    return BodyTemplate(parents, offsets, radii, chain, _within(chain @ offsets, parents, radii))


def bone_lengths(stature: float) -> Float64:
    """(25,) length of the bone that ends at each joint [m]; 0 for the root."""
    check(0.5 <= stature <= 2.5, "stature", stature, "from 0.5 to 2.5 m")
    return np.asarray(np.linalg.norm(body_template().offsets, axis=1) * stature)


def joint_positions(root: Float64, directions: Float64, lengths: Float64) -> Float64:
    """(..., 25, 3) joints of a root (..., 3), unit bone directions (..., 25, 3) and lengths (..., 25)."""
    return root[..., None, :] + body_template().chain @ (directions * lengths[..., None])


def facing(positions: Float64) -> Float64:
    """(..., 3) horizontal unit vector to where the chests of (..., 25, 3) point: left × up, of the shoulders."""
    left = positions[..., JOINT["ShoulderLeft"], :] - positions[..., JOINT["ShoulderRight"], :]
    forward = np.stack([-left[..., 2], np.zeros(left.shape[:-1]), left[..., 0]], axis=-1)
    return np.asarray(forward / np.linalg.norm(forward, axis=-1, keepdims=True))


def joint_selection(wanted: Topology) -> NDArray[np.int64]:
    """For each joint of a topology, which joint of the body it is.

    Raises:
        SettingsError: the topology has a joint that the body has not.
    """
    names: dict[str, str] = body_data()["names"].get(wanted.name, {})
    missing = [joint for joint in wanted.joints if names.get(joint, joint) not in JOINT]
    if missing:
        raise SettingsError(
            f"topology {wanted.name} cannot be simulated: the body has no {', '.join(missing)}; it has {BODY.joints}"
        )
    return np.array([JOINT[names.get(joint, joint)] for joint in wanted.joints])


@cache
def body_data() -> dict[str, Any]:
    """``data/body.toml`` as it stands."""
    text = files("mocapella.sources.simulate").joinpath("data", "body.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def _within(joints: Float64, parents: NDArray[np.int64], radii: Float64) -> NDArray[np.bool_]:
    start, bone = joints[parents], joints - joints[parents]
    squared = np.maximum((bone**2).sum(axis=1), 1e-12)
    along = np.clip(((joints[:, None] - start) * bone).sum(axis=2) / squared, 0, 1)
    distance = np.linalg.norm(joints[:, None] - (start + along[..., None] * bone), axis=2)
    # A joint at a bone's end lies in it, and a finger's breadth of skin belongs to the joint itself.
    return np.asarray(distance <= radii + 0.01)
