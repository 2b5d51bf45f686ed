"""Place people in the room by one camera: rays and a detector's relative 3D, the person's height, and the floor.

One camera measures directions. A detector's estimate of the body in space, of unknown scale and place, becomes a body
in the camera's frame by the translation that puts its joints on their rays; its size comes from the person's height,
and from the floor that the feet stand on, if the camera's height is known. All of it is inferred, not measured.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]

CHAIN: Final = 0.779
"""Ankle to knee to hip to shoulder, relative to the stature (Drillis and Contini, Body Segment Parameters, 1966; in
Winter, Biomechanics and Motor Control of Human Movement, figure 4.1: heights 0.039, 0.285, 0.530 and 0.818)."""
FEWEST: Final = 4
"""Least number of rays that place a body."""
NEAREST_M: Final = 0.2
"""A body nearer to the camera is refused: it is behind it, or the rays do not fit [m]."""


class Placed(NamedTuple):
    """A body's place.

    Attributes:
        translation: (3,) of the relative estimate's origin in the camera's axes, x right, y down, z forward [m].
        covariance: (3, 3) of it, for the given scale [m²].
    """

    translation: Float64
    covariance: Float64


def stature_of(relative: Float64, chains: NDArray[np.int64]) -> float:
    """Return the stature that a body in space implies, whatever its posture; NaN if no chain is known.

    Args:
        relative: (joints, 3) positions relative to any point [m]; NaN where unknown.
        chains: (sides, 4) indices of ankle, knee, hip and shoulder.
    """
    steps = np.linalg.norm(np.diff(relative[chains], axis=1), axis=-1)
    lengths = steps.sum(axis=1)
    known = lengths[np.isfinite(lengths)]
    return float(known.mean() / CHAIN) if len(known) else float("nan")


def place_by_rays(slopes: Float64, relative: Float64, sds: Float64) -> Placed | None:
    """Return the translation that puts a body's joints on their rays, by weighted linear least squares.

    A joint at relative + t has the slope x = (r_x + t_x) / (r_z + t_z), which is linear in t; likewise y.

    Args:
        slopes: (joints, 2) of the rays, x / z and y / z, without the lens' distortion; NaN where not seen.
        relative: (joints, 3) the body in the camera's axes, at its true size [m]; NaN where unknown.
        sds: (joints,) standard deviations of the slopes, above 0.

    Returns:
        None with too few rays (`FEWEST`), or if the body would be behind the camera or nearer than `NEAREST_M`.
    """
    use = np.isfinite(slopes).all(axis=-1) & np.isfinite(relative).all(axis=-1) & np.isfinite(sds) & (sds > 0)
    if np.count_nonzero(use) < FEWEST:
        return None
    x, y, r, weights = slopes[use, 0], slopes[use, 1], relative[use], 1.0 / sds[use]
    zero, one = np.zeros_like(x), np.ones_like(x)
    A = np.concatenate([np.stack([one, zero, -x], axis=1), np.stack([zero, one, -y], axis=1)])
    b = np.concatenate([x * r[:, 2] - r[:, 0], y * r[:, 2] - r[:, 1]])
    W = np.concatenate([weights, weights])
    information = (A * (W**2)[:, None]).T @ A
    if np.linalg.matrix_rank(information) < 3:
        return None
    translation: Float64 = np.linalg.solve(information, (A * (W**2)[:, None]).T @ b)
    if translation[2] + r[:, 2].min() < NEAREST_M:
        return None
    # An error of a slope moves a joint by as much times its depth.
    return Placed(translation, np.linalg.inv(information) * translation[2] ** 2)


def scale_by_floor(
    lowest: Float64, down: Float64, camera_height: float, *, height_sd: float, tilt_sd: float, size_sd: float
) -> tuple[float, float]:
    """Return the factor of a body's size and distance that puts it on the floor, and its standard deviation.

    Size and distance scale together, since one camera sees the same. The factor is 1 by the assumed stature, and camera
    height / depth below the camera by the floor; both are averaged by their variances.

    Args:
        lowest: (3,) the lowest point of the feet in the camera's axes, for the assumed stature [m].
        down: (3,) unit vector downwards in the camera's axes.
        camera_height: height of the camera above the floor [m]; NaN if unknown.
        height_sd: standard deviation of it [m].
        tilt_sd: standard deviation of ``down`` [rad].
        size_sd: standard deviation of the assumed stature [ratio].
    """
    below = float(lowest @ down)
    if not np.isfinite(camera_height) or camera_height <= 0 or below <= 0.1 * camera_height:
        return 1.0, size_sd
    by_floor = camera_height / below
    away = float(np.sqrt(max(float(lowest @ lowest) - below**2, 0.0)))
    floor_sd = by_floor * float(np.hypot(height_sd / camera_height, tilt_sd * away / below))
    own, other = size_sd**-2, max(floor_sd, 1e-6) ** -2
    return (own + other * by_floor) / (own + other), (own + other) ** -0.5


def camera_of_view(size_px: tuple[int, int], field_of_view: float) -> Float64:
    """Return intrinsics (9,) of a lens without distortion, for a camera that was never calibrated.

    Args:
        size_px: (width, height) of its images.
        field_of_view: across the longer side [rad].
    """
    width, height = size_px
    focal = 0.5 * max(width, height) / np.tan(0.5 * field_of_view)
    return np.array([focal, focal, (width - 1) / 2, (height - 1) / 2, 0, 0, 0, 0, 0])
