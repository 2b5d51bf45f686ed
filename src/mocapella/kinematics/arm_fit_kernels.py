"""Kernels that fit an arm and a hand to the points of a depth image.

The arm's surface, here called *flesh*, is a set of tapered capsules about the bones. The fit minimises, over the palm's
motion, the hand's angles, the directions of forearm and upper arm, and the person's sizes,

    Σ ρ(distance of a point of the image from the flesh's visible side)
  + Σ ρ(distance of a piece of flesh beyond the silhouette, or in front of the measured surface)
  + Σ (overlap of digits)² + prior of sizes and angles + penalty beyond joint limits + prediction

by Gauss–Newton steps with points assigned anew before each (articulated ICP): A. Tagliasacchi et al., "Robust
Articulated-ICP for Real-Time Hand Tracking", Computer Graphics Forum 34 (2015) 101, equations 1 to 8; the pieces of
flesh as in A. Tkach, M. Pauly, A. Tagliasacchi, "Sphere-Meshes for Real-Time Hand Modeling and Tracking", ACM Trans.
Graph. 35 (2016) 222. Residuals and derivatives are in the palm's frame. Importing this module imports numba.
"""

# ruff: noqa: PLR0912, PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.geometry.cholesky_kernels import factorise, substitute
from mocapella.geometry.turn_kernels import FIRST, orthonormal, turn_between, turned
from mocapella.kinematics.arm_arrays import ArmArrays, FitParameters
from mocapella.kinematics.arm_fit import ArmEvidence, ArmPose, ArmPrior
from mocapella.kinematics.arm_flesh_kernels import (
    ARM_THICK,
    BODY_DOFS,
    D_ARM_THICK,
    D_DIGITS,
    D_FOREARM,
    D_LENGTH,
    D_SCALE,
    D_THICK,
    D_UPPER,
    DIGITS,
    FOREARM,
    FOREARM_M,
    FROM,
    LENGTH,
    OF_PALM,
    OF_UPPER_ARM,
    PIECE,
    RA,
    RB,
    SCALE,
    STATE,
    THICK,
    UPPER,
    U,
    across,
    balls,
    closest,
    flesh,
    relevance,
    visible,
)  # fmt: skip
from mocapella.kinematics.arm_residual_kernels import (
    GROUPS,
    JUDGED,
    MOVERS,
    ROW,
    add_collisions,
    add_groups,
    add_residual,
    compare,
    group_derivatives,
    group_of,
    residual_numbers,
    robust,
)  # fmt: skip
from mocapella.kinematics.arm_sweep_kernels import COSTS, swept
from mocapella.kinematics.hand_fit_kernels import _penalty, within
from mocapella.kinematics.hand_kernels import DIGIT

__all__ = [
    "COSTS",
    "COST_TERMS",
    "DIGIT",
    "FROM",
    "LENGTH",
    "PIECE",
    "RA",
    "RB",
    "STATE",
    "U",
    "balls",
    "fit",
    "flesh",
    "relevance",
    "swept",
    "system",
    "visible",
]

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

COST_TERMS = 7  # length of the costs of a pose, see `system`
_REST_M, _REST_RAD = 0.0002, 0.004  # smaller steps count as convergence
NEAR_ARM = 0.5  # least weight of points near the hand or forearm
STRAY = 6.0  # factor of the points' robust scale at which stray points are judged
_AT_REST = 2.0  # scale of the robust loss of a part at rest, in standard deviations
_TARGET_SD = 0.004  # standard deviation of a fingertip detected as a branch's end [m]


