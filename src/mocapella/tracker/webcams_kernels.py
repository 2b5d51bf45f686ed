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

# ruff: noqa: PLR0912, PLR0917 - compiled: arrays come by position, loops stand in one place
from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.association.keypoint_kernels import assign_all, cast_rays, drop_duplicates
from mocapella.association.keypoint_rays import (
    BONES,
    JOINTS,
    MIRROR,
    CameraArrays,
    KeypointGates,
    Matches,
    PredictedPeople,
    Rays,
)
from mocapella.association.new_people_kernels import group, plausible
from mocapella.compiled import njit
from mocapella.kinematics.ray_body_kernels import correct_by_rays, predict_body
from mocapella.tracker.webcams_errors_kernels import follow_unpredicted, variance_ahead, widen
from mocapella.tracker.webcams_memory import CANDIDATE, NO_PERSON, CameraCounts, PeopleArrays

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Bools = NDArray[np.bool_]
Float32 = NDArray[np.float32]
UInt8 = NDArray[np.uint8]

FASTEST_M_S = 8.0
"""Largest speed of a joint that moves its rays to their own times [m/s]."""
AGREES = 0.3
"""Least robust weight of a ray that agrees with its body."""
MOST_VALUES = 300.0
"""Number of values after which running means forget."""
TURN_WEIGHT = 0.15
"""Weight of an instant in the running mean of swapped detections."""
MOST_TURNED = 0.6
"""Share of swapped detections above which the person is swapped."""
NEAR_M = 0.4
"""Distance that a person's place may be wrong [m]."""
RUNNING_M_S = 3.0
"""Speed of a person whose distance one camera tells [m/s]."""
REFUTED_S = 1.0
"""A person whom at most one camera sees, and two others should see, is lost after this time [s]."""
REFUTED_WEIGHT = 0.2
"""Weight of an instant in the running means of whether a camera sees no person."""
MOST_REFUTING = 1.5
"""Number of cameras that see no person at a place, above which one or two others do not suffice."""
SURE_CAMERAS = 3
"""Number of cameras that together hardly ever see strangers on one line."""
LEAST_SURE = 3
"""Number of instants when three cameras agree about a person, after which two suffice."""
HIDDEN_SHARE = 0.3
"""Share of a person's joints within another detection above which that may hide the person."""
LEAST_SEEN_PX = 24.0
"""Least height in an image of a person whom a detector must see [px]."""
MISSED_INSTANTS_S = 0.25
"""A candidate that two cameras do not confirm for this long is dropped [s]."""


class PeopleLimits(NamedTuple):
    """Limits of the lives of people, see `mocapella.tracker.webcams_settings.WebcamsSettings`."""

    one_camera_s: float
    unseen_s: float
    doubtful_instants: int
    same_within_m: float
    measured_sd_m: float
    measured_s: float
    slow_error_s: float


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
def forget(people: PeopleArrays, p: int) -> None:
    """Free a person's row.

    Args:
        people: see the module.
        p: the row.
    """
    people.ids[p] = NO_PERSON
    people.hits[p] = people.doubts[p] = people.cameras[p] = 0
    people.turned[p], people.sure[p] = 0.0, 0
    for c in range(people.refuted.shape[1]):
        people.refuted[p, c] = math.nan
    people.at_s[p] = people.born_s[p] = people.seen_s[p] = people.agreed_s[p] = math.nan
    for k in range(3):
        people.agreed_place[p, k] = math.nan
    for i in range(people.rows.shape[1]):
        people.rows[p, i] = math.nan
    for j in range(JOINTS):
        people.support[p, j] = 0
        people.measured_s[p, j] = people.unpredicted[p, j] = math.nan
        for k in range(3):
            people.positions[p, j, k], people.velocities[p, j, k] = math.nan, 0.0
            for m in range(3):
                people.covariances[p, j, k, m] = math.nan
    for b in range(len(BONES)):
        people.lengths[p, b], people.lengths_seen[p, b] = math.nan, 0.0


@njit(cache=True, error_model="numpy")
def middle(positions: Float64, out: Float64) -> None:
    """Write the mean of a person's joints.

    Args:
        positions: (26, 3) world [m]; NaN where not known.
        out: (3,) written; NaN if no joint is known.
    """
    count = 0.0
    out[0] = out[1] = out[2] = 0.0
    for j in range(JOINTS):
        if positions[j, 0] == positions[j, 0]:
            count += 1.0
            for k in range(3):
                out[k] += positions[j, k]
    for k in range(3):
        out[k] = out[k] / count if count > 0.0 else math.nan


