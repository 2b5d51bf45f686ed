"""Kinematic trees in twists: rigid parts, revolute joints, and forward kinematics.

A joint is a twist of zero pitch in the model's rest frame, so a model needs no bone frames: a part's motion maps a
point from its rest position to the world, and is a product of exponentials
(B. Rosenhahn, T. Brox, D. Cremers, H.-P. Seidel, "Online Smoothing for Markerless Motion Capture", DAGM 2007, equation
10; R. Murray, Z. Li, S. Sastry, *A Mathematical Introduction to Robotic Manipulation*, 1994, section 3.2).
"""

from __future__ import annotations

from functools import cache
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.settings import check

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

ROOT_DOFS = 6


class TwistTree(msgspec.Struct, frozen=True, eq=False):
    """Parts and joints of a model. A rigid object is a tree of one part and no joints.

    Attributes:
        parents: (parts,) index of each part's parent, earlier in the order; -1 for the first, the root, which moves
            freely.
        joint_parts: (joints,) index of the part that each joint rotates, with its descendants; ascending. Several
            joints of a part act in sequence, the last one next to it.
        twists: (joints, 6) twist of each joint in the rest frame: translation part [m], then the unit axis; of zero
            pitch; see `geometry.twists.revolute`.
        limits: (joints, 2) least and most angle [rad]; may be infinite.
        root: (3,) reference point of the model on the root part, in the rest frame [m], such as the middle of the hips.

    Raises:
        SettingsError: arrays that do not fit this description.
    """

    parents: Int64
    joint_parts: Int64
    twists: Float64
    limits: Float64
    root: Float64

    def __post_init__(self) -> None:
        parts, joints = len(self.parents), len(self.joint_parts)
        shapes = (self.twists.shape, self.limits.shape, self.root.shape)
        check(shapes == ((joints, 6), (joints, 2), (3,)), "shapes", shapes, f"({joints}, 6), ({joints}, 2) and (3,)")
        before = np.arange(parts)
        rising = parts > 0 and self.parents[0] == -1 and ((self.parents >= 0) & (self.parents < before))[1:].all()
        check(bool(rising), "parents", self.parents.tolist(), "-1, then parts that come before")
        within = (np.diff(self.joint_parts, prepend=1) >= 0).all() and (self.joint_parts < parts).all()
        check(bool(within), "joint_parts", self.joint_parts.tolist(), f"ascending from 1 to {parts - 1}")
        v, w = self.twists[:, :3], self.twists[:, 3:]
        unit = (np.abs((w * w).sum(axis=1) - 1) < 1e-9) & (np.abs((v * w).sum(axis=1)) < 1e-9)
        check(bool(unit.all()), "twists", self.twists[~unit].tolist(), "unit axes without pitch")
        rising = (self.limits[:, 0] <= self.limits[:, 1]).all()
        check(bool(rising), "limits", self.limits.tolist(), "least, then most")
        check(bool(np.isfinite(self.root).all()), "root", self.root.tolist(), "finite")

    @property
    def dofs(self) -> int:
        """Number of degrees of freedom: the root's six and the joints' angles."""
        return ROOT_DOFS + len(self.joint_parts)

    @property
    def arrays(self) -> tuple[Int64, Int64, Float64]:
        """``parents``, ``joint_parts`` and ``twists``: the first arguments of the kernels of forward kinematics."""
        return self.parents, self.joint_parts, self.twists


def twist_tree(
    parents: Any, joint_parts: Any = (), twists: Any = (), limits: Any = None, root: Any = (0, 0, 0)
) -> TwistTree:
    """Make a `TwistTree` of array-likes, which are copied; without limits, joints are unbounded.

    The arguments are the fields of `TwistTree`.

    Raises:
        SettingsError: arrays of other shapes, a parent after its child, a twist without a unit axis or with pitch, or
            limits in the wrong order.
    """
    parts = np.array(joint_parts, dtype=np.int64)
    free = np.tile([-np.inf, np.inf], (len(parts), 1))
    return TwistTree(
        np.array(parents, dtype=np.int64),
        parts,
        np.array(twists, dtype=np.float64).reshape(-1, 6),
        free if limits is None else np.array(limits, dtype=np.float64).reshape(-1, 2),
        np.array(root, dtype=np.float64),
    )