@njit(cache=True)
def system(
    arm: ArmArrays, image: ArmEvidence, which: Int64, pose: ArmPose, parameters: FitParameters, H: Float64, g: Float64,
    costs: Float64, targets: Float64, only_costs: bool,
) -> None:  # fmt: skip
    """Add the Gauss–Newton normal equations H δ = g of the fit's geometric terms to H and g.

    Degrees of freedom (dofs): the palm's twist in its own frame (6), the free angles, and the `BODY_DOFS` of
    `arm_flesh_kernels`.

    Args:
        arm: the arm's model.
        image: the measurements.
        which: (m,) index of the piece last assigned to each point, read and updated.
        pose: pose and sizes of the arm.
        parameters: scales and weights.
        H, g: (dofs, dofs), its lower triangle only, and (dofs,); added to, unless ``only_costs``.
        costs: (`COST_TERMS`,) written: weighted sum of the points' robust costs, 0 to 1 each; integral of the flesh's
            robust cost, 0 to 1, over its area [m²]; sum of the digits' squared overlaps [cm²]; that area, and the part
            of it that other objects occlude [m²]; sum of the robust costs, 0 to 1 each, at `STRAY` times the scale, of
            the points near the arm (`NEAR_ARM`), and their number. The area is the flesh's within the image; palm,
            forearm and upper arm count less than the digits.
        targets: (5, 3) approximate fingertips, camera frame [m], which attract the digits' tips in H and g; NaN where
            unknown.
        only_costs: do not change H and g.

    Raises:
        ValueError: the number of costs is not `COST_TERMS`.
    """
    if len(costs) != COST_TERMS:  # a shorter array would be written beyond its end
        raise ValueError("costs: not COST_TERMS values")
    z, v = pose.z, pose.v
    rows, joints, axes = np.empty((5, DIGIT)), np.empty((5, 4, 3)), np.empty((5, 5, 3))
    pieces = np.empty((len(arm.owners), PIECE))
    flesh(arm.digits, arm.mirror, arm.radii, arm.palm, arm.columns, arm.gains, z, v, rows, joints, axes, pieces)
    A, at, counts = np.empty((GROUPS, MOVERS, ROW)), np.empty((GROUPS, MOVERS), np.int64), np.empty(GROUPS, np.int64)
    Q, b = np.zeros((GROUPS, ROW, ROW)), np.zeros((GROUPS, ROW))
    if not only_costs:
        group_derivatives(joints, axes, arm.columns, arm.gains, arm.rising, v, len(z), A, at, counts)
    for k in range(COST_TERMS):
        costs[k] = 0.0
    _add_points(pieces, arm.owners, image, which, pose, parameters, only_costs, Q, b, costs)
    _add_flesh(pieces, arm.owners, image, pose, parameters, only_costs, Q, b, costs)
    add_collisions(pieces, A, at, counts, v, parameters, only_costs, H, g, costs)
    if only_costs:
        return
    _add_targets(targets, joints, pose, Q, b)
    add_groups(A, at, counts, Q, b, H, g)


@njit(cache=True)
def _add_points(
    pieces: Float64, owners: Int64, image: ArmEvidence, which: Int64, pose: ArmPose, parameters: FitParameters,
    only_costs: bool, Q: Float64, b: Float64, costs: Float64,
) -> None:  # fmt: skip
    """Add the distances of the image's points from the flesh; `system` describes the arguments."""
    R, t, v, points, weights = pose.R, pose.t, pose.v, image.points, image.weights
    few, q, hit = parameters.pieces, np.empty(ROW), np.empty(5)
    ox = -(R[0] * t[0] + R[3] * t[1] + R[6] * t[2])
    oy = -(R[1] * t[0] + R[4] * t[1] + R[7] * t[2])
    oz = -(R[2] * t[0] + R[5] * t[1] + R[8] * t[2])
    for i in range(len(points)):
        X, Y, Z = points[i, 0], points[i, 1], points[i, 2]
        x = R[0] * X + R[3] * Y + R[6] * Z + ox
        y = R[1] * X + R[4] * Y + R[7] * Z + oy
        w = R[2] * X + R[5] * Y + R[8] * Z + oz
        vx, vy, vz = x - ox, y - oy, w - oz
        f = 1.0 / math.sqrt(vx * vx + vy * vy + vz * vz)
        piece = closest(pieces, few, which[i], x, y, w, f * vx, f * vy, f * vz, hit)
        which[i] = piece
        weight, cost = robust(hit[4], parameters.point_scale_m)
        costs[0] += weights[i] * cost
        if weights[i] >= NEAR_ARM:
            costs[5] += robust(hit[4], STRAY * parameters.point_scale_m)[1]
            costs[6] += 1.0
        if only_costs or weight < 0.01:
            continue
        p, c = pieces[piece], hit[3]
        r = p[RA] + (p[RB] - p[RA]) * c / max(p[LENGTH], 1e-6)
        group = group_of(owners[piece, 0], owners[piece, 1])
        residual_numbers(
            group, hit[0], hit[1], hit[2], p[FROM] + c * p[U], p[FROM + 1] + c * p[U + 1], p[FROM + 2] + c * p[U + 2],
            r, v, q,
        )  # fmt: skip
        add_residual(q, weights[i] * weight * parameters.point_information, hit[4], Q[group], b[group])


