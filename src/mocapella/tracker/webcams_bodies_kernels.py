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
from mocapella.kinematics import articulated_memory as at
from mocapella.kinematics.ray_body_kernels import correct_by_rays, predict_body
from mocapella.model.topology import topology
from mocapella.tracker.webcams_cameras_kernels import AGREES, count_agreement, mark_agreed
from mocapella.tracker.webcams_errors_kernels import widen
from mocapella.tracker.webcams_memory import NO_PERSON, CameraCounts, PeopleArrays
from mocapella.tracker.webcams_people_kernels import PeopleLimits, judge, middle
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
HELD_SD_M = 0.2
"""Standard deviation of the body's distance in an instant before the correction by heights [m]."""
MOST_HELD_M = 0.1
"""Largest correction of the distance in an instant [m]."""
APPROACH_M_S = 2.0
"""Largest speed at which a person whom one camera sees comes nearer to it or goes away [m/s]."""
DISTANCE_SD = 0.04
"""Standard deviation of the distance of a person whom one camera sees [ratio]."""
STEADY = np.array([
    name in ("LAnkle", "RAnkle", "Hip", "LHip", "RHip", "Neck", "LShoulder", "RShoulder")
    for name in topology("halpe_26").joints
])  # fmt: skip
"""(26,) joints whose heights change little while a person walks."""
TURN_WEIGHT_OF_ONE = 0.05
"""The same where one camera alone tells the sides."""
SIDES_APART = 8.0
"""Mean squared angle between left and right joints, in variances of a ray, above which a detection tells the sides."""
MOST_APART = 80.0
"""The same above which it tells them no better."""
MOST_TURNED = 0.6
"""Share of swapped detections above which the person is swapped."""
SHOULDERS, HIPS = (
    np.array([topology("halpe_26").index(f"{side}{name}") for side in "LR"], dtype=np.int64)
    for name in ("Shoulder", "Hip")
)
"""(2,) joints on the left and on the right."""
MOST_TWISTED = 0.1
"""Cosine of the angle between shoulders and hips below which no body can be twisted; the angle is 84°."""


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
def twisted(positions: Float64) -> bool:
    """Return whether shoulders and hips point to opposite sides, as of a body with left and right exchanged in one.

    Args:
        positions: (26, 3) joints, world [m]; NaN where not known.
    """
    dot, shoulders, hips = 0.0, 0.0, 0.0
    for k in range(3):
        a = positions[SHOULDERS[0], k] - positions[SHOULDERS[1], k]
        b = positions[HIPS[0], k] - positions[HIPS[1], k]
        dot, shoulders, hips = dot + a * b, shoulders + a * a, hips + b * b
    return bool(dot < MOST_TWISTED * math.sqrt(shoulders * hips))


@njit(cache=True, error_model="numpy")
def sides_apart(positions: Float64, rays: Rays, d: int, origin: Float64) -> float:
    """Return how far apart left and right of a person are in the image of a detection: the mean squared angle between
    left and right joints, in variances of a ray. A detection with both sides at one place cannot tell them.

    Args:
        positions: (26, 3) joints of the person, world [m].
        rays: see the module.
        d: the detection.
        origin: (3,) centre of its camera, world [m].
    """
    total, weight = 0.0, 0.0
    for j in range(JOINTS):
        i = MIRROR[j]
        if i == j or not rays.confidences[d, j] > 0.0:
            continue
        near, far, both = 0.0, 0.0, 0.0
        for k in range(3):
            a, b = positions[j, k] - origin[k], positions[i, k] - origin[k]
            near, far, both = near + a * a, far + b * b, both + a * b
        across = (near * far - both * both) / (near * far)  # squared sine of the angle between the two directions
        if across >= 0.0:
            total += across / (rays.sds_rad[d, j] * rays.sds_rad[d, j])
            weight += 1.0
    return total / weight if weight > 0.0 else 0.0