def limbs_of(tree: TwistTree) -> list[tuple[Int64, Int64]]:
    """Return the joints (j,) and the parts (p,), as indices, of each unbranched chain of parts, such as an arm.

    A chain starts below the root or below a part with several children; the root itself is in none.
    """
    limbs: dict[int, list[int]] = {}
    of = np.zeros(len(tree.parents), dtype=np.int64)
    for part in range(1, len(tree.parents)):
        parent = int(tree.parents[part])
        alone = np.count_nonzero(tree.parents == parent) == 1
        of[part] = of[parent] if alone else part
        limbs.setdefault(int(of[part]), []).append(part)
    return [(np.flatnonzero(np.isin(tree.joint_parts, limb)), np.array(limb)) for limb in limbs.values()]


class TreePose(msgspec.Struct, frozen=True, eq=False):
    """The pose of a tree; leading axes are batches.

    Attributes:
        T_world_model: (..., 4, 4) rigid motion of the root part, from the rest frame to the world.
        angles: (..., joints) joint angles [rad].
    """

    T_world_model: Float64
    angles: Float64


def part_motions(tree: TwistTree, pose: TreePose) -> Float64:
    """Return the transforms (..., parts, 4, 4) of the parts from the rest frame to the world, by forward kinematics.

    Joint limits are not applied. The batch axes of the pose's two arrays broadcast.
    """
    R, t, _ = _forward(tree, pose)
    T = np.zeros((*R.shape[:-1], 4, 4))
    T[..., :3, :3] = R.reshape(*R.shape[:-1], 3, 3)
    T[..., :3, 3] = t
    T[..., 3, 3] = 1.0
    return T


def motions(tree: TwistTree, pose: TreePose) -> tuple[Float64, Float64]:
    """Return the parts' transforms from rest to one pose, for kernels: R (parts, 9), row by row; t (parts, 3) [m].

    The pose must have no batch axes; `part_motions` accepts them.
    """
    parts = len(tree.parents)
    R, t, xi = np.empty((parts, 9)), np.empty((parts, 3)), np.empty((len(tree.joint_parts), 6))
    _kernels().forward(*tree.arrays, pose.T_world_model, pose.angles, np.zeros(3), R, t, xi)
    return R, t


def joint_twists(tree: TwistTree, pose: TreePose) -> Float64:
    """Return the joints' twists (..., joints, 6) in a pose, in the world, about its origin.

    A twist is its translation part [m per radian], then the joint's unit axis.
    """
    return _forward(tree, pose)[2]


def _forward(tree: TwistTree, pose: TreePose) -> tuple[Float64, Float64, Float64]:
    parts, joints = len(tree.parents), len(tree.joint_parts)
    T, angles = np.asarray(pose.T_world_model, np.float64), np.asarray(pose.angles, np.float64)
    batch = np.broadcast_shapes(T.shape[:-2], angles.shape[:-1])
    T = np.broadcast_to(T, (*batch, 4, 4)).reshape(-1, 4, 4)
    angles = np.broadcast_to(angles, (*batch, joints)).reshape(len(T), joints)
    R, t, xi = np.empty((len(T), parts, 9)), np.empty((len(T), parts, 3)), np.empty((len(T), joints, 6))
    origin = np.zeros(3)
    for k in range(len(T)):
        _kernels().forward(*tree.arrays, T[k], angles[k], origin, R[k], t[k], xi[k])
    return R.reshape(*batch, parts, 9), t.reshape(*batch, parts, 3), xi.reshape(*batch, joints, 6)


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.geometry import twist_tree_kernels

    return twist_tree_kernels
