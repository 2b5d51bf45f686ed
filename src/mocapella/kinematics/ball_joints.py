"""Parametrise ball joints about their present pose, so that no pose is singular.

A shoulder is three revolute joints in a row. Where the second aligns the third axis with the first, two joints rotate
the arm about the same axis and none about another (gimbal lock): a fit is stuck there, and an arm raised to the side
passes through it. So each step of a fit uses a local tree, whose rest pose is the body's present pose:

    local = local_tree(tree, balls, pose)
    pose = local.back(fit(local.tree, local.at, constraints, [local.into_prior(prior)]).pose)

In the local tree a ball joint rotates about three perpendicular axes, the last one along the limb, and all three angles
are 0. It is the product of exponentials about another rest pose (R. Murray, Z. Li, S. Sastry, *A Mathematical
Introduction to Robotic Manipulation*, 1994, section 3.2.2). The motions of its parts apply to points in that rest pose,
not in the mesh's.
"""

from __future__ import annotations

from copy import copy
from functools import cache
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.kinematics.twist_fit import Prior
from mocapella.model.twist_tree import TreePose, TwistTree

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

_PERPENDICULAR = 1e-9


class BallJoints(msgspec.Struct, frozen=True, eq=False):
    """The ball joints of a tree that have a singular pose within their limits.

    Attributes:
        parts: (n,) index of the part that each ball joint moves.
        first: (n,) index of the first of its three revolute joints.
        axes: (n, 3, 3) unit axes of these in the rest pose, one per row.
        centres: (n, 3) intersection of the axes in the rest pose [m].
    """

    parts: Int64
    first: Int64
    axes: Float64
    centres: Float64


def ball_joints(tree: TwistTree) -> BallJoints:
    """Find parts with three perpendicular, intersecting revolute axes whose second angle can reach a right angle.

    Such joints are singular there, so `local_tree` re-expresses them; there may be none.
    """
    found: list[tuple[int, int, Float64, Float64]] = []
    for part in range(1, len(tree.parents)):
        turns = np.flatnonzero(tree.joint_parts == part)
        if len(turns) != 3:
            continue
        v, axes = tree.twists[turns, :3], tree.twists[turns, 3:]
        # v = −ω × c of all three: nine equations of the centre.
        system = np.concatenate([_crossing(axis) for axis in axes])
        centre = np.linalg.lstsq(system, -v.ravel(), rcond=None)[0]
        meet = np.abs(system @ centre + v.ravel()).max() < _PERPENDICULAR
        perpendicular = np.abs(axes @ axes.T - np.eye(3)).max() < _PERPENDICULAR
        least, most = tree.limits[turns[1]]
        if meet and perpendicular and (least <= -np.pi / 2 or most >= np.pi / 2):
            found.append((part, int(turns[0]), axes, centre))
    n = len(found)
    return BallJoints(
        np.array([one[0] for one in found], np.int64), np.array([one[1] for one in found], np.int64),
        np.array([one[2] for one in found]).reshape(n, 3, 3), np.array([one[3] for one in found]).reshape(n, 3),
    )  # fmt: skip


class LocalTree(msgspec.Struct, frozen=True, eq=False):
    """A body's tree, re-expressed so that its rest pose is the body's present pose.

    Attributes:
        tree: the local tree.
        at: the present pose as a pose of the local tree: the ball joints' angles are 0.
        of: the body's tree.
        balls: the ball joints.
        pose: the present pose as a pose of the body's tree.
        turned: (n, 9) rotations of the ball joints in the present pose, by rows.
        axes: (n, 3, 3) their axes in the local tree, one per row.
    """

    tree: TwistTree
    at: TreePose
    of: TwistTree
    balls: BallJoints
    pose: TreePose
    turned: Float64
    axes: Float64

    def into(self, pose: TreePose) -> TreePose:
        """Convert a pose of the body's tree to the local tree; the root's pose is the same array."""
        angles = np.array(pose.angles, np.float64)
        _kernels().into(self.balls.first, self.balls.axes, self.turned, self.axes, angles)
        return TreePose(pose.T_world_model, angles)

    def back(self, pose: TreePose) -> TreePose:
        """Convert a pose of the local tree to the body's tree, within its joint limits."""
        angles = np.array(pose.angles, np.float64)
        _kernels().back(
            self.balls.first, self.balls.axes, self.turned, self.axes, self.of.limits, self.pose.angles, angles
        )
        return TreePose(pose.T_world_model, angles)

    def into_prior(self, prior: Prior) -> Prior:
        """Convert a prior of the body's pose to the local tree; its inverse standard deviations stay."""
        return Prior(self.into(prior.pose), prior.root_per_m, prior.root_per_rad, prior.angles_per_rad)

    def into_usual(self, usual: Prior) -> Prior:
        """Convert the prior of the typical (resting) posture to the local tree.

        For a ball joint it keeps only the rotation about the limb, with an inverse standard deviation that falls to 0
        at the singular pose, where that rotation is undefined. The limb's direction is seen, and gets no prior.
        """
        angles, weights = np.array(usual.pose.angles), np.array(usual.angles_per_rad)
        for first in self.balls.first.tolist():
            _, raised, turn = self.pose.angles[first : first + 3]
            angles[first : first + 3] = 0.0, 0.0, angles[first + 2] - turn
            weights[first : first + 3] = 0.0, 0.0, weights[first + 2] * abs(np.cos(raised))
        return Prior(TreePose(usual.pose.T_world_model, angles), usual.root_per_m, usual.root_per_rad, weights)


def local_tree(tree: TwistTree, balls: BallJoints, pose: TreePose) -> LocalTree:
    """Make the local tree of a body's tree about a pose, for one step of a fit; the arguments are not changed.

    Args:
        tree: the body's tree.
        balls: the ball joints that `ball_joints` finds in it.
        pose: the present pose, which becomes the local tree's rest pose.
    """
    angles = np.array(pose.angles, np.float64)
    twists, limits, n = tree.twists.copy(), tree.limits.copy(), len(balls.parts)
    turned, axes = np.empty((n, 9)), np.empty((n, 3, 3))
    _kernels().localise(
        tree.parents, tree.joint_parts, balls.parts, balls.first, balls.axes, balls.centres, angles, turned, axes,
        twists, limits,
    )  # fmt: skip
    return LocalTree(
        _moved(tree, twists, limits), TreePose(pose.T_world_model, angles), tree, balls, pose, turned, axes
    )


def _moved(tree: TwistTree, twists: Float64, limits: Float64) -> TwistTree:
    """Copy a tree with moved joints, without a check: the original joints were checked."""
    moved = copy(tree)
    msgspec.structs.force_setattr(moved, "twists", twists)
    msgspec.structs.force_setattr(moved, "limits", limits)
    return moved


def _crossing(a: Float64) -> Float64:
    """(3, 3) that takes x to a × x."""
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.kinematics import ball_joint_kernels

    return ball_joint_kernels
