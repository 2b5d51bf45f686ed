"""Fit the velocity field of a rigid motion to the velocities of points.

It gives hidden points of a rigid body, such as a hand, the velocity of the visible ones.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.alignment import cross_matrix

Bools = NDArray[np.bool_]
Float64 = NDArray[np.float64]


def rigid_velocity(points: Float64, velocities: Float64, used: Bools) -> Float64:
    """Fit v + ω × (x − x̄) to the velocities of the points used, by least squares; evaluate it at all points.

    For collinear points, or one point, ω is not unique: the smallest is taken (L. Sciavicco, B. Siciliano, *Modelling
    and Control of Robot Manipulators* (2000), section 3.1, for the velocities of a rigid body).

    Args:
        points: (n, 3) [m].
        velocities: (n, 3) [m/s].
        used: (n,) whether a point is used in the fit; points or velocities that are not finite are left out anyway.

    Returns:
        (n, 3) the fitted velocities of all points [m/s]; NaN where the point is NaN; else zero if no point is used.
    """
    used = used & np.isfinite(points).all(axis=-1) & np.isfinite(velocities).all(axis=-1)
    if not used.any():
        return np.where(np.isfinite(points), 0.0, np.nan)
    centre, mean = points[used].mean(axis=0), velocities[used].mean(axis=0)
    K = cross_matrix(points[used] - centre)
    turn = np.linalg.pinv((np.swapaxes(K, -1, -2) @ K).sum(axis=0), rcond=1e-6, hermitian=True)
    turn = turn @ (K @ (velocities[used] - mean)[..., None]).sum(axis=0)[:, 0]
    return np.asarray(mean + np.cross(turn, points - centre))
