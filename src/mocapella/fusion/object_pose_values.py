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
        twist: (6,) velocity [m/s] and angular velocity [rad/s] in the world; NaN where lost.
        covariance: (6, 6) of the position in the world [m] and a small rotation about the world's axes [rad].
        state: TRACKED: recently four markers in one camera, or two cameras, and certain; INFERRED; LOST.
        ambiguous: whether another pose fits the pixels as well.
        unseen_s: time since the last used frame [s].
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
        outliers: number of markers left out of used frames.
        found, lost: how often the object was initialised and lost.
    """

    received: int = 0
    used: int = 0
    refused: int = 0
    late: int = 0
    outliers: int = 0
    found: int = 0
    lost: int = 0


class Hypothesis(msgspec.Struct, frozen=True, eq=False):
    """One hypothesis of the pose ``T`` (4, 4) and twist (6,) at a time, with their covariance (12, 12) and cost."""

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
        pixels, sd_px: (points, 2), (points,) [px].
        later_s: (points,) time of each pixel's row after the prediction [s].
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
        R: (3, 3) rotation.
        x: (9,) position, velocity, angular velocity.
        information: (12, 12) inverse covariance of position, rotation from the left, velocity, angular velocity.
    """

    R: Float64
    x: Float64
    information: Float64


class PoseResult(NamedTuple):
    """The posterior that the kernel writes: R (3, 3) and x (9,) as in `PosePrediction`, and covariance (12, 12)."""

    R: Float64
    x: Float64
    covariance: Float64


class SeenFrame(msgspec.Struct, frozen=True, eq=False):
    """A camera's pixels of the object: (points, 2), NaN where not seen, and standard deviations; ``at_s`` of row 0."""

    at_s: float
    camera: str
    pixels: Float64
    sd_px: Float64
    before: tuple[Hypothesis, ...] = ()
