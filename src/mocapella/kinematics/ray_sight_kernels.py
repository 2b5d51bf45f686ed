"""Kernels of what rays tell about the joints of a body: which rays count, and the joints' information matrices.

Importing this module imports numba.
"""

# ruff: noqa: PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.kinematics.articulated_model import BodyArrays
from mocapella.kinematics.ray_point_kernels import GATE, NEAREST_M, NU, agree, invert, misfit, student

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]


UNSURE_SPEED = 0.3
"""Standard deviation of a joint's predicted speed, for rays of another time than the frame's [m/s]."""
LEAST_SD, MOST_SD = 1e-5, 1.0
"""Least standard deviation of a direction, which smaller ones count as, and the one above which a ray has no
information [rad]."""
FARTHEST_M = 1e5
"""Sum of a camera's coordinates above which its rays are not used, because of rounding errors [m]."""
UNIT = 1e-3
"""Largest deviation of a direction's squared length from 1."""
SURE = 3
"""Least number of agreeing rays of a joint that counts as measured, however far it is from its prediction."""
MOST_SURPRISE = 4.0
"""Limit of one joint's surprise."""
FIRST_VARIANCE = 0.0025
"""Variance of a joint about the pose while a body is initialised [m²]."""


class Sight(NamedTuple):
    """The rays of one frame, sorted by joint, and their information about the joints.

    Attributes:
        rays: (n, 8) of `ray_point_kernels`, about the body's root.
        order: (n,) indices of the valid rays, sorted by joint.
        first: (joints + 1,) the rays of joint j are order[first[j]:first[j + 1]].
        weights: (n,) robust weights.
        agreeing: (joints,) number of rays that agree on the joint's point.
        points: (joints, 9) the point about the root, and its covariance; read where two rays or more agree.
        information: (joints, 6) upper triangle of Λ, the misfit of the body model included [1/m²].
        forces: (joints, 3) Λ r [1/m].
        offsets: (joints, 4) keypoint − joint of the chain, with the world's axes [m], and the variance of a coordinate
            [m²].
    """

    rays: Float64
    order: Int64
    first: Int64
    weights: Float64
    agreeing: Int64
    points: Float64
    information: Float64
    forces: Float64
    offsets: Float64


@njit(cache=True, error_model="numpy")
def sort_rays(sight: Sight, joints: Int64, origins: Float64, directions: Float64, sds_rad: Float64) -> None:
    """Sort the valid rays by joint into the sight's ``order`` and ``first``; set the others' weights to 0."""
    order, first, weights = sight.order, sight.first, sight.weights
    n = len(first) - 1
    for turn in range(2):
        for k in range(len(joints)):
            j, sd, far, square = joints[k], sds_rad[k], 0.0, 0.0
            for i in range(3):
                far += abs(origins[k, i])
                square += directions[k, i] * directions[k, i]
            if not (0 <= j < n and 0.0 < sd < MOST_SD and far < FARTHEST_M and abs(square - 1.0) < UNIT):
                weights[k] = 0.0
            elif turn == 0:
                first[j + 1] += 1
            else:
                order[first[j]] = k
                first[j] += 1
        if turn == 0:
            for j in range(n):
                first[j + 1] += first[j]
    for j in range(n, 0, -1):
        first[j] = first[j - 1]
    first[0] = 0


@njit(cache=True, error_model="numpy")
def crossed(sight: Sight) -> bool:
    """Return whether two rays or more see any joint."""
    most = 0
    for j in range(len(sight.first) - 1):
        most = max(most, sight.first[j + 1] - sight.first[j])
    return most > 1


@njit(cache=True, error_model="numpy")
def aim(
    sight: Sight, joints: Int64, origins: Float64, directions: Float64, sds_rad: Float64,
    after_s: Float64, origin: Float64, speeds: Float64,
) -> None:  # fmt: skip
    """Write the valid rays about an origin (3,), moved back to the frame's instant by joint speeds (joints, 3)."""
    rays, order, first, offsets = sight.rays, sight.order, sight.first, sight.offsets
    for i in range(first[len(first) - 1]):
        k = order[i]
        j, late = joints[k], after_s[k]
        for m in range(3):
            rays[k, m] = origins[k, m] - origin[m] - late * speeds[j, m] - offsets[j, m]
            rays[k, 3 + m] = directions[k, m]
        rays[k, 6] = max(sds_rad[k], LEAST_SD) ** 2
        rays[k, 7] = offsets[j, 3] + (UNSURE_SPEED * late) ** 2


