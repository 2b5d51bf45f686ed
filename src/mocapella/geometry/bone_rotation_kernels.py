"""Kernels of `mocapella.geometry.bone_rotations`: rotations of a skeleton's joints. Importing this imports numba."""

# ruff: noqa: PLR0917 - kernels take arrays by position
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.geometry.alignment_kernels import rotation_of

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

_OPPOSITE = -1.0 + 1e-9
"""Cosine of the least angle between opposite directions."""
_TINY = 1e-9


@njit(cache=True, nogil=True, error_model="numpy")
def swing(start: Float64, end: Float64, S: Float64) -> None:
    """Write the shortest rotation S (3, 3) from one direction to another, both of unit length.

    Between opposite ones, it is half a turn about one of the axes across. A zero ``end`` turns nothing.
    """
    for i in range(3):
        for k in range(3):
            S[i, k] = 0.0
    cosine = start[0] * end[0] + start[1] * end[1] + start[2] * end[2]
    length2 = end[0] * end[0] + end[1] * end[1] + end[2] * end[2]
    if not length2 > 0.25:
        S[0, 0] = S[1, 1] = S[2, 2] = 1.0
    elif cosine > _OPPOSITE:
        x = start[1] * end[2] - start[2] * end[1]
        y = start[2] * end[0] - start[0] * end[2]
        z = start[0] * end[1] - start[1] * end[0]
        h = 1.0 / (1.0 + cosine)  # O. Rodrigues
        S[0, 0], S[0, 1], S[0, 2] = 1.0 - h * (y * y + z * z), h * x * y - z, h * x * z + y
        S[1, 0], S[1, 1], S[1, 2] = h * x * y + z, 1.0 - h * (x * x + z * z), h * y * z - x
        S[2, 0], S[2, 1], S[2, 2] = h * x * z - y, h * y * z + x, 1.0 - h * (x * x + y * y)
    else:
        least = 0
        for i in range(1, 3):
            if abs(start[i]) < abs(start[least]):
                least = i
        a, b = (least + 1) % 3, (least + 2) % 3
        axis = np.empty(3)  # start × the coordinate axis that it is least along
        axis[least], axis[a], axis[b] = 0.0, start[b], -start[a]
        length = math.sqrt(axis[a] * axis[a] + axis[b] * axis[b])
        for i in range(3):
            for k in range(3):
                S[i, k] = 2.0 * axis[i] * axis[k] / (length * length) - (1.0 if i == k else 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def swings(start: Float64, end: Float64, S: Float64) -> None:
    """Write the shortest rotations (n, 3, 3) from directions to others, both (n, 3); see `swing`."""
    for i in range(len(start)):
        swing(start[i], end[i], S[i])


@njit(cache=True, nogil=True, error_model="numpy")
def _direction(start: Float64, end: Float64, out: Float64) -> None:
    """Write the unit direction from a point to another; 0 between equal ones."""
    length2 = 0.0
    for i in range(3):
        out[i] = end[i] - start[i]
        length2 += out[i] * out[i]
    length = math.sqrt(length2)
    for i in range(3):
        out[i] = out[i] / length if length > _TINY else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _fit(
    joint: int, first: Int64, children: Int64, rest: Float64, weights: Float64, p: Float64, S: Float64, R: Float64
) -> None:
    """Write the rotation R (3, 3) that best turns several bones of a joint from rest to their ends p (joints, 3).

    S (3, 3) is overwritten.
    """
    measured = np.empty(3)
    for i in range(3):
        for k in range(3):
            S[i, k] = 0.0
    for bone in range(first[joint], first[joint + 1]):
        _direction(p[joint], p[children[bone]], measured)
        for i in range(3):
            for k in range(3):
                S[i, k] += weights[bone] * rest[bone, i] * measured[k]
    rotation_of(S, R)


@njit(cache=True, nogil=True, error_model="numpy")
def joint_rotations(
    parents: Int64, first: Int64, children: Int64, rest: Float64, weights: Float64, positions: Float64, R: Float64
) -> None:
    """Write the rotation of each joint in each frame; see `bone_rotations.joint_rotations`.

    Args:
        parents: (joints,) index of each joint's parent, which is smaller; −1 for the root.
        first: (joints + 1,) index of each joint's first bone, and the number of bones.
        children: (bones,) joint at the end of each bone that determines a rotation.
        rest, weights: (bones, 3) and (bones,) unit direction at rest, and weight.
        positions: (frames, joints, 3) measured positions.
        R: (frames, joints, 3, 3) written.
    """
    S, start, measured, before = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty((3, 3))
    for f in range(len(positions)):
        for j in range(len(parents)):
            bone = first[j]
            if first[j + 1] - bone > 1:
                _fit(j, first, children, rest, weights, positions[f], S, R[f, j])
                continue
            for i in range(3):
                for k in range(3):
                    before[i, k] = R[f, parents[j], i, k] if parents[j] >= 0 else (1.0 if i == k else 0.0)
                    R[f, j, i, k] = before[i, k]
            if bone == first[j + 1]:
                continue
            _direction(positions[f, j], positions[f, children[bone]], measured)
            for i in range(3):
                start[i] = before[i, 0] * rest[bone, 0] + before[i, 1] * rest[bone, 1] + before[i, 2] * rest[bone, 2]
            swing(start, measured, S)
            for i in range(3):
                for k in range(3):
                    R[f, j, i, k] = S[i, 0] * before[0, k] + S[i, 1] * before[1, k] + S[i, 2] * before[2, k]
