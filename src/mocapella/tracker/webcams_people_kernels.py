"""Kernels of the lives of people in the method ``webcams``: counts of agreement, velocities, and lost people.

Common arguments: see `mocapella.tracker.webcams_kernels`; importing this module imports numba.
"""

# ruff: noqa: PLR0917 - compiled: arrays come by position
from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.association.keypoint_rays import BONES, JOINTS, KeypointGates
from mocapella.association.new_people_kernels import plausible
from mocapella.compiled import njit
from mocapella.model.topology import topology
from mocapella.tracker.webcams_memory import (
    CANDIDATE,
    FIRST_HEIGHT_SD_M,
    LIFTED_M,
    LONG_SEEN,
    MOST_MISSED,
    NO_PERSON,
    ROAMED_M,
    PeopleArrays,
)

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Bools = NDArray[np.bool_]

FASTEST_M_S = 8.0
"""Largest speed of a joint that moves its rays to their own times [m/s]."""
MOST_VALUES = 300.0
"""Number of values after which running means forget."""
NEAR_M = 0.4
"""Distance that a person's place may be wrong [m]."""
RUNNING_M_S = 3.0
"""Speed of a person whose distance one camera tells [m/s]."""
REFUTED_S = 1.0
"""A person whom at most one camera sees, and two others should see, is lost after this time [s]."""
MOST_REFUTING = 1.5
"""Number of cameras that see no person at a place, above which one or two others do not suffice."""
SURE_CAMERAS = 3
"""Number of cameras that together hardly ever see strangers on one line."""
LEAST_SURE = 3
"""Number of instants when three cameras agree about a person, after which two suffice."""
HEIGHT_WEIGHT = 0.03
"""Least weight of an instant in the running mean of a joint's height."""
LEAST_REFUTING = 1.0
"""Number of cameras that see no person at a place, below which a person whom no camera sees may be hidden."""
VAGUE_M = 0.35
"""Mean standard deviation of the joints, all axes together, above which a person's place is vague [m]."""
VAGUE_S = 1.5
"""Time after which a person at a vague place, about whom no two cameras agree, is lost [s]."""
DOUBLE_M = 0.3
"""Mean distance of the joints of two tracks of one person [m]."""
DOUBLE_S = 0.4
"""Time after two cameras last agreed about a person, from which the track may be the second of another person [s]."""
TRUSTED_S = 0.2
"""Time for each instant when two cameras agreed, for which a person stays about whom no two agree any more [s]."""
LIFTED_S = 0.25
"""Time without agreement of two cameras after which a person so far above or below is lost [s]."""
ANKLES = tuple(topology("halpe_26").index(f"{side}Ankle") for side in "LR")
"""Joints that stand on the floor."""
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
    hidden_s: float


@njit(cache=True, error_model="numpy")
def forget(people: PeopleArrays, p: int) -> None:
    """Free a person's row.

    Args:
        people: see the module.
        p: the row.
    """
    people.ids[p] = NO_PERSON
    people.hits[p] = people.doubts[p] = people.cameras[p] = 0
    people.turned[p], people.roamed[p], people.sure[p] = 0.0, 0.0, 0
    for c in range(people.refuted.shape[1]):
        people.refuted[p, c] = math.nan
    people.at_s[p] = people.born_s[p] = people.seen_s[p] = people.agreed_s[p] = math.nan
    for k in range(3):
        people.agreed_place[p, k] = people.first_place[p, k] = math.nan
    for i in range(people.rows.shape[1]):
        people.rows[p, i] = math.nan
    for j in range(JOINTS):
        people.support[p, j] = 0
        people.measured_s[p, j] = people.unpredicted[p, j] = people.heights[p, j] = math.nan
        people.measured_variances[p, j] = math.nan
        people.height_variances[p, j] = 0.0
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
def learn_heights(people: PeopleArrays, p: int, measured: Float64, up: Float64) -> None:
    """Update the mean and the variance of the joints' heights.

    Args:
        people: see the module.
        p: row of the person.
        measured: (26, 3) joints that two cameras see, world [m]; NaN for others.
        up: (3,) upward direction, world.
    """
    for j in range(JOINTS):
        height = measured[j, 0] * up[0] + measured[j, 1] * up[1] + measured[j, 2] * up[2]
        if math.isnan(height):
            continue
        if math.isnan(people.heights[p, j]):
            people.heights[p, j], people.height_variances[p, j] = height, FIRST_HEIGHT_SD_M * FIRST_HEIGHT_SD_M
            continue
        off, variance = height - people.heights[p, j], people.height_variances[p, j]
        share = max(1.0 / (people.hits[p] + 1.0), HEIGHT_WEIGHT)
        people.heights[p, j] += share * off
        people.height_variances[p, j] += share * (off * off - variance)


