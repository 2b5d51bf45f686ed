"""Kernels of one digit's iterative inverse kinematics: FABRIK, Jacobian methods and Newton's. Importing imports numba.

A digit is a row (`DIGIT`,) of `hand_kernels`; its angles are f, a, m, b [rad].
"""

# ruff: noqa: PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.kinematics.hand_kernels import (
    A0,
    AX,
    B_MAX,
    COUPLED,
    F0,
    FMIN,
    FX,
    L1,
    L2,
    L3,
    M_MAX,
    NATURAL,
    RATIO,
    bounds,
    descend,
    limit,
    missed,
    tip,
    to_digit,
    wrapped,
)  # fmt: skip

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

TRANSPOSE, PSEUDO_INVERSE, DAMPED, FABRIK, NEWTON = 0, 1, 2, 3, 4
STARTS = 4  # further initial postures where the first does not lead to the target
_AT_LIMIT = 1e-9
_HALVINGS = 12
_STILL_M = 1e-9  # least progress of an iteration
_STILL = 1e-10  # least change of angles in an iteration [rad]


@njit(cache=True)
def _spread(row: Float64, f: float, a: float) -> float:
    """Return the abduction within the cone nearest to a, at the flexion f [rad]."""
    share = (min(max(f, row[FMIN]), row[F0] + row[FX]) - row[F0]) / row[FX]
    most = row[AX] * math.sqrt(max(1.0 - share * share, 0.0))
    return float(row[A0] + min(max(a - row[A0], -most), most))


@njit(cache=True)
def fabrik(row: Float64, x: float, y: float, z: float, out: Float64, tolerance: float, iterations: int) -> int:
    """Solve a digit's angles by FABRIK; return the number of iterations.

    Aristidou and Lasenby 2011, algorithm 1 and section 4: the base is a rotor with a cone of limits, the other joints
    are hinges, and the limits are imposed in every forward pass. The hinges are parallel, so the problem is planar
    once the rotor points at the target. Coupled hinges take the coupled flexions nearest to those of the pass
    (a constraint of the model: Aristidou, Chrysanthou, Lasenby 2016). The nearest posture of all passes is the result.

    Args:
        row: (`DIGIT`,) the digit's parameters, see `hand_kernels`.
        x, y, z: target of the tip, in the digit's frame [m].
        out: (4,) flexion f and abduction a of the first joint, flexions m and b of the others [rad]; the start,
            overwritten with the result.
        tolerance: distance of the tip at which it has reached the target [m].
        iterations: largest number of iterations.
    """
    f, a, m, b = out[0], out[1], out[2], out[3]
    best_f, best_a, best_m, best_b = f, a, m, b
    least = missed(row, x, y, z, f, a, m, b)
    azimuth = math.atan2(x, z) if z >= 0.0 else math.atan2(-x, -z)
    u1, w1 = row[L1] * math.cos(f), row[L1] * math.sin(f)
    u2, w2 = u1 + row[L2] * math.cos(f + m), w1 + row[L2] * math.sin(f + m)
    length = row[L1] + row[L2] + row[L3]
    k, still = 0, False
    while k < iterations and least >= tolerance and not still:
        k += 1
        a = _spread(row, f, azimuth)
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
        towards = math.atan2(w1, u1)
        limit(row, towards, _spread(row, towards, azimuth), 0.0, 0.0, out)
        turned, spread = out[0], out[1]
        u1, w1 = row[L1] * math.cos(turned), row[L1] * math.sin(turned)
        middle = min(max(wrapped(math.atan2(w2 - w1, u2 - u1) - turned), 0.0), row[M_MAX])
        u2, w2 = u1 + row[L2] * math.cos(turned + middle), w1 + row[L2] * math.sin(turned + middle)
        last = wrapped(wrapped(math.atan2(tw - w2, tu - u2) - turned) - middle)
        if row[COUPLED] > 0.0:
            middle = (middle + row[RATIO] * last) / (1.0 + row[RATIO] ** 2)
        limit(row, turned, spread, middle, last, out)
        still = abs(out[0] - f) + abs(out[1] - a) + abs(out[2] - m) + abs(out[3] - b) < _STILL
        f, a, m, b = out[0], out[1], out[2], out[3]
        u2, w2 = u1 + row[L2] * math.cos(f + m), w1 + row[L2] * math.sin(f + m)
        away = missed(row, x, y, z, f, a, m, b)
        if away < least:
            least, best_f, best_a, best_m, best_b = away, f, a, m, b
    out[0], out[1], out[2], out[3] = best_f, best_a, best_m, best_b
    return k


