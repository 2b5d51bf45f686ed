"""Kernels of rotations, stored as nine numbers row by row, and of rotation vectors, axis times angle [rad].

Importing this module imports numba.
"""

# ruff: noqa: PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit

Float64 = NDArray[np.float64]

FIRST = np.int64(0)
"""Offset 0 of a rotation that has an array to itself.

A literal 0 has another type, for which numba compiles once more.
"""


@njit(cache=True, error_model="numpy")
def turned(B: Float64, b: int, x: float, y: float, z: float, out: Float64) -> None:
    """Write the rotation B[b : b + 9]·exp(x, y, z) into out (9,), row by row.

    The exponential of the rotation vector (x, y, z) [rad] is Rodrigues' formula; the vector is in B's rotated axes.

    Args:
        B: rotations, nine numbers each, row by row.
        b: index of the first number of one of them.
        x, y, z: rotation vector [rad].
        out: (9,) written; must not overlap B.
    """
    s = x * x + y * y + z * z
    if s < 1e-8:
        f, g = 1.0 - s / 6.0, 0.5 - s / 24.0
    else:
        angle = math.sqrt(s)
        f, g = math.sin(angle) / angle, (1.0 - math.cos(angle)) / s
    r0, r1, r2 = 1.0 - g * (y * y + z * z), g * x * y - f * z, g * x * z + f * y
    r3, r4, r5 = g * x * y + f * z, 1.0 - g * (x * x + z * z), g * y * z - f * x
    r6, r7, r8 = g * x * z - f * y, g * y * z + f * x, 1.0 - g * (x * x + y * y)
    for i in range(0, 9, 3):
        u, v, w = B[b + i], B[b + i + 1], B[b + i + 2]
        out[i], out[i + 1], out[i + 2] = u * r0 + v * r3 + w * r6, u * r1 + v * r4 + w * r7, u * r2 + v * r5 + w * r8


@njit(cache=True, error_model="numpy")
def turn_between(A: Float64, a: int, B: Float64) -> tuple[float, float, float]:
    """Return the rotation vector (x, y, z) with A[a : a + 9]·exp(x, y, z) = B (9,) [rad]; its angle is at most π."""
    r = np.empty(9)
    for i in range(3):
        for k in range(3):
            r[3 * i + k] = A[a + i] * B[k] + A[a + 3 + i] * B[3 + k] + A[a + 6 + i] * B[6 + k]
    x, y, z = r[7] - r[5], r[2] - r[6], r[3] - r[1]
    sine, cosine = 0.5 * math.sqrt(x * x + y * y + z * z), 0.5 * (r[0] + r[4] + r[8] - 1.0)
    angle = math.atan2(sine, cosine)
    if sine > 1e-3 or cosine > 0.0:
        f = 0.5 + sine * sine / 12.0 if sine < 1e-4 else 0.5 * angle / sine
        return f * x, f * y, f * z
    k = 0  # close to π the axis is the longest column of R + 1
    for i in range(1, 3):
        if r[4 * i] > r[4 * k]:
            k = i
    r[4 * k] += 1.0
    u, v, w = r[k], r[3 + k], r[6 + k]
    f = angle / math.sqrt(u * u + v * v + w * w)
    if u * x + v * y + w * z < 0.0:
        f = -f
    return f * u, f * v, f * w


@njit(cache=True, error_model="numpy")
def orthonormal(R: Float64) -> None:
    """Remove accumulated rounding errors from a rotation, in place, by Gram–Schmidt on its columns.

    Args:
        R: (9,) the rotation, row by row.
    """
    n = 1.0 / math.sqrt(R[0] * R[0] + R[3] * R[3] + R[6] * R[6])
    ax, ay, az = n * R[0], n * R[3], n * R[6]
    d = ax * R[1] + ay * R[4] + az * R[7]
    bx, by, bz = R[1] - d * ax, R[4] - d * ay, R[7] - d * az
    n = 1.0 / math.sqrt(bx * bx + by * by + bz * bz)
    bx, by, bz = n * bx, n * by, n * bz
    R[0], R[3], R[6] = ax, ay, az
    R[1], R[4], R[7] = bx, by, bz
    R[2], R[5], R[8] = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@njit(cache=True, error_model="numpy")
def carry_on(A: Float64, B: Float64, ratio: float, out: Float64) -> None:
    """Extrapolate the rigid motion from A to B (4, 4): write B·exp(ratio·log(A⁻¹B)) into out (4, 4).

    With a ratio of 0, out is B; with 1, it is as far beyond B as B is beyond A. Exponential and logarithm are
    `geometry.twists`'; the rotation from A to B is below π.
    """
    P, Q, R, d, t = np.empty(9), np.empty(9), np.empty(9), np.empty(3), np.empty(3)
    for i in range(3):
        d[i] = B[i, 3] - A[i, 3]
        for k in range(3):
            P[3 * i + k], Q[3 * i + k] = A[i, k], B[i, k]
    x, y, z = turn_between(P, FIRST, Q)
    for i in range(3):
        t[i] = P[i] * d[0] + P[3 + i] * d[1] + P[6 + i] * d[2]
    s = x * x + y * y + z * z
    if s < 1e-6:
        c = 1.0 / 12.0 + s / 720.0
    else:
        half = 0.5 * math.sqrt(s)
        c = (1.0 - half * math.cos(half) / math.sin(half)) / s
    # t − φ × t / 2 + c φ × (φ × t) is the twist's translation; then the exponential of ratio times the twist.
    u, v, w = y * t[2] - z * t[1], z * t[0] - x * t[2], x * t[1] - y * t[0]
    a = ratio * (t[0] - 0.5 * u + c * (y * w - z * v))
    b = ratio * (t[1] - 0.5 * v + c * (z * u - x * w))
    c = ratio * (t[2] - 0.5 * w + c * (x * v - y * u))
    x, y, z, s = ratio * x, ratio * y, ratio * z, ratio * ratio * s
    if s < 1e-8:
        f, g = 0.5 - s / 24.0, 1.0 / 6.0 - s / 120.0
    else:
        angle = math.sqrt(s)
        f, g = (1.0 - math.cos(angle)) / s, (angle - math.sin(angle)) / (s * angle)
    u, v, w = y * c - z * b, z * a - x * c, x * b - y * a
    t[0], t[1], t[2] = a + f * u + g * (y * w - z * v), b + f * v + g * (z * u - x * w), c + f * w + g * (x * v - y * u)
    turned(Q, FIRST, x, y, z, R)
    for i in range(3):
        for k in range(3):
            out[i, k] = R[3 * i + k]
        out[i, 3] = Q[3 * i] * t[0] + Q[3 * i + 1] * t[1] + Q[3 * i + 2] * t[2] + B[i, 3]
        out[3, i] = 0.0
    out[3, 3] = 1.0
