"""Triangulate points from several calibrated cameras, with covariances and rejection of outlier views.

The estimate minimises the squared reprojection errors, through the distorted lenses, over their standard deviations
(Hartley, Zisserman: Multiple View Geometry, 2nd ed. 2004, sections 12.2 and 12.4 for start and cost; A6.1 for
Gauss–Newton). If a camera disagrees with it, every pair of cameras is tried, and the point with the least truncated
error is kept. The number of cameras is small, so no random sampling is needed, and equal pixels give equal points to
the bit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.lens import farthest_r2
from mocapella.settings import check

Float64 = NDArray[np.float64]
VIEW_NUMBERS = 25


class PointState(IntEnum):
    """Outcome of triangulating a point; its position is NaN in all states but `SEEN`."""

    SEEN = 0
    """Two cameras or more agree."""
    ONE_VIEW = 1
    """Fewer than two cameras see the point within their lens models."""
    PARALLEL = 2
    """The rays are so nearly parallel that the depth would be a guess."""
    BEHIND = 3
    """The rays meet behind a camera."""
    INCONSISTENT = 4
    """No two cameras agree within the gate."""


@dataclass(frozen=True)
class TriangulationSettings:
    """Thresholds for outlier views and for parallel rays.

    Attributes:
        gate_sd: a view is rejected if its reprojection error is above this number of its standard deviations; at 4, one
            in 3,000 correct views with Gaussian errors is rejected. Infinity uses every camera.
        least_angle_rad: a point is rejected unless at least two of its rays meet at this angle or a larger one [rad].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    gate_sd: float = 4.0
    least_angle_rad: float = math.radians(0.5)

    def __post_init__(self) -> None:
        check(self.gate_sd > 0, "gate_sd", self.gate_sd, "above 0")
        check(0 <= self.least_angle_rad < math.pi / 2, "least_angle_rad", self.least_angle_rad, "0 to below π/2")


EVERY_CAMERA: Final = TriangulationSettings(gate_sd=math.inf, least_angle_rad=0.0)
"""Settings that reject no camera and no angle."""


class Views(msgspec.Struct, frozen=True, eq=False):
    """The cameras of a rig in the kernels' format; made once by `views`.

    Attributes:
        numbers: (views, 25): lens (9), `lens.farthest_r2`, R_camera_world by rows (9), translation of T_camera_world
            (3) [m], camera centre in the world (3) [m].
    """

    numbers: Float64

    def __len__(self) -> int:
        return len(self.numbers)


class Triangulated(msgspec.Struct, frozen=True, eq=False):
    """Triangulated points, with covariance, residuals and the views used.

    Attributes:
        points: (..., 3) in the world [m]; NaN where the state is not `PointState.SEEN`.
        covariances: (..., 3, 3) [m²], propagated from the ``sd_px`` of `triangulate`; NaN where the point is.
        residuals_px: (..., views) reprojection errors, also of rejected cameras [px]; infinite where the point cannot
            be projected into the camera, NaN where the camera does not see it, or the point is NaN.
        used: (..., views) whether the camera is an inlier.
        states: (...,) a `PointState`.
    """

    points: Float64
    covariances: Float64
    residuals_px: Float64
    used: NDArray[np.bool_]
    states: NDArray[np.uint8]


def views(lenses: Any, T_camera_world: Any) -> Views:
    """Convert the cameras of a rig to the format of `triangulate`, once for many points; the arrays are copied.

    Args:
        lenses: (views, 9) intrinsics and distortion: fx fy cx cy [px], k1 k2 p1 p2 k3.
        T_camera_world: (views, 4, 4) extrinsics.
    """
    lenses, T = np.asarray(lenses, dtype=np.float64), np.asarray(T_camera_world, dtype=np.float64)
    numbers = np.empty((len(lenses), VIEW_NUMBERS))
    numbers[:, :9] = lenses
    numbers[:, 9] = [farthest_r2(lens) for lens in lenses]
    numbers[:, 10:19] = T[:, :3, :3].reshape(-1, 9)
    numbers[:, 19:22] = T[:, :3, 3]
    numbers[:, 22:] = -np.einsum("vij,vi->vj", T[:, :3, :3], T[:, :3, 3])
    return Views(numbers)


DEFAULT = TriangulationSettings()


def triangulate(
    pixels: Any, cameras: Views, sd_px: Any = 1.0, settings: TriangulationSettings = DEFAULT
) -> Triangulated:
    """Triangulate points from their pixels in several cameras at one instant, each point on its own.

    Args:
        pixels: (..., views, 2) x, y, with the lens' distortion [px]; NaN where a camera does not see the point.
        cameras: the rig, prepared by `views`.
        sd_px: standard deviation of a pixel's coordinates [px], broadcast to (..., views); a camera whose sd is NaN or
            infinite is not used.
        settings: thresholds for outlier views and for parallel rays.

    Returns:
        New arrays, with the batch axes of ``pixels``. Nothing is raised for a point that cannot be triangulated: its
        position is NaN, and its state is the reason.
    """
    pixels = np.ascontiguousarray(pixels, dtype=np.float64)
    batch, count = pixels.shape[:-2], len(cameras.numbers)
    sd = np.empty((*batch, count))
    sd[...] = sd_px
    points, covariances = np.empty((*batch, 3)), np.empty((*batch, 3, 3))
    residuals, used = np.empty((*batch, count)), np.empty((*batch, count), dtype=np.bool_)
    states = np.empty(batch, dtype=np.uint8)
    result = Triangulated(points, covariances, residuals, used, states)
    if len(batch) != 1:  # new shapes of the same numbers
        pixels, sd, points = pixels.reshape(-1, count, 2), sd.reshape(-1, count), points.reshape(-1, 3)
        covariances, residuals = covariances.reshape(-1, 3, 3), residuals.reshape(-1, count)
        used, states = used.reshape(-1, count), states.reshape(-1)
    _kernels().triangulate(
        cameras.numbers, pixels, sd, settings.gate_sd, math.sin(settings.least_angle_rad) ** 2,
        points, covariances, residuals, used, states,
    )  # fmt: skip
    return result


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.geometry import triangulation_kernels

    return triangulation_kernels
