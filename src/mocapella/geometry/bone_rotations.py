"""Rotations of a skeleton's bones from the positions of its joints, and forward kinematics.

A skeleton is a tree of joints; every joint carries the bones to its children. Arrays have leading batch axes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

_TINY: float = 1e-9


def joint_rotations(parents: Int64, offsets: Float64, positions: Float64) -> Float64:
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
    count = len(parents)
    R = np.empty((*positions.shape[:-1], 3, 3))
    for joint in range(count):
        before = np.broadcast_to(np.eye(3), R[..., joint, :, :].shape) if joint == 0 else R[..., parents[joint], :, :]
        children = np.flatnonzero(parents == joint)
        measured = positions[..., children, :] - positions[..., joint, None, :]
        R[..., joint, :, :] = _turned(before, offsets[children], measured)
    return R


def _turned(before: Float64, rest: Float64, measured: Float64) -> Float64:
    """Return the rotation (..., 3, 3) of one joint's bones, from rest (bones, 3) to measured (..., bones, 3)."""
    length = np.linalg.norm(rest, axis=1)
    long = length > _TINY
    length, rest, measured = length[long], _unit(rest[long]), _unit(measured[..., long, :])
    if not len(rest):
        return before
    if np.linalg.matrix_rank(rest, tol=0.1) > 1:
        u, _, vt = np.linalg.svd(np.einsum("b,...bi,bj->...ij", length**2, measured, rest))
        flip = np.ones(u.shape[:-1])
        flip[..., 2] = np.sign(np.linalg.det(u) * np.linalg.det(vt))
        return np.asarray((u * flip[..., None, :]) @ vt)
    return shortest(np.einsum("...ij,j->...i", before, rest[0]), measured[..., 0, :]) @ before


def shortest(start: Float64, end: Float64) -> Float64:
    """Return the shortest rotation (..., 3, 3) from directions ``start`` to ``end``, (..., 3) of unit length.

    Between opposite directions, it is half a turn about one of the axes across. NaN or 0 as ``end`` turns nothing.
    """
    end = np.where(np.linalg.norm(end, axis=-1, keepdims=True) > 0.5, end, start)
    axis = np.cross(start, end)
    cosine = np.sum(start * end, axis=-1)[..., None, None]
    x = np.zeros((*axis.shape, 3))
    x[..., 0, 1], x[..., 0, 2], x[..., 1, 2] = -axis[..., 2], axis[..., 1], -axis[..., 0]
    K = x - np.swapaxes(x, -1, -2)
    with np.errstate(divide="ignore", invalid="ignore"):
        R = np.eye(3) + K + K @ K / (1.0 + cosine)  # O. Rodrigues
    across = _unit(np.cross(start, np.eye(3)[np.argmin(np.abs(start), axis=-1)]))
    half = 2.0 * across[..., :, None] * across[..., None, :] - np.eye(3)
    return np.where(cosine > -1.0 + 1e-9, R, half)


def _unit(vectors: Float64) -> Float64:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > _TINY, vectors / np.where(length > _TINY, length, 1.0), 0.0)


def posed(parents: Int64, offsets: Float64, root: Float64, R: Float64) -> Float64:
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
