"""Rigid motions as twists (translation [m], rotation [rad]): exponential, logarithm, adjoint, and a joint's.

Source: R. Murray, Z. Li, S. Sastry, *A Mathematical Introduction to Robotic Manipulation* (1994), chapter 2 and
appendix A.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.alignment import cross_matrix
from mocapella.geometry.rigid import rigid

Float64 = NDArray[np.float64]


def exp_twist(twist: Any) -> Float64:
    """Return the rigid motion of a twist: its exponential.

    Args:
        twist: (..., 6) translation part [m], then rotation part [rad].

    Returns:
        (..., 4, 4).
    """
    twist = np.asarray(twist, dtype=np.float64)
    phi = twist[..., 3:]
    angle = np.linalg.norm(phi, axis=-1)[..., None, None]
    safe = np.where(angle < 1e-4, 1.0, angle)
    a = np.where(angle < 1e-4, 1 - angle**2 / 6, np.sin(safe) / safe)
    b = np.where(angle < 1e-4, 0.5 - angle**2 / 24, (1 - np.cos(safe)) / safe**2)
    c = np.where(angle < 1e-4, 1 / 6 - angle**2 / 120, (safe - np.sin(safe)) / safe**3)
    K = cross_matrix(phi)
    V = np.eye(3) + b * K + c * (K @ K)
    return rigid(np.eye(3) + a * K + b * (K @ K), (V @ twist[..., :3, None])[..., 0])


def log_motion(T: Float64) -> Float64:
    """Return the twist (..., 6) of rigid motions (..., 4, 4): translation part [m], then rotation part [rad].

    The angle, the length of the rotation part, is in [0, π]. Below π, this is the inverse of `exp_twist`.
    """
    T = np.asarray(T)
    phi = _rotation_vector(T[..., :3, :3])
    angle = np.linalg.norm(phi, axis=-1)[..., None, None]
    safe = np.where(angle < 1e-3, 1.0, angle)
    half = 0.5 * safe
    c = np.where(angle < 1e-3, 1 / 12 + angle**2 / 720, (1 - half * np.cos(half) / np.sin(half)) / safe**2)
    K = cross_matrix(phi)
    V_inverse = np.eye(3) - 0.5 * K + c * (K @ K)
    return np.concatenate([(V_inverse @ T[..., :3, 3, None])[..., 0], phi], axis=-1)


def _rotation_vector(R: Float64) -> Float64:
    """Axis times angle, by way of the unit quaternion.

    4 q qᵀ is made of sums of the elements of R; its longest column, which cannot vanish, is divided by its length.
    """
    xx, yy, zz = R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]
    wx, wy, wz = R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]
    xy, xz, yz = R[..., 0, 1] + R[..., 1, 0], R[..., 0, 2] + R[..., 2, 0], R[..., 1, 2] + R[..., 2, 1]
    columns = np.stack(
        [1 + xx + yy + zz, wx, wy, wz, wx, 1 + xx - yy - zz, xy, xz, wy, xy, 1 - xx + yy - zz, yz,
         wz, xz, yz, 1 - xx - yy + zz],
        axis=-1,
    ).reshape(*R.shape[:-2], 4, 4)  # fmt: skip
    longest = np.diagonal(columns, axis1=-2, axis2=-1).argmax(axis=-1)
    q = np.take_along_axis(columns, longest[..., None, None], axis=-2)[..., 0, :]
    q = np.where(q[..., :1] < 0, -q, q)
    sine = np.linalg.norm(q[..., 1:], axis=-1)[..., None]
    angle = 2 * np.arctan2(sine, q[..., :1])
    small = sine < 1e-12 * q[..., :1]
    factor = np.where(small, 2 / np.where(small, q[..., :1], 1.0), angle / np.where(small, 1.0, sine))
    return np.asarray(factor * q[..., 1:])


def adjoint(T: Float64) -> Float64:
    """Return the adjoint matrices (..., 6, 6) of rigid motions (..., 4, 4), which express a twist in T's target frame.

    T exp(x) T⁻¹ = exp(Ad x), for twists x of translation part [m], then rotation part [rad].
    """
    R, t = T[..., :3, :3], T[..., :3, 3]
    out = np.zeros((*T.shape[:-2], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = R
    out[..., :3, 3:] = cross_matrix(t) @ R
    return out


def revolute(axis: Any, point: Any) -> Float64:
    """Return the twist of a rotation by one radian about an axis, without translation along it (zero pitch).

    Args:
        axis: (..., 3) direction, of any length.
        point: (..., 3) any point on the axis [m].

    Returns:
        (..., 6) translation part [m], then the unit axis; NaN where the axis is zero.
    """
    axis = np.asarray(axis, dtype=np.float64)
    length = np.linalg.norm(axis, axis=-1)[..., None]
    w = axis / np.where(length > 0, length, np.nan)
    point, w = np.broadcast_arrays(np.asarray(point, dtype=np.float64), w)
    return np.concatenate([np.cross(point, w), w], axis=-1)
