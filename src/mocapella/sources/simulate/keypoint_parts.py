"""Faults of detectors that put keypoints together to people: parts of people, and things taken for people.

Detectors that find keypoints first, such as OpenPose, join them to people afterwards. So a person can be found in two
parts, get a limb of somebody near, or have hidden keypoints at the edge of what hides them. Things that look like a
person, such as a coat on a chair, are found again and again at one place. The rates are assumed (`keypoint_faults`).
"""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.sources.simulate.keypoint_body import HALPE
from mocapella.sources.simulate.keypoint_faults import KeypointFaults

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Bools = NDArray[np.bool_]

LIMBS: Final = tuple(
    np.array([HALPE.index(f"{side}{name}") for name in names])
    for side in "LR"
    for names in (("Elbow", "Wrist"), ("Knee", "Ankle", "BigToe", "SmallToe", "Heel"))
)
"""Keypoints of each arm and leg below the shoulder and the hip."""
BELOW: Final = np.array([name[1:] in ("Knee", "Ankle", "BigToe", "SmallToe", "Heel") for name in HALPE.joints])
"""Whether each keypoint (26,) is in the lower part of a person who is detected in two parts."""
HIPS: Final = np.array(["Hip" in name for name in HALPE.joints])
"""Whether each keypoint (26,) is in both parts."""
REACH: Final = 0.4
"""Mean distance of two people's keypoints in an image below which one may get a limb of the other, relative to size."""
SNAPPED: Final = (0.05, 0.5)
"""Least and largest share of the way from the visible keypoint to the hidden one at which that is reported."""
FURNITURE_SHARE: Final = 0.3
"""Share of the images in which a place of furniture is taken for a person."""
FURNITURE_CONFIDENCE: Final = (0.1, 0.5)
_PARENT: Final = np.array([
    HALPE.index({
        "Elbow": f"{name[0]}Shoulder", "Wrist": f"{name[0]}Elbow", "Knee": f"{name[0]}Hip", "Ankle": f"{name[0]}Knee",
        "BigToe": f"{name[0]}Ankle", "SmallToe": f"{name[0]}Ankle", "Heel": f"{name[0]}Ankle",
    }.get(name[1:], name)) for name in HALPE.joints
])  # fmt: skip
"""(26,) next keypoint of the limb towards the trunk; the keypoint itself without one."""


class PartDraws(msgspec.Struct, frozen=True, eq=False):
    """Random numbers, uniform from 0 to 1.

    Attributes:
        snapped: (frames, bodies, 26) whether a hidden keypoint is snapped.
        where: (frames, bodies, 26) where on the limb.
        person: (frames, bodies, 3) whether a person gets a limb, which one, and whether the person is split.
        places: (places, 3) where furniture looks like a person: x, y and height, relative to the image's height.
        shape: (places, 26, 2) deviations of its keypoints from a standing person's, relative to its height.
        there: (frames, places) whether it is taken for a person, and its confidence.
    """

    snapped: Float64
    where: Float64
    person: Float64
    places: Float64
    shape: Float64
    there: Float64


def snap(draws: PartDraws, k: int, faults: KeypointFaults, states: Int64, pixels: Float64) -> None:
    """Move hidden keypoints towards the next visible keypoint of their limb.

    Args:
        draws, k, faults: random numbers, the frame, and the rates.
        states: (bodies, 26) as of `keypoint_errors.STATES`.
        pixels: (bodies, 26, 2), changed [px].
    """
    rows, parent = np.arange(len(states))[:, None], np.broadcast_to(_PARENT, states.shape)
    for _ in range(2):  # from a foot to the hip
        parent = np.where(states[rows, parent] == 2, _PARENT[parent], parent)
    may = (states == 2) & (draws.snapped[k] < faults.snapped) & (states[rows, parent] == 0)
    share = SNAPPED[0] + (SNAPPED[1] - SNAPPED[0]) * draws.where[k]
    moved = pixels[rows, parent] + share[..., None] * (pixels - pixels[rows, parent])
    pixels[may] = moved[may]


def take_limbs(
    draws: PartDraws, k: int, faults: KeypointFaults, pixels: Float64, confidences: Float64, *, true: Float64,
    sizes: Float64, there: Bools,
) -> None:  # fmt: skip
    """Give people a limb of the nearest person, who then lacks it.

    Args:
        draws, k, faults: random numbers, the frame, and the rates.
        pixels, confidences: (bodies, 26, 2) and (bodies, 26), changed.
        true: (bodies, 26, 2) keypoints without errors [px].
        sizes: (bodies,) statures in the image [px].
        there: (bodies,) whether the person is detected.
    """
    for i in np.flatnonzero(there & (draws.person[k, :, 0] < faults.taken_limbs)):
        apart = np.linalg.norm(np.nan_to_num(true - true[i], nan=1e6), axis=-1).mean(axis=1)
        apart[i] = np.inf
        apart[~there] = np.inf
        j = int(np.argmin(apart))
        if not apart[j] < REACH * sizes[i]:
            continue
        limb = LIMBS[min(int(draws.person[k, i, 1] * len(LIMBS)), len(LIMBS) - 1)]
        pixels[i, limb], confidences[i, limb] = pixels[j, limb], confidences[j, limb]
        pixels[j, limb], confidences[j, limb] = np.nan, 0.0


def split(draws: PartDraws, k: int, faults: KeypointFaults, found: Int64) -> Int64:
    """Return which of the detected bodies (n,) are detected in two parts."""
    chosen: Int64 = found[draws.person[k, found, 2] < faults.split]
    return chosen


def lower_part(pixels: Float64, confidences: Float64) -> tuple[Float64, Float64]:
    """Take the legs out of a detection (26, 2), (26,), and return them as another one; both have the hips."""
    below = BELOW | HIPS
    legs = np.where(below[:, None], pixels, np.nan), np.where(below, confidences, 0.0)
    pixels[BELOW], confidences[BELOW] = np.nan, 0.0
    return legs


def furniture(draws: PartDraws, k: int, size_px: tuple[int, int], upright: Float64) -> list[tuple[Float64, Float64]]:
    """Return the detections of what is no person in a frame: pixels (26, 2) and confidences (26,).

    Args:
        draws, k: random numbers, and the frame.
        size_px: of the image.
        upright: (26, 2) keypoints of a standing person, relative to the stature.
    """
    made = []
    width, height = size_px
    low, high = FURNITURE_CONFIDENCE
    for place, shape, seen in zip(draws.places, draws.shape, draws.there[k], strict=True):
        if seen >= FURNITURE_SHARE:
            continue
        size = (0.2 + 0.4 * place[2]) * height
        pixels = place[:2] * (width, height) + size * (upright + shape)
        outside = (pixels < 0).any(axis=1) | (pixels >= (width, height)).any(axis=1) | (np.abs(shape[:, 0]) > 0.08)
        pixels[outside] = np.nan
        made.append((pixels, np.where(outside, 0.0, low + (high - low) * seen / FURNITURE_SHARE)))
    return made
