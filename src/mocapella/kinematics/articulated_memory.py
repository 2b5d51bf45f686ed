"""Layout of the row of numbers that keeps one body's state between frames.

The state of the filter is the pose, its velocity, and for each degree of freedom the covariance of both. Correlations
between degrees of freedom are not kept from frame to frame.
"""

from __future__ import annotations

from typing import NamedTuple

AT, SEEN, STARTED, LOST_SINCE, RESTLESS, SCALE, SCALE_VARIANCE = 0, 1, 2, 3, 4, 5, 6
"""Columns at the head of a row.

They are its instant [s], the capture time of the body's last measurement [s], 1 once the body is initialised, since
when it is lost (NaN: it is not) [s], the recent average of the innovations over their expectation, and the factor of
all bone lengths with its variance (`mocapella.kinematics.articulated_scale_kernels`).
"""
HEAD = 8
"""Numbers reserved for the head."""


class MemoryLayout(NamedTuple):
    """Counts of a body model, and the index in a row at which each array begins.

    Attributes:
        dofs: number of degrees of freedom.
        balls: number of ball joints, the root included.
        joints: number of joints.
        lengths: number of bone lengths; the two sides of the body share theirs.
        angles: (dofs,) the root's position [m], three unused, and the hinges' angles [rad]; unused for balls.
        velocities: (dofs,) velocity of the root along the world's axes [m/s], and of every rotation about its own axes
            [rad/s].
        variance: (dofs,) variance of each degree of freedom [m² or rad²]; the root's along its own axes.
        covariance: (dofs,) covariance of each degree of freedom with its velocity [m²/s or rad²/s].
        speed_variance: (dofs,) variance of the velocity [m²/s² or rad²/s²].
        rotations: (balls, 3, 3) rotations of the ball joints, the root's first.
        bones: (lengths,) bone lengths [m].
        learnt: (lengths,) duration over which each length was learnt [s].
        contacts: (contacts, 6) position of a joint that may be in contact [m], and its smoothed velocity [m/s].
        jumps: (joints, 4) the last innovation [m], NaN where the joint was not measured, and the variance of a
            coordinate that is estimated from the innovations' successive differences [m²].
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
    contacts: int
    jumps: int
    size: int


def memory_layout(dofs: int, balls: int, joints: int, lengths: int, contacts: int) -> MemoryLayout:
    """Lay out the arrays of a body one after the other, behind the head.

    Args:
        dofs, balls, joints, lengths, contacts: the numbers of `MemoryLayout`.
    """
    starts = [HEAD]
    for size in (dofs, dofs, dofs, dofs, dofs, 9 * balls, lengths, lengths, 6 * contacts, 4 * joints):
        starts.append(starts[-1] + size)
    return MemoryLayout(dofs, balls, joints, lengths, *starts)
