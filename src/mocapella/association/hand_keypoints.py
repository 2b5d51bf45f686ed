"""Hands in images: which keypoints are a hand's, which known hand they belong to, and which detections are one hand.

A detection of a hand is compared with predicted landmarks by the truncated mean of its squared distances in the image.
Detections of two cameras are one hand if most of their rays meet, and the palm has a human size.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from types import ModuleType
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.triangulation import Views, triangulate
from mocapella.model.topology import topology
from mocapella.settings import check

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

LANDMARKS: Final = 21
MOST_COST: Final = 9.0
"""Limit of one landmark's squared distance, and of the mean above which detections cannot match [squared sd]."""
PALM_M: Final = (0.045, 0.14)
"""Least and greatest distance of the wrist from the middle finger's first joint [m]."""
FEWEST: Final = 6
"""Number of confident landmarks below which a detection is no hand."""
_WRIST, _MIDDLE = 0, 9


@dataclass(frozen=True)
class HandKeypointSettings:
    """Thresholds for hands from keypoints.

    Attributes:
        hand_sd: standard deviation of a sure landmark, relative to the longer side of the hand in the image; larger:
            noisier hands are still matched, and landmarks are less certain [ratio].
        least_sd_px: least standard deviation of a landmark; larger: small hands count less [px].
        least_confidence: landmarks below this confidence are not used; larger: fewer wrong and fewer true ones
            [0 to 1].
        most_cost: limit of the mean squared distance of a detection from a known hand; larger: more detections are
            matched, also wrong ones [squared standard deviations, at most 9].
        pair_cost: limit of the mean squared distance of two cameras' rays for a new hand; larger: new hands are found
            in noisier detections, and phantoms sooner [squared standard deviations, at most 9].
        least_landmarks: least number of landmarks about which two cameras agree for a new hand; larger: partly visible
            hands are found later [count].
        wrist_m: greatest distance of a hand's wrist from that of its person; larger: hands join less certain bodies,
            and may join a wrong one [m].
        confirm_instants: number of instants when two cameras must agree before a hand without a body is shown;
            larger: fewer phantoms, and hands are shown later [count].
        marker_tips: names of the colour markers on the fingertips, from thumb to little finger, if cameras send
            markers [names].
        marker_left: whether the markers are on a left hand.
        marker_sd_m: standard deviation of a marker's centre about the tip of its finger; larger: markers count less
            beside keypoints [m].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    hand_sd: float = 0.03
    least_sd_px: float = 1.0
    least_confidence: float = 0.3
    most_cost: float = 5.0
    pair_cost: float = 3.5
    least_landmarks: int = 10
    wrist_m: float = 0.15
    confirm_instants: int = 3
    marker_tips: tuple[str, ...] = ("red", "yellow", "green", "blue", "magenta")
    marker_left: bool = False
    marker_sd_m: float = 0.003

    def __post_init__(self) -> None:
        check(0.001 <= self.hand_sd <= 1, "hand_sd", self.hand_sd, "from 0.001 to 1")
        check(0.1 <= self.least_sd_px <= 100, "least_sd_px", self.least_sd_px, "from 0.1 to 100 px")
        check(0 <= self.least_confidence < 1, "least_confidence", self.least_confidence, "from 0 to below 1")
        check(0 < self.most_cost <= MOST_COST, "most_cost", self.most_cost, f"above 0 and at most {MOST_COST:g}")
        check(0 < self.pair_cost <= MOST_COST, "pair_cost", self.pair_cost, f"above 0 and at most {MOST_COST:g}")
        check(1 <= self.least_landmarks <= LANDMARKS, "least_landmarks", self.least_landmarks, f"from 1 to {LANDMARKS}")
        check(0 < self.wrist_m <= 1, "wrist_m", self.wrist_m, "above 0 and at most 1 m")
        check(1 <= self.confirm_instants <= 1000, "confirm_instants", self.confirm_instants, "from 1 to 1000")
        tips = self.marker_tips
        check(len(tips) in {0, 5} and len(set(tips)) == len(tips), "marker_tips", tips, "five different names, or none")
        check(0 < self.marker_sd_m <= 0.05, "marker_sd_m", self.marker_sd_m, "above 0 and at most 0.05 m")


class SeenHand(NamedTuple):
    """A hand in one camera's image.

    Attributes:
        camera: index of the camera.
        after_s: capture time after the instant; usually negative [s].
        pixels: (21, 2) with the lens' distortion, in the order of `mocapella.model.hand.LANDMARKS` [px]; NaN where not
            seen.
        sds_px: (21,) standard deviations of a coordinate [px]; NaN where not seen.
        person: row of the person whose body the same detection shows; −1 if it shows none, or no known person.
        left: whether the detector calls it a left hand; None if it does not say.
    """

    camera: int
    after_s: float
    pixels: Float64
    sds_px: Float64
    person: int = -1
    left: bool | None = None


@cache
def hand_sources(name: str) -> tuple[tuple[bool | None, Int64], ...]:
    """Return the hands among a topology's keypoints: whether each is a left one, None if unknown, and indices (21,).

    Args:
        name: name of the topology; ``hand`` is one hand, topologies of the whole body have ``left_hand_root`` and the
            20 points of the fingers after it.
    """
    own = topology(name)
    if name == "hand":
        return ((None, np.arange(LANDMARKS)),)
    found = []
    for left, root in ((True, "left_hand_root"), (False, "right_hand_root")):
        if root in own.joints:
            first = own.index(root)
            found.append((left, np.arange(first, first + LANDMARKS)))
    return tuple(found)


def seen_hand(
    camera: int, after_s: float, pixels: NDArray[np.floating], confidences: NDArray[np.floating],
    settings: HandKeypointSettings, *, person: int = -1, left: bool | None = None,
) -> SeenHand | None:  # fmt: skip
    """Return the hand of a detection; None if fewer than `FEWEST` landmarks are confident.

    Args:
        camera, after_s, person, left: see `SeenHand`.
        pixels, confidences: (21, 2) [px] and (21,) of the landmarks.
        settings: thresholds.
    """
    s = settings
    px, sds = np.empty((LANDMARKS, 2)), np.empty(LANDMARKS)
    count = kernels().sure_landmarks(
        np.ascontiguousarray(pixels, dtype=np.float64), np.ascontiguousarray(confidences, dtype=np.float64),
        float(s.hand_sd), float(s.least_sd_px), max(s.least_confidence, 1e-3), px, sds,
    )  # fmt: skip
    return SeenHand(camera, after_s, px, sds, person, left) if count >= FEWEST else None


def mismatch(seen: SeenHand, landmarks: Float64, velocities: Float64, sd_m: float, cameras: Views) -> float:
    """Return the mean squared distance of a detection from predicted landmarks [squared standard deviations].

    Args:
        seen: the detection.
        landmarks, velocities: (21, 3) predicted for the instant, world [m, m/s].
        sd_m: standard deviation of the prediction [m].
        cameras: all cameras.

    Returns:
        The mean over its landmarks, each at most `MOST_COST`; `MOST_COST` if the camera cannot see the hand.
    """
    return float(kernels().mean_mismatch(
        cameras.numbers, seen.camera, landmarks, velocities, seen.after_s, sd_m, seen.pixels, seen.sds_px, MOST_COST
    ))  # fmt: skip


def chosen_pairs(costs: Mapping[tuple[int, int], float], most: float) -> list[tuple[int, int]]:
    """Return one-to-one pairs in the order of their costs; equal costs in the order of the pairs.

    Args:
        costs: cost of each possible pair.
        most: greatest cost of a pair.
    """
    found: list[tuple[int, int]] = []
    for _, (a, b) in sorted((cost, pair) for pair, cost in costs.items() if cost <= most):
        if all(a != one and b != other for one, other in found):
            found.append((a, b))
    return found


def new_hands(seen: Sequence[SeenHand], cameras: Views, pair_cost: float, least_landmarks: int) -> list[list[int]]:
    """Group detections of different cameras into new hands; a hand is seen by two cameras or more.

    Args:
        seen: the detections that belong to no known hand.
        cameras: all cameras.
        pair_cost: greatest mean squared distance of two cameras' rays [squared standard deviations].
        least_landmarks: least number of landmarks whose rays meet.

    Returns:
        Indices in ``seen`` of each new hand; the pair that agrees best first.
    """
    costs = {}
    for a, one in enumerate(seen):
        for b in range(a + 1, len(seen)):
            other = seen[b]
            sides = {one.left, other.left} - {None}
            if one.camera != other.camera and len(sides) < 2:
                costs[a, b] = _disagreement([one, other], cameras, least_landmarks)
    groups: list[list[int]] = []
    for a, b in chosen_pairs(costs, pair_cost):
        taken = {i for group in groups for i in group}
        if a in taken or b in taken:
            continue
        group = [a, b]
        for i, more in enumerate(seen):
            if i in taken or any(seen[k].camera == more.camera for k in group):
                continue
            if _disagreement([*(seen[k] for k in group), more], cameras, least_landmarks) <= pair_cost:
                group.append(i)
        groups.append(group)
    return groups


def arranged(seen: Sequence[SeenHand], cameras: int) -> tuple[Float64, Float64]:
    """Return the pixels (21, cameras, 2) and standard deviations (21, cameras) of one hand's detections; NaN elsewhere.

    Args:
        seen: detections; a later one of the same camera replaces the landmarks that both have.
        cameras: number of cameras.
    """
    pixels, sds = np.full((LANDMARKS, cameras, 2), np.nan), np.full((LANDMARKS, cameras), np.nan)
    for one in seen:
        known = np.isfinite(one.sds_px)
        pixels[known, one.camera], sds[known, one.camera] = one.pixels[known], one.sds_px[known]
    return pixels, sds


def _disagreement(seen: Sequence[SeenHand], cameras: Views, least_landmarks: int) -> float:
    pixels, sds = arranged(seen, len(cameras))
    found = triangulate(pixels, cameras, sds)
    agree = found.used.sum(axis=1) == len(seen)
    if agree.sum() < least_landmarks:
        return np.inf
    palm = float(np.linalg.norm(found.points[_MIDDLE] - found.points[_WRIST]))
    if not PALM_M[0] <= palm <= PALM_M[1]:
        return np.inf
    with np.errstate(invalid="ignore"):
        squared = np.minimum((found.residuals_px / sds) ** 2, MOST_COST)
    known = np.isfinite(squared)
    # Two cameras measure four numbers of a point with three unknowns; the residuals are of one degree of freedom.
    return float(np.where(agree[:, None] & known, squared, np.where(known, MOST_COST, 0.0)).sum() / known.sum())


@cache
def kernels() -> ModuleType:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.association import hand_keypoint_kernels

    return hand_keypoint_kernels
