"""Kernels that compare the cameras of the method ``webcams``: agreement about people, and cameras that see none.

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
from mocapella.tracker.webcams_people_kernels import MOST_VALUES

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Bools = NDArray[np.bool_]

AGREES = 0.3
"""Least robust weight of a ray that agrees with its body."""
REFUTED_WEIGHT = 0.2
"""Weight of an instant in the running means of whether a camera sees no person."""
MISSED_WEIGHT = 0.01
"""Weight of a person and instant in the running mean of whether a camera misses people."""
WELL_KNOWN = 10
"""Number of instants when three cameras agreed about a person who shows which cameras miss people."""
HIDDEN_SHARE = 0.3
"""Share of a person's joints within another detection above which that may hide the person."""
LEAST_SEEN_PX = 24.0
"""Least height in an image of a person whom a detector must see [px]."""


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
    delivered: Bools, counts: CameraCounts,
) -> int:  # fmt: skip
    """Follow which cameras look at a person and see no person there, although no other detection hides the person.

    Args:
        people, rays, cameras, matches: see the module.
        p: row of the person.
        pixels: (detections, 26, 2) keypoints [px].
        delivered: (cameras,) whether the camera has an image in this instant.
        counts: updated.

    Returns:
        The number of cameras in whose images the person would be, whether they delivered or not.
    """
    image, looking = np.empty((JOINTS, 2)), 0
    for c in range(len(delivered)):
        looks, mine, hidden = inside(people.positions[p], cameras, c, image), False, False
        looking += looks
        if not delivered[c]:
            continue
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
            if looks and people.sure[p] >= WELL_KNOWN and people.cameras[p] >= 2 and people.doubts[p] == 0:
                counts.missed[c] += MISSED_WEIGHT * (refuted - counts.missed[c])
    return looking


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