@njit(cache=True, error_model="numpy")
def shift_origin(sight: Sight, shift: Float64) -> None:
    """Move the origin of the rays and points by ``shift`` (3,) [m]."""
    rays, points, order, first, agreeing = sight.rays, sight.points, sight.order, sight.first, sight.agreeing
    for i in range(first[len(first) - 1]):
        for k in range(3):
            rays[order[i], k] -= shift[k]
    for j in range(len(points)):
        if agreeing[j] >= 2:
            for k in range(3):
                points[j, k] -= shift[k]


@njit(cache=True, error_model="numpy")
def weigh(
    model: BodyArrays, sight: Sight, known: bool, positions: Float64, variances: Float64, aged: Float64
) -> tuple[float, int]:
    """Weight the rays by their agreement with each other and with the prediction.

    Args:
        model, known, positions: as in `_fit`.
        sight: its weights, agreeing rays and points are written.
        variances: (joints,) variance of a coordinate of the prediction [m²].
        aged: (joints,) the same with the growth since the last triangulation [m²].

    Returns:
        The sum of the surprises of the joints that rays see, and their number.
    """
    rays, order, weights, nu = sight.rays, sight.order, sight.weights, model.parameters.degrees_of_freedom
    starts, agreeing, points = sight.first, sight.agreeing, sight.points
    surprise, seen = 0.0, 0
    for j in range(len(variances)):
        first, last = starts[j], starts[j + 1]
        agreeing[j] = 0
        if first == last:
            continue
        variance = aged[j] if known else math.inf
        agreeing[j] = agree(rays, order, first, last, variance, positions[j], weights, points[j])
        if not known:
            seen += agreeing[j] > 1
            continue
        expected, total, share = 0.0, 0.0, 0.0
        for i in range(first, last):
            k = order[i]
            own = spread(rays, k, positions, j)
            off = misfit(rays, k, positions[j, 0], positions[j, 1], positions[j, 2]) * own
            if not math.isfinite(off):
                weights[k] = 0.0
                continue
            if agreeing[j] < 2:
                weights[k] = student(off / (own + aged[j]), 2.0, nu) ** 2
            expected += weights[k] * off / (own + variances[j])
            total += weights[k] * off / (own + aged[j])
            share += weights[k]
        if not share > 0.0:
            continue
        seen += 1
        surprise += min(0.5 * expected / share, MOST_SURPRISE)
        if 2 <= agreeing[j] < SURE:
            joint = student(total / share, 2.0, nu)
            for i in range(first, last):
                weights[order[i]] *= joint
    return surprise, seen


@njit(cache=True, error_model="numpy")
def reweigh(sight: Sight, positions: Float64) -> None:
    """Multiply the rays' weights by their agreement with a pose that is not yet found well."""
    rays, weights = sight.rays, sight.weights
    for j in range(len(positions)):
        for i in range(sight.first[j], sight.first[j + 1]):
            k = sight.order[i]
            chi2 = misfit(rays, k, positions[j, 0], positions[j, 1], positions[j, 2])
            own = spread(rays, k, positions, j)
            wide = chi2 * own / (own + FIRST_VARIANCE)
            weights[k] = weights[k] * student(wide, 2.0, NU) if math.isfinite(wide) else 0.0


@njit(cache=True, error_model="numpy")
def spread(rays: Float64, k: int, positions: Float64, j: int) -> float:
    """Return the variance of the distance of ray k from joint j, the divisor of its misfit [m²]."""
    s = 0.0
    for m in range(3):
        s += rays[k, 3 + m] * (positions[j, m] - rays[k, m])
    return float(rays[k, 6] * s * s + rays[k, 7])


