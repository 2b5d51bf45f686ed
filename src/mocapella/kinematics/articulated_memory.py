"""Layout of a body's *memory*: the row of numbers that holds the state of its filter between frames.

The state is the pose, its velocity, and for each degree of freedom the 2 × 2 covariance of both. Correlations between
degrees of freedom are not kept from frame to frame.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]

AT, SEEN, STARTED, LOST_SINCE, RESTLESS, SCALE, SCALE_VARIANCE = 0, 1, 2, 3, 4, 5, 6
"""Indices of the first numbers of a row.

They are the time of the state [s], the capture time of the last measurement [s], 1 once the body is initialised, the
time since which it is lost (NaN: it is not) [s], the averaged surprise (`ArticulatedSettings.surprise_s`), and the
common factor of all bone lengths and its variance (`mocapella.kinematics.articulated_scale_kernels`).
"""
HEAD = 8
"""Index at which the arrays of `MemoryLayout` begin."""


class MemoryLayout(NamedTuple):
    """Counts of a body model, and the index in a row at which each array begins.

    Attributes:
        dofs: number of degrees of freedom.
        balls: number of ball joints, the root included.
        joints: number of joints.
        lengths: number of bone lengths; the two sides of the body share theirs.
        angles: (dofs,) the root's position, world [m], and the hinges' angles [rad]; unused for ball joints.
        velocities: (dofs,) velocity of the root along the world's axes [m/s], and of every rotation about its own axes
            [rad/s].
        variance: (dofs,) variance of each degree of freedom [m² or rad²]; the root's along its own axes.
        covariance: (dofs,) covariance of each degree of freedom with its velocity [m²/s or rad²/s].
        speed_variance: (dofs,) variance of the velocity [m²/s² or rad²/s²].
        rotations: (balls, 3, 3) rotations of the ball joints, the root's first.
        bones: (lengths,) bone lengths [m].
        learnt: (lengths,) duration over which each length was learnt [s].
        strains: (lengths,) recent average of the deviation of each measured length from the learnt one, in standard
            deviations, limited to ±2 a frame.
        slack: (joints,) angle added to the limits of each joint [rad].
        demands: (joints,) recent average of the angle that a joint's limits held it back in a frame [rad].
        ages: (2, joints, 4) for how long each joint has not been triangulated [s], and its last innovation, in standard
            deviations; then the age of the last ray that saw the joint alone [s], NaN without, and its direction. Only
            in bodies that are measured by rays.
        contacts: (contacts, 6) last position of each joint that may touch the floor, such as a foot, world [m], and its
            smoothed velocity [m/s].
        jumps: (joints, 4) the last innovation [m], NaN where the joint was not measured, and the noise variance of a
            coordinate, estimated from successive differences of the innovations [m²].
        size: length of the row.
    """

    dofs: int
    balls: int
    joints: int
    lengths: int
    angles: int
    velocities: int
    variance: int
    covariance: int
    speed_variance: int
    rotations: int
    bones: int
    learnt: int
    strains: int
    slack: int
    demands: int
    ages: int
    contacts: int
    jumps: int
    size: int


def memory_layout(dofs: int, balls: int, joints: int, lengths: int, contacts: int, *, ages: int = 0) -> MemoryLayout:
    """Lay out the arrays of a body one after the other, from index `HEAD` on.

    Args:
        dofs, balls, joints, lengths: counts as of `MemoryLayout`.
        contacts: number of joints that may touch the floor.
        ages: number of joints whose ages are kept: all of a body that is measured by rays, else 0.
    """
    starts = [HEAD]
    for size in (
        dofs,
        dofs,
        dofs,
        dofs,
        dofs,
        9 * balls,
        lengths,
        lengths,
        lengths,
        joints,
        joints,
        8 * ages,
        6 * contacts,
        4 * joints,
    ):
        starts.append(starts[-1] + size)
    return MemoryLayout(dofs, balls, joints, lengths, *starts)


class Rigidity(NamedTuple):
    """How rigid measured skeletons are; see `mocapella.model.topology.Topology`.

    Attributes:
        noise: factor of the standard deviations of the joints, and of their misfits [ratio].
        scale_sd: standard deviation of the common factor of all bone lengths; 0 lets it return to 1 [ratio].
    """

    noise: float
    scale_sd: float


class Measurements(NamedTuple):
    """The joints of one frame, in the world, and intermediate results that `correct` writes.

    Attributes:
        positions: (joints, 3) measured [m]; NaN where not measured.
        variances: (joints,) variance of a coordinate [m²]; not finite where not measured.
        share: factor of the variances and of the joints' squared misfits [ratio].
        residuals: (joints, 3) measured − estimated [m]; undefined where not measured. Written.
        weights: (joints,) information [1/m²], the robust weight included; 0 where not measured. Written.
        robust: (joints,) weights of the robust loss, from 0 to 1; 0 where not measured. Written.
    """

    positions: Float64
    variances: Float64
    share: float
    residuals: Float64
    weights: Float64
    robust: Float64
