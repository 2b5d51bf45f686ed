"""Lines in space by Plücker coordinates: a unit direction n and the moment m = x × n, the same for all points x on it.

A line is an array (..., 6): n, then m [m]. The residual of a point x is x × n − m: perpendicular to n, as long as the
distance of x from the line, and 0 on it. It is linear in x, so a point can be fitted to a line of sight without its
depth: B. Rosenhahn, T. Brox, D. Cremers, H.-P. Seidel, "Online Smoothing for Markerless Motion Capture", DAGM 2007,
equations 11 to 14; R. Murray, Z. Li, S. Sastry, *A Mathematical Introduction to Robotic Manipulation* (1994), section
2.3.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.lens import undistort
from mocapella.geometry.rigid import inverse

Float64 = NDArray[np.float64]


def line(point: Any, direction: Any) -> Float64:
    """Return the line through a point in a direction, as Plücker coordinates.

    Args:
        point: (..., 3) [m]; batch axes broadcast with ``direction``'s.
        direction: (..., 3) of any length.

    Returns:
        (..., 6): unit direction n, then moment m = point × n [m]; NaN where the direction is zero or an input is NaN.
    """
    direction = np.asarray(direction, dtype=np.float64)
    length = np.linalg.norm(direction, axis=-1)[..., None]
    n = direction / np.where(length > 0, length, np.nan)
    point, n = np.broadcast_arrays(np.asarray(point, dtype=np.float64), n)
    return np.concatenate([n, np.cross(point, n)], axis=-1)


def join(p: Any, q: Any) -> Float64:
    """Return the Plücker lines (..., 6) from points p to points q, (..., 3) each [m]; NaN where they coincide.

    A line is its unit direction, from p to q, then its moment [m].
    """
    p = np.asarray(p, dtype=np.float64)
    return line(p, np.asarray(q, dtype=np.float64) - p)


def camera_rays(pixels: Any, lens: Float64, T_camera_world: Float64) -> Float64:
    """Return the viewing rays of pixels as Plücker lines, directed away from the camera.

    Args:
        pixels: (..., 2) [px].
        lens: (9,) intrinsics and distortion: fx fy cx cy [px], k1 k2 p1 p2 k3.
        T_camera_world: (4, 4) extrinsics; camera frame: x right, y down, z out of the lens.

    Returns:
        (..., 6) unit direction, then moment [m], in the world frame; NaN outside the range of the distortion model, or
        where the pixel is NaN.
    """
    seen = undistort(pixels, lens)
    T_world_camera = inverse(T_camera_world)
    directions = np.concatenate([seen, np.ones((*seen.shape[:-1], 1))], axis=-1) @ T_world_camera[:3, :3].T
    return line(T_world_camera[:3, 3], directions)


def residual(points: Any, lines: Float64) -> Float64:
    """Return the offset x × n − m (..., 3) of points x (..., 3) [m] from Plücker lines (n, m) (..., 6).

    Its length is the distance of the point from the line [m]; it is perpendicular to n, and NaN where an input is.
    """
    return np.asarray(np.cross(points, lines[..., :3]) - lines[..., 3:])


def nearest_point(lines: Float64) -> Float64:
    """Return the points (..., 3) [m] with the least sum of squared distances from lines (..., n, 6).

    The residual x × n − m is linear in x, so they solve 3 × 3 normal equations. NaN where an input is, or where no two
    directions differ by more than about 1e-5 rad, which leaves the point free to move along the lines.
    """
    n, m = np.asarray(lines[..., :3]), np.asarray(lines[..., 3:])
    A = (np.eye(3) * (n * n).sum(axis=-1)[..., None, None] - n[..., :, None] * n[..., None, :]).sum(axis=-3)
    b = np.cross(n, m).sum(axis=-2)
    A = np.where(np.isfinite(A).all(axis=(-2, -1), keepdims=True), A, 0.0)
    known = (np.linalg.eigvalsh(A)[..., 0] > 1e-10)[..., None]
    solved = np.linalg.solve(np.where(known[..., None], A, np.eye(3)), b[..., None])[..., 0]
    return np.where(known, solved, np.nan)


def moved(T: Float64, lines: Float64) -> Float64:
    """Return Plücker lines (..., 6) [direction, moment in m] after rigid motions (..., 4, 4); batch axes broadcast."""
    n, m = (T[..., :3, :3] @ lines[..., k : k + 3, None] for k in (0, 3))
    n, m = n[..., 0], m[..., 0]
    return np.concatenate([n, m + np.cross(T[..., :3, 3], n)], axis=-1)
