"""Homography from a plane to its image, focal length from homographies, and the plane's pose in the camera frame.

Source: Z. Zhang, *A Flexible New Technique for Camera Calibration* (IEEE PAMI 22(11), 2000), sections 2.2 and 3.1 and
appendix A.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.rigid import rigid

Float64 = NDArray[np.float64]


def homography(plane: Float64, picture: Float64) -> Float64:
    """Estimate the homography from a plane to its image by the normalised direct linear transformation (DLT).

    It is the least-squares solution over all points, without rejection of outliers.

    Args:
        plane: (n, 2) points of the plane, in any unit; n ≥ 4, finite, no three of four collinear (not checked).
        picture: (n, 2) their images, in pixels or normalised.

    Returns:
        (3, 3) H, its last element 1: H (x, y, 1) of the plane is the image point in homogeneous coordinates.
    """
    A, B = _centred(plane), _centred(picture)
    p, q = plane @ A[:2, :2] + A[:2, 2], picture @ B[:2, :2] + B[:2, 2]
    one, zero = np.ones((len(p), 1)), np.zeros((len(p), 3))
    of_x = np.hstack([p, one, zero, -q[:, :1] * p, -q[:, :1]])
    of_y = np.hstack([zero, p, one, -q[:, 1:] * p, -q[:, 1:]])
    h = np.linalg.svd(np.vstack([of_x, of_y]))[2][-1].reshape(3, 3)
    H = np.linalg.solve(B, h @ A)
    return np.asarray(H / H[2, 2])


def _centred(points: Float64) -> Float64:
    """Return the similarity (3, 3) that brings points to mean 0 and mean square distance 2 (Hartley 1997)."""
    centre = points.mean(axis=0)
    scale = np.sqrt(2.0 / ((points - centre) ** 2).sum(axis=1).mean())
    return np.array([[scale, 0, -scale * centre[0]], [0, scale, -scale * centre[1]], [0, 0, 1]])


def focal_length(homographies: Sequence[Float64], centre: Float64) -> float:
    """Estimate the focal length from homographies of a rigid plane: Zhang's equations 3 and 4.

    The principal point is given and pixels are square, which leaves one unknown, 1/f²: a few views that cover a small
    part of the image determine no more.

    Args:
        homographies: (3, 3) each, from a plane to one camera's images [px].
        centre: (2,) principal point [px].

    Returns:
        The focal length [px]; NaN without a positive solution, as when the plane is parallel to the image in all views,
        or without homographies.
    """
    rows, sides = [], []
    for H in homographies:
        G = H.copy()
        G[:2] -= np.outer(centre, H[2])
        G = G / np.linalg.norm(G[:, :2])
        g, h = G[:, 0], G[:, 1]
        rows += [g[0] * h[0] + g[1] * h[1], g[0] ** 2 + g[1] ** 2 - h[0] ** 2 - h[1] ** 2]
        sides += [-g[2] * h[2], h[2] ** 2 - g[2] ** 2]
    a, b = np.array(rows), np.array(sides)
    inverse_f2 = float(a @ b) / float(a @ a) if float(a @ a) > 0 else np.nan
    return float(inverse_f2**-0.5) if inverse_f2 > 0 else float("nan")


def plane_pose(plane: Float64, directions: Float64) -> Float64:
    """Estimate a plane's pose from its image through a known lens: Zhang's section 3.1, the rotation by appendix C.

    Args:
        plane: (n, 2) points of the plane z = 0 of its own frame [m]; see `homography` for their number.
        directions: (n, 2) their undistorted images, x/z and y/z in the camera frame.

    Returns:
        (4, 4) ``T_camera_plane``, with the plane in front of the camera.
    """
    H = homography(plane, directions)
    H = H / np.sqrt(np.linalg.norm(H[:, 0]) * np.linalg.norm(H[:, 1]))
    if H[2] @ [*plane.mean(axis=0), 1.0] < 0:
        H = -H
    U, _, Vt = np.linalg.svd(np.column_stack([H[:, 0], H[:, 1], np.cross(H[:, 0], H[:, 1])]))
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return rigid(R, H[:, 2])