@njit(cache=True)
def _add_flesh(
    pieces: Float64, owners: Int64, image: ArmEvidence, pose: ArmPose, parameters: FitParameters, only_costs: bool,
    Q: Float64, b: Float64, costs: Float64,
) -> None:  # fmt: skip
    """Add the flesh beyond the silhouette or in front of the surface; `system` describes the arguments."""
    R, t, v = pose.R, pose.t, pose.v
    q, beside = np.empty(ROW), np.empty(5)
    for i in range(parameters.pieces):
        owner, bone = owners[i, 0], owners[i, 1]
        p = pieces[i]
        steps = 3 if owner >= 0 else (3 if owner == OF_PALM else 6)
        for step in range(steps):
            if owner >= 0 and bone < 2 and step == steps - 1:
                continue  # the next bone's first
            c = p[LENGTH] * step / (steps - 1)
            r = p[RA] + (p[RB] - p[RA]) * step / (steps - 1)
            x, y, w = p[FROM] + c * p[U], p[FROM + 1] + c * p[U + 1], p[FROM + 2] + c * p[U + 2]
            X = R[0] * x + R[1] * y + R[2] * w + t[0]
            Y = R[3] * x + R[4] * y + R[5] * w + t[1]
            Z = R[6] * x + R[7] * y + R[8] * w + t[2]
            # Palm and forearm overlap themselves.
            area = 2.0 * r * max(p[LENGTH] / (steps - 1), 0.005) * (1.0 if owner >= 0 else 0.4)
            if owner == OF_UPPER_ARM:
                area *= 0.1  # often hidden, and then it may be anywhere
            said = compare(image, X, Y, Z, r, parameters, beside)
            costs[3] += area * (said >= 0)
            costs[4] += area * (said == 0)
            if said <= 0:
                continue
            costs[1] += area * beside[4]
            if only_costs:
                continue
            group = group_of(owner, bone)
            # Flesh beyond the silhouette is moved inwards, sideways.
            if beside[0] > 0.0:
                ux, uy = beside[1], beside[2]
                nx, ny, nz = R[0] * ux + R[3] * uy, R[1] * ux + R[4] * uy, R[2] * ux + R[5] * uy
                weight = robust(beside[0], parameters.silhouette_scale_m)[0]
                residual_numbers(group, nx, ny, nz, x, y, w, -r, v, q)  # it stands out less as it gets thinner
                add_residual(
                    q, max(weight, 0.1) * parameters.silhouette_information, min(beside[0], 0.03), Q[group], b[group]
                )
            if beside[3] > 0.0:  # in front of the measured surface: move it back along the view
                f = 1.0 / math.sqrt(X * X + Y * Y + Z * Z)
                nx = f * (R[0] * X + R[3] * Y + R[6] * Z)
                ny = f * (R[1] * X + R[4] * Y + R[7] * Z)
                nz = f * (R[2] * X + R[5] * Y + R[8] * Z)
                weight = robust(beside[3], parameters.silhouette_scale_m)[0]
                residual_numbers(group, nx, ny, nz, x, y, w, 0.0, v, q)
                add_residual(q, weight * parameters.silhouette_information, beside[3], Q[group], b[group])


@njit(cache=True)
def _add_targets(targets: Float64, joints: Float64, pose: ArmPose, Q: Float64, b: Float64) -> None:
    """Add the distances of the fingertips from their targets; `system` describes the arguments."""
    R, t, v, q = pose.R, pose.t, pose.v, np.empty(ROW)
    ox = -(R[0] * t[0] + R[3] * t[1] + R[6] * t[2])
    oy = -(R[1] * t[0] + R[4] * t[1] + R[7] * t[2])
    oz = -(R[2] * t[0] + R[5] * t[1] + R[8] * t[2])
    for d in range(5):
        X, Y, Z = targets[d, 0], targets[d, 1], targets[d, 2]
        if not math.isfinite(X):
            continue
        x = R[0] * X + R[3] * Y + R[6] * Z + ox
        y = R[1] * X + R[4] * Y + R[7] * Z + oy
        w = R[2] * X + R[5] * Y + R[8] * Z + oz
        px, py, pz = joints[d, 3, 0], joints[d, 3, 1], joints[d, 3, 2]
        for k in range(3):
            nx, ny, nz = 1.0 * (k == 0), 1.0 * (k == 1), 1.0 * (k == 2)
            e = nx * (x - px) + ny * (y - py) + nz * (w - pz)
            residual_numbers(3 * d + 2, nx, ny, nz, px, py, pz, 0.0, v, q)
            add_residual(q, 1.0 / _TARGET_SD**2, e, Q[3 * d + 2], b[3 * d + 2])


