"""Compiled search for new people in detections that no predicted person explains; importing this module imports numba.

Two detections of one person in two cameras have rays that meet, joint by joint, at a body of human proportions. Pairs
are joined to groups of at most one detection a camera, in the order of their cost, where each pair of the group agrees
(complete linkage). Pairs that a third camera confirms come first: a match must be consistent over all cameras (J. Dong
et al., *Fast and Robust Multi-Person 3D Pose Estimation from Multiple Views*, CVPR 2019; only the principle is used).

Common arguments: see `mocapella.association.keypoint_kernels`.
"""

# ruff: noqa: PLR0912, PLR0917 - compiled: arrays come by position, loops stand in one place
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.association.keypoint_rays import (
    BONES,
    JOINTS,
    MIRROR,
    MOST_COST,
    SHARES,
    SWAP_COST,
    SWAP_RATIO,
    KeypointGates,
    Rays,
)
from mocapella.compiled import njit

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Bools = NDArray[np.bool_]

WALKING_M_S = 1.0
"""Largest speed of a joint between the captures of two cameras [m/s]."""
SYSTEMATIC_M = 0.015
"""Difference between what two cameras call the same joint [m]."""
LEAST_SINE = 0.02
"""Rays at a smaller angle do not tell a distance."""
BONE_RATIO = 2.0
"""Largest ratio of a bone's length and that of a body of average proportions."""
PLAUSIBLE_SHARE = 0.75
"""Least share of bones that have human lengths."""