@njit(cache=True)
def follow_jacobian(
    row: Float64, x: float, y: float, z: float, out: Float64, kind: int, tolerance: float, iterations: int,
    damping_m: float, work: Float64,
) -> int:  # fmt: skip
    """Solve a digit's angles by a Jacobian method; return the number of iterations.

    Buss 2004, sections 3 to 6. A step is at most 0.5 rad. A joint at a limit that the step would cross is locked, and
    the step is computed anew without it (Baerlocher and Boulic 2004, section 4.2); on the cone's rim only the motion
    across it is locked. A step that does not bring the tip nearer is halved; if no part of it does, the solver stops.

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
    J, A, e, d, step, new = work[0:4], work[4:8], work[8], work[9], work[10], work[11]
    away = missed(row, x, y, z, out[0], out[1], out[2], out[3])
    for k in range(iterations):
        if away < tolerance:
            return k
        tx, ty, tz = tip(row, out[0], out[1], out[2], out[3])
        e[0], e[1], e[2] = x - tx, y - ty, z - tz
        _differentiate(row, out, J)
        locked = 0
        for _ in range(5):
            _step(J, A, e, d, kind, damping_m, step)
            before, locked = locked, _lock(row, out, J, step, locked)
            if locked == before:
                break
        most = 1e-30
        for j in range(4):
            most = max(most, abs(step[j]))
        part, nearer = min(1.0, 0.5 / most), away
        for _ in range(_HALVINGS):
            limit(
                row, out[0] + part * step[0], out[1] + part * step[1], out[2] + part * step[2],
                out[3] + part * step[3], new,
            )  # fmt: skip
            nearer = missed(row, x, y, z, new[0], new[1], new[2], new[3])
            if nearer < away:
                break
            part *= 0.5
        if not nearer < away - _STILL_M:
            return k + 1
        away = nearer
        for j in range(4):
            out[j] = new[j]
    return iterations


@njit(cache=True)
def _differentiate(row: Float64, q: Float64, J: Float64) -> None:
    """Write the tip's derivatives J (4, 3) by the angles q (4,); a coupled joint has its leader's."""
    f, a, m, b = q[0], q[1], q[2], q[3]
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
    if row[COUPLED] > 0.0:
        for c in range(3):
            J[2, c] += row[RATIO] * J[3, c]
            J[3, c] = 0.0


@njit(cache=True)
def _step(J: Float64, A: Float64, e: Float64, d: Float64, kind: int, damping_m: float, step: Float64) -> None:
    """Write a method's step (4,) for the tip's error e (3,)."""
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
    for j in range(4):
        step[j] = J[j, 0] * d[0] + J[j, 1] * d[1] + J[j, 2] * d[2]


@njit(cache=True)
def _lock(row: Float64, q: Float64, J: Float64, step: Float64, locked: int) -> int:
    """Remove from J (4, 3) the motions that take a step (4,) across limits at q (4,); return the set of these."""
    if q[0] <= row[FMIN] + _AT_LIMIT and step[0] < 0.0 and not locked & 1:
        locked |= 1
        _drop(J, 0)
    for j in range(2, 4):
        high = row[M_MAX] if j == 2 else row[B_MAX]
        outward = (q[j] <= _AT_LIMIT and step[j] < 0.0) or (q[j] >= high - _AT_LIMIT and step[j] > 0.0)
        if outward and not locked & (1 << j):
            locked |= 1 << j
            _drop(J, j)
    f, a = (q[0] - row[F0]) / row[FX], (q[1] - row[A0]) / row[AX] if row[AX] > 0.0 else 0.0
    if f * f + a * a >= 1.0 - _AT_LIMIT and not locked & 2:
        nf, na = f / row[FX], a / row[AX] if row[AX] > 0.0 else 0.0
        if nf * step[0] + na * step[1] > 0.0:
            locked |= 2
            size = math.hypot(nf, na)
            tf, ta = -na / size, nf / size
            for c in range(3):
                along = tf * J[0, c] + ta * J[1, c]
                J[0, c], J[1, c] = tf * along, ta * along
    return locked


@njit(cache=True)
def _drop(J: Float64, j: int) -> None:
    """Set a row of J (4, 3) to 0."""
    J[j, 0] = J[j, 1] = J[j, 2] = 0.0


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


@njit(cache=True)
def newton(
    row: Float64, x: float, y: float, z: float, out: Float64, tolerance: float, iterations: int, work: Float64,
) -> int:  # fmt: skip
    """Solve a digit's angles by Newton's method with exact second derivatives; return the number of iterations.

    Nocedal and Wright, *Numerical Optimization* (2006), sections 3.4 (modified Hessian) and 16.7 (bounds).

    Args:
        row: (`DIGIT`,) the digit's parameters, see `hand_kernels`.
        x, y, z: target of the tip, in the digit's frame [m].
        out: (4,) flexion f and abduction a of the first joint, flexions m and b of the others [rad]; the start,
            overwritten with the result.
        tolerance: distance of the tip at which it has reached the target [m].
        iterations: largest number of iterations.
        work: (25, 4) workspace.
    """
    least = missed(row, x, y, z, out[0], out[1], out[2], out[3])
    if least < tolerance:
        return 0
    low, high, v, new = work[11], work[12], work[13], work[14]
    bounds(row, low, high)
    f, a = (out[0] - row[F0]) / row[FX], (out[1] - row[A0]) / row[AX] if row[AX] > 0.0 else 0.0
    size, turn = math.hypot(f, a), math.atan2(f, a)
    if row[AX] == 0.0:
        size, turn = f, 0.5 * math.pi
    m, b, used = out[2], out[3], 0
    for side in range(2):  # at the cone's apex the direction has no gradient: begin on either side of it
        v[0], v[1], v[2], v[3] = max(size, 0.05) if row[AX] > 0.0 else size, turn, m, b
        if side == 1:
            v[0], v[1] = 0.05, math.pi - turn
        _value, steps = descend(row, x, y, z, v, low, high, work, iterations - used, 0.5 * tolerance * tolerance)
        used += steps
        limit(
            row, row[F0] + row[FX] * v[0] * math.sin(v[1]), row[A0] + row[AX] * v[0] * math.cos(v[1]), v[2], v[3], new
        )
        away = missed(row, x, y, z, new[0], new[1], new[2], new[3])
        if away < least:
            least = away
            for j in range(4):
                out[j] = new[j]
        if least < tolerance or row[AX] == 0.0 or v[0] > 1e-6 or low[0] < 0.0:
            break
    return used


@njit(cache=True)
def _solve(
    row: Float64, x: float, y: float, z: float, out: Float64, kind: int, tolerance: float, most: int,
    damping_m: float, work: Float64,
) -> int:  # fmt: skip
    """Solve a digit's angles out (4,) from their start by a method; return the number of iterations."""
    if kind == FABRIK:
        return int(fabrik(row, x, y, z, out, tolerance, most))
    if kind == NEWTON:
        return int(newton(row, x, y, z, out, tolerance, most, work))
    return int(follow_jacobian(row, x, y, z, out, kind, tolerance, most, damping_m, work))


