"""Ball joints told by three turns about the pose they are in, so that none of their poses is singular.

A shoulder is three revolute joints in a row, and where the second brings the third one's axis onto the first one's,
two of them turn the arm about the same axis and nothing turns it about another: there a fit is stuck, and an arm that
is raised to the side passes there. So a step is taken in a tree that is at rest where the body is:

    local = local_tree(tree, balls, pose)
    pose = local.back(fit(local.tree, local.at, constraints, [local.into_prior(prior)]).pose)

In it a ball joint turns about three perpendicular axes, the last one along the limb, and all three angles are 0. It is
the product of exponentials about another rest pose (R. Murray, Z. Li, S. Sastry, *A Mathematical Introduction to
Robotic Manipulation*, 1994, section 3.2.2). Parts' motions in it take points from that rest pose, not from the mesh's.
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
    """Those of a tree that can be singular.

    Attributes:
        parts: (n,) each one's part.
        first: (n,) the first of its three turns.
        axes: (n, 3, 3) their axes at rest, one a row.
        centres: (n, 3) where these meet at rest [m].
    """

    parts: Int64
    first: Int64
    axes: Float64
    centres: Float64


def ball_joints(tree: TwistTree) -> BallJoints:
    """Parts that three perpendicular turns about one point move, the second one to a right angle or beyond."""
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
    """A tree at rest where a body is.

    Attributes:
        tree: the body's, but for its rest pose.
        at: where the body is, as a pose of this tree: its ball joints' angles are 0.
        of: the body's tree.
        balls: see its class.
        pose: where the body is.
        turned: (n, 9) the ball joints' rotations there.
        axes: (n, 3, 3) about which they turn in this tree, one a row.
    """

    tree: TwistTree
    at: TreePose
    of: TwistTree
    balls: BallJoints
    pose: TreePose
    turned: Float64
    axes: Float64

    def into(self, pose: TreePose) -> TreePose:
        """A pose of the body as one of this tree."""
        angles = np.array(pose.angles, np.float64)
        _kernels().into(self.balls.first, self.balls.axes, self.turned, self.axes, angles)
        return TreePose(pose.T_world_model, angles)

    def back(self, pose: TreePose) -> TreePose:
        """A pose of this tree as one of the body, within its limits."""
        angles = np.array(pose.angles, np.float64)
        _kernels().back(
            self.balls.first, self.balls.axes, self.turned, self.axes, self.of.limits, self.pose.angles, angles
        )
        return TreePose(pose.T_world_model, angles)

    def into_prior(self, prior: Prior) -> Prior:
        """What is expected of the body's pose, as of this tree's."""
        return Prior(self.into(prior.pose), prior.root_per_m, prior.root_per_rad, prior.angles_per_rad)

    def into_usual(self, usual: Prior) -> Prior:
        """What angles usually are. Of ball joints only the turn about the limb is usual, and not where it is undefined:
        where a limb points nothing is usual, and shows.
        """
        angles, weights = np.array(usual.pose.angles), np.array(usual.angles_per_rad)
        for first in self.balls.first.tolist():
            _, raised, turn = self.pose.angles[first : first + 3]
            angles[first : first + 3] = 0.0, 0.0, angles[first + 2] - turn
            weights[first : first + 3] = 0.0, 0.0, weights[first + 2] * abs(np.cos(raised))
        return Prior(TreePose(usual.pose.T_world_model, angles), usual.root_per_m, usual.root_per_rad, weights)


def local_tree(tree: TwistTree, balls: BallJoints, pose: TreePose) -> LocalTree:
    """The tree at rest where it is in a pose."""
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