@njit(cache=True, error_model="numpy")
def meet(
    o1: Float64, d1: Float64, o2: Float64, d2: Float64, point: Float64,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Return the distance of two rays [m], the distances s1 and s2 of the nearest points along them, and their sine.

    ``point`` (3,) is written: the middle of the nearest points. All are NaN for rays that are nearly parallel.

    Args:
        o1, o2: (3,) origins, world [m].
        d1, d2: (3,) unit directions.
        point: (3,) written.
    """
    nx, ny, nz = d1[1] * d2[2] - d1[2] * d2[1], d1[2] * d2[0] - d1[0] * d2[2], d1[0] * d2[1] - d1[1] * d2[0]
    sine2 = nx * nx + ny * ny + nz * nz
    if not sine2 > LEAST_SINE * LEAST_SINE:
        point[0] = point[1] = point[2] = math.nan
        return math.nan, math.nan, math.nan, math.nan
    bx, by, bz = o2[0] - o1[0], o2[1] - o1[1], o2[2] - o1[2]
    cosine = d1[0] * d2[0] + d1[1] * d2[1] + d1[2] * d2[2]
    along1, along2 = bx * d1[0] + by * d1[1] + bz * d1[2], bx * d2[0] + by * d2[1] + bz * d2[2]
    s1, s2 = (along1 - cosine * along2) / sine2, (cosine * along1 - along2) / sine2
    sine = math.sqrt(sine2)
    for k in range(3):
        point[k] = 0.5 * (o1[k] + s1 * d1[k] + o2[k] + s2 * d2[k])
    return abs(bx * nx + by * ny + bz * nz) / sine, s1, s2, sine


@njit(cache=True, error_model="numpy")
def plausible(points: Float64, sds: Float64, shortest_m: float, tallest_m: float) -> bool:
    """Return whether joints can be a person's: bones have human lengths and proportions, and sizes of a person.

    At least two bones must be known. A bone may be longer or shorter by twice its standard deviation.

    Args:
        points: (26, 3) [m]; NaN where not known.
        sds: (26,) standard deviation of each joint [m].
        shortest_m, tallest_m: limits of the body height [m].
    """
    heights, tolerances = np.empty(len(BONES)), np.empty(len(BONES))
    count = 0
    for b in range(len(BONES)):
        i, j = BONES[b, 0], BONES[b, 1]
        length = math.sqrt(
            (points[i, 0] - points[j, 0]) ** 2 + (points[i, 1] - points[j, 1]) ** 2 + (points[i, 2] - points[j, 2]) ** 2
        )
        if length >= 0.0:
            heights[count] = length / SHARES[b]
            tolerances[count] = 2.0 * math.hypot(sds[i], sds[j]) / SHARES[b]
            count += 1
    if count < 2:
        return False
    middle = np.median(heights[:count])
    spare = np.median(tolerances[:count])
    if not (shortest_m - spare <= middle <= tallest_m + spare):
        return False
    fitting = 0
    for b in range(count):
        least, most = middle / BONE_RATIO - tolerances[b], middle * BONE_RATIO + tolerances[b]
        fitting += least <= heights[b] <= most
    return bool(fitting >= PLAUSIBLE_SHARE * count)


@njit(cache=True, error_model="numpy")
def pair_cost(
    rays: Rays, a: int, b: int, origins: Float64, swapped: bool, gates: KeypointGates,
) -> float:  # fmt: skip
    """Compare two detections of different cameras; infinite if they cannot be one person.

    Args:
        rays, origins, gates: see the module.
        a, b: indices of the detections.
        swapped: whether left and right of ``b`` are exchanged.

    Returns:
        The mean squared distance of the rays, in standard deviations, at most `MOST_COST`.
    """
    o1, o2 = origins[rays.camera[a]], origins[rays.camera[b]]
    points, sds = np.full((JOINTS, 3), math.nan), np.full(JOINTS, math.nan)
    moved_m = WALKING_M_S * abs(rays.after_s[a] - rays.after_s[b])
    total, weight, common, angle = 0.0, 0.0, 0, 0.0
    for j in range(JOINTS):
        i = MIRROR[j] if swapped else j
        w = min(rays.confidences[a, j], rays.confidences[b, i])
        if not w > 0.0:
            continue
        distance, s1, s2, sine = meet(o1, rays.directions[a, j], o2, rays.directions[b, i], points[j])
        if not distance >= 0.0:
            continue
        common += 1
        angle += math.asin(min(sine, 1.0))
        variance = (rays.sds_rad[a, j] * s1) ** 2 + (rays.sds_rad[b, i] * s2) ** 2 + SYSTEMATIC_M**2 + moved_m**2
        sds[j] = math.sqrt(variance) / sine
        deviation = MOST_COST
        if s1 > 0.1 and s2 > 0.1:
            deviation = min(distance * distance / variance, MOST_COST)
        if deviation >= MOST_COST:
            points[j, 0] = points[j, 1] = points[j, 2] = math.nan
        total += w * deviation
        weight += w
    if common < gates.least_joints or angle < common * gates.least_angle_rad:
        return math.inf
    if not plausible(points, sds, gates.shortest_m, gates.tallest_m):
        return math.inf
    return total / weight


@njit(cache=True, error_model="numpy")
def group(
    rays: Rays, free: Bools, origins: Float64, gates: KeypointGates, group_of: Int64, swapped: Bools,
) -> int:  # fmt: skip
    """Join detections that no predicted person explains to groups, one group a person.

    Args:
        rays, origins, gates: see the module.
        free: (detections,) whether a detection may become part of a group.
        group_of: (detections,) written: number of its group from 0, in the order of their costs; −1 for none.
        swapped: (detections,) written: whether left and right are exchanged, so that the group agrees.

    Returns:
        Number of groups.
    """
    count = len(free)
    cost, crossed = np.full((count, count), math.inf), np.zeros((count, count), np.bool_)
    pairs = 0
    for a in range(count):
        group_of[a], swapped[a] = -1, False
        for b in range(a):
            if not (free[a] and free[b] and rays.camera[a] != rays.camera[b]):
                continue
            straight = pair_cost(rays, b, a, origins, False, gates)
            if straight > SWAP_COST:
                other = pair_cost(rays, b, a, origins, True, gates)
                if other < SWAP_RATIO * min(straight, MOST_COST):
                    straight = other
                    crossed[a, b] = crossed[b, a] = True
            if straight < gates.pair_cost:
                cost[a, b] = cost[b, a] = straight
                pairs += 1
    if pairs == 0:
        return 0
    ones, others, prices = np.empty(pairs, np.int64), np.empty(pairs, np.int64), np.empty(pairs)
    at = 0
    for a in range(count):
        for b in range(a):
            if cost[a, b] < math.inf:
                ones[at], others[at], prices[at] = a, b, cost[a, b] / (1.0 + confirmations(rays.camera, cost, a, b))
                at += 1
    groups = 0
    order = np.argsort(prices, kind="mergesort")
    for k in range(pairs):
        a, b = ones[order[k]], others[order[k]]
        ga, gb = group_of[a], group_of[b]
        if ga < 0 and gb < 0:
            group_of[a] = group_of[b] = groups
            swapped[b] = crossed[a, b]
            groups += 1
        elif ga < 0:
            if agrees(rays.camera, cost, group_of, a, gb):
                group_of[a], swapped[a] = gb, swapped[b] != crossed[a, b]
        elif gb < 0:
            if agrees(rays.camera, cost, group_of, b, ga):
                group_of[b], swapped[b] = ga, swapped[a] != crossed[a, b]
        elif ga != gb and joins(rays.camera, cost, group_of, ga, gb):
            turn = swapped[a] != (swapped[b] != crossed[a, b])
            for d in range(count):
                if group_of[d] == gb:
                    group_of[d], swapped[d] = ga, swapped[d] != turn
    for g in range(groups):
        unswap(rays.confidences, group_of, g, swapped)
    return groups


@njit(cache=True, error_model="numpy")
def confirmations(camera: Int64, cost: Float64, a: int, b: int) -> float:
    """Return the number of detections of other cameras that agree with both of a pair.

    Args:
        camera: (detections,) index of the camera.
        cost: (detections, detections) finite where a pair agrees.
        a, b: the pair.
    """
    found = 0.0
    for d in range(len(camera)):
        found += camera[d] != camera[a] and camera[d] != camera[b] and cost[a, d] + cost[b, d] < math.inf
    return found


@njit(cache=True, error_model="numpy")
def agrees(camera: Int64, cost: Float64, group_of: Int64, d: int, g: int) -> bool:
    """Return whether a detection agrees with all of a group, which has none of its camera.

    Args:
        camera, cost: see `confirmations`.
        group_of: (detections,) number of the group.
        d, g: the detection, and the group.
    """
    for e in range(len(camera)):
        if group_of[e] == g and (camera[e] == camera[d] or cost[d, e] == math.inf):
            return False
    return True


@njit(cache=True, error_model="numpy")
def joins(camera: Int64, cost: Float64, group_of: Int64, one: int, other: int) -> bool:
    """Return whether all detections of one group agree with all of another, see `agrees`."""
    fits = True
    for d in range(len(camera)):
        if group_of[d] == one:
            fits &= agrees(camera, cost, group_of, d, other)
    return fits


@njit(cache=True, error_model="numpy")
def unswap(confidences: Float64, group_of: Int64, g: int, swapped: Bools) -> None:
    """Exchange all flags of a group if most of its detections, by their confidence, would be swapped.

    Args:
        confidences: (detections, 26) of the keypoints.
        group_of: (detections,) number of the group.
        g: the group.
        swapped: (detections,) changed in place.
    """
    balance = 0.0
    for d in range(len(group_of)):
        if group_of[d] == g:
            for j in range(JOINTS):
                balance += -confidences[d, j] if swapped[d] else confidences[d, j]
    if balance < 0.0:
        for d in range(len(group_of)):
            if group_of[d] == g:
                swapped[d] = not swapped[d]
