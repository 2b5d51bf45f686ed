"""One articulated body over time, for whoever has no tracker; and what its memory says of its pose."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from types import ModuleType
from typing import Any, cast

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.kinematics import articulated_memory as at
from mocapella.kinematics.articulated_model import ArticulatedModel, ArticulatedSettings, memory_size
from mocapella.model.topology import Topology

Float64 = NDArray[np.float64]


class Estimate(msgspec.Struct, frozen=True, eq=False):
    """Where a body is.

    Attributes:
        at_s: the instant [s].
        positions: (joints, 3) [m]; NaN where the body is not known.
        variances: (joints,) of a coordinate [m²]; NaN where the body is not known.
    """

    at_s: float
    positions: Float64
    variances: Float64


class Pose(msgspec.Struct, frozen=True, eq=False):
    """How a body stands.

    Attributes:
        position: (3,) of the root [m].
        rotations: (balls, 3, 3) of the joints that turn every way, the root's first: from the bone's frame to that it
            hangs on, for the root the world's.
        angles: (dofs,) of the hinges [rad]; unused elsewhere.
        lengths: (lengths,) of the bones [m].
    """

    position: Float64
    rotations: Float64
    angles: Float64
    lengths: Float64


class ArticulatedBody:
    """The memory of one body. The same inputs give the same outputs, to the bit."""

    def __init__(self, topology: Topology, settings: ArticulatedSettings | None = None) -> None:
        self.model = ArticulatedModel.of(topology, settings)
        self.reset()

    def reset(self) -> None:
        """Forget everything, as if newly made."""
        self.memory: Float64 = np.full((1, memory_size(self.model)), np.nan)

    def update(self, positions: Any, variances: Any, at_s: float) -> Estimate:
        """Take in what was measured at an instant.

        Args:
            positions: (joints, 3) [m]; NaN where a joint is not seen.
            variances: (joints,) of a coordinate [m²]; not finite where a joint is not seen.
            at_s: when it was captured [s]; where it is before the last, the last is taken.

        Returns:
            The body at that instant, unseen joints too.
        """
        joints = len(self.model.order)
        x, v = np.empty((joints, 3)), np.empty(joints)
        measured = np.ascontiguousarray(positions, dtype=np.float64).reshape(joints, 3)
        sure = np.ascontiguousarray(variances, dtype=np.float64).reshape(joints)
        _kernels().correct(*self.model.arrays, self.memory[0], float(at_s), measured, sure, x, v)
        return Estimate(float(at_s), x, v)

    def predict(self, at_s: float) -> Estimate:
        """Where the body is at an instant [s], as far as is known now; changes nothing."""
        joints = len(self.model.order)
        x, v = np.empty((joints, 3)), np.empty(joints)
        _kernels().predict(*self.model.arrays, self.memory[0], float(at_s), x, v)
        return Estimate(float(at_s), x, v)

    def move(self, T_new_old: Float64) -> None:
        """Everything is told in another frame from now on: (4, 4), rigid."""
        move(self.model, self.memory, T_new_old)

    @property
    def pose(self) -> Pose | None:
        """How the body stood at the last update; None while it is not known."""
        return pose_of(self.model, self.memory[0])


def move(model: ArticulatedModel, memory: Float64, T_new_old: Float64) -> None:
    """Tell every body of memory (people, memory_size) in another frame from now on, in place: (4, 4), rigid."""
    _kernels().move(model.layout, memory, np.ascontiguousarray(T_new_old, dtype=np.float64))


def pose_of(model: ArticulatedModel, row: Float64) -> Pose | None:
    """The pose in a person's memory (memory_size,); None while the body is not known."""
    if row[at.STARTED] != 1.0:
        return None
    starts = model.layout
    angles = row[starts[at.ANGLES] : starts[at.VELOCITIES]].copy()
    rotations = row[starts[at.ROTATIONS] : starts[at.BONES]].reshape(-1, 3, 3).copy()
    return Pose(angles[:3].copy(), rotations, angles, row[starts[at.BONES] : starts[at.LEARNT]].copy())


def joints(model: ArticulatedModel, pose: Pose) -> Float64:
    """Forward kinematics: (joints, 3) of a pose [m]."""
    count, dofs = len(model.order), int(model.layout[at.DOFS])
    x, frames, twists = np.empty((count, 3)), np.empty((count, 9)), np.empty((dofs, 6))
    angles = pose.angles.copy()
    angles[:3] = pose.position
    balls = np.ascontiguousarray(pose.rotations).reshape(-1, 9)
    _forward()(
        model.dof_kind, model.joint_table, model.joint_values, model.order, angles, balls, pose.lengths, np.zeros(3), x,
        frames, twists,
    )  # fmt: skip
    return x


def hinge_angles(model: ArticulatedModel, pose: Pose) -> dict[str, float]:
    """The angles of the hinges by their names in the body model [rad]."""
    named: dict[str, float] = {}
    for joint, bone in model.body.bones.items():
        first = int(model.joint_table[joint, 1])
        for k, hinge in enumerate(bone.hinges):
            named[hinge.name] = float(pose.angles[first + k])
    return named


def ball_rotations(model: ArticulatedModel, pose: Pose) -> dict[str, Float64]:
    """The rotations (3, 3) of the joints that turn every way, by their names in the body model, and of the ``root``."""
    named = {"root": pose.rotations[0]}
    for joint, bone in model.body.bones.items():
        if bone.ball is not None:
            named[bone.ball.name] = pose.rotations[int(model.joint_table[joint, 3])]
    return named


def bone_lengths(model: ArticulatedModel, pose: Pose) -> Float64:
    """(joints,) of the bone that ends at each joint [m]; 0 for the root."""
    at_joint = model.joint_table[:, 4]
    return np.where(at_joint >= 0, pose.lengths[at_joint], 0.0)


@cache
def _kernels() -> ModuleType:
    """Compiled; numba is imported when it is first needed."""
    from mocapella.kinematics import articulated_kernels

    return articulated_kernels


@cache
def _forward() -> Callable[..., None]:
    from mocapella.kinematics import chain_kernels

    return cast(Callable[..., None], chain_kernels.forward)
