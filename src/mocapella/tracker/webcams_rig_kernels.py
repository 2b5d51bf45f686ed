"""Kernels that estimate the errors of each camera of the method ``webcams``: their size, its direction and its time.

Rigs are wrong by a few pixels, frames of one number are not of one time, and some images are worse than others. The
rays of a camera are compared with the people whom several cameras see:

    spread      mean squared residual over its stated variance; variances grow by it where it is larger than usual
    direction   mean residual along the image's axes; rays are turned back by it
    time        slope of the residuals against the people's motion in the image; rays get their own time

A camera with a wrong direction or lens has residuals in all its images. People who walk one way then seem to be seen
late, or early. So the slope is that of a regression with an intercept, the direction: only a residual that changes with
the motion is a time error. Directions and times are shrunk towards 0. Only differences between cameras can be seen, so
the mean of the times is 0.
Common arguments: see `mocapella.tracker.webcams_kernels`; importing this module imports numba.
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.association.keypoint_rays import JOINTS, CameraArrays, KeypointGates, Matches, Rays
from mocapella.compiled import njit
from mocapella.tracker.webcams_memory import CameraCounts, PeopleArrays

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Bools = NDArray[np.bool_]

USUAL_SPREAD = 1.25
"""Spread of a detector as good as stated, whose errors have tails, before a well calibrated camera."""
MOST_SPREAD = 20.0
"""Largest spread that is stated."""
TRUNCATED = 4.0
"""Limit of one ray's squared residual, over the spread so far; it limits rays of swapped or mixed limbs."""
FIRST_VALUES = 20.0
"""Number of people and instants that a new camera's spread stands for."""
SPREAD_WEIGHT = 0.01
"""Least weight of one person and instant in the spread."""
UNMATCHED_GROWTH = 1.1
"""Growth of the spread in an instant where no detection of the camera is of a person, but other cameras see people."""
UNMATCHED_SPREAD = 12.0
"""Largest spread by that growth."""
KEPT = 0.998
"""Factor of earlier values when a person is compared in an instant."""
PRIOR_VALUES = 50.0
"""Number of people and instants that a direction error of 0 stands for."""
MOST_TURNED_RAD = 0.015
"""Largest direction error of a camera that is corrected [rad]."""
MOST_LATE_S = 0.15
"""Largest time error of a camera that is corrected [s]."""
INDEPENDENT = 0.05
"""Share of the rays of a person in an instant that count as independent: their errors are of one detection."""
LEAST_COMPARED = 4
"""Least number of joints of a person for a comparison of cameras."""
LEAST_SPEED_M_S = 0.3
"""Speed of a person above which the cameras' times are compared [m/s]."""


@njit(cache=True, error_model="numpy")
def time_error(counts: CameraCounts, c: int) -> float:
    """Return how much later than stated a camera's frames are, by its own residuals [s].

    Args:
        counts: what the cameras saw.
        c: index of the camera.
    """
    own = counts.late[c]
    weight = max(own[0], 1e-9)
    known = max(own[3] - (own[1] * own[1] + own[2] * own[2]) / weight, 0.0)
    late = (own[6] - (own[1] * own[4] + own[2] * own[5]) / weight) / (known + own[7])
    return float(min(max(late, -MOST_LATE_S), MOST_LATE_S))


@njit(cache=True, error_model="numpy")
def mean_time_error(counts: CameraCounts) -> float:
    """Return the mean of the cameras' time errors [s], which no comparison of cameras can show.

    Args:
        counts: what the cameras saw.
    """
    total, known = 0.0, 0.0
    for c in range(len(counts.spread)):
        if counts.late[c, 0] > 0.0:
            total += time_error(counts, c)
            known += 1.0
    return total / known if known > 0.0 else 0.0


@njit(cache=True, error_model="numpy")
def variance_factor(counts: CameraCounts, c: int) -> float:
    """Return by how much the variances of a camera's rays are larger than stated.

    Args:
        counts: what the cameras saw.
        c: index of the camera.
    """
    return float(max(counts.spread[c] / USUAL_SPREAD, 1.0))