@njit(cache=True, error_model="numpy")
def judge(people: PeopleArrays, p: int, at_s: float, views: int, gates: KeypointGates, up: Float64) -> None:
    """Count whether the cameras agree about a person, after the body's correction, and learn the bones' lengths.

    Args:
        people: see the module.
        p: row of the person.
        at_s: time of the instant [s].
        views: number of cameras that saw the person.
        gates: thresholds.
        up: (3,) upward direction, world.
    """
    agreeing, sure = 0, 0
    measured, sds = np.full((JOINTS, 3), math.nan), np.full(JOINTS, math.nan)
    for j in range(JOINTS):
        if people.support[p, j] >= 2:
            agreeing += 1
            sure += people.support[p, j] >= SURE_CAMERAS
            people.measured_s[p, j] = at_s
            C = people.covariances[p, j]
            people.measured_variances[p, j] = max(C[0, 0] + C[1, 1] + C[2, 2], 0.0) / 3.0
            sds[j] = math.sqrt(people.measured_variances[p, j])
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
    apart = 0.0
    for k in range(3):
        if people.hits[p] == 1:
            people.first_place[p, k] = people.agreed_place[p, k]
        apart += (people.agreed_place[p, k] - people.first_place[p, k]) ** 2
    people.roamed[p] = max(people.roamed[p], math.sqrt(apart))
    learn_heights(people, p, measured, up)
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
def refuting(people: PeopleArrays, p: int, missed: Float64) -> float:
    """Return the number of cameras that look at a person, unhidden, and see no person: a sum of running means.

    A camera that often sees no person where others see one, such as through furniture, counts less.

    Args:
        people: see the module.
        p: row of the person.
        missed: (cameras,) see `CameraCounts`.
    """
    total = 0.0
    for c in range(people.refuted.shape[1]):
        if people.refuted[p, c] > 0.0:
            total += people.refuted[p, c] * max(1.0 - missed[c] / MOST_MISSED, 0.0)
    return total


@njit(cache=True, error_model="numpy")
def vague(people: PeopleArrays, p: int) -> bool:
    """Return whether the place of a person is vague (`VAGUE_M`).

    Args:
        people: see the module.
        p: row of the person.
    """
    total, known = 0.0, 0.0
    for j in range(JOINTS):
        C = people.covariances[p, j]
        variance = C[0, 0] + C[1, 1] + C[2, 2]
        if variance >= 0.0:
            total += math.sqrt(variance)
            known += 1.0
    return bool(known > 0.0 and total > VAGUE_M * known)


@njit(cache=True, error_model="numpy")
def lifted(people: PeopleArrays, p: int, up: Float64) -> bool:
    """Return whether a person is far above or below the heights that the feet had while two cameras agreed.

    The rays of other people may draw a body that one camera sees along its rays, into the air or into the floor.

    Args:
        people: see the module.
        p: row of the person.
        up: (3,) upward direction, world.
    """
    now, before, variance = math.inf, math.inf, 0.0
    for j in ANKLES:
        x = people.positions[p, j]
        height = x[0] * up[0] + x[1] * up[1] + x[2] * up[2]
        if math.isnan(height + people.heights[p, j]):
            return False
        now, before = min(now, height), min(before, people.heights[p, j])
        variance = max(variance, people.height_variances[p, j])
    return bool(people.hits[p] >= LONG_SEEN and abs(now - before) > LIFTED_M + math.sqrt(variance))