@njit(cache=True)
def _turn(v: Float64, first: int, d1: float, d2: float) -> None:
    """Rotate the unit vector at v[first:first + 3] by small motions d1 and d2 perpendicular to it [rad], in place."""
    x, y, z = v[first], v[first + 1], v[first + 2]
    ax, ay, az = across(x, y, z)
    bx, by, bz = y * az - z * ay, z * ax - x * az, x * ay - y * ax
    x, y, z = x + d1 * ax + d2 * bx, y + d1 * ay + d2 * by, z + d1 * az + d2 * bz
    f = 1.0 / math.sqrt(x * x + y * y + z * z)
    v[first], v[first + 1], v[first + 2] = f * x, f * y, f * z


@njit(cache=True)
def _expected_body(expected: Float64, information: Float64, v: Float64, first: int, H: Float64, g: Float64) -> None:
    """Add the prior of directions and sizes to H and g."""
    for k in range(2):
        at = FOREARM if k == 0 else UPPER
        x, y, z = v[at], v[at + 1], v[at + 2]
        ax, ay, az = across(x, y, z)
        bx, by, bz = y * az - z * ay, z * ax - x * az, x * ay - y * ax
        # The information is along the palm's axes.
        for c in range(3):
            w = information[at + c]
            e = expected[at + c] - v[at + c]
            p, q = (ax, bx) if c == 0 else ((ay, by) if c == 1 else (az, bz))
            i = first + (D_FOREARM if k == 0 else D_UPPER)
            H[i, i] += w * p * p
            H[i + 1, i + 1] += w * q * q
            H[i + 1, i] += w * p * q
            g[i] += w * p * e
            g[i + 1] += w * q * e
        i = first + (D_FOREARM if k == 0 else D_UPPER)
        H[i, i] += 1e-6
        H[i + 1, i + 1] += 1e-6
    for j in range(9):
        k = j if j < 4 else DIGITS + j - 4
        i = first + D_DIGITS + j - 4
        if j < 4:
            i = first + (
                D_SCALE if k == SCALE else (D_THICK if k == THICK else (D_LENGTH if k == FOREARM_M else D_ARM_THICK))
            )
        # Sizes are logarithmic, the forearm's length is in metres.
        factor = 1.0 if k == FOREARM_M else v[k]
        # The forearm's length is proportional to the hand's size.
        e = (expected[k] * (v[SCALE] if k == FOREARM_M else 1.0) - v[k]) / factor
        w = information[k] * factor * factor
        H[i, i] += w
        g[i] += w * e


@njit(cache=True)
def fit(
    arm: ArmArrays, image: ArmEvidence, prior: ArmPrior, pose: ArmPose, parameters: FitParameters, loose: float,
    iterations: int, costs: Float64, targets: Float64, keep: float,
) -> None:  # fmt: skip
    """Fit pose and sizes of an arm, from a start near the solution, in place.

    Args:
        arm: the arm's model.
        image: the measurements.
        prior: prior and prediction.
        pose: the start, overwritten with the result.
        parameters: scales and weights.
        loose: factor of the robust scales in the first iteration; it falls to 1.
        iterations: largest number of iterations.
        costs: (`COST_TERMS`,) written: costs of the result, as of `system`.
        targets: (5, 3) as of `system`.
        keep: share of the iterations, from the first on, that use the targets.
    """
    z, v, digits, columns, gains = pose.z, pose.v, arm.digits, arm.columns, arm.gains
    n = 6 + len(z)
    full = n + BODY_DOFS
    H, g, M, d = np.empty((full, full)), np.empty(full), np.empty((full, full)), np.empty(full)
    Ha, ga = np.empty((n, n)), np.empty(n)
    nowhere = np.full((5, 3), math.nan)
    which = np.zeros(len(image.points), np.int64)
    turn, sharp = 0, (2 * iterations + 2) // 3
    while True:
        last = turn == iterations
        f = 1.0 if last or iterations < 2 else max(loose * (1.0 - 1.5 * turn / (iterations - 1)), 1.0)
        f *= JUDGED if last else 1.0
        # Edges locate the flesh's ends more sharply than points, but mislead far from the solution.
        sharp_information = parameters.silhouette_information * (parameters.sharpness if turn >= sharp else 1.0)
        now = FitParameters(
            f * parameters.point_scale_m, f * parameters.silhouette_scale_m, parameters.point_information,
            sharp_information, parameters.collision_information, parameters.ahead_m, parameters.overlap_m,
            parameters.pieces, parameters.edge_m, parameters.sharpness,
        )  # fmt: skip
        for i in range(full):
            g[i] = 0.0
            for k in range(full):
                H[i, k] = 0.0
        system(arm, image, which, pose, now, H, g, costs, targets if turn < keep * iterations else nowhere, last)
        for i in range(n):
            ga[i] = 0.0
            for k in range(n):
                Ha[i, k] = 0.0
        _add_prior(prior, pose, Ha, ga)
        _penalty(digits, columns, gains, z, arm.c_max, Ha, ga)
        for i in range(n):
            g[i] += ga[i]
            for k in range(i + 1):
                H[i, k] += Ha[i, k]
        _expected_body(prior.v, prior.information, v, n, H, g)
        for i in range(full):
            H[i, i] += 1e-6
        if last:
            break
        if not factorise(H, 1e-3, M):
            break
        for i in range(full):
            d[i] = g[i]
        substitute(M, d)
        most = 0.0
        for i in range(3, n):
            most = max(most, abs(d[i]))
        if most > 0.5:
            for i in range(full):
                d[i] *= 0.5 / most
        _apply_step(arm, pose, d)
        # After convergence the next stage begins.
        rests = most < _REST_RAD and max(abs(d[0]), abs(d[1]), abs(d[2])) < _REST_M
        turn = (sharp if turn < sharp else iterations) if rests else turn + 1


