"""Standard deviations of the cameras of a rig that do not depend on the choice of its frame.

Relative to the first camera, an error of the first camera's direction moves all the others. Triangulated points do not
notice it. So the standard deviations are those after the rigid motion that aligns the cameras best: that of the mean of
their rotations and the mean of their positions. Source: B. Triggs et al., *Bundle Adjustment – A Modern Synthesis*
(2000), section 9.2 (gauge transformations of covariances).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.alignment import cross_matrix

Float64 = NDArray[np.float64]


def aligned_sds(T_camera_world: Float64, covariance: Float64) -> tuple[Float64, Float64]:
    """Return the standard deviations of positions and directions after the best rigid alignment.

    Args:
        T_camera_world: (cameras, 4, 4) poses, in any world.
        covariance: (cameras, 6, cameras, 6) of small motions in the cameras' frames: translation [m], rotation [rad].

    Returns:
        (cameras,) of the position, all axes together [m]; (cameras,) of the direction, all axes together [rad].
    """
    cameras = len(T_camera_world)
    R = T_camera_world[:, :3, :3]
    centres = -np.einsum("cji,cj->ci", R, T_camera_world[:, :3, 3])
    off = cross_matrix(centres - centres.mean(axis=0))
    J = np.zeros((cameras, 6, cameras, 6))
    for c in range(cameras):
        J[c, :3, c, :3] = J[c, 3:, c, 3:] = -R[c].T
    turn, step = J[:, 3:].mean(axis=0), J[:, :3].mean(axis=0)
    J[:, 3:] -= turn
    J[:, :3] += np.einsum("cij,jdk->cidk", off, turn) - step
    aligned = np.einsum("aibj,bjck,aick->ai", J, covariance, J)
    squares = np.maximum(aligned, 0.0).reshape(cameras, 2, 3).sum(axis=2)
    return np.sqrt(squares[:, 0]), np.sqrt(squares[:, 1])
