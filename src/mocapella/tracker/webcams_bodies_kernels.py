"""Kernels that correct the bodies of the method ``webcams`` by the rays of their detections.

Common arguments: see `mocapella.tracker.webcams_kernels`; importing this module imports numba.
"""

# ruff: noqa: PLR0912, PLR0917 - compiled: arrays come by position, loops stand in one place
from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocapella.association.keypoint_rays import JOINTS, MIRROR, CameraArrays, KeypointGates, Matches, Rays
from mocapella.compiled import njit
from mocapella.kinematics.ray_body_kernels import correct_by_rays, predict_body
from mocapella.model.topology import topology
from mocapella.tracker.webcams_cameras_kernels import AGREES, count_agreement, mark_agreed
from mocapella.tracker.webcams_errors_kernels import widen
from mocapella.tracker.webcams_memory import NO_PERSON, CameraCounts, PeopleArrays
from mocapella.tracker.webcams_people_kernels import PeopleLimits, judge
from mocapella.tracker.webcams_rig_kernels import compare_cameras

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Bools = NDArray[np.bool_]

TURN_WEIGHT = 0.15
"""Weight of an instant in the running mean of swapped detections."""
LEAST_HEIGHT_SD_M = 0.03
"""Least standard deviation of the height of a joint that one camera sees [m]."""
LEAST_FALL = 0.05
"""Least sine of a ray's angle to the horizon at which the height of its joint tells the distance."""
HELD_SD_M = 0.1
"""Standard deviation of the body's distance in an instant before the correction by heights [m]."""
MOST_HELD_M = 0.1
"""Largest correction of the distance in an instant [m]."""
DISTANCE_SD = 0.04
"""Standard deviation of the distance of a person whom one camera sees [ratio]."""
STEADY = np.array([
    name in ("LAnkle", "RAnkle", "Hip", "LHip", "RHip", "Neck", "LShoulder", "RShoulder")
    for name in topology("halpe_26").joints
])  # fmt: skip
"""(26,) joints whose heights change little while a person walks."""
MOST_TURNED = 0.6
"""Share of swapped detections above which the person is swapped."""


@njit(cache=True, error_model="numpy")
def take_rays(
    p: int, rays: Rays, cameras: CameraArrays, owner: Int64, matches: Matches, turned: Bools, joints: Int64,
    origins: Float64, directions: Float64, sds_rad: Float64, after_s: Float64, camera: Int64,
) -> int:  # fmt: skip
    """Collect the rays of a person's detections, then of parts that add joints to them, sorted by camera.

    Args:
        p: row or group of the person.
        rays, cameras: see the module.
        owner: (detections,) row or group of each detection.
        matches: its ``explained`` are the parts; groups have none.
        turned: (detections,) whether left and right are exchanged.
        joints, origins, directions, sds_rad, after_s, camera: written, for `correct_by_rays`; long enough for all.

    Returns:
        Number of rays.
    """
    n = 0
    for d in range(len(owner)):
        if owner[d] != p and matches.explained[d] != p:
            continue
        part = owner[d] != p
        for j in range(JOINTS):
            i = MIRROR[j] if turned[d] else j
            if not rays.confidences[d, i] > 0.0:
                continue
            taken = False
            if part:
                for e in range(len(owner)):
                    if owner[e] == p and rays.camera[e] == rays.camera[d]:
                        other = MIRROR[j] if turned[e] else j
                        taken |= rays.confidences[e, other] > 0.0
                for k in range(n):
                    taken |= joints[k] == j and camera[k] == rays.camera[d]
            if taken:
                continue
            joints[n], sds_rad[n], after_s[n], camera[n] = j, rays.sds_rad[d, i], rays.after_s[d], rays.camera[d]
            for k in range(3):
                origins[n, k] = cameras.origins[rays.camera[d], k]
                directions[n, k] = rays.directions[d, i, k]
            n += 1
    return n


@njit(cache=True, error_model="numpy")
def seen_by(p: int, owner: Int64, camera: Int64) -> int:
    """Return the number of cameras with a detection of a person; the detections are sorted by camera.

    Args:
        p: row or group of the person.
        owner: (detections,) row or group of each detection.
        camera: (detections,) index of the camera.
    """
    count, last = 0, -1
    for d in range(len(owner)):
        if owner[d] == p and camera[d] != last:
            count += 1
            last = camera[d]
    return count


@njit(cache=True, error_model="numpy")
def turn(people: PeopleArrays, p: int, matches: Matches) -> bool:
    """Return whether a person must begin anew with left and right exchanged, which most detections contradict.

    So a person who began from swapped detections recovers.

    Args:
        people, matches: see the module; if true, the flags of the person's detections are exchanged.
        p: row of the person.
    """
    swapped, count = 0.0, 0.0
    for d in range(len(matches.person)):
        if matches.person[d] == p:
            swapped += matches.swapped[d]
            count += 1.0
    weight = max(1.0 / (people.hits[p] + 1.0), TURN_WEIGHT)
    people.turned[p] += weight * (swapped / count - people.turned[p])
    if people.turned[p] < MOST_TURNED or 2.0 * swapped <= count:
        return False
    people.turned[p] = 0.0
    for d in range(len(matches.person)):
        if matches.person[d] == p or matches.explained[d] == p:
            matches.swapped[d] = not matches.swapped[d]
    return True