@njit(cache=True)
def hand_iterative(
    digits: Float64, targets: Float64, angles: Float64, errors: Float64, iterations: Int64, kind: int,
    tolerance: float, most: int, damping_m: float, starts: int,
) -> None:  # fmt: skip
    """Solve the angles of five digits as `hand_closed_form` does, by an iterative method.

    Where a digit's start does not lead to its target, further starts are tried; one that ends nearer by more than the
    tolerance, or reaches the target, takes its place.

    Args:
        digits, targets, angles, errors: (5, `DIGIT`), (5, 3) [m], (5, 4) in and out [rad], (5,) written [m], as in
            `hand_closed_form`.
        iterations: (5,) written: number of iterations for each digit, over all starts.
        kind: the method: `FABRIK`, `NEWTON`, or one of the Jacobian methods of `follow_jacobian`.
        tolerance: distance at which a digit counts as solved [m].
        most: largest number of iterations from a start.
        damping_m: λ of the damped least squares [m].
        starts: number of further starts, at most `STARTS`.
    """
    work, new = np.empty((25, 4)), np.empty(4)
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
        iterations[i] = _solve(row, x, y, z, out, kind, tolerance, most, damping_m, work)
        errors[i] = missed(row, x, y, z, out[0], out[1], out[2], out[3])
        azimuth = math.atan2(x, z) if z >= 0.0 else math.atan2(-x, -z)
        for k in range(starts):
            if errors[i] < tolerance:
                break
            first = (0.3, 0.7, 0.05, -0.5)[k]
            middle = row[M_MAX] * (0.15, 0.5, 0.85, 0.3)[k]
            first = row[F0] + first * row[FX]
            limit(row, first, _spread(row, first, azimuth), middle, row[RATIO] * middle, new)
            iterations[i] += _solve(row, x, y, z, new, kind, tolerance, most, damping_m, work)
            away = missed(row, x, y, z, new[0], new[1], new[2], new[3])
            if away < errors[i] - tolerance or (away < tolerance <= errors[i]):
                errors[i] = away
                for c in range(4):
                    out[c] = new[c]
