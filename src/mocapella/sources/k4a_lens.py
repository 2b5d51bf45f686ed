"""The lenses of an Azure Kinect's calibration, converted to the lens model of `mocapella.geometry.lens`.

The vendor's model is Brown-Conrady's with a rational radial term of six coefficients,
(1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶), as in OpenCV (calib3d, "rational model").
Ours has three. They are fitted, with the focal length, by least squares over the image.
"""

from __future__ import annotations

import ctypes
from ctypes import c_float, c_int, c_uint32
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]

DEPTH: Final = 0
COLOUR: Final = 1
"""Numbers of the cameras in a calibration."""
_FARTHEST: Final = 4.0
"""Largest tangent of the angle from the optical axis that is sampled."""
_SAMPLES: Final = 4001
_MODEL: Final = 4
"""The only model of lenses in devices: ``K4A_CALIBRATION_LENS_DISTORTION_MODEL_BROWN_CONRADY``."""


class _Motion(ctypes.Structure):
    """``k4a_calibration_extrinsics_t``; translation in millimetres."""

    _fields_ = (("rotation", c_float * 9), ("translation", c_float * 3))


class _Camera(ctypes.Structure):
    """``k4a_calibration_camera_t``; its parameters are cx cy fx fy k1 k2 k3 k4 k5 k6 codx cody p2 p1 and a radius."""

    _fields_ = (
        ("extrinsics", _Motion), ("model", c_int), ("count", c_uint32), ("parameters", c_float * 15),
        ("width", c_int), ("height", c_int), ("metric_radius", c_float),
    )  # fmt: skip


class K4aCalibration(ctypes.Structure):
    """``k4a_calibration_t``: both cameras, and the motion from each to each, ``motions[from][to]``."""

    _fields_ = (
        ("cameras", _Camera * 2), ("motions", (_Motion * 4) * 4), ("depth_mode", c_int), ("colour_resolution", c_int),
    )  # fmt: skip


def size_of(calibration: K4aCalibration, camera: int) -> tuple[int, int]:
    """Return (width, height) of the images of `DEPTH` or `COLOUR` [px]."""
    one: Any = calibration.cameras[camera]
    return int(one.width), int(one.height)


def motion_of(calibration: K4aCalibration) -> tuple[Float64, Float64]:
    """Return rotation (3, 3) and translation (3,) [m] from the depth camera's frame to the colour camera's."""
    motion: Any = calibration.motions[DEPTH][COLOUR]
    return np.array(motion.rotation[:], np.float64).reshape(3, 3), np.array(motion.translation[:], np.float64) / 1e3


def lens_of(calibration: K4aCalibration, camera: int) -> tuple[tuple[float, ...], float]:
    """Return the lens of `DEPTH` or `COLOUR`, and the largest error of its radial term.

    Returns:
        (9,) intrinsics fx fy cx cy [px], k1 k2 p1 p2 k3; and the error over the image, along the radius [px]. The error
        is infinite, and the lens without distortion, if the calibration has another model or cannot be fitted.
    """
    one: Any = calibration.cameras[camera]
    cx, cy, fx, fy, *radial, _, _, p2, p1, _ = map(float, one.parameters[:])
    plain = (fx, fy, cx, cy, 0.0, 0.0, 0.0, 0.0, 0.0)
    if one.model != _MODEL or not min(fx, fy) > 0:
        return plain, np.inf
    width, height = size_of(calibration, camera)
    corner = max(float(np.hypot((x - cx) / fx, (y - cy) / fy)) for x in (0, width - 1) for y in (0, height - 1))
    found = _fitted(np.array(radial), corner)
    if found is None:
        return plain, np.inf
    (scale, k1, k2, k3), error = found
    return (fx * scale, fy * scale, cx, cy, k1, k2, p1 / scale, p2 / scale, k3), error * fx


def _fitted(radial: Float64, corner: float) -> tuple[tuple[float, float, float, float], float] | None:
    """Return the scale of the focal length, k1, k2 and k3, and the largest error; lengths are tangents of angles.

    Args:
        radial: (6,) k1 to k6 of the rational model.
        corner: largest radius in the image, after the distortion.
    """
    r = np.linspace(0.0, _FARTHEST, _SAMPLES)
    s = r * r
    bent = r * np.polyval([*radial[2::-1], 1.0], s) / np.polyval([*radial[:2:-1], 1.0], s)
    outside = ~(bent <= corner) | (np.diff(bent, append=np.inf) <= 0)
    inside = int(outside.argmax()) if outside.any() else len(r)
    if inside < 10 or not corner - bent[inside - 1] < 0.05 * corner:
        return None  # the image ends beyond the angles that the model covers
    r, s, bent = r[:inside], s[:inside], bent[:inside]
    weights = np.sqrt(r)[:, None]  # a ring of the image has as many pixels as its radius is long
    terms = r[:, None] * np.stack([np.ones_like(s), s, s**2, s**3], axis=1)
    a = np.linalg.lstsq(terms * weights, bent * weights[:, 0], rcond=None)[0]
    error = float(np.abs(terms @ a - bent).max())
    scale = float(a[0])
    return (scale, *(float(one) / scale for one in a[1:])), error  # type: ignore[return-value]
