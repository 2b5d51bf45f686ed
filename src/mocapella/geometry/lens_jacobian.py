"""Derivatives of `lens.project` with respect to the point and the lens.

The polynomial is evaluated for every point in front of the camera, also beyond the radius at which `lens.project`
returns NaN, because a least-squares search may pass there.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]


def project_with_jacobian(points: Any, lens: Any) -> tuple[Float64, Float64, Float64]:
    """Project points to pixels, with the Jacobians by point and by lens.

    Args:
        points: (..., 3) camera frame: x right, y down, z out of the lens [m].
        lens: (..., 9) fx fy cx cy [px], k1 k2 p1 p2 k3; broadcasts with the points.

    Returns:
        (..., 2) pixels [px]; (..., 2, 3) their derivatives by the point [px/m]; (..., 2, 9) by the lens's numbers, in
        their order. Behind the camera, pixels are NaN, and so are the derivatives that depend on the point.
    """
    points = np.asarray(points, dtype=np.float64)
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = np.moveaxis(np.asarray(lens, dtype=np.float64), -1, 0)
    z = np.where(points[..., 2] > 0, points[..., 2], np.nan)
    x, y = points[..., 0] / z, points[..., 1] / z
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))  # ∂radial/∂x = slope · x
    u = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    v = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    uu = fx * (radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x)
    uv = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y
    vv = fy * (radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x)
    zero, one = np.zeros_like(u), np.ones_like(u)
    by_point = np.stack(
        [
            np.stack([uu, fx * uv, -(uu * x + fx * uv * y)], axis=-1),
            np.stack([fy * uv, vv, -(fy * uv * x + vv * y)], axis=-1),
        ],
        axis=-2,
    ) / z[..., None, None]  # fmt: skip
    by_lens = np.stack(
        [
            np.stack(
                [u, zero, one, zero, fx * x * r2, fx * x * r2**2, 2 * fx * x * y, fx * (r2 + 2 * x * x),
                 fx * x * r2**3], axis=-1),
            np.stack(
                [zero, v, zero, one, fy * y * r2, fy * y * r2**2, fy * (r2 + 2 * y * y), 2 * fy * x * y,
                 fy * y * r2**3], axis=-1),
        ],
        axis=-2,
    )  # fmt: skip
    return np.stack([fx * u + cx, fy * v + cy], axis=-1), by_point, by_lens
