"""Rotations of limbs from directions: swing, twist about the limb, and quaternions without jumps.

A limb's rotation is the shortest one from its parent's to the measured direction (the swing), followed by a rotation
about that direction (the twist). Arrays have leading batch axes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.bone_rotations import shortest
from mocapella.geometry.segment_axes import unit

Float64 = NDArray[np.float64]


def across(vectors: Float64, axis: Float64) -> Float64:
    """Return the part of vectors (..., 3) that is perpendicular to an axis of unit length (..., 3)."""
    return np.asarray(vectors - np.sum(vectors * axis, axis=-1, keepdims=True) * axis)


def of_two_directions(first: Float64, second: Float64, rest_first: Float64, rest_second: Float64) -> Float64:
    """Return the rotations (..., 3, 3) that turn one direction exactly to the measured one, and a second nearest to it.

    H. Black, *A passive system for determining the attitude of a satellite*, AIAA Journal 2 (1964) 1350 (TRIAD).

    Args:
        first, second: (..., 3) measured directions, of any length; NaN gives NaN, as do parallel ones.
        rest_first, rest_second: (3,) these directions at rest.
    """
    return _axes(first, second) @ np.swapaxes(_axes(rest_first, rest_second), -1, -2)


def _axes(first: Float64, second: Float64) -> Float64:
    x = unit(first)
    z = unit(np.cross(x, second))
    return np.stack([x, np.cross(z, x), z], axis=-1)


def swung(before: Float64, rest: Float64, direction: Float64) -> Float64:
    """Return the rotations of limbs without twist: the shortest ones from the parents' to the measured directions.

    Args:
        before: (..., 3, 3) rotations of the parents from the rest pose.
        rest: (3,) direction of the limb at rest, of unit length.
        direction: (..., 3) measured direction, of unit length.

    Returns:
        (..., 3, 3) rotations from the rest pose.
    """
    return np.asarray(shortest(np.einsum("...ij,j->...i", before, rest), direction) @ before)


def twisted(R: Float64, axis: Float64, angle: Float64) -> Float64:
    """Return rotations (..., 3, 3) followed by a rotation by ``angle`` (...,) [rad] about ``axis`` (..., 3)."""
    from scipy.spatial.transform import Rotation  # it takes most of a second to import

    turn = Rotation.from_rotvec((axis * np.asarray(angle)[..., None]).reshape(-1, 3)).as_matrix()
    return np.asarray(turn.reshape(R.shape) @ R)


def twist_angle(R: Float64, axis: Float64, rest_side: Float64, side: Float64) -> Float64:
    """Return the angles (...,) about an axis that bring a direction across it to the measured one [rad], −π to π.

    Args:
        R: (..., 3, 3) rotations without twist, as `swung` returns them.
        axis: (..., 3) the limb's direction, of unit length.
        rest_side: (3,) a direction across the limb at rest.
        side: (..., 3) the measured one; only its part across the axis counts. NaN, or a direction along the axis,
            gives NaN.
    """
    start = across(np.einsum("...ij,j->...i", R, rest_side), axis)
    end = unit(across(side, axis))
    return np.asarray(np.arctan2(np.sum(np.cross(start, end) * axis, axis=-1), np.sum(start * end, axis=-1)))


def faded(angle: Float64, weight: Float64) -> Float64:
    """Return angles (...,) [rad] that go to 0 with their weight, 0 to 1, along the chord between both directions.

    The result is continuous in angle and weight, but for opposite directions of equal weight.
    """
    return np.asarray(np.arctan2(weight * np.sin(angle), 1.0 - weight + weight * np.cos(angle)))


def quaternions(R: Float64) -> Float64:
    """Return unit quaternions (frames, ..., 4), x, y, z, w, of rotations (frames, ..., 3, 3), continuous over frames.

    Of the two quaternions of a rotation, each frame has the one nearer to that of the frame before; the first frame's w
    is not negative.
    """
    from scipy.spatial.transform import Rotation  # it takes most of a second to import

    q = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_quat().reshape(*R.shape[:-2], 4)
    q[:1] *= np.where(q[:1, ..., 3:] < 0, -1.0, 1.0)
    flips = np.where(np.sum(q[1:] * q[:-1], axis=-1, keepdims=True) < 0, -1.0, 1.0)
    q[1:] *= np.cumprod(flips, axis=0)
    return np.asarray(q)