@njit(cache=True, error_model="numpy")
def adjust_rays(rays: Rays, cameras: CameraArrays, counts: CameraCounts) -> None:
    """Correct the rays by their cameras' known errors, and enlarge their standard deviations.

    Args:
        rays: changed.
        cameras: see the module.
        counts: what the cameras saw.
    """
    mean = mean_time_error(counts)
    for d in range(len(rays.camera)):
        c = rays.camera[d]
        R, scale = cameras.R_world_camera[c], math.sqrt(variance_factor(counts, c))
        right, down = direction_error(counts, c, 0), direction_error(counts, c, 1)
        if counts.late[c, 0] > 0.0:
            rays.after_s[d] += time_error(counts, c) - mean
        for j in range(JOINTS):
            if not rays.confidences[d, j] > 0.0:
                continue
            rays.sds_rad[d, j] *= scale
            total = 0.0
            for k in range(3):
                rays.directions[d, j, k] -= right * R[k, 0] + down * R[k, 1]
                total += rays.directions[d, j, k] ** 2
            total = math.sqrt(total)
            for k in range(3):
                rays.directions[d, j, k] /= total


@njit(cache=True, error_model="numpy")
def direction_error(counts: CameraCounts, c: int, axis: int) -> float:
    """Return the direction error of a camera towards its right (0) or down (1) [rad].

    Args:
        counts: what the cameras saw.
        c: index of the camera.
        axis: axis of the image.
    """
    error = counts.aside[c, axis] / (counts.aside[c, 2] + PRIOR_VALUES)
    return float(min(max(error, -MOST_TURNED_RAD), MOST_TURNED_RAD))


@njit(cache=True, error_model="numpy")
def motion_of(people: PeopleArrays, p: int, velocity: Float64) -> int:
    """Write the mean velocity of a person's joints about which two cameras agree; return the number of these joints.

    Args:
        people: see the module; their velocities are of the last instant.
        p: row of the person.
        velocity: (3,) written [m/s].
    """
    known = 0
    velocity[0] = velocity[1] = velocity[2] = 0.0
    for j in range(JOINTS):
        if people.support[p, j] >= 2:
            known += 1
            for k in range(3):
                velocity[k] += people.velocities[p, j, k]
    for k in range(3):
        velocity[k] /= max(known, 1)
    return known


@njit(cache=True, error_model="numpy")
def compare_cameras(
    people: PeopleArrays, p: int, n: int, joints: Int64, camera: Int64, directions: Float64, sds_rad: Float64,
    after_s: Float64, cameras: CameraArrays, counts: CameraCounts,
) -> None:  # fmt: skip
    """Compare the rays of a person with the corrected body, and update the errors of their cameras.

    Args:
        people, cameras: see the module; the people's velocities are of the last instant.
        p: row of the person.
        n: number of rays, sorted by camera.
        joints, camera, directions, sds_rad, after_s: (≥ n, …) the rays, as in `correct_by_rays`.
        counts: updated.
    """
    views, velocity, sums = np.zeros(JOINTS), np.empty(3), np.empty(9)
    for i in range(n):
        views[joints[i]] += 1.0
    if motion_of(people, p, velocity) < LEAST_COMPARED:
        return
    moves = math.sqrt(velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2) >= LEAST_SPEED_M_S
    first, mean = 0, mean_time_error(counts)
    while first < n:
        c, last = camera[first], first
        while last < n and camera[last] == c:
            last += 1
        factor = variance_factor(counts, c)
        late_s = time_error(counts, c) - mean if counts.late[c, 0] > 0.0 else 0.0  # as `adjust_rays` moved the rays
        right, down = direction_error(counts, c, 0), direction_error(counts, c, 1)
        sum_residuals(
            people, p, first, last, joints, directions, sds_rad, after_s, cameras, counts.spread[c], factor, c, views,
            velocity, sums,
        )  # fmt: skip
        if sums[1] >= LEAST_COMPARED:
            counts.compared[c] += 1.0
            share = max(1.0 / (FIRST_VALUES + counts.compared[c]), SPREAD_WEIGHT)
            counts.spread[c] += share * (sums[0] / sums[1] - counts.spread[c])
            counts.spread[c] = min(max(counts.spread[c], 1.0), MOST_SPREAD)
        if sums[2] > 0.0:
            counts.aside[c, 0] = KEPT * counts.aside[c, 0] + sums[3] / sums[2] + right
            counts.aside[c, 1] = KEPT * counts.aside[c, 1] + sums[4] / sums[2] + down
            counts.aside[c, 2] = KEPT * counts.aside[c, 2] + 1.0
            if not moves:  # without motion, only the direction is known
                for k in range(5, 9):
                    sums[k] = 0.0
            share = INDEPENDENT / factor
            add_late(counts.late[c], share, sums, right, down, late_s)
        first = last


