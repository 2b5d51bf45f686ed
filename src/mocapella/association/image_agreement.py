"""Match the detections in a camera's image with people at known places, and count contradictions."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply
from mocapella.model.camera import PlacedCamera

Float64 = NDArray[np.float64]

AGREES: Final = 0.1
"""A detection is of a person whose joints are, in the median, at most this part of the person's size away."""
LEAST_PX: Final = 8.0
"""The limit is at least as large [px]."""
LEAST_POINTS: Final = 3
"""Least number of common keypoints of a detection and a person that are compared."""
STRANGER_POINTS: Final = 8
"""Least number of confident keypoints of a stranger, a detection that is of no person."""
WITHIN: Final = 0.8
"""Least share of a person's joints within an image for the person to be in it."""
CONTRARY: Final = 0.12
"""Share of people in whose place a camera sees strangers, above which it contradicts the others.

Cameras of simulated crowds have up to 0.04, with a poor detector 0.08, and more where a rig is off by several pixels.
"""


class ImageAgreement(NamedTuple):
    """How the detections of an image agree with people.

    Attributes:
        pairs: detection and person, the nearest pair first.
        far: (detections, people, joints) distances of the keypoints from the projected joints [px]; NaN if unknown.
        size: (people,) size of the people in the image, at least `LEAST_PX` / `AGREES` [px].
        contrary: number of people who are in the image by their places, are not detected, and in whose stead there is a
            stranger.
    """

    pairs: list[tuple[int, int]]
    far: Float64
    size: Float64
    contrary: int


def image_agreement(keypoints: Float64, joints: Float64, placed: PlacedCamera) -> ImageAgreement:
    """Compare the detections in an image with people.

    Args:
        keypoints: (detections, joints, 2) the confident keypoints; NaN for others [px].
        joints: (people, joints, 3) the same joints of the people, world; NaN if unknown [m].
        placed: the camera.
    """
    width, height = placed.camera.size_px
    in_camera = apply(placed.T_camera_world, joints)
    in_camera[in_camera[..., 2] < 0.1] = np.nan
    projected = project(in_camera, placed.camera.lens)
    size = np.array([max(LEAST_PX / AGREES, _size(one)) for one in projected])
    far = np.linalg.norm(keypoints[:, None] - projected[None], axis=-1)
    known = np.isfinite(far).sum(axis=-1)
    enough = np.where((known >= LEAST_POINTS)[..., None], far, 0.0)
    middle = np.where(known >= LEAST_POINTS, np.nanmedian(enough, axis=-1) / size, np.inf)
    absent = _inside(projected, width, height)
    strangers = np.isfinite(keypoints).all(axis=-1).sum(axis=-1) >= STRANGER_POINTS
    pairs = []
    while middle.size and middle.min() <= AGREES:
        i, k = divmod(int(middle.argmin()), middle.shape[1])
        middle[i], middle[:, k] = np.inf, np.inf
        absent[k], strangers[i] = False, False
        pairs.append((i, k))
    return ImageAgreement(pairs, far, size, int(min(absent.sum(), strangers.sum())))


def _inside(projected: Float64, width: int, height: int) -> NDArray[np.bool_]:
    """Return which people (people,) are in an image, by their joints (people, points, 2) [px]."""
    known = np.isfinite(projected).all(axis=-1)
    within = known & (projected >= 0).all(axis=-1) & (projected < [width, height]).all(axis=-1)
    count = known.sum(axis=-1)
    return np.asarray((count >= LEAST_POINTS) & (within.sum(axis=-1) >= WITHIN * count))


def _size(projected: Float64) -> float:
    """Return the diagonal of the box around points (points, 2) [px]; 0 if none is known."""
    known = projected[np.isfinite(projected).all(axis=-1)]
    return float(np.linalg.norm(np.ptp(known, axis=0))) if len(known) else 0.0
