"""Small rigid motions as twists (translation [m], rotation [rad]): exponential, logarithm and adjoint.

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
    """The rigid motion of a twist.

    Args:
        twist: (..., 6) translation part, then rotation part.

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
    """The twist of a rigid motion, (..., 6), its angle within [0, π]; the inverse of `exp_twist` below π."""
    from scipy.spatial.transform import Rotation

    R = np.asarray(T)[..., :3, :3]
    phi = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_rotvec().reshape(*R.shape[:-2], 3)
    angle = np.linalg.norm(phi, axis=-1)[..., None, None]
    safe = np.where(angle < 1e-3, 1.0, angle)
    half = 0.5 * safe
    c = np.where(angle < 1e-3, 1 / 12 + angle**2 / 720, (1 - half * np.cos(half) / np.sin(half)) / safe**2)
    K = cross_matrix(phi)
    V_inverse = np.eye(3) - 0.5 * K + c * (K @ K)
    return np.concatenate([(V_inverse @ T[..., :3, 3, None])[..., 0], phi], axis=-1)


def adjoint(T: Float64) -> Float64:
    """(..., 6, 6) ``Ad`` with T exp(x) T⁻¹ = exp(Ad x): the same small motion, told in T's target frame."""
    R, t = T[..., :3, :3], T[..., :3, 3]
    out = np.zeros((*T.shape[:-2], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = R
    out[..., :3, 3:] = cross_matrix(t) @ R
    return out
