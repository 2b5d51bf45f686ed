"""Lens model: project points of the camera frame to pixels, and undistort pixels to directions.

The model is that of D. Brown, *Close-Range Camera Calibration* (Photogrammetric Engineering 37(8), 1971), with three
radial and two tangential coefficients, in the order k1 k2 p1 p2 k3 that is customary since J.-Y. Bouguet's toolbox.

A lens is one array of nine numbers: focal lengths fx fy [px], centre cx cy [px], k1 k2 p1 p2 k3. The coordinates (0, 0)
are the centre of the first pixel.
"""

from __future__ import annotations

from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]

_NOTHING: Final = 1e-9
"""A coefficient below it does nothing within any picture."""


def distort(normalised: Any, lens: Float64) -> Float64:
    """Distort normalised image coordinates and convert them to pixels; the inverse of `undistort`.

    Args:
        normalised: (..., 2) x/z and y/z.
        lens: (9,) fx fy cx cy [px], k1 k2 p1 p2 k3.

    Returns:
        (..., 2) x, y [px]; NaN where the distortion model is no longer one-to-one, see `farthest_r2`, or the input is
        NaN.
    """
    x, y = np.moveaxis(np.asarray(normalised, dtype=np.float64), -1, 0)
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = lens
    r2 = x * x + y * y
    radial = np.where(r2 <= farthest_r2(lens), 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)), np.nan)
    u = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    v = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    return np.stack([fx * u + cx, fy * v + cy], axis=-1)


def project(points: Any, lens: Float64) -> Float64:
    """Project points of the camera frame to pixels.

    Args:
        points: (..., 3) camera frame [m]: x right, y down, z out of the lens.
        lens: (9,) fx fy cx cy [px], k1 k2 p1 p2 k3.

    Returns:
        (..., 2) x, y [px], also outside the image; NaN behind the camera, and where `distort` returns NaN.
    """
    points = np.asarray(points, dtype=np.float64)
    z = np.where(points[..., 2:] > 0, points[..., 2:], np.nan)
    return distort(points[..., :2] / z, lens)


def undistort(pixels: Any, lens: Float64) -> Float64:
    """Return the viewing directions of pixels, undistorted by Newton's method; the inverse of `distort`.

    Args:
        pixels: (..., 2) [px].
        lens: (9,) fx fy cx cy [px], k1 k2 p1 p2 k3.

    Returns:
        (..., 2) x/z and y/z; NaN outside the range of the distortion model, or where the pixel is NaN.
    """
    pixels = np.asarray(pixels, dtype=np.float64)
    flat = np.ascontiguousarray(pixels.reshape(-1, 2))
    out = np.empty_like(flat)
    _kernels().undistort_points(np.ascontiguousarray(lens, dtype=np.float64), farthest_r2(lens), flat, out)
    return out.reshape(pixels.shape)


def farthest_r2(lens: Float64) -> float:
    """Return the squared radius x² + y² up to which the radial distortion of a lens (9,) is monotonic.

    Beyond it the model folds back into the image, so `distort` and `undistort` return NaN there. It is the least
    positive root of d(r·radial)/dr = 1 + 3 k1 r² + 5 k2 r⁴ + 7 k3 r⁶; infinite where there is none. r² has no unit.
    """
    coefficients = np.array([7.0 * lens[8], 5.0 * lens[5], 3.0 * lens[4], 1.0])
    coefficients[np.abs(coefficients) < _NOTHING] = 0.0  # it would fold at right angles to the axis, or overflow
    roots = np.roots(coefficients)
    real = roots.real[(abs(roots.imag) < 1e-12 * abs(roots)) & (roots.real > 0)]
    return float(real.min()) if len(real) else np.inf


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.geometry import lens_kernels

    return lens_kernels
