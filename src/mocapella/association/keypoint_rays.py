"""Values of the association of keypoints: rays of all cameras, gates, and the proportions of people.

All joints are in the order of the topology ``halpe_26``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.model.topology import Topology, topology
from mocapella.settings import check

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Bools = NDArray[np.bool_]

JOINTS: Final = 26
"""Number of joints of ``halpe_26``."""
SPREADS: Final[Float64] = np.array(
    [0.7, 0.7, 0.7, 0.7, 0.7, 0.9, 0.9, 1.1, 1.1, 1.3, 1.3, 1.2, 1.2, 1.2, 1.2, 1.2, 1.2, 0.9, 0.9, 1.2, 1.2, 1.2, 1.2,
     1.2, 1.2, 1.2]
)  # fmt: skip
"""(26,) scatter of each joint in images, relative to the average: rounded from the deviations of MediaPipe's keypoints
from their triangulation in the clip ``mediapipe_holistic_4cam``; feet as ankles, which it hardly shows [ratio]."""


class CameraArrays(NamedTuple):
    """Cameras in the order of their names: lens and pose.

    Attributes:
        lenses: (cameras, 9) fx fy cx cy [px], k1 k2 p1 p2 k3.
        farthest_r2: (cameras,) squared radius of the lens model, see `mocapella.geometry.lens.farthest_r2`.
        R_world_camera: (cameras, 3, 3) rotation from the camera to the world.
        origins: (cameras, 3) centres, world [m].
        sizes_px: (cameras, 2) width and height of the image [px].
        up: (3,) unit vector of the upward direction, world.
    """

    lenses: Float64
    farthest_r2: Float64
    R_world_camera: Float64
    origins: Float64
    sizes_px: Float64
    up: Float64


class Rays(NamedTuple):
    """Rays of all detections of one instant, sorted by camera.

    Attributes:
        camera: (detections,) index of the camera.
        after_s: (detections,) capture time after the instant; usually negative [s].
        directions: (detections, 26, 3) unit vectors, world; NaN where not seen.
        sds_rad: (detections, 26) angular standard deviation [rad].
        confidences: (detections, 26) the detector's confidences, 0 to 1; 0 where not seen.
    """

    camera: Int64
    after_s: Float64
    directions: Float64
    sds_rad: Float64
    confidences: Float64


class PredictedPeople(NamedTuple):
    """People predicted to the instant.

    Attributes:
        known: (people,) whether a row has a predicted person.
        positions: (people, 26, 3) world [m]; NaN where not known.
        covariances: (people, 26, 3, 3) [m²].
        velocities: (people, 26, 3) [m/s].
    """

    known: Bools
    positions: Float64
    covariances: Float64
    velocities: Float64


class Matches(NamedTuple):
    """Assignment of detections to people, written by `keypoint_kernels.assign_all`.

    Attributes:
        person: (detections,) row of the person; −1 for none.
        swapped: (detections,) whether left and right are swapped.
        explained: (detections,) row of a person who explains an unassigned detection, a part or a duplicate; −1 none.
        cost: (detections,) mean squared deviation from the person, in standard deviations; NaN for none.
    """

    person: Int64
    swapped: Bools
    explained: Int64
    cost: Float64


class KeypointGates(NamedTuple):
    """Thresholds of the association, see `KeypointAssociationSettings`."""

    most_cost: float
    pair_cost: float
    least_joints: int
    least_angle_rad: float
    shortest_m: float
    tallest_m: float


@dataclass(frozen=True)
class KeypointAssociationSettings:
    """Thresholds for the assignment of detections to people, and for new people.

    Attributes:
        joint_sd: standard deviation of a keypoint of average scatter, relative to the person's size in the image;
            larger: noisier keypoints are still assigned, and close people are distinguished later [ratio].
        least_sd_px: least standard deviation of a keypoint; larger: small people count less [px].
        least_confidence: keypoints below this confidence are not used; larger: fewer wrong and fewer true ones
            [0 to 1].
        most_cost: limit of the mean squared deviation of a detection from a predicted person; larger: more detections
            are assigned, also wrong ones [squared standard deviations, at most 9].
        pair_cost: limit of the mean squared distance of two detections' rays for one new person; larger: new people
            are found in noisier detections, and phantoms sooner [squared standard deviations, at most 9].
        least_joints: least number of keypoints that a detection must share with a person; larger: partly visible
            people are found later [count].
        least_angle_deg: least angle between the rays of two cameras that find a new person; larger: better
            distances, but fewer people between close cameras [°].
        shortest_m: height of the smallest person; larger: fewer phantoms, and no small children [m].
        tallest_m: height of the tallest person; smaller: fewer phantoms [m].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    joint_sd: float = 0.02
    least_sd_px: float = 1.0
    least_confidence: float = 0.1
    most_cost: float = 5.0
    pair_cost: float = 3.5
    least_joints: int = 4
    least_angle_deg: float = 3.0
    shortest_m: float = 0.5
    tallest_m: float = 2.3

    def __post_init__(self) -> None:
        check(0.001 <= self.joint_sd <= 1, "joint_sd", self.joint_sd, "from 0.001 to 1")
        check(0.1 <= self.least_sd_px <= 100, "least_sd_px", self.least_sd_px, "from 0.1 to 100 px")
        check(0 <= self.least_confidence < 1, "least_confidence", self.least_confidence, "from 0 to below 1")
        check(0 < self.most_cost <= MOST_COST, "most_cost", self.most_cost, f"above 0 and at most {MOST_COST:g}")
        check(0 < self.pair_cost <= MOST_COST, "pair_cost", self.pair_cost, f"above 0 and at most {MOST_COST:g}")
        check(1 <= self.least_joints <= JOINTS, "least_joints", self.least_joints, f"from 1 to {JOINTS}")
        check(0.1 <= self.least_angle_deg <= 90, "least_angle_deg", self.least_angle_deg, "from 0.1 to 90°")
        fits = 0 < self.shortest_m < self.tallest_m <= 10
        check(fits, "shortest_m, tallest_m", (self.shortest_m, self.tallest_m), "above 0, rising, and at most 10 m")

    @property
    def gates(self) -> KeypointGates:
        """The thresholds for the kernels."""
        return KeypointGates(
            float(self.most_cost), float(self.pair_cost), int(self.least_joints),
            float(np.deg2rad(self.least_angle_deg)), float(self.shortest_m), float(self.tallest_m),
        )  # fmt: skip


