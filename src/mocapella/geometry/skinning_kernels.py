"""Kernels of linear blend skinning. Importing this module imports numba.

A vertex moves by the weighted mean of its parts' rigid motions.
"""

# ruff: noqa: PLR0917 - kernels take arrays by position
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Float64 = NDArray[np.float64]
Int32 = NDArray[np.int32]
Int64 = NDArray[np.int64]


@njit(cache=True)
def skin(vertices: Float64, bones: Int32, shares: Float64, R: Float64, t: Float64, out: Float64) -> None:
    """Write the posed vertices by linear blend skinning, x = Σ share · (R x₀ + t).

    Args:
        vertices: (n, 3) at rest [m].
        bones, shares: (n, most) indices of the parts that move each vertex, and their weights; the first weight of 0
            ends a row.
        R, t: (parts, 9), (parts, 3) the parts' motions from rest: rotations row by row, translations [m].
        out: (n, 3) written [m].
    """
    for k in range(len(vertices)):
        x, y, z = vertices[k, 0], vertices[k, 1], vertices[k, 2]
        a = b = c = 0.0
        for i in range(bones.shape[1]):
            s = shares[k, i]
            if s == 0.0:
                break
            A, o = R[bones[k, i]], t[bones[k, i]]
            a += s * (A[0] * x + A[1] * y + A[2] * z + o[0])
            b += s * (A[3] * x + A[4] * y + A[5] * z + o[1])
            c += s * (A[6] * x + A[7] * y + A[8] * z + o[2])
        out[k, 0], out[k, 1], out[k, 2] = a, b, c


@njit(cache=True)
def at_rest(points: Float64, part: Int64, R: Float64, t: Float64, out: Float64) -> None:
    """Write the rest positions of points that each move with one part: x₀ = Rᵀ (x − t).

    Args:
        points: (n, 3) in the pose [m].
        part: (n,) index of each point's part.
        R, t: (parts, 9), (parts, 3) the parts' motions from rest: rotations row by row, translations [m].
        out: (n, 3) written [m].
    """
    for k in range(len(points)):
        A, o = R[part[k]], t[part[k]]
        x, y, z = points[k, 0] - o[0], points[k, 1] - o[1], points[k, 2] - o[2]
        for d in range(3):
            out[k, d] = A[d] * x + A[3 + d] * y + A[6 + d] * z


@njit(cache=True)
def farthest_apart(these: Float64, those: Float64) -> float:
    """Return the largest distance between corresponding points, (n, 3) each [m]; 0 without points."""
    most = 0.0
    for i in range(len(these)):
        x, y, z = these[i, 0] - those[i, 0], these[i, 1] - those[i, 1], these[i, 2] - those[i, 2]
        most = max(most, x * x + y * y + z * z)
    return math.sqrt(most)