@njit(cache=True, error_model="numpy")
def turn(people: PeopleArrays, p: int, rays: Rays, origins: Float64, matches: Matches) -> int:
    """Return whether a person must begin anew: 1 with left and right exchanged, 2 as the detections are, 0 if not.

    So a person recovers who began from swapped detections, which most detections contradict (1), or from a detection
    with left and right exchanged in one half of the body (2). Detections count by how far apart left and right are,
    and do not count with both at the same place.

    Args:
        people, rays, matches: see the module; the flags of the person's detections are exchanged (1), or cleared (2).
        p: row of the person.
        origins: (cameras, 3) centres of the cameras, world [m].
    """
    swapped, every, count = 0.0, 0.0, 0
    sided = np.zeros(len(matches.person), np.bool_)
    for d in range(len(matches.person)):
        apart = 0.0
        if matches.person[d] == p or matches.explained[d] == p:
            apart = sides_apart(people.positions[p], rays, d, origins[rays.camera[d]])
            sided[d] = matches.swapped[d] or apart > SIDES_APART
        if matches.person[d] == p and sided[d]:
            clear = min(max(apart, SIDES_APART), MOST_APART)
            swapped += clear * matches.swapped[d]
            every += clear
            count += 1
    halves = twisted(people.positions[p])
    if count == 0 and not halves:
        return 0
    weight = max(1.0 / (people.hits[p] + 1.0), TURN_WEIGHT if count > 1 or halves else TURN_WEIGHT_OF_ONE)
    people.turned[p] += weight * ((1.0 if halves else swapped / every) - people.turned[p])
    if people.turned[p] < MOST_TURNED or (2.0 * swapped <= every and not halves):
        return 0
    people.turned[p] = 0.0
    for d in range(len(matches.person)):
        if matches.person[d] == p or matches.explained[d] == p:
            matches.swapped[d] = sided[d] and not halves and not matches.swapped[d]
    return 2 if halves else 1


@njit(cache=True, error_model="numpy")
def limit_approach(model: Any, people: PeopleArrays, p: int, origin: Float64, before: Float64, most_m: float) -> None:
    """Limit how far a person whom one camera sees moves along the line from the camera, in one instant.

    A camera alone sees no distance, and wrong keypoints make a body seem larger or smaller.

    Args:
        model, people: see the module; the body is corrected.
        p: row of the person.
        origin: (3,) centre of the camera, world [m].
        before: (3,) root of the body in the last instant, world [m].
        most_m: largest distance [m].
    """
    root, far, along = model.layout.angles, 0.0, 0.0
    for k in range(3):
        far += (before[k] - origin[k]) ** 2
        along += (people.rows[p, root + k] - before[k]) * (before[k] - origin[k])
    far = math.sqrt(far)
    along /= far
    excess = along - min(max(along, -most_m), most_m)
    if not abs(excess) > 0.0:  # also if it is not known
        return
    for k in range(3):
        moved = excess * (before[k] - origin[k]) / far
        people.rows[p, root + k] -= moved
        for j in range(JOINTS):
            people.positions[p, j, k] -= moved


