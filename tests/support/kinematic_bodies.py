"""Bodies of the model itself, in any pose, for the tests of this room."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocapella.kinematics.articulated_body import Pose, joints
from mocapella.kinematics.articulated_model import ABOUT, OF_BALL, ArticulatedModel, ArticulatedSettings
from mocapella.model.topology import topology

Float64 = NDArray[np.float64]

KINECT = topology("kinect_v2")
MODEL = ArticulatedModel.of(KINECT)
DOFS = len(MODEL.dof_kind)
VARIANCES = np.full(len(KINECT), 0.01**2)


def model(**settings: float) -> ArticulatedModel:
    return ArticulatedModel.of(KINECT, ArticulatedSettings(**settings))  # type: ignore[arg-type]


def lengths(stature: float) -> Float64:
    """(lengths,) of somebody of the template's proportions [m]."""
    values = np.zeros(int(MODEL.layout[3]))
    for joint in range(len(KINECT)):
        if MODEL.joint_table[joint, 4] >= 0:
            values[MODEL.joint_table[joint, 4]] = stature * MODEL.joint_values[joint, 3]
    return values


def pose(rng: np.random.Generator, stature: float = 1.75, bent: float = 0.4) -> Pose:
    """Somebody anywhere, facing anywhere, with every angle a share of its range from its rest."""
    angles = np.zeros(DOFS)
    hinge = (MODEL.dof_kind >= ABOUT) & (MODEL.dof_kind < OF_BALL)
    low, high = MODEL.dof_values[hinge, 0], MODEL.dof_values[hinge, 1]
    angles[hinge] = bent * rng.uniform(low, high)
    turns = rng.normal(0.0, bent, (int(MODEL.layout[1]), 3))
    turns[0] = 0.0, rng.uniform(-3.0, 3.0), 0.0
    rotations = Rotation.from_rotvec(turns).as_matrix()
    return Pose(rng.normal(0.0, 1.0, 3), rotations, angles, lengths(stature))


def standing(stature: float = 1.75, yaw: float = 0.0) -> Float64:
    """(25, 3) joints of somebody who stands with hanging arms, knees and elbows a little bent [m]."""
    angles = np.zeros(DOFS)
    for joint, angle in (("AnkleLeft", 0.2), ("AnkleRight", 0.2), ("WristLeft", -0.4), ("WristRight", 0.4)):
        angles[MODEL.joint_table[KINECT.index(joint), 1]] = angle
    rotations = np.tile(np.eye(3), (int(MODEL.layout[1]), 1, 1))
    rotations[0] = Rotation.from_rotvec((0.0, yaw, 0.0)).as_matrix()
    for joint, angle in (("ElbowLeft", -1.3), ("ElbowRight", 1.3)):
        rotations[MODEL.joint_table[KINECT.index(joint), 3]] = Rotation.from_rotvec((0.0, 0.0, angle)).as_matrix()
    return joints(MODEL, Pose(np.array([0.1, 0.9, 2.5]), rotations, angles, lengths(stature)))
