"""The lens of `mocapella.geometry.lens`, compiled, a point at a time; importing this module imports numba.

Brown's model: radial (k1 k2 k3) and tangential (p1 p2) distortion; undistortion by iteration.

Arguments k1 to k3, p1 and p2 are the distortion coefficients. ``farthest_r2`` is the squared radius of the model, see
`lens.farthest_r2`; 0 for no limit. Coordinates (x, y) are x/z and y/z in the camera frame, (u, v) the same distorted.
"""

# ruff: noqa: PLR0917 - kernels take arrays by position
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Float64 = NDArray[np.float64]

STEPS = 20
"""Largest number of Newton steps; about 4 suffice where they converge at all."""


@njit(cache=True, forceinline=True)  # into its callers' loops, which are vectorised
def distort(
    x: float, y: float, k1: float, k2: float, p1: float, p2: float, k3: float,
) -> tuple[float, float, float, float, float]:  # fmt: skip
    """Distort normalised image coordinates.

    Args:
        x, y: x/z and y/z in the camera frame.
        k1, k2, p1, p2, k3: radial and tangential distortion coefficients.

    Returns:
        The distorted coordinates (u, v), then the derivatives ∂u/∂x, ∂u/∂y = ∂v/∂x and ∂v/∂y.
    """
    xx, xy, yy = x * x, x * y, y * y
    r2 = xx + yy
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * k1 + r2 * (4.0 * k2 + r2 * (6.0 * k3))  # ∂radial/∂x = slope · x
    u = x * radial + 2.0 * p1 * xy + p2 * (3.0 * xx + yy)
    v = y * radial + 2.0 * p2 * xy + p1 * (xx + 3.0 * yy)
    px, py, qx, qy = 2.0 * p1 * x, 2.0 * p1 * y, 2.0 * p2 * x, 2.0 * p2 * y
    uu = radial + slope * xx + py + 3.0 * qx
    uv = slope * xy + px + qy
    vv = radial + slope * yy + 3.0 * py + qx
    return u, v, uu, uv, vv


@njit(cache=True)
def undistorted(
    u: float, v: float, k1: float, k2: float, p1: float, p2: float, k3: float, farthest_r2: float,
) -> tuple[float, float, float, float, float]:  # fmt: skip
    """Undistort normalised image coordinates by Newton's method, and return the distortion's derivatives there.

    Args:
        u, v: distorted x/z and y/z in the camera frame.
        k1, k2, p1, p2, k3: radial and tangential distortion coefficients.
        farthest_r2: squared radius of the lens model; 0 for no limit.

    Returns:
        x and y, NaN where there are none within the lens model; then the three derivatives that `distort` returns.
    """
    x, y = u, v
    for _ in range(STEPS):
        at_u, at_v, uu, uv, vv = distort(x, y, k1, k2, p1, p2, k3)
        du, dv = u - at_u, v - at_v
        if abs(du) < 1e-13 and abs(dv) < 1e-13:
            return x, y, uu, uv, vv
        det = uu * vv - uv * uv
        if not abs(det) > 1e-12:
            return math.nan, math.nan, uu, uv, vv
        x += (vv * du - uv * dv) / det
        y += (uu * dv - uv * du) / det
        r2 = x * x + y * y
        if r2 > farthest_r2 > 0.0:  # Newton's step may pass the edge on its way to a point inside
            shrink = math.sqrt(farthest_r2 / r2)
            x, y = shrink * x, shrink * y
    at_u, at_v, uu, uv, vv = distort(x, y, k1, k2, p1, p2, k3)
    if abs(at_u - u) < 1e-9 and abs(at_v - v) < 1e-9:
        return x, y, uu, uv, vv
    return math.nan, math.nan, uu, uv, vv


@njit(cache=True, error_model="numpy")
def undistorted_all(
    us: Float64, vs: Float64, k1: float, k2: float, p1: float, p2: float, k3: float, farthest_r2: float, xs: Float64,
    ys: Float64,
) -> None:  # fmt: skip
    """Undistort points as `undistort` does, by vectorised Newton steps of all points together.

    Args:
        us, vs: (n,) distorted normalised coordinates.
        k1, k2, p1, p2, k3, farthest_r2: the lens.
        xs, ys: (n,) written: undistorted ones; NaN where there are none within the lens model's radius.
    """
    for i in range(len(us)):
        xs[i], ys[i] = us[i], vs[i]
    edge = farthest_r2 if farthest_r2 > 0.0 else math.inf
    for _ in range(STEPS):
        moving = 0
        for i in range(len(us)):
            at_u, at_v, uu, uv, vv = distort(xs[i], ys[i], k1, k2, p1, p2, k3)
            du, dv, det = us[i] - at_u, vs[i] - at_v, uu * vv - uv * uv
            there = (abs(du) < 1e-13) & (abs(dv) < 1e-13)
            f = det if abs(det) > 1e-12 else math.nan
            x, y = xs[i] + (vv * du - uv * dv) / f, ys[i] + (uu * dv - uv * du) / f
            r2 = x * x + y * y
            shrink = math.sqrt(edge / r2) if r2 > edge else 1.0
            xs[i], ys[i] = xs[i] if there else shrink * x, ys[i] if there else shrink * y
            moving += not there
        if moving == 0:
            return
    for i in range(len(us)):
        at_u, at_v, _, _, _ = distort(xs[i], ys[i], k1, k2, p1, p2, k3)
        if not (abs(at_u - us[i]) < 1e-9 and abs(at_v - vs[i]) < 1e-9):
            xs[i] = ys[i] = math.nan


@njit(cache=True, forceinline=True)
def undistort(
    u: float, v: float, k1: float, k2: float, p1: float, p2: float, k3: float, farthest_r2: float,
) -> tuple[float, float]:  # fmt: skip
    """Return the (x, y) that `distort` maps to (u, v); NaN if there is none within the lens model's radius.

    Args:
        u, v: distorted x/z and y/z in the camera frame.
        k1, k2, p1, p2, k3: radial and tangential distortion coefficients.
        farthest_r2: squared radius of the lens model, see `lens.farthest_r2`; 0 for no limit.
    """
    x, y, _, _, _ = undistorted(u, v, k1, k2, p1, p2, k3, farthest_r2)
    return x, y


@njit(cache=True)
def undistort_points(lens: Float64, farthest_r2: float, pixels: Float64, out: Float64) -> None:
    """Undistort pixels to viewing directions, by Newton's method; the compiled `lens.undistort`.

    Args:
        lens: (9,) intrinsics and distortion: fx fy cx cy [px], k1 k2 p1 p2 k3.
        farthest_r2: squared radius of the lens model, see `lens.farthest_r2`; 0 for no limit.
        pixels: (n, 2) [px].
        out: (n, 2) written: x/z and y/z; NaN outside the range of the distortion model.
    """
    for i in range(len(pixels)):
        u, v = (pixels[i, 0] - lens[2]) / lens[0], (pixels[i, 1] - lens[3]) / lens[1]
        out[i, 0], out[i, 1] = undistort(u, v, lens[4], lens[5], lens[6], lens[7], lens[8], farthest_r2)
