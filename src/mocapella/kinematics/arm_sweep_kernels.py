"""Kernels that compare many postures of one digit with a depth image. Importing this module imports numba.

A digit has local minima where gradient steps do not help, such as a finger matched to its neighbour's points. So the
cost is evaluated on a table of postures, and a fit continues from the best.
"""

# ruff: noqa: PLR0912, PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.geometry.turn_kernels import FIRST
from mocapella.kinematics.arm_arrays import ArmArrays, FitParameters
from mocapella.kinematics.arm_fit import ArmEvidence, ArmPose
from mocapella.kinematics.arm_flesh_kernels import (
    FROM,
    LENGTH,
    MIDDLE,
    PIECE,
    RA,
    RB,
    SCALE,
    THICK,
    U,
    closest,
    digit_pieces,
    flesh,
)  # fmt: skip
from mocapella.kinematics.arm_residual_kernels import JUDGED, compare, robust, sphere
from mocapella.kinematics.hand_fit_kernels import digit_angles, digit_points, within
from mocapella.kinematics.hand_kernels import DIGIT, L1

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

COSTS = (1.0, 0.5, 0.1, 0.002)  # weights of points, flesh, overlapping digits (at most 2), deviations from the prior


@njit(cache=True)
def swept(
    arm: ArmArrays, image: ArmEvidence, mean: Float64, precision: Float64, pose: ArmPose, parameters: FitParameters,
    digit: int, tries: Float64, out: Float64,
) -> None:  # fmt: skip
    """Evaluate the fit's cost for each of many postures of one digit (exhaustive search), up to a common constant.

    Only the terms that depend on the digit are computed: points that are not near another piece, the digit's own
    capsules, its overlaps, and the prior. So dozens of postures take no longer than a step of the fit.

    Args:
        arm, image, pose, parameters: the hand's model, the image's measurements, the present pose, and the scales and
            weights of the cost.
        mean, precision: (n,), (n, n) mean and inverse covariance of the free angles' prior.
        digit: index of the digit, 0 for the thumb.
        tries: (k, 5) the digit's angles f, a, m, b, c in each posture [rad]; clamped to the limits in place.
        out: (k,) cost of each posture, written.
    """
    digits, columns, gains = arm.digits, arm.columns, arm.gains
    radii, owners, R, t, z, v = arm.radii, arm.owners, pose.R, pose.t, pose.z, pose.v
    rows, joints, axes = np.empty((5, DIGIT)), np.empty((5, 4, 3)), np.empty((5, 5, 3))
    pieces = np.empty((len(owners), PIECE))
    flesh(digits, arm.mirror, radii, arm.palm, columns, gains, z, v, rows, joints, axes, pieces)
    hit, q = np.empty(5), np.empty(5)
    now = FitParameters(
        JUDGED * parameters.point_scale_m, JUDGED * parameters.silhouette_scale_m, parameters.point_information,
        parameters.silhouette_information, parameters.collision_information, parameters.ahead_m, parameters.overlap_m,
        parameters.pieces, parameters.edge_m, parameters.sharpness,
    )  # fmt: skip
    for bone in range(3):  # away
        for k in range(3):
            pieces[3 * digit + bone, MIDDLE + k] = 1e9
    reach = 0.03
    for k in range(3):
        reach += rows[digit, L1 + k]
    kept = np.empty((len(image.points), 8))
    few, total = _near_points(pieces, joints[digit, 0], reach, image, R, t, now.point_scale_m, kept)
    area = 0.0
    for i in range(len(pieces)):
        p = pieces[i]
        area += (p[RA] + p[RB]) * max(p[LENGTH], 0.005) * (1.0 if owners[i, 0] >= 0 else 0.4)
    own, angles = np.empty((3, PIECE)), z.copy()
    for c in range(len(tries)):
        for k in range(5):
            if columns[digit, k] >= 0:
                angles[columns[digit, k]] = tries[c, k]
        within(digits, columns, gains, angles, arm.c_max)
        unusual = 0.0
        for i in range(len(angles)):
            for k in range(len(angles)):
                unusual += (angles[i] - mean[i]) * precision[i, k] * (angles[k] - mean[k])
        for k in range(5):
            if columns[digit, k] >= 0:
                tries[c, k] = angles[columns[digit, k]]
        digit_angles(angles, columns, gains, digit, q)
        digit_points(rows[digit], arm.mirror, q, joints[digit], axes[digit])
        digit_pieces(digit, rows[digit, L1 + 2], radii, v[THICK] * v[SCALE], joints[digit], pieces)
        for k in range(3):
            for i in range(PIECE):
                own[k, i] = pieces[3 * digit + k, i]
        unexplained = 0.0
        for i in range(few):
            closest(own, len(own), FIRST, kept[i, 0], kept[i, 1], kept[i, 2], kept[i, 3], kept[i, 4], kept[i, 5], hit)
            unexplained += kept[i, 6] * min(robust(hit[4], now.point_scale_m)[1], kept[i, 7])
        outside = _outside(own, image, pose, now)
        overlap = _overlap(pieces, digit, now.overlap_m)
        out[c] = (
            unexplained / max(total, 1.0) + COSTS[1] * outside / area + COSTS[2] * min(overlap, 2.0)
            + COSTS[3] * unusual
        )  # fmt: skip


