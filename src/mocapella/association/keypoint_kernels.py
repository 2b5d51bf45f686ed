"""Compiled assignment of detections' keypoints to predicted people; importing this module imports numba.

Common arguments:

    rays        `Rays` of one instant
    expected    `PredictedPeople` people
    origins     (cameras, 3) centres of the cameras, world [m]
    gates       `KeypointGates`

The cost is a truncated quadratic of the angle between a keypoint's ray and the direction to the predicted joint, in
units of both standard deviations, weighted by the confidence and divided by the sum of the weights. The assignment of
one camera is optimal (H. Kuhn, *The Hungarian Method for the Assignment Problem*, 1955, by shortest augmenting paths).
"""

# ruff: noqa: PLR0912, PLR0917 - compiled: arrays come by position, loops stand in one place
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.association.keypoint_rays import (
    JOINTS,
    MIRROR,
    MOST_COST,
    SPREADS,
    SWAP_COST,
    SWAP_RATIO,
    CameraArrays,
    KeypointGates,
    Matches,
    PredictedPeople,
    Rays,
)
from mocapella.compiled import njit
from mocapella.geometry.lens_kernels import undistort

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Bools = NDArray[np.bool_]

UNSURE_SHARE = 0.25
"""Weight of the logarithm of the variances' ratio."""
UNASSIGNED = 2.0
"""Cost of a detection without a person, above the gate; the ratio's logarithm must stay below it for a match."""
DUPLICATE_SHARE = 0.35
"""Mean distance of two detections of one person in one image, relative to its size, in units of its spread."""


@njit(cache=True, error_model="numpy")
def cast_rays(
    pixels: Float64, cameras: CameraArrays, joint_sd: float, least_sd_px: float, rays: Rays, sizes_px: Float64,
) -> None:  # fmt: skip
    """Undistort keypoints to rays in the world, with angular standard deviations.

    Args:
        pixels: (detections, 26, 2) [px]; NaN where not seen.
        cameras: the cameras.
        joint_sd: standard deviation of an average keypoint, relative to the person's size [ratio].
        least_sd_px: least standard deviation [px].
        rays: directions and standard deviations are written; keypoints of confidence 0 are not used, and those outside
            the lens model get this confidence.
        sizes_px: (detections,) written: size of each person, the side of a square of the keypoints' area [px].
    """
    for d in range(len(pixels)):
        c = rays.camera[d]
        lens = cameras.lenses[c]
        left, right, top, bottom = math.inf, -math.inf, math.inf, -math.inf
        for j in range(JOINTS):
            if rays.confidences[d, j] > 0.0:
                x, y = pixels[d, j, 0], pixels[d, j, 1]
                left, right, top, bottom = min(left, x), max(right, x), min(top, y), max(bottom, y)
        wide, high = max(right - left, 0.0), max(bottom - top, 0.0)
        size = math.sqrt(max(wide, 0.35 * high) * max(high, 0.35 * wide))
        sizes_px[d] = size
        for j in range(JOINTS):
            sure = rays.confidences[d, j]
            rays.confidences[d, j] = 0.0
            rays.sds_rad[d, j] = math.nan
            for k in range(3):
                rays.directions[d, j, k] = math.nan
            if not sure > 0.0:
                continue
            u, v = (pixels[d, j, 0] - lens[2]) / lens[0], (pixels[d, j, 1] - lens[3]) / lens[1]
            x, y = undistort(u, v, lens[4], lens[5], lens[6], lens[7], lens[8], cameras.farthest_r2[c])
            r2 = 1.0 + x * x + y * y
            if not r2 < math.inf:
                continue
            R, length = cameras.R_world_camera[c], 1.0 / math.sqrt(r2)
            for k in range(3):
                rays.directions[d, j, k] = length * (R[k, 0] * x + R[k, 1] * y + R[k, 2])
            sd_px = math.hypot(least_sd_px, joint_sd * size * SPREADS[j])
            focal = 0.5 * (lens[0] + lens[1])
            rays.sds_rad[d, j] = sd_px / (focal * r2 * math.sqrt(min(1.0, 0.1 + sure)))
            rays.confidences[d, j] = sure


