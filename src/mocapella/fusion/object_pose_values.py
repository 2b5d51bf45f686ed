"""Values of the estimation of rigid objects' poses: results, hypotheses, frames, and arguments of the kernel."""

from __future__ import annotations

from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.fusion.marker_rays import RayState

Float64 = NDArray[np.float64]


class ObjectPose(msgspec.Struct, frozen=True, eq=False):
    """Estimated pose and motion of an object at one time.

    Attributes:
        at_s: the time, on the rig's clock [s].
        T_world_object: (4, 4); None where lost.
        twist: (6,) velocity of the object's origin [m/s] and angular velocity [rad/s], world; NaN where lost.
        covariance: (6, 6) of the position in the world [m] and a small rotation about the world's axes [rad]; NaN where
            lost.
        state: TRACKED if recently seen with four markers in one camera, or by two cameras, and its standard deviations
            are small; INFERRED if only predicted, uncertain or ambiguous; LOST.
        ambiguous: whether another pose fits the pixels nearly as well.
        unseen_s: time since the last used frame [s]; infinite where lost.
    """

    at_s: float
    T_world_object: Float64 | None
    twist: Float64
    covariance: Float64
    state: RayState
    ambiguous: bool
    unseen_s: float


class ObjectReport(msgspec.Struct, frozen=True):
    """Counts of the frames so far.

    Attributes:
        received: number of frames with a marker of the object.
        used, refused, late: number used by the filter, rejected by the gate, and older than the stored ones.
        outliers: number of visible markers left out of used frames.
        found, lost: how often the object was initialised, and lost.
    """

    received: int = 0
    used: int = 0
    refused: int = 0
    late: int = 0
    outliers: int = 0
    found: int = 0
    lost: int = 0


class Hypothesis(msgspec.Struct, frozen=True, eq=False):
    """One hypothesis of an object's pose and twist at one time.

    Attributes:
        at_s: the time, on the rig's clock [s].
        T: (4, 4) from the object's frame to the world.
        twist: (6,) velocity of the object's origin [m/s] and angular velocity [rad/s], world.
        covariance: (12, 12) of position [m], small rotation about the world's axes [rad], velocity [m/s] and angular
            velocity [rad/s].
        cost: sum over its frames of the least cost [χ²], less the sum of the best hypothesis.
    """

    at_s: float
    T: Float64
    twist: Float64
    covariance: Float64
    cost: float = 0.0


class MarkerPixels(NamedTuple):
    """A camera's pixels of an object's markers, for the kernel.

    Attributes:
        camera: index of the camera.
        places: (points, 3) markers in the object's frame [m].
        pixels, sd_px: (points, 2), (points,) pixels, and standard deviation of a coordinate [px].
        later_s: (points,) capture time of each pixel's row, minus the time of the prediction [s].
        chosen: (points,) which markers to use.
    """

    camera: int
    places: Float64
    pixels: Float64
    sd_px: Float64
    later_s: Float64
    chosen: NDArray[np.bool_]


class PosePrediction(NamedTuple):
    """A predicted pose and twist, for the kernel.

    Attributes:
        R: (3, 3) rotation from the object's frame to the world.
        x: (9,) position and velocity of the object's origin [m], [m/s], and angular velocity [rad/s], world.
        information: (12, 12) inverse covariance of position, rotation from the left, velocity, angular velocity.
    """

    R: Float64
    x: Float64
    information: Float64


class PoseResult(NamedTuple):
    """The posterior that the kernel writes, laid out as `PosePrediction`: R (3, 3), x (9,), and covariance (12, 12)."""

    R: Float64
    x: Float64
    covariance: Float64


class SeenFrame(msgspec.Struct, frozen=True, eq=False):
    """One camera's image points of an object, kept for late frames.

    Attributes:
        at_s: capture time of image row 0, on the rig's clock [s].
        camera: its name in the rig.
        pixels: (points, 2) [px]; NaN where a marker is not seen.
        sd_px: (points,) standard deviation of a pixel's coordinate [px].
        before: the hypotheses before this frame.
    """

    at_s: float
    camera: str
    pixels: Float64
    sd_px: Float64
    before: tuple[Hypothesis, ...] = ()