@njit(cache=True)
def _apply_step(arm: ArmArrays, pose: ArmPose, d: Float64) -> None:
    """Apply a step d (dofs,) to a pose, in place, and clamp angles and sizes to their limits."""
    R, t, z, v, digits, columns, gains = pose.R, pose.t, pose.z, pose.v, arm.digits, arm.columns, arm.gains
    n, new_R = 6 + len(z), np.empty(9)
    turned(R, FIRST, d[3], d[4], d[5], new_R)
    orthonormal(new_R)
    for k in range(3):
        t[k] += R[3 * k] * d[0] + R[3 * k + 1] * d[1] + R[3 * k + 2] * d[2]
    for k in range(9):
        R[k] = new_R[k]
    for k in range(n - 6):
        z[k] += d[6 + k]
    _turn(v, FOREARM, d[n + D_FOREARM], d[n + D_FOREARM + 1])
    _turn(v, UPPER, d[n + D_UPPER], d[n + D_UPPER + 1])
    v[FOREARM_M] = min(max(v[FOREARM_M] + d[n + D_LENGTH], 0.12), 0.4)
    v[SCALE] = min(max(v[SCALE] * math.exp(min(max(d[n + D_SCALE], -0.1), 0.1)), 0.6), 1.4)
    v[THICK] = min(max(v[THICK] * math.exp(min(max(d[n + D_THICK], -0.1), 0.1)), 0.7), 1.4)
    v[ARM_THICK] = min(max(v[ARM_THICK] * math.exp(min(max(d[n + D_ARM_THICK], -0.1), 0.1)), 0.7), 1.6)
    for k in range(5):
        v[DIGITS + k] = min(max(v[DIGITS + k] * math.exp(min(max(d[n + D_DIGITS + k], -0.1), 0.1)), 0.75), 1.3)
    within(digits, columns, gains, z, arm.c_max)


@njit(cache=True)
def _add_prior(prior: ArmPrior, pose: ArmPose, H: Float64, g: Float64) -> None:
    """Add the prior of the angles and the prediction to H and g."""
    R, t, z = pose.R, pose.t, pose.z
    n = len(z)
    for i in range(n):
        v = 0.0
        for k in range(n):
            v += prior.precision[i, k] * (z[k] - prior.mean[k])
            H[6 + i, 6 + k] += prior.precision[i, k]
        g[6 + i] -= v
        e = z[i] - prior.pose.z[i]
        w = prior.certainty[6 + i] + _steady(prior.steady[6 + i], e * e)
        H[6 + i, 6 + i] += w
        g[6 + i] -= w * e
    if prior.certainty[0] > 0.0 or prior.certainty[3] > 0.0:
        d = np.empty(6)
        d[3], d[4], d[5] = turn_between(prior.pose.R, FIRST, R)
        dx, dy, dz = t[0] - prior.pose.t[0], t[1] - prior.pose.t[1], t[2] - prior.pose.t[2]
        for k in range(3):
            d[k] = R[k] * dx + R[3 + k] * dy + R[6 + k] * dz
        for k in range(6):
            first = 0 if k < 3 else 3
            off = d[first] * d[first] + d[first + 1] * d[first + 1] + d[first + 2] * d[first + 2]
            w = prior.certainty[k] + _steady(prior.steady[k], off)
            H[k, k] += w
            g[k] -= w * d[k]


@njit(cache=True)
def _steady(information: float, squared: float) -> float:
    """Return the weight of a part's prediction at rest, by its squared distance (Geman–McClure loss)."""
    f = 1.0 / (1.0 + information * squared / _AT_REST**2)
    return information * f * f