@njit(cache=True, error_model="numpy")
def match_cost(
    rays: Rays, d: int, expected: PredictedPeople, p: int, origins: Float64, swapped: bool,
) -> tuple[float, float, int]:  # fmt: skip
    """Compare a detection with a predicted person.

    Args:
        rays, expected, origins: see the module.
        d, p: index of the detection, and row of the person.
        swapped: whether the detection's left and right are exchanged first.

    Returns:
        The mean squared deviation, at most `MOST_COST`; the same with the mean logarithm of the variances' ratio, which
        makes uncertain people no better matches than certain ones; the number of common keypoints.
    """
    total, unsure, weight, common = 0.0, 0.0, 0.0, 0
    origin, after_s = origins[rays.camera[d]], rays.after_s[d]
    for j in range(JOINTS):
        i = MIRROR[j] if swapped else j
        w = rays.confidences[d, i]
        x = expected.positions[p, j, 0] + after_s * expected.velocities[p, j, 0] - origin[0]
        y = expected.positions[p, j, 1] + after_s * expected.velocities[p, j, 1] - origin[1]
        z = expected.positions[p, j, 2] + after_s * expected.velocities[p, j, 2] - origin[2]
        s2 = x * x + y * y + z * z
        if not (w > 0.0 and s2 > 1e-4):
            continue
        s = math.sqrt(s2)
        x, y, z = x / s, y / s, z / s
        dx, dy, dz = rays.directions[d, i, 0], rays.directions[d, i, 1], rays.directions[d, i, 2]
        C = expected.covariances[p, j]
        along = x * (C[0, 0] * x + 2.0 * (C[0, 1] * y + C[0, 2] * z)) + y * (C[1, 1] * y + 2.0 * C[1, 2] * z)
        along += C[2, 2] * z * z
        own = rays.sds_rad[d, i] ** 2
        variance = own + 0.5 * max(C[0, 0] + C[1, 1] + C[2, 2] - along, 0.0) / s2
        cosine = x * dx + y * dy + z * dz
        deviation = MOST_COST
        if cosine > 0.0:
            deviation = min(((dx - x) ** 2 + (dy - y) ** 2 + (dz - z) ** 2) / (2.0 * variance), MOST_COST)
        total += w * deviation
        unsure += w * math.log(variance / own)
        weight += w
        common += 1
    if common == 0:
        return MOST_COST, MOST_COST, 0
    return total / weight, (total + UNSURE_SHARE * unsure) / weight, common


@njit(cache=True, error_model="numpy")
def optimal(cost: Float64, rows: int, columns: int, unassigned: float, column_of: Int64) -> None:
    """Assign rows to columns at the least total cost, where a row without a column costs ``unassigned``.

    Args:
        cost: (≥ rows, ≥ columns) cost of each pair; pairs of infinite cost, or not below ``unassigned``, are not made.
        rows, columns: the used part of ``cost``.
        unassigned: cost of a row without a column.
        column_of: (≥ rows,) written: column of each row; −1 for none.
    """
    width = columns + rows  # each row has a column of its own for being unassigned
    u, v = np.zeros(rows + 1), np.zeros(width + 1)
    row_at, way = np.zeros(width + 1, np.int64), np.zeros(width + 1, np.int64)
    least, used = np.empty(width + 1), np.empty(width + 1, np.bool_)
    for i in range(1, rows + 1):
        row_at[0], at = i, 0
        for j in range(width + 1):
            least[j], used[j] = math.inf, False
        while row_at[at] != 0:
            used[at] = True
            row, delta, following = row_at[at], math.inf, 0
            for j in range(1, width + 1):
                if used[j]:
                    continue
                price = unassigned
                if j <= columns:
                    price = min(cost[row - 1, j - 1], 1e6)
                elif j - columns != row:
                    price = 1e6
                reduced = price - u[row] - v[j]
                if reduced < least[j]:
                    least[j], way[j] = reduced, at
                if least[j] < delta:
                    delta, following = least[j], j
            for j in range(width + 1):
                if used[j]:
                    u[row_at[j]] += delta
                    v[j] -= delta
                else:
                    least[j] -= delta
            at = following
        while at != 0:
            row_at[at] = row_at[way[at]]
            at = way[at]
    for i in range(rows):
        column_of[i] = -1
    for j in range(1, columns + 1):
        if row_at[j] > 0 and cost[row_at[j] - 1, j - 1] < unassigned:
            column_of[row_at[j] - 1] = j - 1


