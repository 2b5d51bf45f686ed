"""Compiled kernels of `orientation`.

Quaternions from bone axis and forward direction, for many joints at once; importing this module imports numba.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Float64 = NDArray[np.float64]


@njit(cache=True)
def bone_orientations(positions: Float64, bones: NDArray[np.int64], forward: Float64) -> Float64:
    """Return the orientations (bodies, joints, 4) of bones, as quaternions w, x, y, z; NaN where they are undefined.

    This is the compiled part of `orientation.bone_orientations`, which explains axes and arguments.
    """
    bodies, joints = positions.shape[0], positions.shape[1]
    result = np.full((bodies, joints, 4), np.nan)
    for body in range(bodies):
        for joint in range(joints):
            y = positions[body, bones[joint, 1]] - positions[body, bones[joint, 0]]
            x = _cross(y, forward[body])
            long, wide = np.sqrt(np.dot(y, y)), np.sqrt(np.dot(x, x))
            if long > 1e-6 and wide > 1e-6 * long:
                y, x = y / long, x / wide
                q = _quaternion(x, y, _cross(x, y))
                for k in range(4):
                    result[body, joint, k] = q[k]
    return result


@njit(cache=True)
def _cross(a: Float64, b: Float64) -> Float64:
    """Cross product; numpy's takes seconds to compile."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


@njit(cache=True)
def _quaternion(x: Float64, y: Float64, z: Float64) -> Float64:
    """Quaternion of the rotation with columns x, y, z (Shepperd 1978: divide by the largest of the four)."""
    trace = x[0] + y[1] + z[2]
    squares = np.array([1 + trace, 1 + 2 * x[0] - trace, 1 + 2 * y[1] - trace, 1 + 2 * z[2] - trace])
    largest = np.argmax(squares)
    if largest == 0:
        q = np.array([squares[0], y[2] - z[1], z[0] - x[2], x[1] - y[0]])
    elif largest == 1:
        q = np.array([y[2] - z[1], squares[1], x[1] + y[0], x[2] + z[0]])
    elif largest == 2:
        q = np.array([z[0] - x[2], x[1] + y[0], squares[2], y[2] + z[1]])
    else:
        q = np.array([x[1] - y[0], x[2] + z[0], y[2] + z[1], squares[3]])
    unit: Float64 = q / np.sqrt(np.dot(q, q))
    return -unit if unit[0] < 0 else unit
