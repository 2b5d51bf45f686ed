"""Kernels of one digit's iterative inverse kinematics: FABRIK and Jacobian methods. Importing this imports numba.

A digit is a row (`DIGIT`,) of `hand_kernels`; its angles are f, a, m, b [rad].
"""

# ruff: noqa: PLR0912, PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.kinematics.hand_kernels import (
    AX,
    COUPLED,
    L1,
    L2,
    L3,
    M_MAX,
    NATURAL,
    RATIO,
    limit,
    missed,
    tip,
    to_digit,
    wrapped,
)  # fmt: skip

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]


@njit(cache=True)
def fabrik(row: Float64, x: float, y: float, z: float, out: Float64, tolerance: float, iterations: int) -> int:
    """Solve a digit's angles by FABRIK; return the number of iterations.

    Aristidou and Lasenby 2011, algorithm 1 and section 4: the base is a rotor with a cone of limits, the other joints
    are hinges, and the limits are imposed in every backward pass. The hinges are parallel, so the problem is planar
    once the rotor points at the target.

    Args:
        row: (`DIGIT`,) the digit's parameters, see `hand_kernels`.
        x, y, z: target of the tip, in the digit's frame [m].
        out: (4,) flexion f and abduction a of the first joint, flexions m and b of the others [rad]; the start,
            overwritten with the result.
        tolerance: distance of the tip at which it has reached the target [m].
        iterations: largest number of iterations.
    """
    f, a, m, b = out[0], out[1], out[2], out[3]
    azimuth = math.atan2(x, z) if z >= 0.0 else math.atan2(-x, -z)
    u1, w1 = row[L1] * math.cos(f), row[L1] * math.sin(f)
    u2, w2 = u1 + row[L2] * math.cos(f + m), w1 + row[L2] * math.sin(f + m)
    length = row[L1] + row[L2] + row[L3]
    for k in range(iterations):
        limit(row, f, azimuth, m, b, out)
        a = out[1]
        tu, tw = x * math.sin(a) + z * math.cos(a), -y
        far = math.hypot(tu, tw)
        if far >= length:  # not reachable: stretch towards it
            u1, w1 = row[L1] * tu / far, row[L1] * tw / far
            u2, w2 = (row[L1] + row[L2]) * tu / far, (row[L1] + row[L2]) * tw / far
        else:
            d = max(math.hypot(u2 - tu, w2 - tw), 1e-12)
            u2, w2 = tu + row[L3] * (u2 - tu) / d, tw + row[L3] * (w2 - tw) / d
            d = max(math.hypot(u1 - u2, w1 - w2), 1e-12)
            u1, w1 = u2 + row[L2] * (u1 - u2) / d, w2 + row[L2] * (w1 - w2) / d
        limit(row, math.atan2(w1, u1), azimuth, 0.0, 0.0, out)
        f, a = out[0], out[1]
        u1, w1 = row[L1] * math.cos(f), row[L1] * math.sin(f)
        m = min(max(wrapped(math.atan2(w2 - w1, u2 - u1) - f), 0.0), row[M_MAX])
        u2, w2 = u1 + row[L2] * math.cos(f + m), w1 + row[L2] * math.sin(f + m)
        limit(row, f, a, m, wrapped(wrapped(math.atan2(tw - w2, tu - u2) - f) - m), out)
        b = out[3]
        if missed(row, x, y, z, f, a, m, b) < tolerance:
            return k + 1
    return iterations


TRANSPOSE, PSEUDO_INVERSE, DAMPED = 0, 1, 2


