"""Kernels that convert between a ball joint's rotation and its angles about three perpendicular axes.

Rotations are (9,), row by row. Importing this module imports numba.
"""

# ruff: noqa: PLR0912, PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.geometry.turn_kernels import FIRST, orthonormal, turn_between, turned

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

_SINGULAR = 1e-6
"""Cosine of the second angle below which the others are not separable."""


@njit(cache=True)
def rotation(axes: Float64, angles: Float64, out: Float64) -> None:
    """Write the product of three rotations, exp(a₀ α₀) exp(a₁ α₁) exp(a₂ α₂).

    Args:
        axes: (3, 3) unit axes a₀, a₁ and a₂, one a row.
        angles: (3,) α₀, α₁ and α₂ [rad].
        out: (9,) written.
    """
    a, b = np.empty(9), np.empty(9)
    for i in range(9):
        a[i] = 1.0 if i % 4 == 0 else 0.0
    turned(a, FIRST, angles[0] * axes[0, 0], angles[0] * axes[0, 1], angles[0] * axes[0, 2], b)
    turned(b, FIRST, angles[1] * axes[1, 0], angles[1] * axes[1, 1], angles[1] * axes[1, 2], a)
    turned(a, FIRST, angles[2] * axes[2, 0], angles[2] * axes[2, 1], angles[2] * axes[2, 2], out)


@njit(cache=True)
def _product(A: Float64, B: Float64, out: Float64) -> None:
    for i in range(3):
        for k in range(3):
            out[3 * i + k] = A[3 * i] * B[k] + A[3 * i + 1] * B[3 + k] + A[3 * i + 2] * B[6 + k]


@njit(cache=True)
def turns(axes: Float64, R: Float64, near: Float64, out: Float64) -> None:
    """Write the three angles about perpendicular axes whose `rotation` is R, the second one within ±90°.

    At ±90° only the sum or the difference of the others is determined: the first one is taken from ``near``.

    Args:
        axes: (3, 3) perpendicular unit axes, one a row.
        R: (9,) the rotation.
        near: (3,) angles of a pose nearby [rad].
        out: (3,) written [rad].
    """
    a, b = axes[0], axes[1]
    c0, c1, c2 = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    sign = 1.0 if c0 * axes[2, 0] + c1 * axes[2, 1] + c2 * axes[2, 2] > 0.0 else -1.0
    E = np.empty((3, 3))
    for k in range(3):
        E[0, k], E[1, k] = a[k], b[k]
    E[2, 0], E[2, 1], E[2, 2] = c0, c1, c2
    M = np.empty((3, 3))
    for i in range(3):
        for k in range(3):
            total = 0.0
            for m in range(3):
                total += E[i, m] * (R[3 * m] * E[k, 0] + R[3 * m + 1] * E[k, 1] + R[3 * m + 2] * E[k, 2])
            M[i, k] = total
    cosine = math.sqrt(M[0, 0] * M[0, 0] + M[0, 1] * M[0, 1])
    out[1] = math.atan2(M[0, 2], cosine)
    if cosine > _SINGULAR:
        out[0], out[2] = math.atan2(-M[1, 2], M[2, 2]), sign * math.atan2(-M[0, 1], M[0, 0])
    else:
        both = math.atan2(M[1, 0], M[1, 1])  # α₀ ± α₂
        out[0] = near[0]
        out[2] = sign * (both - near[0] if M[0, 2] > 0.0 else both + near[0])


@njit(cache=True)
def _near(angle: float, to: float) -> float:
    """Return the angle plus the full turns that bring it nearest to the angle ``to`` [rad]."""
    return angle - 2.0 * math.pi * round((angle - to) / (2.0 * math.pi))


@njit(cache=True)
def turns_within(axes: Float64, R: Float64, limits: Float64, near: Float64, out: Float64) -> None:
    """Write the three angles within limits whose `rotation` is nearest to R.

    There are two solutions: (α₀, α₁, α₂) and (α₀ + π, π − α₁, α₂ + π). Both are clamped to the limits, and the nearer
    one is taken; of equally near ones, that with the smaller |α₂|.

    Args:
        axes, R, near: (3, 3) unit axes, (9,) rotation and (3,) angles of a pose nearby [rad], as in `turns`.
        limits: (3, 2) least and largest angle [rad].
        out: (3,) written [rad].
    """
    one, other, made, best = np.empty(3), np.empty(3), np.empty(9), math.inf
    turns(axes, R, near, one)
    for way in range(2):
        if way == 1:
            one[0], one[1], one[2] = one[0] + math.pi, math.pi - one[1], one[2] + math.pi
        for i in range(3):
            middle = 0.5 * (limits[i, 0] + limits[i, 1])
            other[i] = _near(one[i], middle) if math.isfinite(middle) else _near(one[i], near[i])
            other[i] = min(max(other[i], limits[i, 0]), limits[i, 1])
        rotation(axes, other, made)
        x, y, z = turn_between(made, FIRST, R)
        away = math.sqrt(x * x + y * y + z * z) + 1e-6 * abs(other[2])
        if away < best:
            best = away
            for i in range(3):
                out[i] = other[i]


