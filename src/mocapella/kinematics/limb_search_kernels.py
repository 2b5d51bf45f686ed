"""Kernels that compare many poses of a limb with the foreground of images. Importing this module imports numba.

They score the candidate poses of `limb_search`: points on the limb are projected, foreground scores are summed at their
pixels, and the penetration of other limbs is measured.
"""

# ruff: noqa: PLR0917 - kernels take arrays by position
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.geometry.outline_kernels import see
from mocapella.geometry.skinning_kernels import at_rest
from mocapella.geometry.twist_tree_kernels import forward
from mocapella.kinematics.contact_kernels import depth

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
UInt8 = NDArray[np.uint8]


@njit(cache=True)
def places(
    parents: Int64, joint_parts: Int64, twists: Float64, T: Float64, now: Float64, tried: Float64, part: Int64,
    points: Float64, at: Float64,
) -> None:  # fmt: skip
    """Compute points of a body in each of n candidate poses of a limb's tree.

    Args:
        parents, joint_parts, twists: fields of a `TwistTree`, whose root may also have joints.
        T: (4, 4) motion of the root before its joints.
        now: (m,) present angles [rad].
        tried: (n, m) candidate angles [rad].
        part: (p,) index of each point's part.
        points: (p, 3) present positions, world [m].
        at: (n, p, 3) written: positions in each candidate pose, world [m].
    """
    origin, n = np.zeros(3), len(points)
    R, t = np.empty((len(parents), 9)), np.empty((len(parents), 3))
    xi, rest = np.empty((len(joint_parts), 6)), np.empty((n, 3))
    forward(parents, joint_parts, twists, T, now, origin, R, t, xi)
    at_rest(points, part, R, t, rest)
    for k in range(len(tried)):
        forward(parents, joint_parts, twists, T, tried[k], origin, R, t, xi)
        for i in range(n):
            A, o = R[part[i]], t[part[i]]
            for d in range(3):
                at[k, i, d] = A[3 * d] * rest[i, 0] + A[3 * d + 1] * rest[i, 1] + A[3 * d + 2] * rest[i, 2] + o[d]


@njit(cache=True)
def add_worth(
    at: Float64, T_camera_world: Float64, lens: Float64, farthest_r2: float, strange: Float32, x0: int, y0: int,
    step: int, worth: Float64,
) -> None:  # fmt: skip
    """Add one camera's evidence for and against each of n poses to ``worth``.

    Evidence for a pose is the sum of the foreground values at its points; evidence against it, of the background
    values.

    Args:
        at: (n, p, 3) points in each pose, world [m], of `places`.
        T_camera_world, lens, farthest_r2: fields of the camera's `Eye`.
        strange: (rows, columns) of `Evidence`, from 1 (foreground) to −1 (background).
        x0, y0, step: position of its first sample, and distance between samples [px].
        worth: (n, 2) sums for and against, updated.
    """
    count, (rows, columns) = at.shape[1], strange.shape
    pixels, depth = np.empty((len(at) * count, 2)), np.empty(len(at) * count)
    see(at.reshape(-1, 3), T_camera_world, lens, farthest_r2, pixels, depth)
    for k in range(len(at)):
        good = bad = 0.0
        for i in range(k * count, (k + 1) * count):
            if depth[i] > 0.0:
                row, column = round((pixels[i, 1] - y0) / step), round((pixels[i, 0] - x0) / step)
                if 0 <= row < rows and 0 <= column < columns:
                    good += max(strange[row, column], 0.0)
                    bad += max(-strange[row, column], 0.0)
        worth[k, 0] += good
        worth[k, 1] += bad


@njit(cache=True)
def forget_covered(mask: UInt8, strange: Float32) -> None:
    """Set strange (rows, columns) to 0 (unknown) at samples in the mask (rows, columns) or adjacent to it."""
    rows, columns = mask.shape
    for i in range(rows):
        for j in range(columns):
            if mask[i, j] != 0:
                for a in range(max(i - 1, 0), min(i + 2, rows)):
                    for b in range(max(j - 1, 0), min(j + 2, columns)):
                        strange[a, b] = 0.0


@njit(cache=True)
def only_lasting(before: Float32, rows_on: int, columns_on: int, reach: int, strange: Float32) -> None:
    """Suppress transient foreground, in place: cap each value by the largest one nearby in the previous image's map.

    Args:
        before: (rows', columns') the previous map.
        rows_on, columns_on: the previous map begins so many rows and columns before the present one.
        reach: largest distance [samples].
        strange: (rows, columns) the present map, of `Evidence`.
    """
    for i in range(strange.shape[0]):
        for j in range(strange.shape[1]):
            if not strange[i, j] > 0.0:
                continue
            most = np.float32(0.0)
            for a in range(max(i + rows_on - reach, 0), min(i + rows_on + reach + 1, before.shape[0])):
                for b in range(max(j + columns_on - reach, 0), min(j + columns_on + reach + 1, before.shape[1])):
                    most = max(most, before[a, b])
            strange[i, j] = min(strange[i, j], most)


@njit(cache=True)
def depths(ends: Float64, radii: Float64, pairs: Int64, deep: Float64) -> None:
    """Write for each of n poses the sum of the penetration depths of pairs of capsules.

    Args:
        ends: (n, c, 2, 3) end points of the capsules' axes in each pose [m].
        radii: (c,) radii of the capsules [m].
        pairs: (q, 2) indices of two capsules.
        deep: (n,) written [m].
    """
    for k in range(len(ends)):
        deep[k] = depth(ends[k], radii, pairs)
