"""Memory of the method ``webcams``: arrays with a row for each person, which its compiled step changes in place."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocapella.association.keypoint_rays import BONES, JOINTS

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Bools = NDArray[np.bool_]
UInt8 = NDArray[np.uint8]

MOST_PEOPLE: Final = 32
"""Number of rows, for people and for candidates that are not shown yet."""
NO_PERSON: Final = -1
"""Value of ``ids`` in a row that is not used."""
CANDIDATE: Final = -2
"""Value of ``ids`` in a row of an unconfirmed person."""
FIRST_SPREAD: Final = 3.0
"""Spread of a new camera, see `CameraCounts`; so large that poorly calibrated cameras find people, too."""
LONG_SEEN: Final = 10
"""Number of instants when two cameras agreed, after which a person may be hidden, or have walked."""
ROAMED_M: Final = 0.7
"""Distance that a person has walked before two cameras; two strangers on one line hardly do so together [m]."""
TIME_SD_S: Final = 0.03
"""Standard deviation of the time errors of free-running webcams: about a period of 30 Hz [s]."""
LEAST_TIME_SD_S: Final = 1e-6
"""Standard deviation of times that are called exact [s]."""
MOST_MISSED: Final = 0.4
"""Largest share of missed people of a camera that still tells whether a person is there."""
FIRST_HEIGHT_SD_M: Final = 0.2
"""Standard deviation of a joint's height after one instant [m]."""

LIFTED_M: Final = 0.5
"""Height of the lower ankle above or below where people stand, besides its standard deviation, that people hardly reach
[m]."""


class PeopleArrays(NamedTuple):
    """People, a row each.

    Attributes:
        rows: (people, row) memory of the body, see `mocapella.kinematics.ray_body`.
        ids: (people,) id of the person, `CANDIDATE` or `NO_PERSON`.
        at_s: (people,) time of ``positions`` [s].
        born_s: (people,) time of the first instant [s].
        seen_s: (people,) last time that a camera saw the person [s].
        agreed_s: (people,) last time that two cameras agreed about the person [s].
        agreed_place: (people, 3) mean of the joints at that time, world [m].
        first_place: (people, 3) mean of the joints when two cameras first agreed, world [m].
        roamed: (people,) largest distance from it at which two cameras agreed [m].
        hits: (people,) number of instants when two cameras agreed.
        doubts: (people,) number of successive instants when two cameras saw the person and did not agree.
        turned: (people,) running mean of the share of the person's detections that are used with left and right
            swapped.
        sure: (people,) number of instants when three cameras agreed.
        refuted: (people, cameras) running mean of whether the camera looks at the person, unhidden, and sees
            nobody; NaN before the first image that tells.
        cameras: (people,) number of cameras that saw the person in the last instant.
        positions: (people, 26, 3) world [m]; NaN where not known.
        covariances: (people, 26, 3, 3) [m²].
        velocities: (people, 26, 3) [m/s].
        support: (people, 26) number of cameras that agree about the joint.
        measured_s: (people, 26) last time that two cameras agreed about the joint, together or in turn [s]; NaN before
            the first, and after rays that disagree.
        measured_variances: (people, 26) variance of a coordinate of the joint when two cameras last agreed together
            [m²].
        unpredicted: (people, 26) running mean of the squared speed of the joint's prediction errors, of one
            coordinate [m²/s²]; NaN before the first.
        lengths: (people, bones) running mean of the bones' lengths [m]; NaN where not measured.
        lengths_seen: (people, bones) number of their measurements.
        heights: (people, 26) running mean of the joints' heights, upward, while two cameras agree [m]; NaN at first.
        height_variances: (people, 26) their running variance [m²].
    """

    rows: Float64
    ids: Int64
    at_s: Float64
    born_s: Float64
    seen_s: Float64
    agreed_s: Float64
    agreed_place: Float64
    first_place: Float64
    roamed: Float64
    hits: Int64
    doubts: Int64
    turned: Float64
    sure: Int64
    refuted: Float64
    cameras: Int64
    positions: Float64
    covariances: Float64
    velocities: Float64
    support: UInt8
    measured_s: Float64
    measured_variances: Float64
    unpredicted: Float64
    lengths: Float64
    lengths_seen: Float64
    heights: Float64
    height_variances: Float64


