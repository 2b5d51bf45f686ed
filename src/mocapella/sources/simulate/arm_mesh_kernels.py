"""Compiled kernels of `mocapella.sources.simulate.arm_mesh`; importing this module imports numba.

Forward kinematics of the arm's bones, and dual quaternion skinning.
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position
from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Float64 = NDArray[np.float64]
Integers = NDArray[np.integer[Any]]

# Literal arguments of a kernel would have types of their own, and numba would compile it once for each.
_X, _Y, _Z = np.int64(0), np.int64(1), np.int64(2)


@njit(cache=True)
def turned(R: Float64, axis: int, angle: float) -> None:
    """Rotate ``R`` (3, 3) by an angle [rad] about its own x (0), y (1) or z (2), in place: R · rotation(angle)."""
    c, s = math.cos(angle), math.sin(angle)
    u, v = (axis + 1) % 3, (axis + 2) % 3
    for i in range(3):
        a, b = R[i, u], R[i, v]
        R[i, u], R[i, v] = c * a + s * b, c * b - s * a


@njit(cache=True)
def _place(point: Float64, p: Float64) -> None:
    """Copy p (3,) into ``point`` (3,)."""
    for i in range(3):
        point[i] = p[i]


@njit(cache=True)
def _stand(bone: Float64, R: Float64, p: Float64) -> None:
    """Write rotation R (3, 3) and position p (3,) into ``bone`` (3, 4)."""
    for i in range(3):
        for k in range(3):
            bone[i, k] = R[i, k]
        bone[i, 3] = p[i]


@njit(cache=True)
def arm_frames(
    digit_frames: Float64, which: Integers, bases: Float64, lengths: Float64, upper_m: float, forearm_m: float,
    joints: Float64, angles: Float64, bones: Float64, points: Float64,
) -> None:  # fmt: skip
    """Write the poses of a right arm's bones and the positions of its joints, in the shoulder's frame.

    Args:
        digit_frames: (5, 3, 3) of `HandModel.frames`.
        which: (5, 5) indices in ``angles``, see `mocapella.model.hand.DIGIT_ANGLES`.
        bases, lengths: (5, 3) of `HandShape` [m].
        upper_m, forearm_m: lengths of the upper arm and the forearm [m].
        joints: (4,) elbow flexion, pronation, wrist flexion, wrist deviation [rad].
        angles: (21,) angles of the hand, in the order of `mocapella.model.hand.ANGLES` [rad].
        bones: (19, 3, 4) ``T_shoulder_bone``, written: upper arm, forearm at the elbow, forearm at the wrist, palm,
            then three of each digit. A bone's origin is its first joint; that of the forearm's second part is the
            wrist.
        points: (24, 3) written: 21 landmarks, middle of the palm, elbow, shoulder [m].
    """
    R, p = np.zeros((3, 3)), np.zeros(3)
    for i in range(3):
        R[i, i] = 1.0
    _place(points[23], p)
    p[2] = upper_m
    _place(points[22], p)
    _stand(bones[0], R, p)
    turned(R, _Y, joints[0])
    _stand(bones[1], R, p)
    turned(R, _Z, -joints[1])
    for i in range(3):
        p[i] += forearm_m * R[i, 2]
    _stand(bones[2], R, p)
    turned(R, _Y, joints[3])
    turned(R, _X, joints[2])
    _stand(bones[3], R, p)
    _place(points[0], p)
    Q, q = np.empty((3, 3)), np.empty(3)
    for d in range(5):
        for i in range(3):
            q[i] = p[i]
            for k in range(3):
                q[i] += R[i, k] * bases[d, k]
                Q[i, k] = R[i, 0] * digit_frames[d, 0, k] + R[i, 1] * digit_frames[d, 1, k]
                Q[i, k] += R[i, 2] * digit_frames[d, 2, k]
        for bone in range(3):
            _place(points[1 + 4 * d + bone], q)
            if bone == 0:
                turned(Q, _Y, angles[which[d, 1]])
            elif bone == 1 and which[d, 4] >= 0:
                turned(Q, _Y, angles[which[d, 4]])
            turned(Q, _X, angles[which[d, 0 if bone == 0 else bone + 1]])
            _stand(bones[4 + 3 * d + bone], Q, q)
            for i in range(3):
                q[i] += lengths[d, bone] * Q[i, 2]
        _place(points[4 + 4 * d], q)
    for i in range(3):
        points[21, i] = 0.5 * (points[0, i] + points[9, i])


@njit(cache=True)
def dual_quaternions(bones: Float64, at_rest: Float64, out: Float64) -> None:
    """Convert the bones' motions from the rest pose to dual quaternions.

    Args:
        bones, at_rest: (b, 3, 4) poses of the bones in the present and in the rest pose, in one frame [m].
        out: (b, 8) written: the rotation w, x, y, z, then the dual part.
    """
    M = np.empty((3, 3))
    for n in range(len(bones)):
        T, S = bones[n], at_rest[n]
        for i in range(3):
            for k in range(3):
                M[i, k] = T[i, 0] * S[k, 0] + T[i, 1] * S[k, 1] + T[i, 2] * S[k, 2]
        t0 = T[0, 3] - M[0, 0] * S[0, 3] - M[0, 1] * S[1, 3] - M[0, 2] * S[2, 3]
        t1 = T[1, 3] - M[1, 0] * S[0, 3] - M[1, 1] * S[1, 3] - M[1, 2] * S[2, 3]
        t2 = T[2, 3] - M[2, 0] * S[0, 3] - M[2, 1] * S[1, 3] - M[2, 2] * S[2, 3]
        trace = M[0, 0] + M[1, 1] + M[2, 2]
        if trace > 0.0:  # Shepperd 1978: divide by a large one of the four
            s = 2.0 * math.sqrt(trace + 1.0)
            w, x, y, z = 0.25 * s, (M[2, 1] - M[1, 2]) / s, (M[0, 2] - M[2, 0]) / s, (M[1, 0] - M[0, 1]) / s
        elif M[0, 0] >= M[1, 1] and M[0, 0] >= M[2, 2]:
            s = 2.0 * math.sqrt(1.0 + M[0, 0] - M[1, 1] - M[2, 2])
            w, x, y, z = (M[2, 1] - M[1, 2]) / s, 0.25 * s, (M[0, 1] + M[1, 0]) / s, (M[0, 2] + M[2, 0]) / s
        elif M[1, 1] >= M[2, 2]:
            s = 2.0 * math.sqrt(1.0 + M[1, 1] - M[0, 0] - M[2, 2])
            w, x, y, z = (M[0, 2] - M[2, 0]) / s, (M[0, 1] + M[1, 0]) / s, 0.25 * s, (M[1, 2] + M[2, 1]) / s
        else:
            s = 2.0 * math.sqrt(1.0 + M[2, 2] - M[0, 0] - M[1, 1])
            w, x, y, z = (M[1, 0] - M[0, 1]) / s, (M[0, 2] + M[2, 0]) / s, (M[1, 2] + M[2, 1]) / s, 0.25 * s
        out[n, 0], out[n, 1], out[n, 2], out[n, 3] = w, x, y, z
        out[n, 4] = -0.5 * (t0 * x + t1 * y + t2 * z)
        out[n, 5] = 0.5 * (t0 * w + t1 * z - t2 * y)
        out[n, 6] = 0.5 * (t1 * w + t2 * x - t0 * z)
        out[n, 7] = 0.5 * (t2 * w + t0 * y - t1 * x)


@njit(cache=True)
def skin(vertices: Float64, bones_of: Integers, weights: Float64, motions: Float64, T: Float64, out: Float64) -> None:
    """Skin vertices with dual quaternions, and transform them by ``T``.

    L. Kavan, S. Collins, J. Zara, C. O'Sullivan, "Skinning with dual quaternions" (I3D 2007), section 4.

    Args:
        vertices: (n, 3) in the rest pose [m].
        bones_of, weights: (n, 4) indices of the bones that move a vertex, and their weights.
        motions: (bones, 8) of `dual_quaternions`.
        T: (3, 4) from the frame of the bones to that of the result.
        out: (n, 3) written [m].
    """
    q = np.empty(8)
    for i in range(len(vertices)):
        q[:] = 0.0
        first = motions[bones_of[i, 0]]
        for k in range(4):
            weight = weights[i, k]
            if weight == 0.0:
                continue
            m = motions[bones_of[i, k]]
            if first[0] * m[0] + first[1] * m[1] + first[2] * m[2] + first[3] * m[3] < 0.0:
                weight = -weight  # q and -q are the same rotation: take the nearer one
            for c in range(8):
                q[c] += weight * m[c]
        size = 1.0 / math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
        w, x, y, z = q[0] * size, q[1] * size, q[2] * size, q[3] * size
        dw, dx, dy, dz = q[4] * size, q[5] * size, q[6] * size, q[7] * size
        px, py, pz = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        cx, cy, cz = y * pz - z * py + w * px, z * px - x * pz + w * py, x * py - y * px + w * pz
        a = px + 2.0 * (y * cz - z * cy + w * dx - dw * x + y * dz - z * dy)
        b = py + 2.0 * (z * cx - x * cz + w * dy - dw * y + z * dx - x * dz)
        c = pz + 2.0 * (x * cy - y * cx + w * dz - dw * z + x * dy - y * dx)
        for r in range(3):
            out[i, r] = T[r, 0] * a + T[r, 1] * b + T[r, 2] * c + T[r, 3]