@njit(cache=True)
def localise(
    parents: Int64, joint_parts: Int64, parts: Int64, first: Int64, axes: Float64, centres: Float64, angles: Float64,
    turned_by: Float64, new_axes: Float64, twists: Float64, limits: Float64,
) -> None:  # fmt: skip
    """Re-express a tree, in place, so that a pose of its ball joints becomes their rest pose, with angles 0.

    Args:
        parents, joint_parts: (parts,), (joints,) of `TwistTree`.
        parts, first, axes, centres: (n,), (n,), (n, 3, 3), (n, 3) [m] of `BallJoints`.
        angles: (joints,) angles of the pose [rad]; ball joints' angles are set to 0.
        turned_by: (n, 9) written: the ball joints' rotations in the pose.
        new_axes: (n, 3, 3) written: their new axes, one a row.
        twists: (joints, 6) of `TwistTree`; changed for ball joints and all their descendants.
        limits: (joints, 2) of `TwistTree` [rad]; made infinite for ball joints.
    """
    moved = np.zeros((len(parents), 12))  # rotation, then translation, of each part's new rest from its old one
    for p in range(len(parents)):
        moved[p, 0] = moved[p, 4] = moved[p, 8] = 1.0
    R, t, new = np.empty(9), np.empty(3), np.empty(9)
    for p in range(1, len(parents)):
        for i in range(12):
            moved[p, i] = moved[parents[p], i]
        M = moved[p]
        ball = -1
        for n in range(len(parts)):
            if parts[n] == p:
                ball = n
        j0 = len(joint_parts)
        for j in range(len(joint_parts)):
            if joint_parts[j] == p:
                j0 = min(j0, j)
                w, v, u = twists[j, 3:].copy(), twists[j, :3].copy(), np.empty(3)
                for i in range(3):
                    twists[j, 3 + i] = M[3 * i] * w[0] + M[3 * i + 1] * w[1] + M[3 * i + 2] * w[2]
                    u[i] = M[3 * i] * v[0] + M[3 * i + 1] * v[1] + M[3 * i + 2] * v[2]
                a, b, c = twists[j, 3], twists[j, 4], twists[j, 5]
                twists[j, 0] = u[0] + M[10] * c - M[11] * b
                twists[j, 1] = u[1] + M[11] * a - M[9] * c
                twists[j, 2] = u[2] + M[9] * b - M[10] * a
        if ball < 0:
            continue
        three, o = angles[first[ball] : first[ball] + 3], centres[ball]
        rotation(axes[ball], three, R)
        for i in range(9):
            turned_by[ball, i] = R[i]
        along = axes[ball, 2]
        N = new_axes[ball]
        for i in range(3):
            N[2, i] = R[3 * i] * along[0] + R[3 * i + 1] * along[1] + R[3 * i + 2] * along[2]
            N[0, i] = R[3 * i] * axes[ball, 0, 0] + R[3 * i + 1] * axes[ball, 0, 1] + R[3 * i + 2] * axes[ball, 0, 2]
            N[1, i] = R[3 * i] * axes[ball, 1, 0] + R[3 * i + 1] * axes[ball, 1, 1] + R[3 * i + 2] * axes[ball, 1, 2]
        # In the parent's new rest: the centre, and the axes.
        for i in range(3):
            t[i] = M[3 * i] * o[0] + M[3 * i + 1] * o[1] + M[3 * i + 2] * o[2] + M[9 + i]
        for k in range(3):
            j = first[ball] + k
            for i in range(3):
                twists[j, 3 + i] = M[3 * i] * N[k, 0] + M[3 * i + 1] * N[k, 1] + M[3 * i + 2] * N[k, 2]
            a, b, c = twists[j, 3], twists[j, 4], twists[j, 5]
            twists[j, 0], twists[j, 1], twists[j, 2] = t[1] * c - t[2] * b, t[2] * a - t[0] * c, t[0] * b - t[1] * a
            limits[j, 0], limits[j, 1] = -math.inf, math.inf
        for k in range(3):
            angles[first[ball] + k] = 0.0
        # Its descendants are rotated with it: x → M (R (x − o) + o).
        _product(M[:9], R, new)
        orthonormal(new)
        for i in range(3):
            M[9 + i] = t[i] - (new[3 * i] * o[0] + new[3 * i + 1] * o[1] + new[3 * i + 2] * o[2])
        for i in range(9):
            M[i] = new[i]


@njit(cache=True)
def into(first: Int64, axes: Float64, turned_by: Float64, new_axes: Float64, angles: Float64) -> None:
    """Convert ball joints' angles, in place, from a body's tree to its local tree (`LocalTree`).

    Args:
        first, axes: (n,), (n, 3, 3) of `BallJoints`.
        turned_by, new_axes: (n, 9), (n, 3, 3) of `localise`.
        angles: (joints,) [rad]; only ball joints' angles are changed.
    """
    R, D = np.empty(9), np.empty(9)
    none = np.zeros(3)
    for n in range(len(first)):
        three, B = angles[first[n] : first[n] + 3], turned_by[n]
        rotation(axes[n], three, R)
        for i in range(3):  # R Bᵀ
            for k in range(3):
                D[3 * i + k] = R[3 * i] * B[3 * k] + R[3 * i + 1] * B[3 * k + 1] + R[3 * i + 2] * B[3 * k + 2]
        turns(new_axes[n], D, none, three)


@njit(cache=True)
def back(
    first: Int64, axes: Float64, turned_by: Float64, new_axes: Float64, limits: Float64, near: Float64,
    angles: Float64,
) -> None:  # fmt: skip
    """Convert ball joints' angles, in place, from a local tree to the body's tree, within its limits.

    Args:
        first, axes: (n,), (n, 3, 3) of `BallJoints`.
        turned_by, new_axes: (n, 9), (n, 3, 3) of `localise`.
        limits: (joints, 2) of the body's tree [rad].
        near: (joints,) angles of a pose nearby in the body's tree [rad].
        angles: (joints,) [rad]; only ball joints' angles are changed.
    """
    D, R = np.empty(9), np.empty(9)
    for n in range(len(first)):
        j = first[n]
        three = angles[j : j + 3]
        rotation(new_axes[n], three, D)
        _product(D, turned_by[n], R)
        turns_within(axes[n], R, limits[j : j + 3], near[j : j + 3], three)