@njit(cache=True, error_model="numpy")
def apart_m(people: PeopleArrays, p: int, q: int) -> float:
    """Return the mean distance of two people's joints [m]; NaN if they have no joint in common.

    Args:
        people: see the module.
        p, q: their rows.
    """
    total, common = 0.0, 0
    for j in range(JOINTS):
        x = people.positions[p, j, 0] - people.positions[q, j, 0]
        y = people.positions[p, j, 1] - people.positions[q, j, 1]
        z = people.positions[p, j, 2] - people.positions[q, j, 2]
        distance = math.sqrt(x * x + y * y + z * z)
        if distance >= 0.0:
            total += distance
            common += 1
    return total / common if common > 0 else math.nan


@njit(cache=True, error_model="numpy")
def join_doubles(people: PeopleArrays, at_s: float, agreed: Bools, gone: Bools) -> None:
    """Mark second tracks of a person who began again: no camera sees both, and few cameras the second.

    The person keeps the number that two cameras saw longer.

    Args:
        people: see the module; numbers are changed.
        at_s: time of the instant [s].
        agreed: (people, cameras) whether a camera agrees about a person.
        gone: (people,) whether the row is to be freed; changed.
    """
    for q in range(len(people.ids)):
        if gone[q] or people.ids[q] < 0 or people.cameras[q] >= 2 or at_s - people.agreed_s[q] < DOUBLE_S:
            continue
        for p in range(len(people.ids)):
            if p == q or gone[p] or people.ids[p] < 0 or people.cameras[p] < 2:
                continue
            both = False
            for c in range(agreed.shape[1]):
                both |= agreed[p, c] and agreed[q, c]
            if both or not apart_m(people, p, q) <= DOUBLE_M:
                continue
            if people.hits[q] > people.hits[p]:
                people.ids[p] = people.ids[q]
            people.ids[q], gone[q] = CANDIDATE, True
            break


@njit(cache=True, error_model="numpy")
def drop(
    people: PeopleArrays, at_s: float, limits: PeopleLimits, looking: Int64, missed: Float64, up: Float64, gone: Bools
) -> None:
    """Mark people who have left, candidates that were not confirmed, phantoms, and second tracks of one person.

    Args:
        people, limits: see the module.
        at_s: time of the instant [s].
        looking: (people,) number of cameras in whose images the person would be.
        missed: (cameras,) see `CameraCounts`.
        up: (3,) upward direction, world.
        gone: (people,) written: whether the row is to be freed.
    """
    for p in range(len(people.ids)):
        gone[p] = False
        if people.ids[p] == NO_PERSON:
            continue
        if people.ids[p] == CANDIDATE:
            gone[p] = at_s - people.agreed_s[p] > MISSED_INSTANTS_S or people.doubts[p] > 2
        else:
            hidden = looking[p] > 0 and people.hits[p] >= LONG_SEEN and refuting(people, p, missed) < LEAST_REFUTING
            unseen = at_s - people.seen_s[p] > (limits.hidden_s if hidden else limits.unseen_s)
            alone_s = at_s - people.agreed_s[p]
            gone[p] = unseen or alone_s > limits.one_camera_s or (alone_s > VAGUE_S and vague(people, p))
            gone[p] |= alone_s > MISSED_INSTANTS_S + TRUSTED_S * people.hits[p]
            gone[p] |= people.doubts[p] > limits.doubtful_instants or ran_away(people, p, at_s)
            refuted = refuting(people, p, missed) >= MOST_REFUTING
            gone[p] |= refuted and people.cameras[p] < 2 and alone_s > REFUTED_S
            gone[p] |= people.cameras[p] < 2 and alone_s > LIFTED_S and lifted(people, p, up)
            few = people.sure[p] < LEAST_SURE and not (people.hits[p] >= LONG_SEEN and people.roamed[p] >= ROAMED_M)
            gone[p] |= refuted and people.cameras[p] <= 2 and few
    for p in range(len(people.ids)):
        for q in range(len(people.ids)):
            if p == q or gone[p] or gone[q] or people.ids[p] == NO_PERSON or people.ids[q] == NO_PERSON:
                continue
            if not apart_m(people, p, q) <= limits.same_within_m:
                continue
            if people.cameras[p] >= 2 and people.cameras[q] >= 2 and people.ids[p] >= 0 and people.ids[q] >= 0:
                continue  # two cameras see both apart
            younger = (people.ids[p] < 0) > (people.ids[q] < 0) or (
                (people.ids[p] < 0) == (people.ids[q] < 0) and (people.born_s[p], p) > (people.born_s[q], q)
            )
            gone[p] |= younger