@njit(cache=True, error_model="numpy")
def ran_away(people: PeopleArrays, p: int, at_s: float) -> bool:
    """Return whether a person has moved farther than people do since two cameras last agreed about the place.

    Args:
        people: see the module.
        p: row of the person.
        at_s: time of the instant [s].
    """
    place, apart = np.empty(3), 0.0
    middle(people.positions[p], place)
    for k in range(3):
        apart += (place[k] - people.agreed_place[p, k]) ** 2
    return bool(math.sqrt(apart) > NEAR_M + RUNNING_M_S * (at_s - people.agreed_s[p]))


@njit(cache=True, error_model="numpy")
def judge(people: PeopleArrays, p: int, at_s: float, views: int, gates: KeypointGates) -> None:
    """Count whether the cameras agree about a person, after the body's correction, and learn the bones' lengths.

    Args:
        people: see the module.
        p: row of the person.
        at_s: time of the instant [s].
        views: number of cameras that saw the person.
        gates: thresholds.
    """
    agreeing, sure = 0, 0
    measured, sds = np.full((JOINTS, 3), math.nan), np.full(JOINTS, math.nan)
    for j in range(JOINTS):
        if people.support[p, j] >= 2:
            agreeing += 1
            sure += people.support[p, j] >= SURE_CAMERAS
            people.measured_s[p, j] = at_s
            C = people.covariances[p, j]
            sds[j] = math.sqrt(max(C[0, 0] + C[1, 1] + C[2, 2], 0.0) / 3.0)
            for k in range(3):
                measured[j, k] = people.positions[p, j, k]
    people.cameras[p] = views
    if views >= 1:
        people.seen_s[p] = at_s
    if views < 2:
        return
    if agreeing < gates.least_joints or not plausible(measured, sds, gates.shortest_m, gates.tallest_m):
        people.doubts[p] += 1
        return
    people.doubts[p] = 0
    people.hits[p] += 1
    people.agreed_s[p] = at_s
    people.sure[p] += sure >= gates.least_joints
    middle(people.positions[p], people.agreed_place[p])
    for b in range(len(BONES)):
        i, j = BONES[b, 0], BONES[b, 1]
        x, y, z = (measured[i, 0] - measured[j, 0], measured[i, 1] - measured[j, 1], measured[i, 2] - measured[j, 2])
        length = math.sqrt(x * x + y * y + z * z)
        if length >= 0.0:
            seen = min(people.lengths_seen[p, b] + 1.0, MOST_VALUES)
            before = people.lengths[p, b] if seen > 1.0 else length
            step = min(max(length - before, -0.1), 0.1)
            people.lengths[p, b], people.lengths_seen[p, b] = before + step / seen, seen


@njit(cache=True, error_model="numpy")
def follow(people: PeopleArrays, p: int, at_s: float, before: Float64) -> None:
    """Update the velocities for the comparison of the next instant's rays.

    Args:
        people: see the module.
        p: row of the person.
        at_s: time of the instant [s].
        before: (26, 3) positions of the last instant [m].
    """
    dt = at_s - people.at_s[p]
    for j in range(JOINTS):
        for k in range(3):
            speed = (people.positions[p, j, k] - before[j, k]) / dt
            if dt > 0.0 and -math.inf < speed < math.inf:
                speed = min(max(speed, -FASTEST_M_S), FASTEST_M_S)
                people.velocities[p, j, k] += 0.5 * (speed - people.velocities[p, j, k])
            elif dt != 0.0:
                people.velocities[p, j, k] = 0.0
    people.at_s[p] = at_s


@njit(cache=True, error_model="numpy")
def refuting(people: PeopleArrays, p: int) -> float:
    """Return the number of cameras that look at a person, unhidden, and see no person: a sum of running means.

    Args:
        people: see the module.
        p: row of the person.
    """
    total = 0.0
    for c in range(people.refuted.shape[1]):
        if people.refuted[p, c] > 0.0:
            total += people.refuted[p, c]
    return total


