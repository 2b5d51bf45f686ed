"""The body of a simulated person: 25 joints of human proportions, with a capsule around each bone.

A pose is a root position and a unit direction for each bone, so bone lengths are always kept.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import own_toml
from mocapella.errors import SettingsError
from mocapella.model.skeleton import SKELETON, JointMapping
from mocapella.model.topology import topology, weights_from_table
from mocapella.settings import check

Float64 = NDArray[np.float64]

BODY = SKELETON
"""The joints of a simulated body, in the order of all arrays of this package."""

JOINT = {name: i for i, name in enumerate(BODY.joints)}
ROOT = BODY.parts["root"]


@dataclass(frozen=True, eq=False)
class BodyTemplate:
    """Properties that all people share.

    Attributes:
        parents: (25,) index of each joint's parent, where the joint's bone begins; the root's is itself.
        offsets: (25, 3) from parent to joint, in fractions of stature: left, up, forward; the arms are out sideways.
        radii: (25,) radii of the bones' capsules in fractions of stature; 0 for the root.
        chain: (25, 25) 1 if the bone of the column is on the way from the root to the joint of the row, else 0.
        within: (25, 25) whether the joint of the row is inside the capsule of the bone of the column, arms out.
    """

    parents: NDArray[np.int64]
    offsets: Float64
    radii: Float64
    chain: Float64
    within: NDArray[np.bool_]


@cache
def body_template() -> BodyTemplate:
    """Return the body of ``data/body.toml``, cached: do not change its arrays."""
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
    """Return the length (25,) of the bone that ends at each joint, for a stature [m]; 0 for the root.

    Raises:
        SettingsError: the stature is not from 0.5 to 2.5 m.
    """
    check(0.5 <= stature <= 2.5, "stature", stature, "from 0.5 to 2.5 m")
    return np.asarray(np.linalg.norm(body_template().offsets, axis=1) * stature)


def joint_positions(root: Float64, directions: Float64, lengths: Float64) -> Float64:
    """Return the joints (..., 25, 3) of a body [m].

    Args:
        root: (..., 3) position of the root joint [m].
        directions: (..., 25, 3) unit vector along the bone that ends at each joint.
        lengths: (..., 25) lengths of the bones [m].
    """
    return root[..., None, :] + body_template().chain @ (directions * lengths[..., None])


def facing(positions: Float64) -> Float64:
    """Return the horizontal facing direction (..., 3) of bodies (..., 25, 3), y up.

    It is a unit vector: the cross product of the direction from the right to the left shoulder and the upward
    direction. It is NaN if a shoulder is NaN, or one is above the other.
    """
    left = positions[..., JOINT["ShoulderLeft"], :] - positions[..., JOINT["ShoulderRight"], :]
    forward = np.stack([-left[..., 2], np.zeros(left.shape[:-1]), left[..., 0]], axis=-1)
    return np.asarray(forward / np.linalg.norm(forward, axis=-1, keepdims=True))


@cache
def simulated_joints(name: str) -> JointMapping:
    """Return the mapping from the body's joints to a topology's, to simulate a sensor with it.

    Args:
        name: name of the topology.

    Raises:
        SettingsError: unknown topology, or it has a joint that the body does not have.
    """
    wanted, table = topology(name), body_data()["joints"].get(name, {})
    missing = [joint for joint in wanted.joints if joint not in table and joint not in JOINT]
    if missing:
        known = ", ".join((BODY.name, *body_data()["joints"]))
        raise SettingsError(
            f"topology {name} cannot be simulated: the body has no {', '.join(missing[:3])}, …; take one of {known}"
        )
    same = {joint: joint for joint in wanted.joints if joint not in table}
    return JointMapping.of(BODY, wanted, weights_from_table(BODY, wanted, same | table))


@cache
def body_data() -> dict[str, Any]:
    """Return the content of ``data/body.toml``, cached: do not change it."""
    return own_toml("mocapella.sources.simulate", "data", "body.toml")


def _within(joints: Float64, parents: NDArray[np.int64], radii: Float64) -> NDArray[np.bool_]:
    start, bone = joints[parents], joints - joints[parents]
    squared = np.maximum((bone**2).sum(axis=1), 1e-12)
    along = np.clip(((joints[:, None] - start) * bone).sum(axis=2) / squared, 0, 1)
    distance = np.linalg.norm(joints[:, None] - (start + along[..., None] * bone), axis=2)
    # A joint at a bone's end is inside it; the margin is a finger's breadth of skin.
    return np.asarray(distance <= radii + 0.01)