@njit(cache=True)
def follow_jacobian(
    row: Float64, x: float, y: float, z: float, out: Float64, kind: int, tolerance: float, iterations: int,
    damping_m: float, work: Float64,
) -> int:  # fmt: skip
    """Solve a digit's angles by a Jacobian method; return the number of iterations.

    Buss 2004, sections 3 to 6; each step is at most 0.5 rad, and then the angles are clamped to their limits.

    Args:
        row: (`DIGIT`,) the digit's parameters, see `hand_kernels`.
        x, y, z: target of the tip, in the digit's frame [m].
        out: (4,) flexion f and abduction a of the first joint, flexions m and b of the others [rad]; the start,
            overwritten with the result.
        kind: `TRANSPOSE`, `PSEUDO_INVERSE` or `DAMPED`.
        tolerance: distance of the tip at which it has reached the target [m].
        iterations: largest number of iterations.
        damping_m: λ of the damped least squares [m].
        work: (25, 4) workspace.
    """
    J, A, e, d = work[0:4], work[4:8], work[8], work[9]  # J's rows are the angles' columns
    coupled = row[COUPLED] > 0.0
    for k in range(iterations):
        f, a, m, b = out[0], out[1], out[2], out[3]
        tx, ty, tz = tip(row, f, a, m, b)
        e[0], e[1], e[2] = x - tx, y - ty, z - tz
        if e[0] * e[0] + e[1] * e[1] + e[2] * e[2] < tolerance * tolerance:
            return k
        u3, w3 = row[L3] * math.cos(f + m + b), row[L3] * math.sin(f + m + b)
        u2, w2 = u3 + row[L2] * math.cos(f + m), w3 + row[L2] * math.sin(f + m)
        u1, w1 = u2 + row[L1] * math.cos(f), w2 + row[L1] * math.sin(f)
        sine, cosine = math.sin(a), math.cos(a)
        J[0, 0], J[0, 1], J[0, 2] = -w1 * sine, -u1, -w1 * cosine
        J[1, 0], J[1, 1], J[1, 2] = u1 * cosine, 0.0, -u1 * sine
        J[2, 0], J[2, 1], J[2, 2] = -w2 * sine, -u2, -w2 * cosine
        J[3, 0], J[3, 1], J[3, 2] = -w3 * sine, -u3, -w3 * cosine
        if row[AX] == 0.0:
            J[1, 0] = J[1, 1] = J[1, 2] = 0.0
        if coupled:
            for c in range(3):
                J[2, c] += row[RATIO] * J[3, c]
                J[3, c] = 0.0
        for i in range(3):  # A = J Jᵀ
            for c in range(3):
                A[i, c] = 0.0
                for j in range(4):
                    A[i, c] += J[j, i] * J[j, c]
        if kind == TRANSPOSE:
            over, under = 0.0, 1e-30
            for i in range(3):
                d[i] = A[i, 0] * e[0] + A[i, 1] * e[1] + A[i, 2] * e[2]
                over, under = over + e[i] * d[i], under + d[i] * d[i]
            for i in range(3):
                d[i] = e[i] * over / under
        else:
            extra = damping_m * damping_m if kind == DAMPED else 1e-12 * (A[0, 0] + A[1, 1] + A[2, 2])
            for i in range(3):
                A[i, i] += extra
            _solve_three(A, e, d)
        most = 1e-30
        for j in range(4):
            work[10, j] = J[j, 0] * d[0] + J[j, 1] * d[1] + J[j, 2] * d[2]
            most = max(most, abs(work[10, j]))
        part = min(1.0, 0.5 / most)  # half a radian at once
        f, a, m, b = f + part * work[10, 0], a + part * work[10, 1], m + part * work[10, 2], b + part * work[10, 3]
        limit(row, f, a, m, b, out)
    return iterations


@njit(cache=True)
def _solve_three(A: Float64, e: Float64, d: Float64) -> None:
    """Write the solution of A d = e for a symmetric (3, 3) matrix, by its adjugate."""
    c00 = A[1, 1] * A[2, 2] - A[1, 2] * A[1, 2]
    c01 = A[0, 2] * A[1, 2] - A[0, 1] * A[2, 2]
    c02 = A[0, 1] * A[1, 2] - A[0, 2] * A[1, 1]
    determinant = A[0, 0] * c00 + A[0, 1] * c01 + A[0, 2] * c02
    c11 = A[0, 0] * A[2, 2] - A[0, 2] * A[0, 2]
    c12 = A[0, 1] * A[0, 2] - A[0, 0] * A[1, 2]
    c22 = A[0, 0] * A[1, 1] - A[0, 1] * A[0, 1]
    scale = 1.0 / determinant if abs(determinant) > 1e-300 else 0.0
    d[0] = scale * (c00 * e[0] + c01 * e[1] + c02 * e[2])
    d[1] = scale * (c01 * e[0] + c11 * e[1] + c12 * e[2])
    d[2] = scale * (c02 * e[0] + c12 * e[1] + c22 * e[2])


FABRIK = 3


@njit(cache=True)
def hand_iterative(
    digits: Float64, targets: Float64, angles: Float64, errors: Float64, iterations: Int64, kind: int,
    tolerance: float, most: int, damping_m: float,
) -> None:  # fmt: skip
    """Solve the angles of five digits as `hand_closed_form` does, by an iterative method.

    Args:
        digits, targets, angles, errors: (5, `DIGIT`), (5, 3) [m], (5, 4) in and out [rad], (5,) written [m], as in
            `hand_closed_form`.
        iterations: (5,) written: number of iterations for each digit.
        kind: the method: `FABRIK`, or one of the Jacobian methods of `follow_jacobian`.
        tolerance: distance at which a digit counts as solved [m].
        most: largest number of iterations.
        damping_m: λ of the damped least squares [m].
    """
    work = np.empty((25, 4))
    for i in range(5):
        row, out = digits[i], angles[i]
        x, y, z = to_digit(row, targets[i, 0], targets[i, 1], targets[i, 2])
        iterations[i] = 0
        for k in range(4):
            if not abs(out[k]) < 1e3:
                out[k] = row[NATURAL + k]
        limit(row, out[0], out[1], out[2], out[3], out)
        if not (abs(x) < 1e3 and abs(y) < 1e3 and abs(z) < 1e3):
            errors[i] = math.nan
            continue
        if kind == FABRIK:
            iterations[i] = fabrik(row, x, y, z, out, tolerance, most)
        else:
            iterations[i] = follow_jacobian(row, x, y, z, out, kind, tolerance, most, damping_m, work)
        errors[i] = missed(row, x, y, z, out[0], out[1], out[2], out[3])