@njit(cache=True, error_model="numpy")
def drop(people: PeopleArrays, at_s: float, limits: PeopleLimits, gone: Bools) -> None:
    """Mark people who have left, candidates that were not confirmed, phantoms, and second tracks of one person.

    Args:
        people, limits: see the module.
        at_s: time of the instant [s].
        gone: (people,) written: whether the row is to be freed.
    """
    for p in range(len(people.ids)):
        gone[p] = False
        if people.ids[p] == NO_PERSON:
            continue
        if people.ids[p] == CANDIDATE:
            gone[p] = at_s - people.agreed_s[p] > MISSED_INSTANTS_S or people.doubts[p] > 2
        else:
            unseen = at_s - people.seen_s[p] > limits.unseen_s
            gone[p] = unseen or at_s - people.agreed_s[p] > limits.one_camera_s
            gone[p] |= people.doubts[p] > limits.doubtful_instants or ran_away(people, p, at_s)
            alone_s = at_s - people.agreed_s[p]
            refuted = refuting(people, p) >= MOST_REFUTING
            gone[p] |= refuted and people.cameras[p] < 2 and alone_s > REFUTED_S
            gone[p] |= refuted and people.cameras[p] <= 2 and people.sure[p] < LEAST_SURE
    for p in range(len(people.ids)):
        for q in range(len(people.ids)):
            if p == q or gone[p] or gone[q] or people.ids[p] == NO_PERSON or people.ids[q] == NO_PERSON:
                continue
            total, common = 0.0, 0
            for j in range(JOINTS):
                x = people.positions[p, j, 0] - people.positions[q, j, 0]
                y = people.positions[p, j, 1] - people.positions[q, j, 1]
                z = people.positions[p, j, 2] - people.positions[q, j, 2]
                distance = math.sqrt(x * x + y * y + z * z)
                if distance >= 0.0:
                    total += distance
                    common += 1
            if common == 0 or total > common * limits.same_within_m:
                continue
            if people.cameras[p] >= 2 and people.cameras[q] >= 2 and people.ids[p] >= 0 and people.ids[q] >= 0:
                continue  # two cameras see both apart
            younger = (people.ids[p] < 0) > (people.ids[q] < 0) or (
                (people.ids[p] < 0) == (people.ids[q] < 0) and (people.born_s[p], p) > (people.born_s[q], q)
            )
            gone[p] |= younger


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
    model: Any, people: PeopleArrays, at_s: float, rays: Rays, cameras: CameraArrays, gates: KeypointGates,
    matches: Matches, agreed: Bools,
) -> int:  # fmt: skip
    """Begin candidates from groups of detections without a person; weak people's detections may be in a group, too.

    Args:
        model, people, rays, cameras, matches: see the module.
        at_s: time of the instant [s].
        gates: thresholds.
        agreed: (people, cameras) written: whether a camera agrees about a person.

    Returns:
        Number of begun candidates.
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
        free[d] = joints >= gates.least_joints and (weak or (p < 0 and matches.explained[d] < 0))
        some += free[d] and p < 0
    if some == 0:
        return 0
    groups = group(rays, free, cameras.origins, gates, group_of, turned)
    size, begun = JOINTS * count, 0
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
            judge(people, p, at_s, views, gates)
            mark_agreed(camera, weights, n, gates.least_joints, agreed[p])
        if not made or people.hits[p] == 0:
            forget(people, p)
            continue
        begun += 1
        for d in range(count):
            if group_of[d] == g and matches.person[d] < 0:
                matches.person[d], matches.swapped[d] = p, turned[d]
    return begun


@njit(cache=True, error_model="numpy")
def mark_agreed(camera: Int64, weights: Float64, n: int, least: int, agreed: Bools) -> None:
    """Mark the cameras that agree about a person.

    Args:
        camera: (≥ n,) camera of each ray.
        weights: (≥ n,) robust weight of each ray.
        n: number of rays.
        least: least number of rays that must agree.
        agreed: (cameras,) written.
    """
    for c in range(len(agreed)):
        count = 0
        for i in range(n):
            count += camera[i] == c and weights[i] > AGREES
        agreed[c] = count >= least


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


@njit(cache=True, error_model="numpy")
def count_agreement(counts: CameraCounts, c: int, share: float) -> None:
    """Update the running mean of a camera's agreement.

    Args:
        counts: updated.
        c: index of the camera.
        share: share of keypoints that agree with other cameras.
    """
    counts.judged[c] = min(counts.judged[c] + 1.0, MOST_VALUES)
    before = counts.agreed[c] if counts.judged[c] > 1.0 else share
    counts.agreed[c] = before + (share - before) / counts.judged[c]


@njit(cache=True, error_model="numpy")
def count_unmatched(
    people: PeopleArrays, rays: Rays, cameras: CameraArrays, gates: KeypointGates, matches: Matches,
    counts: CameraCounts,
) -> None:  # fmt: skip
    """Count against a camera that it sees a person, but none of the people whom the others see in its image.

    Args:
        people, rays, cameras, matches: see the module.
        gates: thresholds.
        counts: updated.
    """
    image = np.empty((JOINTS, 2))
    for c in range(len(cameras.origins)):
        stranger = False
        for d in range(len(rays.camera)):
            if rays.camera[d] == c and matches.person[d] < 0 and matches.explained[d] < 0:
                joints = 0
                for j in range(JOINTS):
                    joints += rays.confidences[d, j] > 0.0
                stranger |= joints >= 2 * gates.least_joints
        if not stranger:
            continue
        for p in range(len(people.ids)):
            if people.ids[p] < 0 or people.cameras[p] < 2 or people.doubts[p] > 0:
                continue
            seen = False
            for d in range(len(rays.camera)):
                seen |= rays.camera[d] == c and matches.person[d] == p
            if not seen and inside(people.positions[p], cameras, c, image):
                count_agreement(counts, c, 0.0)


@njit(cache=True, error_model="numpy")
def count_refuting(
    people: PeopleArrays, p: int, pixels: Float64, rays: Rays, cameras: CameraArrays, matches: Matches,
    delivered: Bools,
) -> None:  # fmt: skip
    """Follow which cameras look at a person and see no person there, although no other detection hides the person.

    Args:
        people, rays, cameras, matches: see the module.
        p: row of the person.
        pixels: (detections, 26, 2) keypoints [px].
        delivered: (cameras,) whether the camera has an image in this instant.
    """
    image = np.empty((JOINTS, 2))
    for c in range(len(delivered)):
        if not delivered[c]:
            continue
        looks, mine, hidden = inside(people.positions[p], cameras, c, image), False, False
        top, bottom = math.inf, -math.inf
        for j in range(JOINTS):
            if image[j, 1] == image[j, 1]:
                top, bottom = min(top, image[j, 1]), max(bottom, image[j, 1])
        looks &= bottom - top >= LEAST_SEEN_PX
        for d in range(len(rays.camera)):
            if rays.camera[d] == c:
                own = matches.person[d] == p or matches.explained[d] == p
                mine |= own
                hidden |= not own and covered(image, pixels[d], rays.confidences[d]) >= HIDDEN_SHARE
        if mine or not looks or not hidden:  # a camera before which the person is hidden tells nothing
            refuted = 1.0 if looks and not mine else 0.0
            before = people.refuted[p, c] if people.refuted[p, c] >= 0.0 else refuted
            people.refuted[p, c] = before + REFUTED_WEIGHT * (refuted - before)


@njit(cache=True, error_model="numpy")
def covered(image: Float64, pixels: Float64, confidences: Float64) -> float:
    """Return the share of a person's joints that are within the rectangle around a detection's keypoints.

    Args:
        image: (26, 2) the person's joints [px]; NaN where not known.
        pixels: (26, 2) the detection's keypoints [px].
        confidences: (26,) of the keypoints; keypoints of 0 do not count.
    """
    left, right, top, bottom = math.inf, -math.inf, math.inf, -math.inf
    for j in range(JOINTS):
        if confidences[j] > 0.0:
            left, right = min(left, pixels[j, 0]), max(right, pixels[j, 0])
            top, bottom = min(top, pixels[j, 1]), max(bottom, pixels[j, 1])
    known, within = 0, 0
    for j in range(JOINTS):
        if image[j, 0] == image[j, 0]:
            known += 1
            within += left <= image[j, 0] <= right and top <= image[j, 1] <= bottom
    return within / known if known > 0 else 0.0


@njit(cache=True, error_model="numpy")
def inside(positions: Float64, cameras: CameraArrays, c: int, image: Float64) -> bool:
    """Return whether a body is in a camera's image, without regard to the lens' distortion.

    Args:
        positions: (26, 3) world [m].
        cameras: see the module.
        c: index of the camera.
        image: (26, 2) written: the joints in the image [px]; NaN where not known, or behind the camera.
    """
    R, o, lens = cameras.R_world_camera[c], cameras.origins[c], cameras.lenses[c]
    known, within = 0, 0
    for j in range(JOINTS):
        x, y, z = positions[j, 0] - o[0], positions[j, 1] - o[1], positions[j, 2] - o[2]
        image[j, 0] = image[j, 1] = math.nan
        if not x * x >= 0.0:
            continue
        known += 1
        depth = R[0, 2] * x + R[1, 2] * y + R[2, 2] * z
        if depth > 0.1:
            u = lens[2] + lens[0] * (R[0, 0] * x + R[1, 0] * y + R[2, 0] * z) / depth
            v = lens[3] + lens[1] * (R[0, 1] * x + R[1, 1] * y + R[2, 1] * z) / depth
            image[j, 0], image[j, 1] = u, v
            within += 0.0 <= u < cameras.sizes_px[c, 0] and 0.0 <= v < cameras.sizes_px[c, 1]
    return bool(known > 0 and within >= 0.8 * known)


@njit(cache=True, error_model="numpy")
def track_instant(
    model: Any, people: PeopleArrays, at_s: float, pixels: Float64, rays: Rays, cameras: CameraArrays,
    joint_sd: float, least_sd_px: float, gates: KeypointGates, limits: PeopleLimits, matches: Matches,
    counts: CameraCounts, delivered: Bools, agreed: Bools, gone: Bools,
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
        agreed: (people, cameras) written: whether a camera agrees about a person.
        gone: (people,) written: whether the row is to be freed, by `forget`.
    """
    sizes_px = np.empty(len(pixels))
    cast_rays(pixels, cameras, joint_sd, least_sd_px, rays, sizes_px)
    drop_duplicates(pixels, rays.confidences, rays.camera, sizes_px)
    before = people.positions.copy()
    known = np.zeros(len(people.ids), np.bool_)
    for p in range(len(people.ids)):
        if people.ids[p] != NO_PERSON:
            known[p] = predict_body(model, people.rows[p], at_s, people.positions[p], people.covariances[p])
    predicted = people.positions.copy()
    expected = PredictedPeople(known, people.positions, people.covariances, people.velocities)
    assign_all(rays, expected, cameras.origins, gates, matches)
    correct(model, people, at_s, rays, cameras, gates, limits, matches, counts, agreed)
    for p in range(len(people.ids)):
        if people.ids[p] != NO_PERSON:
            follow_unpredicted(people, p, at_s - people.at_s[p], predicted[p])
            follow(people, p, at_s, before[p])
    begin(model, people, at_s, rays, cameras, gates, matches, agreed)
    count_unmatched(people, rays, cameras, gates, matches, counts)
    for p in range(len(people.ids)):
        if people.ids[p] != NO_PERSON:
            count_refuting(people, p, pixels, rays, cameras, matches, delivered)
    drop(people, at_s, limits, gone)
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

    A joint is measured if two cameras or more agree about it in the last instant, or if one does where not all cameras
    delivered and two did a short time ago, and if its standard deviation is small.

    Args:
        model, people, limits: see the module; the people are not changed.
        rows: (shown,) rows of the people.
        at_s: time of the last instant [s].
        ahead_s: time to predict ahead; 0 for none [s].
        partial: whether some active cameras did not deliver in the last instant.
        positions: (shown, 26, 3) written: world [m]; NaN where not known.
        sds: (shown, 26) written: standard deviation of a coordinate [m]; NaN where not known.
        states: (shown, 26) written: `JointState`.
    """
    covariances = np.empty((JOINTS, 3, 3))
    for i in range(len(rows)):
        p = rows[i]
        ahead = ahead_s > 0.0 and predict_body(model, people.rows[p], at_s + ahead_s, positions[i], covariances)
        for j in range(JOINTS):
            if ahead:
                variance = variance_ahead(people, p, j, ahead_s, covariances[j])
            else:
                C = people.covariances[p, j]
                variance = (C[0, 0] + C[1, 1] + C[2, 2]) / 3.0
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
            support = people.support[p, j]
            seen = support >= 2 or (support == 1 and partial and at_s - people.measured_s[p, j] <= limits.measured_s)
            states[i, j] = 2 if seen and sds[i, j] <= limits.measured_sd_m else 1