@njit(cache=True)
def _near_points(
    pieces: Float64, base: Float64, reach: float, image: ArmEvidence, R: Float64, t: Float64, scale_m: float,
    kept: Float64,
) -> tuple[int, float]:  # fmt: skip
    """Write the points near a digit that are not near another piece: position, direction of view (palm's frame), weight
    and robust cost (m, 8).

    Returns:
        Their number, and the weight of all points.
    """
    points, weights, hit = image.points, image.weights, np.empty(5)
    ox = -(R[0] * t[0] + R[3] * t[1] + R[6] * t[2])
    oy = -(R[1] * t[0] + R[4] * t[1] + R[7] * t[2])
    oz = -(R[2] * t[0] + R[5] * t[1] + R[8] * t[2])
    few, total, first = 0, 0.0, np.int64(15)
    for i in range(len(points)):
        total += weights[i]
        X, Y, Z = points[i, 0], points[i, 1], points[i, 2]
        x = R[0] * X + R[3] * Y + R[6] * Z + ox
        y = R[1] * X + R[4] * Y + R[7] * Z + oy
        w = R[2] * X + R[5] * Y + R[8] * Z + oz
        dx, dy, dz = x - base[0], y - base[1], w - base[2]
        if weights[i] <= 0.0 or dx * dx + dy * dy + dz * dz > reach * reach:
            continue
        vx, vy, vz = x - ox, y - oy, w - oz
        f = 1.0 / math.sqrt(vx * vx + vy * vy + vz * vz)
        first = closest(pieces, len(pieces), first, x, y, w, f * vx, f * vy, f * vz, hit)
        cost = robust(hit[4], scale_m)[1]
        if cost < 0.05:
            continue
        kept[few, 0], kept[few, 1], kept[few, 2] = x, y, w
        kept[few, 3], kept[few, 4], kept[few, 5] = f * vx, f * vy, f * vz
        kept[few, 6], kept[few, 7] = weights[i], cost
        few += 1
    return few, total


@njit(cache=True)
def _outside(own: Float64, image: ArmEvidence, pose: ArmPose, parameters: FitParameters) -> float:
    """Return the cost of a digit's pieces beyond the silhouette or in front of the surface, by area [m²]."""
    R, t, beside = pose.R, pose.t, np.empty(5)
    outside = 0.0
    for bone in range(3):
        p = own[bone]
        for step in range(3):
            if bone < 2 and step == 2:
                continue  # the next bone's first
            a, r = 0.5 * step * p[LENGTH], p[RA] + (p[RB] - p[RA]) * 0.5 * step
            x, y, w = p[FROM] + a * p[U], p[FROM + 1] + a * p[U + 1], p[FROM + 2] + a * p[U + 2]
            X = R[0] * x + R[1] * y + R[2] * w + t[0]
            Y = R[3] * x + R[4] * y + R[5] * w + t[1]
            Z = R[6] * x + R[7] * y + R[8] * w + t[2]
            if compare(image, X, Y, Z, r, parameters, beside) > 0:
                outside += 2.0 * r * max(0.5 * p[LENGTH], 0.005) * beside[4]
    return float(outside)


@njit(cache=True)
def _overlap(pieces: Float64, digit: int, overlap_m: float) -> float:
    """Return the cost of a digit's overlaps with the others."""
    one, other = np.empty(4), np.empty(4)
    overlap = 0.0
    for rival in range(5):
        if rival == digit:
            continue
        for i in range(6):
            sphere(pieces, digit, i, one)
            for k in range(6):
                sphere(pieces, rival, k, other)
                within_m = one[3] + other[3] - overlap_m
                d2 = (one[0] - other[0]) ** 2 + (one[1] - other[1]) ** 2 + (one[2] - other[2]) ** 2
                if d2 < within_m * within_m:
                    overlap += ((within_m - math.sqrt(d2)) / 0.01) ** 2
    return float(overlap)
