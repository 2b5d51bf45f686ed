"""Compiled judgement of pairs of sensors: covariance, clock offset and problem of each estimate, from a pair's sums.

`mocapella.calibration.pair_calibration` derives the covariance. Sums are in arrays, whose elements the constants of
`pair_memory` name. Importing this module imports numba.
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.pair_memory import (
    BLOCKS,
    BLOCKS_SQ,
    CENTRE,
    CLOCK_A,
    CLOCK_AA,
    CLOCK_AG,
    CLOCK_G,
    CLOCK_GG,
    COST,
    COST_WEIGHT,
    MOTION,
    OFFSET,
    PairLimits,
)
from mocapella.calibration.time_offset import BLOCKS_WANTED, OFFSET_PRIOR_SD
from mocapella.compiled import njit
from mocapella.geometry.alignment_kernels import diagonalise

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

LEAST_EIGENVALUE = 1e-7
"""Lower bound of the eigenvalues of H in units of its diagonal."""
PRIOR_SAMPLES = 2.0
"""Weight of the prior of the scatter B, as a number of samples."""
SAMPLE_JOINTS = 25.0
"""Number of joints with independent errors that a sample is worth."""
MOST_SAMPLES = 8.0
"""Number of samples beyond which an estimate does not become more certain: systematic errors repeat."""
COMMON_PART = 0.3
"""Error that all joints of a view share, a shift of the whole body, as a fraction of the residual."""
NOISE_S = 1.0
"""Time after which the noise of one posture is as small as its systematic error [s]."""
M_ESTIMATE = 1.5
"""Factor of the covariance: the weights 1/residual make H, for 3-D points, up to 3/2 times too large."""
ON_A_LINE_M = 0.03
"""Least scatter of points across their line for determining the rotation about it [m]."""
MIRRORED_M = 0.15
"""Least scatter of points in their third direction for a reflection to mean a mirrored image, not a flat body [m]."""

FINE, ON_A_LINE, MIRRORED, NOT_ONE_BODY, WALK, WALK_ACROSS = range(6)
"""Results of `problem_of`: indices in `pair_calibration.PROBLEMS`."""
POSITION_SD, ROTATION_SD, SAMPLES, RESIDUAL, SECONDS, SECONDS_SD, PROBLEM = range(7)
"""Columns of the figures of `estimate_each`."""


@njit(cache=True, error_model="numpy")
def estimate_each(
    M: Float64, T: Float64, S: Float64, B: Float64, K: Float64, limits: PairLimits, C: Float64, figures: Float64
) -> None:
    """Compute covariance, clock offset and problem of pairs that have compared joints, or were given a pose.

    Args:
        M, T, S, B, K: (pairs, `alignment.MOMENTS`), (pairs, 4, 4), (pairs, `pair_memory.PAIR_SCALARS`), (pairs, 7, 7)
            and (pairs, `pair_memory.CLOCK_SUMS`) of `PairCalibration`.
        limits: the settings.
        C: (pairs, 6, 6) written: covariance of the pose's twist, translation [m] before rotation [rad].
        figures: (pairs, 7) written: standard deviation of a point at the people [m] and of the rotation [rad], number
            of independent samples, residual [m], correction of the clock offset in use and its standard deviation [s],
            and the index of the problem.
    """
    H = np.empty((7, 7))
    for p in range(len(M)):
        normal_matrix(M[p], T[p], S[p, OFFSET], H)
        squares = S[p, BLOCKS_SQ]
        samples = S[p, BLOCKS] * S[p, BLOCKS] / squares if squares > 0.0 else 0.0
        residual = S[p, COST] / S[p, COST_WEIGHT]
        seconds, seconds_sd = clock_offset(K[p])
        covariance(H, B[p], M[p, 0], samples, S[p, MOTION], residual, seconds_sd, limits.residual_floor_m, C[p])
        x, y, z = S[p, CENTRE], S[p, CENTRE + 1], S[p, CENTRE + 2]
        x, y, z = x / S[p, COST_WEIGHT], y / S[p, COST_WEIGHT], z / S[p, COST_WEIGHT]
        c = C[p]
        turned = (y * y + z * z) * c[3, 3] + (x * x + z * z) * c[4, 4] + (x * x + y * y) * c[5, 5]
        turned -= 2.0 * (x * y * c[3, 4] + x * z * c[3, 5] + y * z * c[4, 5])
        both = x * (c[1, 5] - c[2, 4]) + y * (c[2, 3] - c[0, 5]) + z * (c[0, 4] - c[1, 3])
        figures[p, POSITION_SD] = math.sqrt(max(c[0, 0] + c[1, 1] + c[2, 2] + turned + 2.0 * both, 0.0))
        figures[p, ROTATION_SD] = math.sqrt(c[3, 3] + c[4, 4] + c[5, 5])
        figures[p, SAMPLES], figures[p, RESIDUAL] = samples, residual
        figures[p, SECONDS], figures[p, SECONDS_SD] = seconds, seconds_sd
        figures[p, PROBLEM] = problem_of(
            M[p], samples, figures[p, POSITION_SD], figures[p, ROTATION_SD], residual, limits
        )


@njit(cache=True, error_model="numpy")
def normal_matrix(M: Float64, T: Float64, offset: float, H: Float64) -> None:
    """Compute the matrix of `alignment.normal_equations` of one pair of sensors.

    Args:
        M: (`alignment.MOMENTS`,) moments.
        T: (4, 4) ``T_p_q``.
        offset: clock offset of q [s].
        H: (7, 7) written.
    """
    W = M[0]
    qq, qv, vv, R, half = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    xx, xu, x, Rq, u = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3)
    upper = 0
    for i in range(3):
        for k in range(3):
            R[i, k] = T[i, k]
            if k >= i:
                qq[i, k] = qq[k, i] = M[37 + upper]
                vv[i, k] = vv[k, i] = M[43 + upper]
                upper += 1
    for i in range(3):  # every q moves along its velocity
        for k in range(3):
            moved = offset * (M[28 + 3 * i + k] + M[28 + 3 * k + i]) + offset * offset * vv[i, k]
            qq[i, k] += moved
            qv[i, k] = M[28 + 3 * i + k] + offset * vv[i, k]
    for i in range(3):
        Rq[i] = u[i] = 0.0
        for k in range(3):
            Rq[i] += R[i, k] * (M[4 + k] + offset * M[16 + k])
            u[i] += R[i, k] * M[16 + k]
        x[i] = Rq[i] + W * T[i, 3]
    _turned_both(R, qq, half, xx)
    _turned_both(R, qv, half, xu)
    for i in range(3):
        for k in range(3):
            xx[i, k] += Rq[i] * T[k, 3] + T[i, 3] * Rq[k] + W * T[i, 3] * T[k, 3]
            xu[i, k] += T[i, 3] * u[k]
    trace = xx[0, 0] + xx[1, 1] + xx[2, 2]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for m in range(3):
            H[i, m] = W if i == m else 0.0
            H[3 + i, 3 + m] = (trace if i == m else 0.0) - xx[i, m]
        H[i, 3 + i] = H[3 + i, i] = 0.0
        H[3 + k, j] = H[j, 3 + k] = x[i]
        H[3 + j, k] = H[k, 3 + j] = -x[i]
        H[6, i] = H[i, 6] = u[i]
        H[6, 3 + i] = H[3 + i, 6] = xu[j, k] - xu[k, j]
    H[6, 6] = M[43] + M[46] + M[48]


@njit(cache=True, error_model="numpy")
def _turned_both(R: Float64, A: Float64, half: Float64, out: Float64) -> None:
    """Write R A Rᵀ into ``out``; all are (3, 3), and ``half`` is overwritten."""
    for i in range(3):
        for k in range(3):
            half[i, k] = R[i, 0] * A[0, k] + R[i, 1] * A[1, k] + R[i, 2] * A[2, k]
    for i in range(3):
        for k in range(3):
            out[i, k] = half[i, 0] * R[k, 0] + half[i, 1] * R[k, 1] + half[i, 2] * R[k, 2]


@njit(cache=True, error_model="numpy")
def clock_offset(clock: Float64) -> tuple[float, float]:
    """Return the offset of b's clock against the assumed one, and its standard deviation [s].

    With too few blocks, the offset is 0, and the standard deviation that of the prior.

    Args:
        clock: (`pair_memory.CLOCK_SUMS`,) sums over blocks, see `time_offset`.
    """
    a, squares, offset, information = clock[CLOCK_A], clock[CLOCK_AA], 0.0, 0.0
    blocks = a * a / (squares if squares > 0.0 else 1.0) if a > 0.0 else 0.0
    if blocks >= BLOCKS_WANTED:
        offset = clock[CLOCK_G] / a
        scatter = clock[CLOCK_GG] - 2 * offset * clock[CLOCK_AG] + offset * offset * squares
        scatter = max(scatter, 0.0) * (blocks + 2) / (blocks - 1)
        information = a * a / max(scatter, 1e-12 * a * a)
    return offset, 1.0 / math.sqrt(information + 1 / OFFSET_PRIOR_SD**2)


@njit(cache=True, error_model="numpy")
def covariance(
    H: Float64, B: Float64, W: float, samples: float, motion_s: float, residual: float, offset_sd: float,
    floor_m: float, C: Float64,
) -> None:  # fmt: skip
    """Compute the covariance of a pair's pose.

    Args:
        H: (7, 7) of `normal_matrix`.
        B: (7, 7) scatter of the gradients of samples.
        W: sum of the joints' weights.
        samples: number of independent samples; one posture is one sample.
        motion_s: duration of shared motion [s].
        residual: mean distance between the two views' joints [m].
        offset_sd: standard deviation of the clock offset [s].
        floor_m: `PairSettings.residual_floor_m`.
        C: (6, 6) written.
    """
    samples, error = max(samples, 1.0), max(residual, 0.5 * floor_m)
    # Scaled so that H is near the identity, because metres, radians and seconds differ in size.
    unit, N, V, back, scatter = np.empty(7), np.empty((7, 7)), np.empty((7, 7)), np.empty((7, 7)), np.empty((7, 7))
    for i in range(7):
        unit[i] = 1.0 / math.sqrt(max(H[i, i], 1e-12 * H[0, 0]))
    for i in range(7):
        for k in range(7):
            N[i, k] = unit[i] * H[i, k] * unit[k]
    diagonalise(N, V)
    # Prior of the scatter: a sample is worth its joints, with independent errors, once their noise has averaged out.
    of_one, noise = error * error * W / (3 * SAMPLE_JOINTS), 1.0 + NOISE_S / max(motion_s, 1e-3)
    for i in range(7):
        for k in range(7):
            one, inverted = 0.0, 0.0
            for m in range(7):
                value = max(N[m, m], LEAST_EIGENVALUE)
                one += V[i, m] * value * V[k, m]
                inverted += V[i, m] / value * V[k, m]
            one *= of_one
            back[i, k] = unit[i] * inverted
            seen = unit[i] * B[i, k] * unit[k]
            scatter[i, k] = (samples * seen + PRIOR_SAMPLES * noise / samples * one) / (samples + PRIOR_SAMPLES)
            scatter[i, k] += one / MOST_SAMPLES
    _sandwiched(back, scatter, N, V)
    gain = 1.0 / (V[6, 6] + offset_sd * offset_sd)
    for i in range(6):
        for k in range(6):
            C[i, k] = V[i, k] - gain * V[i, 6] * V[k, 6]
    for i in range(3):
        C[i, i] += (COMMON_PART * error) ** 2 / 3


@njit(cache=True, error_model="numpy")
def _sandwiched(A: Float64, S: Float64, half: Float64, out: Float64) -> None:
    """Write A S Aᵀ, times `M_ESTIMATE` and made symmetric, into ``out``; all are (7, 7).

    ``half`` is overwritten.
    """
    for i in range(7):
        for k in range(7):
            half[i, k] = 0.0
            for m in range(7):
                half[i, k] += A[i, m] * S[m, k]
    for i in range(7):
        for k in range(i + 1):
            total = 0.0
            for m in range(7):
                total += half[i, m] * A[k, m] + half[k, m] * A[i, m]
            out[i, k] = out[k, i] = 0.5 * M_ESTIMATE * total


@njit(cache=True, error_model="numpy")
def problem_of(
    M: Float64, samples: float, position_sd: float, rotation_sd: float, residual: float, limits: PairLimits
) -> int:
    """Return the index of an estimate's first problem, from moments (`alignment.MOMENTS`,) and its figures."""
    W, P, Q, V = M[0], np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for i in range(3):
        for k in range(3):
            P[i, k] = (M[7 + 3 * i + k] - M[1 + i] * M[4 + k] / W) / W
    for i in range(3):
        for k in range(3):
            Q[i, k] = P[0, i] * P[0, k] + P[1, i] * P[1, k] + P[2, i] * P[2, k]
    diagonalise(Q, V)  # into the squares of the singular values of P
    largest, least = max(Q[0, 0], Q[1, 1], Q[2, 2]), min(Q[0, 0], Q[1, 1], Q[2, 2])
    middle = Q[0, 0] + Q[1, 1] + Q[2, 2] - largest - least
    if middle < ON_A_LINE_M**4:
        return ON_A_LINE
    volume = P[0, 0] * (P[1, 1] * P[2, 2] - P[1, 2] * P[2, 1]) - P[0, 1] * (P[1, 0] * P[2, 2] - P[1, 2] * P[2, 0])
    volume += P[0, 2] * (P[1, 0] * P[2, 1] - P[1, 1] * P[2, 0])
    if volume < 0.0 and least > MIRRORED_M**4:
        return MIRRORED
    if residual > limits.residual_allowed_m:
        return NOT_ONE_BODY
    if position_sd > limits.position_sd_wanted_m or rotation_sd > limits.rotation_sd_wanted:
        return WALK if samples < limits.samples_wanted else WALK_ACROSS
    return FINE