@njit(cache=True, error_model="numpy")
def assign_all(rays: Rays, expected: PredictedPeople, origins: Float64, gates: KeypointGates, matches: Matches) -> None:
    """Assign the detections of each camera to predicted people, one to one, and explain parts and duplicates.

    Args:
        rays, expected, origins, gates: see the module; the detections of one camera follow each other.
        matches: written.
    """
    count, people = len(rays.camera), len(expected.known)
    cost, plain = np.empty((count, people)), np.empty((count, people))
    crossed = np.zeros((count, people), np.bool_)
    column_of = np.empty(count, np.int64)
    for d in range(count):
        matches.person[d], matches.explained[d], matches.swapped[d], matches.cost[d] = -1, -1, False, math.nan
        for p in range(people):
            cost[d, p], plain[d, p] = math.inf, math.inf
            if not expected.known[p]:
                continue
            deviation, priced, common = match_cost(rays, d, expected, p, origins, False)
            if deviation > SWAP_COST:
                other, other_priced, _ = match_cost(rays, d, expected, p, origins, True)
                if other < SWAP_RATIO * deviation:
                    deviation, priced, crossed[d, p] = other, other_priced, True
            if common >= gates.least_joints and deviation < gates.most_cost:
                cost[d, p], plain[d, p] = priced, deviation
    first = 0
    while first < count:
        last = first
        while last < count and rays.camera[last] == rays.camera[first]:
            last += 1
        optimal(cost[first:last], last - first, people, gates.most_cost + UNASSIGNED, column_of[first:last])
        for d in range(first, last):
            p = column_of[d]
            if p >= 0:
                matches.person[d], matches.swapped[d], matches.cost[d] = p, crossed[d, p], plain[d, p]
        for d in range(first, last):
            if matches.person[d] < 0:
                best = 0.6 * gates.most_cost
                for p in range(people):
                    if plain[d, p] < best:
                        best, matches.explained[d], matches.swapped[d] = plain[d, p], p, crossed[d, p]
        first = last


@njit(cache=True, error_model="numpy")
def drop_duplicates(pixels: Float64, confidences: Float64, camera: Int64, sizes_px: Float64) -> int:
    """Drop detections of people whom another detection of the same camera covers: all of its keypoints are there, too.

    Args:
        pixels: (detections, 26, 2) [px]; NaN where not seen.
        confidences: (detections, 26); set to 0 for dropped detections.
        camera: (detections,) index of the camera.
        sizes_px: (detections,) see `cast_rays` [px].

    Returns:
        Number of dropped detections.
    """
    dropped = 0
    for a in range(len(camera)):
        for b in range(len(camera)):
            if a == b or camera[a] != camera[b]:
                continue
            total, common, seen, others, sure, other_sure = 0.0, 0, 0, 0, 0.0, 0.0
            limit = DUPLICATE_SHARE * max(sizes_px[a], sizes_px[b])
            for j in range(JOINTS):
                one, other = confidences[a, j], confidences[b, j]
                seen, others, sure, other_sure = seen + (one > 0), others + (other > 0), sure + one, other_sure + other
                if one > 0 and other > 0:
                    common += 1
                    total += math.hypot(pixels[a, j, 0] - pixels[b, j, 0], pixels[a, j, 1] - pixels[b, j, 1]) / (
                        limit * SPREADS[j]
                    )
            worse = sure < other_sure or (sure == other_sure and a > b)
            if worse and seen > 0 and common >= 0.8 * seen and total < 0.25 * common:
                for j in range(JOINTS):
                    confidences[a, j] = 0.0
                dropped += 1
    return dropped
