"""Kernels that turn rotations into the rows of a BVH. Importing this imports numba."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
UInt8 = NDArray[np.uint8]

_LARGEST = 9e9
"""Numbers from this on have more digits than a double."""


@njit(cache=True, nogil=True, error_model="numpy")
def turns(parents: Int64, order: Int64, R: Float64, last: Float64, out: Float64) -> None:
    """Write the angles of joints about Z, then X, then Y, relative to their parents, without jumps over time.

    Args:
        parents: (joints,) index of each joint's parent; −1 for the root.
        order: (joints,) the joints in the order of ``last`` and ``out``.
        R: (frames, joints, 3, 3) rotations of the joints in the world.
        last: (joints, 3) angles before the first frame, updated to the last frame's [°].
        out: (frames, 3 · joints) written [°].
    """
    L, angles = np.empty((3, 3)), np.empty(3)
    for f in range(len(R)):
        for at in range(len(order)):
            joint = order[at]
            parent = parents[joint]
            for i in range(3):
                for k in range(3):
                    if parent < 0:
                        L[i, k] = R[f, joint, i, k]
                    else:
                        L[i, k] = 0.0
                        for m in range(3):
                            L[i, k] += R[f, parent, m, i] * R[f, joint, m, k]
            across = math.hypot(L[2, 0], L[2, 2])
            angles[1] = math.atan2(L[2, 1], across)
            if across > 1e-7:
                angles[0], angles[2] = math.atan2(-L[0, 1], L[1, 1]), math.atan2(-L[2, 0], L[2, 2])
            else:  # X is a right angle, and only the sum or difference of the others counts
                angles[0], angles[2] = math.atan2(L[1, 0], L[0, 0]), 0.0
            for i in range(3):
                value = math.degrees(angles[i])
                value -= 360.0 * np.rint((value - last[at, i]) / 360.0)
                last[at, i] = out[f, 3 * at + i] = value


@njit(cache=True, nogil=True, error_model="numpy")
def write_decimals(values: Float64, digits: int, text: UInt8) -> int:
    """Write rows of numbers as decimals with spaces between them, a row a line; return the number of bytes.

    Args:
        values: (rows, columns).
        digits: number of digits after the point, 1 to 6.
        text: (n,) written; ``n`` is at least 20 for each number.

    Returns:
        The number of bytes; −1 if a number is not finite, or from 9e9 on.
    """
    at, scale = 0, np.int64(1)
    for _ in range(digits):
        scale *= 10
    places = np.empty(20, np.uint8)
    for i in range(values.shape[0]):
        for k in range(values.shape[1]):
            value = values[i, k]
            if not abs(value) < _LARGEST:
                return -1
            whole = np.int64(np.rint(abs(value) * scale))
            if value < 0.0 and whole > 0:
                text[at] = 45
                at += 1
            count = 0
            while count <= digits or whole > 0:
                places[count] = 48 + whole % 10
                whole //= 10
                count += 1
            for place in range(count - 1, -1, -1):
                text[at] = places[place]
                at += 1
                if place == digits:
                    text[at] = 46
                    at += 1
            text[at] = 32
            at += 1
        text[at - 1] = 10
    return at
