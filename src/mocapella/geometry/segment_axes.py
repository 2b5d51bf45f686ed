"""Axes of body segments from directions, and the angles between two of them about mobile axes.

Axes are ISB's (International Society of Biomechanics): x forward, y up, z to the person's right. Directions have
any length; leading axes are batches. What is not determined is NaN: axes of directions that are nearly parallel, and
the first and last angle where their axes nearly coincide.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]

LEAST_SINE: Final = math.sin(math.radians(10.0))
"""Sine of the angle between two directions, or two mobile axes, below which they count as parallel."""

_TINY: Final = 1e-9
"""Largest length of a vector without a direction."""


def cross(a: Float64, b: Float64) -> Float64:
    """Return the cross products (..., 3), as `numpy.cross` but several times faster."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return out


def length_of(vectors: Float64) -> Float64:
    """Return the lengths (...,) of vectors (..., 3)."""
    return np.sqrt(vectors[..., 0] ** 2 + vectors[..., 1] ** 2 + vectors[..., 2] ** 2)


def unit(vectors: Float64) -> Float64:
    """Return vectors (..., 3) at unit length; NaN for those without a length."""
    length = length_of(vectors)[..., None]
    return np.asarray(vectors / np.where(length > _TINY, length, np.nan))


def axes_along_z(z: Float64, y: Float64) -> Float64:
    """Return axes (..., 3, 3), as columns, with z along the first direction (..., 3) and y nearest the second."""
    z = unit(z)
    x = _across(unit(y), z)
    return np.stack([x, cross(z, x), z], axis=-1)


def axes_along_y(y: Float64, z: Float64) -> Float64:
    """Return axes (..., 3, 3), as columns, with y along the first direction (..., 3) and z nearest the second."""
    y = unit(y)
    x = _across(y, unit(z))
    return np.stack([x, y, cross(x, y)], axis=-1)


def _across(y: Float64, z: Float64) -> Float64:
    x = cross(y, z)
    sine = length_of(x)[..., None]
    return np.asarray(x / np.where(sine >= LEAST_SINE, sine, np.nan))


def angles_zxy(R: Float64) -> tuple[Float64, Float64, Float64]:
    """Return the angles (...,) of R = Rz Rx Ry about z of the proximal, x, and y of the distal segment [rad].

    It is the joint coordinate system of Grood and Suntay (J. Biomech. Eng. 105, 1983, 136) with the floating axis x.

    Args:
        R: (..., 3, 3) axes of the distal segment in the proximal one.
    """
    first, second = swing_zx(R[..., :, 1])
    third = np.arctan2(-R[..., 2, 0], R[..., 2, 2])
    return first, second, np.where(np.isfinite(first), third, np.nan)


def angles_yxz(R: Float64) -> tuple[Float64, Float64, Float64]:
    """Return the angles (...,) of R = Ry Rx Rz: about the vertical, then x and z of the segment [rad].

    For a pelvis in a frame with y up, they are rotation, obliquity and tilt of Baker (Gait & Posture 13, 2001, 1): the
    last two do not depend on where the person faces.

    Args:
        R: (..., 3, 3) axes of the segment in a frame with y up.
    """
    level = np.hypot(R[..., 0, 2], R[..., 2, 2])
    seen = level >= LEAST_SINE
    first = np.where(seen, np.arctan2(R[..., 0, 2], R[..., 2, 2]), np.nan)
    third = np.where(seen, np.arctan2(R[..., 1, 0], R[..., 1, 1]), np.nan)
    return first, np.arctan2(-R[..., 1, 2], level), third


def swing_zx(y: Float64) -> tuple[Float64, Float64]:
    """Return the first two angles (...,) of `angles_zxy`; they need the distal segment's y axis (..., 3) only [rad]."""
    level = np.hypot(y[..., 0], y[..., 1])
    first = np.arctan2(-y[..., 0], y[..., 1])
    return np.where(level >= LEAST_SINE, first, np.nan), np.arctan2(y[..., 2], level)


def swing_yx(y: Float64) -> tuple[Float64, Float64]:
    """Return the plane and the angle (...,) of elevation of a segment whose y axis (..., 3) points to its upper end.

    Elevation is 0 to π from the segment that hangs down; the plane is 0 where it moves to the right (abduction) and π/2
    where it moves forward. They are γ and −β of Wu et al. (J. Biomech. 38, 2005, 981), R = Ry(γ) Rx(β) Ry [rad].
    """
    sine = np.hypot(y[..., 0], y[..., 2])
    plane = np.arctan2(-y[..., 0], -y[..., 2])
    return np.where(sine >= LEAST_SINE, plane, np.nan), np.arctan2(sine, y[..., 1])


def twist_yxy(R: Float64) -> Float64:
    """Return the last angle (...,) of R = Ry(γ) Rx(β) Ry, about y of the distal segment, for −π ≤ β ≤ 0 [rad].

    Args:
        R: (..., 3, 3) axes of the distal segment in the proximal one.
    """
    sine = np.hypot(R[..., 1, 0], R[..., 1, 2])
    return np.where(sine >= LEAST_SINE, np.arctan2(-R[..., 1, 0], R[..., 1, 2]), np.nan)


def between(a: Float64, b: Float64) -> Float64:
    """Return the angle (...,) between directions (..., 3), 0 to π [rad]; precise near both ends."""
    return np.asarray(np.arctan2(length_of(cross(a, b)), np.sum(a * b, axis=-1)))