MOST_COST: Final = 9.0
"""Limit of one keypoint's squared deviation (truncated quadratic) [squared standard deviations]."""
SWAP_RATIO: Final = 0.4
"""A detection is used with left and right swapped if its cost is then at most this part of its cost before [ratio]."""
SWAP_COST: Final = 1.5
"""Cost above which a detection may be swapped [squared standard deviations]."""


def sources_of(own: Topology) -> Int64 | None:
    """Return for each joint of ``halpe_26`` the index of a topology's joint at its position, −1 where it has none.

    The topology's mapping to ``halpe_26`` must take single joints. None if it has no such mapping.
    """
    target = topology("halpe_26")
    single = own.single_joints(target.name)
    if not single or len(single) < len(own.mappings.get(target.name, {})):
        return None
    sources = np.full(JOINTS, -1, dtype=np.int64)
    sources[list(single)] = list(single.values())
    return sources


@cache
def sources_named(name: str) -> Int64 | None:
    """Return `sources_of` a topology by its name; the same array at each call."""
    return sources_of(topology(name))


@cache
def _shifts_named(name: str) -> tuple[Int64, Int64, Float64]:
    """Return the shifted joints of ``halpe_26`` by a topology's name: joints, keypoints towards, and shares."""
    found = topology(name).shifts.get("halpe_26", {})
    towards = [one for one, _ in found.values()]
    shares = [share for _, share in found.values()]
    return np.array(list(found), np.int64), np.array(towards, np.int64), np.array(shares, np.float64)


def halpe_keypoints(
    name: str, pixels: NDArray[np.floating[Any]], confidences: NDArray[np.floating[Any]]
) -> tuple[NDArray[np.floating[Any]], NDArray[np.floating[Any]]]:
    """Return the joints of ``halpe_26`` in an image: pixels (detections, 26, 2) and confidences (detections, 26).

    A joint that the topology shifts towards another keypoint (`Topology.shifts`) lies on the line between both. Where
    the other keypoint is not seen, the joint is at its own one. The shift is made in the image: the perspective of
    such a short way changes it by less than the errors of detectors.

    Args:
        name: name of a topology that `sources_named` maps.
        pixels: (detections, keypoints, 2) [px], or places in space (detections, keypoints, 3); NaN where not seen.
        confidences: (detections, keypoints) 0 to 1.
    """
    sources: Any = sources_named(name)
    sure = np.where(sources >= 0, confidences.take(sources, axis=1), 0.0)
    places = pixels.take(sources, axis=1)
    joints, towards, shares = _shifts_named(name)
    if len(joints):
        steps = shares[:, None] * (pixels[:, towards] - places[:, joints])
        seen = (confidences[:, towards] > 0) & np.isfinite(steps).all(axis=-1)
        places[:, joints] += np.where(seen[..., None], steps, 0.0).astype(places.dtype)
    return places, sure


def _bones() -> tuple[Int64, Float64]:
    of = topology("halpe_26").index
    # Lengths relative to the body height: R. Drillis, R. Contini, Body Segment Parameters (1966), in D. Winter,
    # Biomechanics and Motor Control of Human Movement; widths are between the keypoints, not the body's outlines.
    table = [
        (f"{side}{one}", f"{side}{other}", share)
        for side in "LR"
        for one, other, share in (
            ("Hip", "Knee", 0.245), ("Knee", "Ankle", 0.246), ("Shoulder", "Elbow", 0.172), ("Elbow", "Wrist", 0.150),
            ("Shoulder", "Hip", 0.290),
        )
    ]  # fmt: skip
    table += [("LShoulder", "RShoulder", 0.215), ("LHip", "RHip", 0.125)]
    return np.array([(of(a), of(b)) for a, b, _ in table], dtype=np.int64), np.array([share for _, _, share in table])


BONES, SHARES = _bones()
"""(bones, 2) joints at the ends of each bone, and (bones,) its length relative to the body height [ratio]."""
MIRROR: Final[Int64] = np.array(topology("halpe_26").mirror, dtype=np.int64)
"""(26,) the joint on the other side of the body."""
