"""Lines in space by Plücker coordinates: a unit direction n and the moment m = x × n, the same for all points x on it.

A line is an array (..., 6): n, then m [m]. The point x is on it where x × n − m = 0, and else this vector, which stands
at right angles to n, is as long as x is far from the line. It is linear in the point, so what moves a point to a line
need know no depth: B. Rosenhahn, T. Brox, D. Cremers, H.-P. Seidel, "Online Smoothing for Markerless Motion Capture",
DAGM 2007, equations 11 to 14; R. Murray, Z. Li, S. Sastry, *A Mathematical Introduction to Robotic Manipulation*
(1994), section 2.3.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.lens import undistort
from mocapella.geometry.rigid import inverse

Float64 = NDArray[np.float64]


def line(point: Any, direction: Any) -> Float64:
    """The line through a point.

    Args:
        point: (..., 3) [m].
        direction: (..., 3) of any length.

    Returns:
        (..., 6); NaN where the direction has no length.
    """
    direction = np.asarray(direction, dtype=np.float64)
    length = np.linalg.norm(direction, axis=-1)[..., None]
    n = direction / np.where(length > 0, length, np.nan)
    point, n = np.broadcast_arrays(np.asarray(point, dtype=np.float64), n)
    return np.concatenate([n, np.cross(point, n)], axis=-1)


def join(p: Any, q: Any) -> Float64:
    """The line from p to q, (..., 3) each [m]: (..., 6), NaN where they are one point."""
    p = np.asarray(p, dtype=np.float64)
    return line(p, np.asarray(q, dtype=np.float64) - p)


def camera_rays(pixels: Any, lens: Float64, T_camera_world: Float64) -> Float64:
    """The lines of sight of pixels, away from the camera.

    Args:
        pixels: (..., 2) [px].
        lens: (9,), see `mocapella.geometry.lens`.
        T_camera_world: (4, 4) to its space: x right, y down, z out of the lens.

    Returns:
        (..., 6) in the world; NaN where the lens shows nothing, or the pixel is NaN.
    """
    seen = undistort(pixels, lens)
    T_world_camera = inverse(T_camera_world)
    directions = np.concatenate([seen, np.ones((*seen.shape[:-1], 1))], axis=-1) @ T_world_camera[:3, :3].T
    return line(T_world_camera[:3, 3], directions)


def residual(points: Any, lines: Float64) -> Float64:
    """x × n − m: how far points (..., 3) are from lines (..., 6) [m], turned by a right angle about the line."""
    return np.asarray(np.cross(points, lines[..., :3]) - lines[..., 3:])


def moved(T: Float64, lines: Float64) -> Float64:
    """Lines (..., 6) after a rigid motion (..., 4, 4); batch axes broadcast."""
    n, m = (T[..., :3, :3] @ lines[..., k : k + 3, None] for k in (0, 3))
    n, m = n[..., 0], m[..., 0]
    return np.concatenate([n, m + np.cross(T[..., :3, 3], n)], axis=-1)