@njit(cache=True, error_model="numpy")
def hold_distance(
    model: Any, people: PeopleArrays, p: int, origin: Float64, joints: Int64, directions: Float64, sds_rad: Float64
) -> None:
    """Correct the distance of a person whom one camera sees by the heights that the joints had.

    A ray that is not level meets the height of its joint at one distance. The body moves along the line from the camera
    to its root, towards the mean of these distances; less where heights vary, such as of a person who sits down. The
    covariance grows by the uncertainty of a distance from sizes and heights (`DISTANCE_SD`).

    Args:
        model, people: see the module; the body is corrected.
        p: row of the person.
        origin: (3,) centre of the camera, world [m].
        joints: (n,) the joint of each ray.
        directions: (≥ n, 3) unit directions of the rays.
        sds_rad: (≥ n,) their standard deviations [rad].
    """
    weight, total, count, root = 0.0, 0.0, 0.0, model.layout.angles
    for i in range(len(joints)):
        j, fall, s = joints[i], directions[i, 1], 0.0
        if not STEADY[j] or math.isnan(people.heights[p, j]) or abs(fall) < LEAST_FALL:
            continue
        for k in range(3):
            s += directions[i, k] * (people.positions[p, j, k] - origin[k])
        variance = people.height_variances[p, j] + LEAST_HEIGHT_SD_M**2 + (sds_rad[i] * s) ** 2
        away = (people.heights[p, j] - origin[1]) / fall
        if away > 0.0:
            weight += fall * fall / variance
            total += fall * fall / variance * (away - s)
            count += 1.0
    if count > 0.0:
        # The heights of one posture are wrong together: the mean is as uncertain as one of them.
        step = total / weight * HELD_SD_M**2 / (HELD_SD_M**2 + count / weight)
        step = min(max(step, -MOST_HELD_M), MOST_HELD_M)
        far = 0.0
        for k in range(3):
            far += (people.rows[p, root + k] - origin[k]) ** 2
        for k in range(3):
            moved = step * (people.rows[p, root + k] - origin[k]) / math.sqrt(far)
            people.rows[p, root + k] += moved
            for j in range(JOINTS):
                people.positions[p, j, k] += moved
    for j in range(JOINTS):
        for k in range(3):
            for m in range(3):
                offset = (people.positions[p, j, k] - origin[k]) * (people.positions[p, j, m] - origin[m])
                people.covariances[p, j, k, m] += DISTANCE_SD * DISTANCE_SD * offset


@njit(cache=True, error_model="numpy")
def correct(
    model: Any, people: PeopleArrays, at_s: float, rays: Rays, cameras: CameraArrays, gates: KeypointGates,
    limits: PeopleLimits, matches: Matches, counts: CameraCounts, agreed: Bools,
) -> None:  # fmt: skip
    """Correct all people by their rays, and compare the cameras.

    Args:
        model, people, rays, cameras, limits, matches: see the module.
        at_s: time of the instant [s].
        gates: thresholds.
        counts: updated.
        agreed: (people, cameras) written: whether a camera agrees about a person.
    """
    size = JOINTS * max(len(rays.camera), 1)
    joints, camera = np.empty(size, np.int64), np.empty(size, np.int64)
    origins, directions = np.empty((size, 3)), np.empty((size, 3))
    sds, after_s, weights = np.empty(size), np.empty(size), np.empty(size)
    agreeing, taken = np.empty(len(counts.agreed)), np.empty(len(counts.agreed))
    for p in range(len(people.ids)):
        if people.ids[p] == NO_PERSON:
            continue
        views = seen_by(p, matches.person, rays.camera)
        n = 0
        around = views >= 2 and turn(people, p, matches)
        kept = people.rows[p].copy() if around else people.rows[p]
        if around:
            for i in range(people.rows.shape[1]):
                people.rows[p, i] = math.nan
        if views > 0:
            n = take_rays(
                p, rays, cameras, matches.person, matches, matches.swapped, joints, origins, directions, sds, after_s,
                camera,
            )  # fmt: skip
        for j in range(JOINTS):
            people.support[p, j] = 0
        if n > 0:
            known = correct_by_rays(
                model, people.rows[p], at_s, joints[:n], origins[:n], directions[:n], sds[:n], after_s[:n],
                weights[:n], people.positions[p], people.covariances[p], people.support[p],
            )  # fmt: skip
            if around and not known:
                for i in range(people.rows.shape[1]):
                    people.rows[p, i] = kept[i]
                predict_body(model, people.rows[p], at_s, people.positions[p], people.covariances[p])
            if known and not around:
                correlation = math.exp((people.at_s[p] - at_s) / limits.slow_error_s)
                widen(
                    joints[:n], origins[:n], directions[:n], sds[:n], weights[:n], correlation, people.positions[p],
                    people.support[p], people.covariances[p],
                )  # fmt: skip
                if views >= 2:
                    compare_cameras(people, p, n, joints, camera, directions, sds, after_s, cameras, counts)
                elif views == 1 and people.hits[p] > 0:
                    hold_distance(model, people, p, cameras.origins[camera[0]], joints[:n], directions, sds)
        mark_agreed(camera, weights, n, gates.least_joints, agreed[p])
        judge(people, p, at_s, views, gates)
        if views >= 3 and people.doubts[p] == 0:
            for c in range(len(taken)):
                agreeing[c] = taken[c] = 0.0
            for i in range(n):
                taken[camera[i]] += 1.0
                agreeing[camera[i]] += weights[i] > AGREES
            for c in range(len(taken)):
                if taken[c] > 0.0:
                    count_agreement(counts, c, agreeing[c] / taken[c])