class CameraCounts(NamedTuple):
    """What the cameras saw; all arrays (cameras,).

    Attributes:
        detections: running mean of the number of people seen in an image.
        height_px: running mean of their size [px]; NaN before the first.
        agreed: running mean of the share of a person's detections that agree with the other cameras; NaN at first.
        judged: number of instants that ``agreed`` is the mean of.
        spread: running mean of the squared residuals of its rays over their stated variances; at least 1.
        compared: number of people and instants that ``spread`` is the mean of.
        aside: (cameras, 3) sums of its direction errors to the right and down [rad], and the number of their values.
        late: (cameras, 8) weighted sums that give its time error: the weights, the motions in the image to the right
            and down [rad/s], the squared motions [rad²/s²], the residuals to the right and down [rad], and the products
            of residual and motion [rad²/s], with weights in 1/rad²; and the precision of a time error of 0 [1/s²].
        missed: running mean of whether it sees no person where other cameras see one, and no other detection hides it.
        met: number of people whom it saw at their places, or should have seen there; of some of the images.
        contrary: number of these in whose stead it saw a stranger.
    """

    detections: Float64
    height_px: Float64
    agreed: Float64
    judged: Float64
    spread: Float64
    compared: Float64
    aside: Float64
    late: Float64
    missed: Float64
    met: Float64
    contrary: Float64


def no_people(row: int, cameras: int) -> PeopleArrays:
    """Return the memory without people.

    Args:
        row: number of values of a body's memory.
        cameras: number of cameras.
    """
    n, bones = MOST_PEOPLE, len(BONES)

    def unknown(*shape: int) -> Float64:
        return np.full((n, *shape), np.nan)

    return PeopleArrays(
        rows=unknown(row),
        ids=np.full(n, NO_PERSON, dtype=np.int64),
        at_s=unknown(),
        born_s=unknown(),
        seen_s=unknown(),
        agreed_s=unknown(),
        agreed_place=unknown(3),
        first_place=unknown(3),
        roamed=np.zeros(n),
        hits=np.zeros(n, dtype=np.int64),
        doubts=np.zeros(n, dtype=np.int64),
        turned=np.zeros(n),
        sure=np.zeros(n, dtype=np.int64),
        refuted=unknown(cameras),
        cameras=np.zeros(n, dtype=np.int64),
        positions=unknown(JOINTS, 3),
        covariances=unknown(JOINTS, 3, 3),
        velocities=np.zeros((n, JOINTS, 3)),
        support=np.zeros((n, JOINTS), dtype=np.uint8),
        measured_s=unknown(JOINTS),
        measured_variances=unknown(JOINTS),
        unpredicted=unknown(JOINTS),
        lengths=unknown(bones),
        lengths_seen=np.zeros((n, bones)),
        heights=unknown(JOINTS),
        height_variances=np.zeros((n, JOINTS)),
    )


def no_counts(cameras: int, time_sd_s: float | Float64 = TIME_SD_S) -> CameraCounts:
    """Return the counts before the first image.

    Args:
        cameras: number of cameras.
        time_sd_s: standard deviation of the time errors, of all cameras or (cameras,) [s].
    """
    n, unknown = cameras, np.nan
    late = np.zeros((n, 8))
    late[:, 7] = np.maximum(time_sd_s, LEAST_TIME_SD_S) ** -2.0
    return CameraCounts(
        np.zeros(n), np.full(n, unknown), np.full(n, unknown), np.zeros(n), np.full(n, FIRST_SPREAD), np.zeros(n),
        np.zeros((n, 3)), late, np.zeros(n), np.zeros(n), np.zeros(n),
    )  # fmt: skip
