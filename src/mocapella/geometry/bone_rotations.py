"""Rotations of a skeleton's bones from the positions of its joints, and forward kinematics.

A skeleton is a tree of joints; every joint carries the bones to its children. Arrays have leading batch axes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]
Floats = NDArray[np.floating]
Int64 = NDArray[np.int64]

_TINY: float = 1e-9


def joint_rotations(parents: Int64, offsets: Float64, positions: Floats) -> Float64:
    """Return the rotation of each joint that turns its bones, at rest along ``offsets``, to the measured ones.

    A joint with several bones has the rotation with the least squared error of their ends at the length at rest (W.
    Kabsch, Acta Cryst. A32, 1976, 922), computed by singular values, never a reflection. One with a single bone, or
    with parallel ones, has the parent's rotation, followed by the shortest rotation to the measured direction: the
    twist about the bone is not observed, and is zero. One without a bone has its parent's rotation.

    Args:
        parents: (joints,) index of each joint's parent, which is smaller than the joint's own; −1 for the root, which
            is the first.
        offsets: (joints, 3) position of each joint relative to its parent at rest, in any unit; unused for the root.
        positions: (..., joints, 3) measured positions; all known.

    Returns:
        (..., joints, 3, 3) rotations from the rest pose to the axes of ``positions``.
    """
    from mocapella.geometry import bone_rotation_kernels as kernels  # imports numba

    lengths = np.linalg.norm(offsets, axis=1)
    bones = [_determining(offsets, lengths, np.flatnonzero(parents == joint)) for joint in range(len(parents))]
    first = np.concatenate([[0], np.cumsum([len(own) for own in bones])])
    children = np.concatenate(bones)
    measured = np.ascontiguousarray(positions, np.float64).reshape(-1, len(parents), 3)
    R = np.empty((*measured.shape, 3))
    rest = offsets[children] / lengths[children, None]
    kernels.joint_rotations(parents, first, children, rest, lengths[children] ** 2, measured, R)
    return R.reshape(*positions.shape, 3)


def _determining(offsets: Float64, lengths: Float64, children: Int64) -> Int64:
    """Return the bones that determine a joint's rotation: those with a length, and of parallel ones the first."""
    long = children[lengths[children] > _TINY]
    if len(long) and np.linalg.matrix_rank(offsets[long] / lengths[long, None], tol=0.1) < 2:
        return long[:1]
    return long


def shortest(start: Float64, end: Float64) -> Float64:
    """Return the shortest rotation (..., 3, 3) from directions ``start`` to ``end``, (..., 3) of unit length.

    Between opposite directions, it is half a turn about one of the axes across. NaN or 0 as ``end`` turns nothing.
    """
    from mocapella.geometry import bone_rotation_kernels as kernels  # imports numba

    start, end = np.broadcast_arrays(np.asarray(start, np.float64), np.asarray(end, np.float64))
    S = np.empty((start.size // 3, 3, 3))
    kernels.swings(np.ascontiguousarray(start).reshape(-1, 3), np.ascontiguousarray(end).reshape(-1, 3), S)
    return S.reshape(*start.shape, 3)


def posed(parents: Int64, offsets: Float64, root: Floats, R: Float64) -> Float64:
    """Return the joints' positions by forward kinematics (..., joints, 3).

    Args:
        parents, offsets: as in `joint_rotations`.
        root: (..., 3) position of the root.
        R: (..., joints, 3, 3) rotations from the rest pose, as `joint_rotations` returns them.
    """
    out = np.empty(R.shape[:-1])
    out[..., 0, :] = root
    for joint in range(1, len(parents)):
        parent = parents[joint]
        out[..., joint, :] = out[..., parent, :] + np.einsum("...ij,j->...i", R[..., parent, :, :], offsets[joint])
    return out


def local_rotations(parents: Int64, R: Float64) -> Float64:
    """Return each joint's rotation relative to its parent's (..., joints, 3, 3); the root's is unchanged."""
    out = R.copy()
    children = parents >= 0
    out[..., children, :, :] = np.swapaxes(R[..., parents[children], :, :], -1, -2) @ R[..., children, :, :]
    return out
