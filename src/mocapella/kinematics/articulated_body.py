"""Filter one articulated body without a tracker, and read the pose from a body's memory.

The filter is an iterated extended Kalman filter in joint space, see `articulated_kernels` and
docs/methods/articulated.md. A body's *memory* is its state: pose, velocity, covariance and bone lengths.
"""

from __future__ import annotations

import re
from functools import cache
from types import ModuleType
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.kinematics import articulated_memory as at
from mocapella.kinematics.articulated_memory import Rigidity
from mocapella.kinematics.articulated_model import ArticulatedModel, ArticulatedSettings, memory_size
from mocapella.model.topology import Topology

Float64 = NDArray[np.float64]

LEAST_REPORTED: Final = np.radians(40.0)
"""Smallest reported widening of a joint's limits: badly seen arms reach 30° [rad]."""
STEP_DEG: Final = 10
"""Reported angles are multiples of this [degrees], so that a report changes rarely."""


class Estimate(msgspec.Struct, frozen=True, eq=False):
    """The estimated joints of a body at an instant.

    Attributes:
        at_s: the instant, on the clock of the capture times [s].
        positions: (joints, 3) world [m]; NaN where the body is not known.
        variances: (joints,) variance of a coordinate [m²]; NaN where the body is not known.
    """

    at_s: float
    positions: Float64
    variances: Float64


class Pose(msgspec.Struct, frozen=True, eq=False):
    """The pose of a body.

    Attributes:
        position: (3,) root in the world [m].
        rotations: (balls, 3, 3) rotations of the ball joints, the root's first: from the bone's frame to its parent's,
            the root's to the world.
        angles: (dofs,) angles of the hinges, each at the index of its degree of freedom [rad]; unused elsewhere.
        lengths: (lengths,) bone lengths [m]; the two sides of the body share theirs.
    """

    position: Float64
    rotations: Float64
    angles: Float64
    lengths: Float64


class ArticulatedBody:
    """Filter of one body. Equal inputs give equal outputs, to the bit.

    Args:
        topology: the skeleton, which must have a body model.
        settings: process noise and thresholds; the defaults if None.

    Attributes:
        model: the body model and the settings.
        memory: (1, memory_size) the body's state, see `articulated_memory`; updated in place.

    Raises:
        SettingsError: the topology has no body model.
    """

    def __init__(self, topology: Topology, settings: ArticulatedSettings | None = None) -> None:
        self.model = ArticulatedModel.of(topology, settings)
        self.reset()

    def reset(self) -> None:
        """Forget the body."""
        self.memory: Float64 = np.full((1, memory_size(self.model)), np.nan)

    def update(self, positions: Any, variances: Any, at_s: float) -> Estimate:
        """Update the body with the measurements of one instant.

        Args:
            positions: (joints, 3) world [m]; NaN where a joint is not measured.
            variances: (joints,) variance of a coordinate [m²]; not finite where a joint is not measured.
            at_s: capture time [s]; a time before the last update's counts as that of the last update.

        Returns:
            All joints at the instant that ``at_s`` counts as, including unmeasured ones; all NaN until enough joints
            initialise the body, and after ``forget_after_s`` without measurements.
        """
        joints = len(self.model.order)
        x, v = np.empty((joints, 3)), np.empty(joints)
        measured = np.ascontiguousarray(positions, dtype=np.float64).reshape(joints, 3)
        sure = np.ascontiguousarray(variances, dtype=np.float64).reshape(joints)
        rigid = Rigidity(1.0, self.model.parameters.scale_sd)
        _kernels().correct(self.model.arrays, self.memory[0], float(at_s), measured, sure, rigid, x, v)
        return Estimate(self._instant(at_s), x, v)

    def predict(self, at_s: float) -> Estimate:
        """Predict the body at an instant, on the clock of the capture times [s], without changing it.

        A time before the last update's counts as that of the last update. All is NaN while the body is not known, and
        later than ``forget_after_s`` after its last measurement.
        """
        joints = len(self.model.order)
        x, v = np.empty((joints, 3)), np.empty(joints)
        _kernels().predict(self.model.arrays, self.memory[0], float(at_s), x, v)
        return Estimate(self._instant(at_s), x, v)

    def _instant(self, at_s: float) -> float:
        """Return the instant that the kernels compute for ``at_s`` [s]: not before the memory's, NaN for a new body."""
        return float(np.fmax(at_s, self.memory[0, at.AT]))

    def move(self, T_new_old: Float64) -> None:
        """Transform the state to another world frame, by a rigid motion (4, 4) from the old to the new world."""
        move(self.model, self.memory, T_new_old)

    @property
    def pose(self) -> Pose | None:
        """The pose at the last update, copied; None until a body is initialised."""
        return pose_of(self.model, self.memory[0])


