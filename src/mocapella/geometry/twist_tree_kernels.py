"""Forward kinematics of a tree of twists. Importing this module imports numba."""

# ruff: noqa: PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.geometry.turn_kernels import FIRST, turned

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]


@njit(cache=True)
def forward(
    parents: Int64, joint_parts: Int64, twists: Float64, T: Float64, angles: Float64, about: Float64, R: Float64,
    t: Float64, xi: Float64,
) -> None:  # fmt: skip
    """Compute the motions of a tree's parts, and the joints' twists in the pose, as products of exponentials.

    A part without joints moves with its parent.

    R. Murray, Z. Li, S. Sastry, *A Mathematical Introduction to Robotic Manipulation* (1994), section 3.2.

    Args:
        parents, joint_parts, twists: (parts,), (joints,) and (joints, 6) of `TwistTree`.
        T: (4, 4) the root's motion from rest into the world.
        angles: (joints,) [rad].
        about: (3,) world point [m]; the written translations and twists refer to it as origin, with the world's axes;
            (0, 0, 0) for the world's own.
        R: (parts, 9) written: rotations from rest, row by row.
        t: (parts, 3) written: translations [m].
        xi: (joints, 6) written: twists in the pose, translation [m] per radian, then the unit axis.
    """
    new, j = np.empty(9), 0
    for p in range(len(parents)):
        k = parents[p]
        if k < 0:
            for i in range(3):
                R[p, 3 * i], R[p, 3 * i + 1], R[p, 3 * i + 2] = T[i, 0], T[i, 1], T[i, 2]
                t[p, i] = T[i, 3] - about[i]
        else:
            for i in range(9):
                R[p, i] = R[k, i]
            for i in range(3):
                t[p, i] = t[k, i]
        B, o = R[p], t[p]
        while j < len(joint_parts) and joint_parts[j] == p:
            v0, v1, v2, a, b, c = twists[j, 0], twists[j, 1], twists[j, 2], twists[j, 3], twists[j, 4], twists[j, 5]
            q0, q1, q2 = b * v2 - c * v1, c * v0 - a * v2, a * v1 - b * v0  # of the axis, nearest to the origin
            x, y, z = B[0] * a + B[1] * b + B[2] * c, B[3] * a + B[4] * b + B[5] * c, B[6] * a + B[7] * b + B[8] * c
            u = B[0] * q0 + B[1] * q1 + B[2] * q2 + o[0]
            v = B[3] * q0 + B[4] * q1 + B[5] * q2 + o[1]
            w = B[6] * q0 + B[7] * q1 + B[8] * q2 + o[2]
            xi[j, 0], xi[j, 1], xi[j, 2] = v * z - w * y, w * x - u * z, u * y - v * x
            xi[j, 3], xi[j, 4], xi[j, 5] = x, y, z
            angle = angles[j]
            turned(B, FIRST, angle * a, angle * b, angle * c, new)
            for i in range(9):
                B[i] = new[i]
            o[0] = u - (B[0] * q0 + B[1] * q1 + B[2] * q2)
            o[1] = v - (B[3] * q0 + B[4] * q1 + B[5] * q2)
            o[2] = w - (B[6] * q0 + B[7] * q1 + B[8] * q2)
            j += 1
