"""The model of an arm and the parameters of its fit, as the kernels take them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]


class ArmArrays(NamedTuple):
    """The model of an arm, as the kernels take it.

    Attributes:
        digits: (5, DIGIT) of the hand's shape.
        mirror: -1 for a left hand, else 1.
        radii: (6, 5) of the digits at their joints, and of forearm and upper arm [m].
        palm: (k, 8) two points and radii of each capsule of a right hand's palm [m].
        owners: (pieces, 2) digit or other owner of a piece, and bone.
        columns, gains: (5, 5) free angle and factor of each digit's angle.
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
        point_scale_m, silhouette_scale_m: scales of the robust losses.
        point_information, silhouette_information, collision_information: inverse variances [1/m²].
        ahead_m: allowed distance of flesh in front of the surface.
        overlap_m: allowed overlap of digits.
        pieces: number of pieces to which points may be assigned.
        edge_m: distance of the surface's end from an edge's outer pixel.
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
