"""The rigid motion that is nearest to the velocities of points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.alignment import cross_matrix

Bools = NDArray[np.bool_]
Float64 = NDArray[np.float64]


def rigid_velocity(points: Float64, velocities: Float64, used: Bools) -> Float64:
    """The field v + ω × (x − x̄) at all points that fits the velocities of those used, by least squares.

    Points on a line, or one point, have no unique ω: the smallest is taken (L. Sciavicco, B. Siciliano, *Modelling and
    Control of Robot Manipulators* (2000), section 3.1, for the velocities of a rigid body).

    Args:
        points: (n, 3) [m].
        velocities: (n, 3) [m/s].
        used: (n,) whose velocities count.

    Returns:
        (n, 3) [m/s]; NaN where a point is; zero where none is used.
    """
    used = used & np.isfinite(points).all(axis=-1) & np.isfinite(velocities).all(axis=-1)
    if not used.any():
        return np.where(np.isfinite(points), 0.0, np.nan)
    centre, mean = points[used].mean(axis=0), velocities[used].mean(axis=0)
    K = cross_matrix(points[used] - centre)
    turn = np.linalg.pinv((np.swapaxes(K, -1, -2) @ K).sum(axis=0), rcond=1e-6, hermitian=True)
    turn = turn @ (K @ (velocities[used] - mean)[..., None]).sum(axis=0)[:, 0]
    return np.asarray(mean + np.cross(turn, points - centre))
