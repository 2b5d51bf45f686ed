"""What the user of the method ``webcams`` must know: cameras that disagree, see nothing in common, or are too far."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.association.image_agreement import CONTRARY, image_agreement
from mocapella.geometry.rigid import inverse
from mocapella.model.camera import PlacedCamera
from mocapella.model.scene import SensorPlace
from mocapella.tracker.webcams_memory import CameraCounts

Float64 = NDArray[np.float64]

PATIENCE_S: Final = 5.0
"""Time without a person before the reason is reported [s]."""
SEES_PEOPLE: Final = 0.5
"""Least mean number of detections of a camera that sees people."""
SMALLEST_PX: Final = 16.0
"""Size of people, the side of a square of their keypoints' area, below which they are too small [px]."""
LEAST_AGREED: Final = 0.25
"""Share of a camera's keypoints that agree with the others, below which the camera is reported."""
LEAST_JUDGED: Final = 60.0
"""Number of comparisons before a camera is reported."""
LEAST_MET: Final = 20.0
"""Number of people met before a camera is reported that sees strangers in their stead."""
MOST_MET: Final = 400.0
"""Number of people met at which the counts are halved, so that a camera that is put right is forgiven."""
MUCH_MORE: Final = 3.0
"""Ratio of a camera's share of strangers to the median of the others' above which it is reported."""

_TO_SENSOR: Final = np.diag([-1.0, -1.0, 1.0, 1.0])
"""From a sensor's space (x left, y up) to a camera's (x right, y down)."""


def place_of(placed: PlacedCamera) -> SensorPlace:
    """Return the pose of a rig's camera as a sensor's place; standard deviations are NaN if the rig does not tell."""
    variances = np.diag(placed.covariance)
    position_sd, rotation_sd = math.nan, math.nan
    if np.isfinite(variances).all():
        position_sd, rotation_sd = (math.sqrt(max(float(v.mean()), 0.0)) for v in (variances[:3], variances[3:]))
    T = inverse(placed.T_camera_world) @ _TO_SENSOR
    return SensorPlace(placed.camera.name, T, position_sd, rotation_sd, "as calibrated")


def disagreeing(counts: CameraCounts) -> NDArray[np.bool_]:
    """Return which cameras (cameras,) do not agree with the others."""
    return np.asarray((counts.judged >= LEAST_JUDGED) & (counts.agreed < LEAST_AGREED))


def count_strangers(counts: CameraCounts, c: int, keypoints: Float64, joints: Float64, placed: PlacedCamera) -> None:
    """Count whether a camera sees people at their places, or strangers in their stead.

    Args:
        counts: updated.
        c: index of the camera.
        keypoints: (detections, 26, 2) the confident keypoints in its image; NaN for others [px].
        joints: (people, 26, 3) of the people, world [m].
        placed: the camera.
    """
    found = image_agreement(keypoints, joints, placed)
    counts.met[c] += len(found.pairs) + found.contrary
    counts.contrary[c] += found.contrary
    if counts.met[c] > MOST_MET:
        counts.met[c] *= 0.5
        counts.contrary[c] *= 0.5


def elsewhere(counts: CameraCounts) -> NDArray[np.bool_]:
    """Return which cameras (cameras,) see strangers where the others see people, as in another room.

    Of two cameras nothing tells which is wrong. Of more, a camera must do so much more often than the others: where all
    do, the calibration is poor.
    """
    share = np.where(counts.met >= LEAST_MET, counts.contrary / np.maximum(counts.met, 1.0), 0.0)
    if len(share) == 2:
        return np.full(2, bool((share > CONTRARY).any()))
    others = np.array([np.median(np.delete(share, c)) for c in range(len(share))])
    return np.asarray((share > CONTRARY) & (share > MUCH_MORE * others))


def disagree(counts: CameraCounts) -> bool:
    """Return whether any camera does not agree with the others, or sees strangers in the stead of people."""
    return bool((disagreeing(counts) | elsewhere(counts)).any())


def problems(
    places: tuple[SensorPlace, ...], counts: CameraCounts, remedy: str = "calibrate again", *,
    exchanged: Collection[str] = (), text: str = "",
) -> tuple[SensorPlace, ...]:  # fmt: skip
    """Return the places with the problems of the cameras.

    Args:
        places: poses of the cameras, in the order of their names.
        counts: what the cameras saw, in the same order.
        remedy: what to do about a camera that does not agree.
        exchanged: names of cameras whose images are exchanged.
        text: their problem, with the remedy.
    """
    bad = disagreeing(counts) | elsewhere(counts)
    if not bad.any() and not exchanged:
        return places
    wrong = (
        f"its keypoints do not agree with the other cameras: it was moved, sees another room, is mirrored or upside "
        f"down, or is wrongly calibrated; switch mirroring off, or {remedy}"
    )
    found = []
    for place, is_bad in zip(places, bad.tolist(), strict=True):
        problem = text if place.sensor in exchanged else wrong if is_bad and not exchanged else ""
        found.append(msgspec.structs.replace(place, problem=problem) if problem else place)
    return tuple(found)


def trouble(counts: CameraCounts, names: list[str], nobody_s: float) -> str:
    """Return why no person is tracked, with a remedy; empty if one is, or without a reason for concern.

    Args:
        counts: what the cameras saw.
        names: the cameras' names, in the order of ``counts``.
        nobody_s: time since the last person was tracked, or since the first frame [s].
    """
    if not nobody_s > PATIENCE_S:
        return ""
    sees = np.flatnonzero(counts.detections >= SEES_PEOPLE).tolist()
    if not sees:
        return ""
    if len(sees) == 1:
        return f"only {names[sees[0]]} sees people: a second camera must see them, too; turn the cameras to one place"
    heights = counts.height_px[sees]
    if float(np.median(heights)) < SMALLEST_PX:
        return f"people are too small in the images ({np.median(heights):.0f} pixels): move the cameras nearer"
    seeing = ", ".join(names[i] for i in sees)
    return (
        f"{seeing} see people, but no two cameras agree about one: do they see the same place at the same time, and "
        "is no image mirrored? If so, the rig does not fit; calibrate again"
    )