@njit(cache=True, error_model="numpy")
def gather(sight: Sight, j: int, positions: Float64, out: Float64) -> None:
    """Write the sum of the information of the rays to joint j about its position, and their force, to out (9,).

    A ray at distance s, with the unit direction d and the angular variance σ², tells (I − d dᵀ) / (σ s)².
    """
    rays, order, weights, starts = sight.rays, sight.order, sight.weights, sight.first
    first, last, misfits = starts[j], starts[j + 1], sight.offsets[j, 3]
    a00 = a01 = a02 = a11 = a12 = a22 = f0 = f1 = f2 = 0.0
    x, y, z = positions[j, 0], positions[j, 1], positions[j, 2]
    for i in range(first, last):
        k = order[i]
        if not weights[k] > 0.0:
            continue
        d0, d1, d2 = rays[k, 3], rays[k, 4], rays[k, 5]
        r0, r1, r2 = rays[k, 0] - x, rays[k, 1] - y, rays[k, 2] - z
        s = r0 * d0 + r1 * d1 + r2 * d2
        # Least distance as in `misfit`; the offset's variance is common to all rays, and not this ray's.
        w = weights[k] / (rays[k, 6] * max(s * s, NEAREST_M * NEAREST_M) + max(rays[k, 7] - misfits, 0.0))
        a00 += w * (1.0 - d0 * d0)
        a01 -= w * d0 * d1
        a02 -= w * d0 * d2
        a11 += w * (1.0 - d1 * d1)
        a12 -= w * d1 * d2
        a22 += w * (1.0 - d2 * d2)
        f0 += w * (r0 - s * d0)
        f1 += w * (r1 - s * d1)
        f2 += w * (r2 - s * d2)
    out[0], out[1], out[2], out[3], out[4], out[5] = a00, a01, a02, a11, a12, a22
    out[6], out[7], out[8] = f0, f1, f2


@njit(cache=True, error_model="numpy")
def inform(sight: Sight, positions: Float64) -> None:
    """Write each joint's information matrix Λ and force Λ r at the present positions (joints, 3).

    The offset of the keypoint from the chain is the same for all rays of a joint: with its variance p, (I + p Λ)⁻¹ Λ is
    left of the sum Λ of their information.
    """
    information, forces, inverse, A = sight.information, sight.forces, np.empty(6), np.empty(9)
    first, offsets = sight.first, sight.offsets
    for j in range(len(positions)):
        if first[j] == first[j + 1]:
            for i in range(6):
                information[j, i] = 0.0
            forces[j, 0] = forces[j, 1] = forces[j, 2] = 0.0
            continue
        gather(sight, j, positions, A)
        a00, a01, a02, a11, a12, a22 = A[0], A[1], A[2], A[3], A[4], A[5]
        p = offsets[j, 3]
        invert(1.0 + p * a00, p * a01, p * a02, 1.0 + p * a11, p * a12, 1.0 + p * a22, inverse, 0)
        b00, b01, b02, b11, b12, b22 = inverse[0], inverse[1], inverse[2], inverse[3], inverse[4], inverse[5]
        information[j, 0] = b00 * a00 + b01 * a01 + b02 * a02
        information[j, 1] = b00 * a01 + b01 * a11 + b02 * a12
        information[j, 2] = b00 * a02 + b01 * a12 + b02 * a22
        information[j, 3] = b01 * a01 + b11 * a11 + b12 * a12
        information[j, 4] = b01 * a02 + b11 * a12 + b12 * a22
        information[j, 5] = b02 * a02 + b12 * a12 + b22 * a22
        forces[j, 0] = b00 * A[6] + b01 * A[7] + b02 * A[8]
        forces[j, 1] = b01 * A[6] + b11 * A[7] + b12 * A[8]
        forces[j, 2] = b02 * A[6] + b12 * A[7] + b22 * A[8]


@njit(cache=True, error_model="numpy")
def triangulated(sight: Sight) -> int:
    """Return the number of joints that two rays or more agree on."""
    count = 0
    for j in range(len(sight.agreeing)):
        count += sight.agreeing[j] >= 2
    return count


@njit(cache=True, error_model="numpy")
def supporting(sight: Sight, j: int, positions: Float64, covariances: Float64) -> int:
    """Return how many rays agree with joint j of the estimate, within their noise and its uncertainty."""
    rays, order, weights, first, agreeing = sight.rays, sight.order, sight.weights, sight.first, 0
    variance = (covariances[j, 0, 0] + covariances[j, 1, 1] + covariances[j, 2, 2]) / 3.0
    for i in range(first[j], first[j + 1]):
        k = order[i]
        own = spread(rays, k, positions, j)
        chi2 = misfit(rays, k, positions[j, 0], positions[j, 1], positions[j, 2])
        agreeing += weights[k] > 0.0 and chi2 * own < GATE * (own + variance)
    return agreeing
