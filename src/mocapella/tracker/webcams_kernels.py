"""Compiled step of the method ``webcams``: one instant of all cameras; importing this module imports numba.

    predict    each person to the instant
    assign     detections of each camera to people
    group      the other detections to new people
    correct    each body by its rays
    keep       count agreement, drop absent and false people

Common arguments:

    model       model of the body, see `mocapella.kinematics.ray_body`
    people      `PeopleArrays`, changed in place
    rays        `Rays` of the instant
    cameras     `CameraArrays`
    limits      `PeopleLimits`
    matches     `Matches` of the rays
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position, loops stand in one place
from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocapella.association.keypoint_kernels import assign_all, cast_rays, drop_duplicates
from mocapella.association.keypoint_rays import JOINTS, CameraArrays, KeypointGates, Matches, PredictedPeople, Rays
from mocapella.association.new_people_kernels import group
from mocapella.compiled import njit
from mocapella.kinematics.ray_body_kernels import correct_by_rays, predict_body
from mocapella.tracker.webcams_bodies_kernels import correct, seen_by, take_rays
from mocapella.tracker.webcams_cameras_kernels import count_refuting, count_unmatched, mark_agreed
from mocapella.tracker.webcams_errors_kernels import follow_unpredicted, stated_variance
from mocapella.tracker.webcams_memory import CANDIDATE, NO_PERSON, CameraCounts, PeopleArrays
from mocapella.tracker.webcams_people_kernels import PeopleLimits, drop, follow, forget, join_doubles, judge
from mocapella.tracker.webcams_rig_kernels import adjust_rays, doubt_unmatched

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Bools = NDArray[np.bool_]
Float32 = NDArray[np.float32]
UInt8 = NDArray[np.uint8]

LATE_S = 0.05
"""Time before the last instant at which a detection is late [s]."""


@njit(cache=True, error_model="numpy")
def crossed(group_of: Int64, g: int, turned: Bools) -> bool:
    """Return whether a detection of a group is swapped.

    Args:
        group_of: (detections,) number of each detection's group.
        g: the group.
        turned: (detections,) whether left and right are exchanged.
    """
    found = False
    for d in range(len(group_of)):
        found |= group_of[d] == g and turned[d]
    return found


@njit(cache=True, error_model="numpy")
def begin(
    model: Any, people: PeopleArrays, at_s: float, since_s: float, rays: Rays, cameras: CameraArrays,
    gates: KeypointGates, matches: Matches, agreed: Bools,
) -> None:  # fmt: skip
    """Begin candidates from groups of detections without a person; weak people's detections may be in a group, too.

    Args:
        model, people, rays, cameras, matches: see the module.
        at_s: time of the instant [s].
        since_s: time before which detections are late, so that people may have left; these begin no person [s].
        gates: thresholds.
        agreed: (people, cameras) written: whether a camera agrees about a person.
    """
    count = len(rays.camera)
    free, turned = np.zeros(count, np.bool_), np.zeros(count, np.bool_)
    group_of = np.full(count, -1, np.int64)
    some = 0
    for d in range(count):
        p, joints = matches.person[d], 0
        for j in range(JOINTS):
            joints += rays.confidences[d, j] > 0.0
        weak = p >= 0 and people.cameras[p] < 2
        late = at_s + rays.after_s[d] < since_s
        free[d] = not late and joints >= gates.least_joints and (weak or (p < 0 and matches.explained[d] < 0))
        some += free[d] and p < 0
    if some == 0:
        return
    groups = group(rays, free, cameras.origins, gates, group_of, turned)
    size = JOINTS * count
    joints_of, camera = np.empty(size, np.int64), np.empty(size, np.int64)
    origins, directions = np.empty((size, 3)), np.empty((size, 3))
    sds, after_s, weights = np.empty(size), np.empty(size), np.empty(size)
    nobody = Matches(matches.person, matches.swapped, np.full(count, -1, np.int64), matches.cost)
    for g in range(groups):
        views, p = seen_by(g, group_of, rays.camera), 0
        if views == 2 and crossed(group_of, g, turned):
            continue  # the order of left and right is not known
        while p < len(people.ids) and people.ids[p] != NO_PERSON:
            p += 1
        if views < 2 or p == len(people.ids):
            continue
        n = take_rays(g, rays, cameras, group_of, nobody, turned, joints_of, origins, directions, sds, after_s, camera)
        forget(people, p)
        made = correct_by_rays(
            model, people.rows[p], at_s, joints_of[:n], origins[:n], directions[:n], sds[:n], after_s[:n], weights[:n],
            people.positions[p], people.covariances[p], people.support[p],
        )  # fmt: skip
        if made:
            people.ids[p], people.born_s[p], people.at_s[p] = CANDIDATE, at_s, at_s
            judge(people, p, at_s, views, gates, cameras.up)
            mark_agreed(camera, weights, n, gates.least_joints, agreed[p])
        if not made or people.hits[p] == 0:
            forget(people, p)
            continue
        for d in range(count):
            if group_of[d] == g and matches.person[d] < 0:
                matches.person[d], matches.swapped[d] = p, turned[d]


@njit(cache=True, error_model="numpy")
def track_instant(
    model: Any, people: PeopleArrays, at_s: float, pixels: Float64, rays: Rays, cameras: CameraArrays,
    joint_sd: float, least_sd_px: float, gates: KeypointGates, limits: PeopleLimits, matches: Matches,
    counts: CameraCounts, delivered: Bools, incomplete: bool, agreed: Bools, gone: Bools,
) -> None:  # fmt: skip
    """Track one instant of all cameras.

    Args:
        model, people, rays, cameras, limits, matches: see the module; ``rays`` has the cameras, times and confidences,
            the rest is written.
        at_s: time of the instant, not before the last one's [s].
        pixels: (detections, 26, 2) keypoints [px]; NaN where not seen.
        joint_sd, least_sd_px: see `mocapella.association.keypoint_rays.KeypointAssociationSettings`.
        gates: thresholds.
        counts: updated.
        delivered: (cameras,) whether the camera has an image in this instant.
        incomplete: whether active cameras have none, so that cameras may see people in turn.
        agreed: (people, cameras) written: whether a camera agrees about a person.
        gone: (people,) written: whether the row is to be freed, by `forget`.
    """
    sizes_px = np.empty(len(pixels))
    cast_rays(pixels, cameras, joint_sd, least_sd_px, rays, sizes_px)
    adjust_rays(rays, cameras, counts)
    drop_duplicates(pixels, rays.confidences, rays.camera, sizes_px)
    before, last_s = people.positions.copy(), -math.inf
    known = np.zeros(len(people.ids), np.bool_)
    for p in range(len(people.ids)):
        if people.ids[p] != NO_PERSON:
            last_s = max(last_s, people.at_s[p])
            known[p] = predict_body(model, people.rows[p], at_s, people.positions[p], people.covariances[p])
    predicted = people.positions.copy()
    expected = PredictedPeople(known, people.positions, people.covariances, people.velocities)
    assign_all(rays, expected, cameras.origins, gates, matches)
    correct(model, people, at_s, rays, cameras, gates, limits, matches, counts, incomplete, agreed)
    for p in range(len(people.ids)):
        if people.ids[p] != NO_PERSON:
            follow_unpredicted(people, p, at_s - people.at_s[p], predicted[p])
            follow(people, p, at_s, before[p])
    begin(model, people, at_s, last_s - LATE_S, rays, cameras, gates, matches, agreed)
    doubt_unmatched(rays, matches, gates, counts)
    count_unmatched(people, rays, cameras, gates, matches, counts)
    looking = np.zeros(len(people.ids), np.int64)
    for p in range(len(people.ids)):
        if people.ids[p] != NO_PERSON:
            looking[p] = count_refuting(people, p, pixels, rays, cameras, matches, delivered, counts)
    drop(people, at_s, limits, looking, counts.missed, cameras.up, gone)
    join_doubles(people, at_s, agreed, gone)
    for c in range(len(delivered)):
        if not delivered[c]:
            continue
        seen, size = 0.0, 0.0
        for d in range(len(rays.camera)):
            if rays.camera[d] == c and sizes_px[d] > 0.0:
                seen += 1.0
                size = max(size, sizes_px[d])
        counts.detections[c] += 0.05 * (seen - counts.detections[c])
        if size > 0.0:
            earlier = counts.height_px[c] if counts.height_px[c] >= 0.0 else size
            counts.height_px[c] = earlier + 0.05 * (size - earlier)


@njit(cache=True, error_model="numpy")
def show(
    model: Any, people: PeopleArrays, rows: Int64, at_s: float, ahead_s: float, limits: PeopleLimits, partial: bool,
    positions: Float64, sds: Float32, states: UInt8,
) -> None:  # fmt: skip
    """Write the joints of people for a scene, at the time of the last instant or predicted to a later one.

    A joint is measured if two cameras or more agree about it in the last instant, or did so a short time ago where not
    all cameras delivered and none contradicts, and if its standard deviation is small. Rays of several instants can
    agree, too (`measure_in_turn`).

    Args:
        model, people, limits: see the module; the people are not changed.
        rows: (shown,) rows of the people.
        at_s: time of the last instant [s].
        ahead_s: time to predict ahead; 0 for none [s].
        incomplete: whether some active cameras did not deliver in the last instant.
        positions: (shown, 26, 3) written: world [m]; NaN where not known.
        sds: (shown, 26) written: standard deviation of a coordinate [m]; NaN where not known.
        states: (shown, 26) written: `JointState`.
    """
    covariances = np.empty((JOINTS, 3, 3))
    for i in range(len(rows)):
        p = rows[i]
        ahead = ahead_s > 0.0 and predict_body(model, people.rows[p], at_s + ahead_s, positions[i], covariances)
        for j in range(JOINTS):
            lately = partial and at_s - people.measured_s[p, j] <= limits.measured_s
            seen = people.support[p, j] >= 2 or lately
            C = covariances[j] if ahead else people.covariances[p, j]
            variance = stated_variance(people, p, j, at_s, ahead_s if ahead else 0.0, C, seen)
            known = variance >= 0.0
            for k in range(3):
                if not ahead:
                    positions[i, j, k] = people.positions[p, j, k]
                known &= -math.inf < positions[i, j, k] < math.inf
            if not known:
                positions[i, j, 0] = positions[i, j, 1] = positions[i, j, 2] = sds[i, j] = math.nan
                states[i, j] = 0
                continue
            sds[i, j] = math.sqrt(variance)
            states[i, j] = 2 if seen and sds[i, j] <= limits.measured_sd_m else 1