def move(model: ArticulatedModel, memory: Float64, T_new_old: Float64) -> None:
    """Transform the states of all bodies to another world frame, in place.

    Args:
        model: the body model.
        memory: (people, memory_size) a state in each row, changed.
        T_new_old: (4, 4) rigid motion from the old to the new world.
    """
    _kernels().move(model.layout, memory, np.ascontiguousarray(T_new_old, dtype=np.float64))


def pose_of(model: ArticulatedModel, row: Float64) -> Pose | None:
    """Copy the pose from a body's memory.

    Args:
        model: the body model.
        row: (memory_size,) the body's memory, laid out by `ArticulatedModel.layout`.

    Returns:
        The pose at the memory's instant; None if the body is not initialised.
    """
    if row[at.STARTED] != 1.0:
        return None
    starts = model.layout
    angles = row[starts.angles : starts.velocities].copy()
    rotations = row[starts.rotations : starts.bones].reshape(-1, 3, 3).copy()
    return Pose(angles[:3].copy(), rotations, angles, row[starts.bones : starts.learnt].copy())


def row_of(model: ArticulatedModel, pose: Pose) -> Float64:
    """Return a new memory row (memory_size,) that holds only a pose, for kernels that read poses.

    Limits have no slack; all else is NaN.
    """
    starts = model.layout
    row = np.full(starts.size, np.nan)
    row[starts.angles : starts.velocities] = pose.angles
    row[starts.angles : starts.angles + 3] = pose.position
    row[starts.rotations : starts.bones] = pose.rotations.reshape(-1)
    row[starts.bones : starts.learnt] = pose.lengths
    row[starts.slack : starts.demands] = 0.0
    return row


def joints(model: ArticulatedModel, pose: Pose) -> Float64:
    """Compute the joints of a pose, by forward kinematics: (joints, 3) world [m]."""
    count = len(model.order)
    x, frames, no_twists = np.empty((count, 3)), np.empty((count, 9)), np.empty((0, 6))
    _kernels().forward(model.arrays, row_of(model, pose), np.zeros(3), x, frames, no_twists)
    return x


def hinge_angles(model: ArticulatedModel, pose: Pose) -> dict[str, float]:
    """Return the hinges' angles by their names in the body model [rad]."""
    named: dict[str, float] = {}
    for joint, bone in model.body.bones.items():
        first = int(model.joint_table[joint, 1])
        for k, hinge in enumerate(bone.hinges):
            named[hinge.name] = float(pose.angles[first + k])
    return named


def ball_rotations(model: ArticulatedModel, pose: Pose) -> dict[str, Float64]:
    """Return the ball joints' rotations (3, 3) from bone to parent frame by their names, and that of the ``root``.

    The root's is from its frame to the world. All are views into ``pose.rotations``.
    """
    named = {"root": pose.rotations[0]}
    for joint, bone in model.body.bones.items():
        if bone.ball is not None:
            named[bone.ball.name] = pose.rotations[int(model.joint_table[joint, 3])]
    return named


def bone_lengths(model: ArticulatedModel, pose: Pose) -> Float64:
    """Return the length (joints,) of the bone that ends at each joint [m]; 0 for the root."""
    at_joint = model.joint_table[:, 4]
    return np.where(at_joint >= 0, pose.lengths[at_joint], 0.0)


def conditions_of(model: ArticulatedModel, memory: Float64) -> list[str]:
    """Return for each body which joints' limits measurements have widened, by how many degrees; empty texts if none.

    Shoulders and hips are left out: the fusion turns them to the facing, so their angles are not the sensors' alone.
    Elbows are, too: one that bends backwards has the joints of an upper arm turned about itself, within its limits.

    Args:
        model: the body model.
        memory: (people, memory_size) states of the bodies.
    """
    slack = memory[:, model.layout.slack : model.layout.demands]
    beyond = slack > LEAST_REPORTED  # False for NaN
    if not beyond.any():
        return [""] * len(memory)
    balls, parents, twist = model.joint_table[:, 3], model.joint_table[:, 0], model.joint_values[:, 8:10]
    turns = (balls[parents] > 0) & (np.abs(twist[parents]).min(axis=1) > np.pi / 2)
    beyond &= (balls < 0) & ~turns
    return [
        ", ".join(_condition(model, j, one[j]) for j in np.flatnonzero(far).tolist())
        for one, far in zip(slack, beyond, strict=True)
    ]


def words_of(joint: str) -> str:
    """Return a joint's name in words: ``left knee`` of ``KneeLeft``."""
    side = next((side for side in ("Left", "Right") if joint.endswith(side)), "")
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", f"{side} {joint.removesuffix(side)}".strip()).lower()


def _condition(model: ArticulatedModel, joint: int, slack: float) -> str:
    """Describe by how much measurements are beyond the limits of the joint at the beginning of a bone."""
    name = model.body.topology.joints[model.joint_table[joint, 0]]
    degrees = STEP_DEG * round(np.degrees(slack) / STEP_DEG)
    return f"{words_of(name)}: sensors and body model disagree by {degrees}°"


@cache
def _kernels() -> ModuleType:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.kinematics import articulated_kernels

    return articulated_kernels