@njit(cache=True, error_model="numpy")
def add_late(late: Float64, share: float, sums: Float64, right: float, down: float, late_s: float) -> None:
    """Add a person's residuals to the equations of a camera's time error.

    Args:
        late: (8,) updated, see `CameraCounts`.
        share: weight of the residuals.
        sums: (9,) of `sum_residuals`, from rays that are corrected by the next three.
        right, down: direction error, as taken from the rays [rad].
        late_s: time error, as taken from their times [s].
    """
    for k in range(7):
        late[k] *= KEPT
    late[0] += share * sums[2]
    late[1] += share * sums[5]
    late[2] += share * sums[6]
    late[3] += share * sums[7]
    late[4] += share * (sums[3] + right * sums[2] + late_s * sums[5])
    late[5] += share * (sums[4] + down * sums[2] + late_s * sums[6])
    late[6] += share * (sums[8] + right * sums[5] + down * sums[6] + late_s * sums[7])


@njit(cache=True, error_model="numpy")
def sum_residuals(
    people: PeopleArrays, p: int, first: int, last: int, joints: Int64, directions: Float64, sds_rad: Float64,
    after_s: Float64, cameras: CameraArrays, spread: float, factor: float, c: int, views: Float64, velocity: Float64,
    sums: Float64,
) -> None:  # fmt: skip
    """Sum the residuals of a person's rays of one camera.

    Args:
        people, p, joints, directions, sds_rad, after_s, cameras: as in `compare_cameras`.
        first, last: the rays of the camera.
        spread, factor: the camera's spread, and by how much its rays' variances are enlarged.
        c: index of the camera.
        views: (26,) number of rays to each joint.
        velocity: (3,) of the person [m/s].
        sums: (9,) written: squared residuals over stated variances, and their number; the weights of those that are
            not outliers, and with these weights the residuals to the right and down [rad], the motions to the right
            and down [rad/s], the squared motions [rad²/s²], and the products of residual and motion [rad²/s].
    """
    x, e, R, o = np.empty(3), np.empty(3), cameras.R_world_camera[c], cameras.origins[c]
    for i in range(9):
        sums[i] = 0.0
    for i in range(first, last):
        j = joints[i]
        if people.support[p, j] < 2 or views[j] < 2.0:
            continue
        s, ahead = 0.0, 0.0
        for k in range(3):
            x[k] = people.positions[p, j, k] + after_s[i] * velocity[k] - o[k]
            s += x[k] * x[k]
        s = math.sqrt(s)
        for k in range(3):
            e[k] = directions[i, k] - x[k] / s
            ahead += velocity[k] * x[k] / s
        own = sds_rad[i] ** 2 / factor
        left = 1.0 - 1.0 / views[j]  # share of a camera's error in its residual: the body follows the rest
        chi2 = (e[0] ** 2 + e[1] ** 2 + e[2] ** 2) / (2.0 * own * left)
        sums[0] += min(chi2, TRUNCATED * spread)
        sums[1] += 1.0
        if not chi2 < TRUNCATED * spread:
            continue
        sums[2] += 1.0 / own
        for k in range(3):
            moved = (velocity[k] - ahead * x[k] / s) / s
            sums[3] += e[k] / left * R[k, 0] / own
            sums[4] += e[k] / left * R[k, 1] / own
            sums[5] += moved * R[k, 0] / own
            sums[6] += moved * R[k, 1] / own
            sums[7] += moved * moved / own
            sums[8] += e[k] / left * moved / own


@njit(cache=True, error_model="numpy")
def doubt_unmatched(rays: Rays, matches: Matches, gates: KeypointGates, counts: CameraCounts) -> None:
    """Enlarge the spread of cameras whose detections match no person, while other cameras see people.

    Args:
        rays, matches: see the module.
        gates: thresholds.
        counts: updated.
    """
    cameras = len(counts.spread)
    strangers, matched = np.zeros(cameras, np.bool_), np.zeros(cameras, np.bool_)
    for d in range(len(rays.camera)):
        joints = 0
        for j in range(JOINTS):
            joints += rays.confidences[d, j] > 0.0
        own = matches.person[d] >= 0 or matches.explained[d] >= 0
        matched[rays.camera[d]] |= own
        strangers[rays.camera[d]] |= joints >= 2 * gates.least_joints and not own
    for c in range(cameras):
        others = False
        for e in range(cameras):
            others |= e != c and (strangers[e] or matched[e])
        if strangers[c] and not matched[c] and others and counts.spread[c] < UNMATCHED_SPREAD:
            counts.spread[c] = min(counts.spread[c] * UNMATCHED_GROWTH, UNMATCHED_SPREAD)
