"""Rigid motions as (4, 4) matrices ``T_to_from``; leading axes are batches."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]

_LAST_ROW: Final = np.array([0.0, 0.0, 0.0, 1.0])


def rotation_about_x(angle: Any) -> Float64:
    """Rotation matrices about the x axis.

    Args:
        angle: (...,) [rad]; positive turns y towards z.

    Returns:
        (..., 3, 3): x' = x, y' = y·cos − z·sin, z' = y·sin + z·cos.
    """
    a = np.asarray(angle, dtype=np.float64)
    R = np.zeros((*a.shape, 3, 3))
    R[..., 0, 0] = 1.0
    R[..., 1, 1] = R[..., 2, 2] = np.cos(a)
    R[..., 2, 1] = np.sin(a)
    R[..., 1, 2] = -R[..., 2, 1]
    return R


def rotation_about_y(angle: Any) -> Float64:
    """Rotation matrices about the y axis.

    Args:
        angle: (...,) [rad]; positive turns z towards x.

    Returns:
        (..., 3, 3): x' = x·cos + z·sin, y' = y, z' = z·cos − x·sin.
    """
    a = np.asarray(angle, dtype=np.float64)
    R = np.zeros((*a.shape, 3, 3))
    R[..., 0, 0] = R[..., 2, 2] = np.cos(a)
    R[..., 0, 2] = np.sin(a)
    R[..., 2, 0] = -R[..., 0, 2]
    R[..., 1, 1] = 1.0
    return R


def rotation_about_z(angle: Any) -> Float64:
    """Rotation matrices about the z axis.

    Args:
        angle: (...,) [rad]; positive turns x towards y.

    Returns:
        (..., 3, 3): x' = x·cos − y·sin, y' = x·sin + y·cos, z' = z.
    """
    a = np.asarray(angle, dtype=np.float64)
    R = np.zeros((*a.shape, 3, 3))
    R[..., 0, 0] = R[..., 1, 1] = np.cos(a)
    R[..., 1, 0] = np.sin(a)
    R[..., 0, 1] = -R[..., 1, 0]
    R[..., 2, 2] = 1.0
    return R


def rigid(R: Any, t: Any) -> Float64:
    """Return the rigid motion p' = R p + t.

    Args:
        R: (..., 3, 3) rotations.
        t: (..., 3) translations [m]; batch axes broadcast with ``R``'s.

    Returns:
        (..., 4, 4).
    """
    R, t = np.asarray(R, dtype=np.float64), np.asarray(t, dtype=np.float64)
    T = np.zeros((*np.broadcast_shapes(R.shape[:-2], t.shape[:-1]), 4, 4))
    T[..., :3, :3] = R
    T[..., :3, 3] = t
    T[..., 3, 3] = 1.0
    return T


def inverse(T: Float64) -> Float64:
    """Return the inverses of rigid motions (..., 4, 4), ``T_to_from`` to ``T_from_to``, by transposing the rotation.

    The result is a new array, wrong for matrices with a scale.
    """
    R_back = T[..., :3, :3].swapaxes(-1, -2)
    back = np.empty(T.shape)
    back[..., :3, :3] = R_back
    back[..., :3, 3:] = -(R_back @ T[..., :3, 3:])
    back[..., 3, :] = _LAST_ROW
    return back


def apply(T: Float64, points: Any) -> Float64:
    """Apply rigid motions to points.

    Args:
        T: (..., 4, 4).
        points: (..., n, 3); batch axes broadcast with ``T``'s. A NaN affects its own point only.

    Returns:
        (..., n, 3), a new array.
    """
    moved: Float64 = np.matmul(points, np.swapaxes(T[..., :3, :3], -1, -2))
    moved += T[..., None, :3, 3]
    return moved
