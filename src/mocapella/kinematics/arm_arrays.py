"""The model of an arm and the parameters of its fit, as the kernels take them.

The surface of an arm, here called *flesh*, is a set of tapered capsules about the bones; a *piece* is one capsule
(`arm_flesh_kernels`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]


class ArmArrays(NamedTuple):
    """Arrays of an arm's kinematic model and its surface of capsules, in the palm's frame, for the kernels.

    Attributes:
        digits: (5, DIGIT) parameters of the hand's digits, see `hand_kernels`.
        mirror: -1 for a left hand, else 1.
        radii: (6, 5) [m]. Rows 0 to 4: a digit's radii at its joints, from the base outwards (4). Row 5: the forearm's
            radius at the wrist, half the distance of its two bones there, the radii at the elbow and of the upper arm,
            and the distance of a fingertip's landmark beyond the centre of its round end.
        palm: (k, 8) two points and radii of each capsule of a right hand's palm [m].
        owners: (pieces, 2) digit of each piece, or a negative code such as `arm_flesh_kernels.OF_PALM`, and index of
            the bone in the digit, from the base outwards; else 0.
        columns, gains: (5, 5) index of the free angle that each of a digit's angles follows, −1 for none, and factor.
        rising: (5, 5) indices that sort each digit's `columns`.
        c_max: largest opposition of the thumb [rad].
    """

    digits: Float64
    mirror: float
    radii: Float64
    palm: Float64
    owners: NDArray[np.int64]
    columns: NDArray[np.int64]
    gains: Float64
    rising: NDArray[np.int64]
    c_max: float


class FitParameters(NamedTuple):
    """Scales and weights of the fit's terms.

    Attributes:
        point_scale_m, silhouette_scale_m: scales of the robust losses [m].
        point_information, silhouette_information, collision_information: inverse variances of a residual [1/m²].
        ahead_m: allowed distance of capsules in front of the measured surface [m].
        overlap_m: allowed overlap of digits [m].
        pieces: number of pieces (capsules) that the fit uses, from index 0 on.
        edge_m: distance of the silhouette's edge from the nearest pixel on its other side [m].
        sharpness: factor of the silhouette's information in the last third of a fit.
    """

    point_scale_m: float
    silhouette_scale_m: float
    point_information: float
    silhouette_information: float
    collision_information: float
    ahead_m: float
    overlap_m: float
    pieces: int
    edge_m: float
    sharpness: float