@njit(cache=True, error_model="numpy")
def hold_distance(
    model: Any, people: PeopleArrays, p: int, origin: Float64, joints: Int64, directions: Float64, sds_rad: Float64,
    up: Float64,
) -> None:  # fmt: skip
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
        up: (3,) upward direction, world.
    """
    own = origin[0] * up[0] + origin[1] * up[1] + origin[2] * up[2]
    weight, total, count, root = 0.0, 0.0, 0.0, model.layout.angles
    for i in range(len(joints)):
        j, s = joints[i], 0.0
        fall = directions[i, 0] * up[0] + directions[i, 1] * up[1] + directions[i, 2] * up[2]
        if not STEADY[j] or math.isnan(people.heights[p, j]) or abs(fall) < LEAST_FALL:
            continue
        for k in range(3):
            s += directions[i, k] * (people.positions[p, j, k] - origin[k])
        variance = people.height_variances[p, j] + LEAST_HEIGHT_SD_M**2 + (sds_rad[i] * s) ** 2
        away = (people.heights[p, j] - own) / fall
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
def measure_in_turn(
    model: Any, people: PeopleArrays, p: int, at_s: float, joints: Int64, limits: PeopleLimits
) -> int:  # fmt: skip
    """Update when the joints that one camera sees were triangulated: also by rays of several instants that cross.

    A joint counts as not triangulated if its rays in this instant disagree with the body.

    Args:
        model, people: see the module; ``measured_s`` is changed.
        p: row of the person, after the correction.
        at_s: time of the instant [s].
        joints: (n,) the joint of each ray of the instant.
        limits: see the module.

    Returns:
        Number of rays whose joints were triangulated within ``measured_s``.
    """
    lately = 0
    for j in joints:
        age = people.rows[p, model.layout.ages + 4 * j]
        if people.support[p, j] == 0:
            people.measured_s[p, j] = math.nan
        elif people.support[p, j] == 1 and age >= 0.0 and not people.measured_s[p, j] >= at_s - age:
            people.measured_s[p, j] = at_s - age
        lately += at_s - people.measured_s[p, j] <= limits.measured_s
    return lately


@njit(cache=True, error_model="numpy")
def correct(
    model: Any, people: PeopleArrays, at_s: float, rays: Rays, cameras: CameraArrays, gates: KeypointGates,
    limits: PeopleLimits, matches: Matches, counts: CameraCounts, incomplete: bool, agreed: Bools,
) -> None:  # fmt: skip
    """Correct all people by their rays, and compare the cameras.

    Args:
        model, people, rays, cameras, limits, matches: see the module.
        at_s: time of the instant [s].
        gates: thresholds.
        counts: updated.
        incomplete: whether active cameras have no image in this instant: only then do cameras see people in turn.
        agreed: (people, cameras) written: whether a camera agrees about a person.
    """
    size = JOINTS * max(len(rays.camera), 1)
    joints, camera = np.empty(size, np.int64), np.empty(size, np.int64)
    origins, directions = np.empty((size, 3)), np.empty((size, 3))
    sds, after_s, weights = np.empty(size), np.empty(size), np.empty(size)
    agreeing, taken = np.empty(len(counts.agreed)), np.empty(len(counts.agreed))
    before, root = np.empty(3), model.layout.angles
    for p in range(len(people.ids)):
        if people.ids[p] == NO_PERSON:
            continue
        views = seen_by(p, matches.person, rays.camera)
        n = 0
        turned = turn(people, p, rays, cameras.origins, matches) if views >= 2 else 0
        around = turned > 0
        kept = people.rows[p].copy() if around else people.rows[p]
        if turned == 2:
            people.rows[p, at.LOST_SINCE] = -math.inf  # the lengths stay
        elif turned == 1:
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
            for k in range(3):
                before[k] = people.rows[p, root + k]
            known = correct_by_rays(
                model, people.rows[p], at_s, joints[:n], origins[:n], directions[:n], sds[:n], after_s[:n],
                weights[:n], people.positions[p], people.covariances[p], people.support[p],
            )  # fmt: skip
            if around and not known:
                for i in range(people.rows.shape[1]):
                    people.rows[p, i] = kept[i]
                predict_body(model, people.rows[p], at_s, people.positions[p], people.covariances[p])
            if known and not around:
                lately = measure_in_turn(model, people, p, at_s, joints[:n], limits) if incomplete else 0
                if views == 1 and lately >= gates.least_joints:  # cameras that see the person in turn agree
                    people.agreed_s[p] = at_s
                    middle(people.positions[p], people.agreed_place[p])
                correlation = math.exp((people.at_s[p] - at_s) / limits.slow_error_s)
                widen(
                    joints[:n], origins[:n], directions[:n], sds[:n], weights[:n], correlation, people.positions[p],
                    people.support[p], people.covariances[p],
                )  # fmt: skip
                if views >= 2:
                    compare_cameras(people, p, n, joints, camera, directions, sds, after_s, cameras, counts)
                elif views == 1 and people.hits[p] > 0 and at_s > people.agreed_s[p]:
                    most_m = APPROACH_M_S * (at_s - people.at_s[p])
                    limit_approach(model, people, p, cameras.origins[camera[0]], before, most_m)
                    hold_distance(model, people, p, cameras.origins[camera[0]], joints[:n], directions, sds, cameras.up)
        mark_agreed(camera, weights, n, gates.least_joints, agreed[p])
        judge(people, p, at_s, views, gates, cameras.up)
        if views >= 3 and people.doubts[p] == 0:
            for c in range(len(taken)):
                agreeing[c] = taken[c] = 0.0
            for i in range(n):
                taken[camera[i]] += 1.0
                agreeing[camera[i]] += weights[i] > AGREES
            for c in range(len(taken)):
                if taken[c] > 0.0:
                    count_agreement(counts, c, agreeing[c] / taken[c])
