"""Weighted linear triangulation that drops cameras until the mean reprojection error is small.

Each camera gives two rows of the homogeneous equations u·p₃ − p₁ and v·p₃ − p₂ (Hartley, Zisserman: Multiple View
Geometry, 2nd ed. 2004, section 12.2), weighted by the confidence of its detection. If the mean reprojection error is
too large, the point is estimated again without each camera, then without each two, and so on; the best is kept.
`triangulation.triangulate` is more accurate and gives covariances; this one is for comparison with tools that use it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.lens import project, undistort
from mocapella.geometry.rigid import apply
from mocapella.geometry.triangulation import PointState, Triangulated
from mocapella.settings import check

Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class WeightedLinearSettings:
    """Thresholds for detections and for dropping cameras.

    Attributes:
        least_confidence: detections with a confidence above this are used.
        largest_error_px: largest mean reprojection error of the cameras used [px].
        drop_cameras: whether cameras are dropped if the error is larger; otherwise the point is NaN. Turn it off where
            detection errors are large: two remaining cameras then mostly agree by chance.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    least_confidence: float = 0.3
    largest_error_px: float = 15.0
    drop_cameras: bool = True

    def __post_init__(self) -> None:
        check(0 <= self.least_confidence < 1, "least_confidence", self.least_confidence, "0 to below 1")
        check(self.largest_error_px > 0, "largest_error_px", self.largest_error_px, "above 0 px")


DEFAULT = WeightedLinearSettings()


def weighted_linear(
    pixels: Any, confidences: Any, lenses: Any, T_camera_world: Any, settings: WeightedLinearSettings = DEFAULT
) -> Triangulated:
    """Triangulate points linearly (DLT) with views weighted by confidence; the result's covariances are NaN.

    Args:
        pixels: (..., views, 2) [px]; NaN where the camera does not see the point.
        confidences: (..., views) confidence of each detection, 0 to 1; NaN where the camera does not see the point.
        lenses: (views, 9) intrinsics and distortion: fx fy cx cy [px], k1 k2 p1 p2 k3.
        T_camera_world: (views, 4, 4) extrinsics.
        settings: the thresholds.

    Returns:
        The points, with the batch axes of ``pixels``. Points and residuals are NaN where no set of two or more cameras
        has a mean error below ``largest_error_px``; the state is then `PointState.INCONSISTENT`, or
        `PointState.ONE_VIEW` with fewer than two usable detections.
    """
    pixels = np.asarray(pixels, dtype=np.float64)
    confidences = np.broadcast_to(np.asarray(confidences, dtype=np.float64), pixels.shape[:-1])
    batch, count = pixels.shape[:-2], pixels.shape[-2]
    pixels, weights = pixels.reshape(-1, count, 2), confidences.reshape(-1, count)
    lenses, T = np.asarray(lenses, dtype=np.float64), np.asarray(T_camera_world, dtype=np.float64)
    normalised = np.stack([undistort(pixels[:, k], lens) for k, lens in enumerate(lenses)], axis=1)
    usable = (weights > settings.least_confidence) & np.isfinite(normalised).all(axis=-1)
    points = np.full((len(pixels), 3), np.nan)
    used, open_ = np.zeros(weights.shape, dtype=np.bool_), usable.sum(axis=1) >= 2
    states = np.where(open_, PointState.INCONSISTENT, PointState.ONE_VIEW).astype(np.uint8)
    for dropped in range(count - 1 if settings.drop_cameras else 1):
        best = np.full(len(pixels), np.inf)
        for without in combinations(range(count), dropped):
            kept = usable.copy()
            kept[:, list(without)] = False
            rows = np.flatnonzero(open_ & (kept.sum(axis=1) >= 2) & usable[:, list(without)].all(axis=1))
            found = _linear(normalised[rows], np.where(kept, weights, 0.0)[rows], lenses, T)
            error = _mean_error(found, pixels[rows], kept[rows], lenses, T)
            better = error < best[rows]
            best[rows[better]] = error[better]
            points[rows[better]], used[rows[better]] = found[better], kept[rows][better]
        closed = open_ & (best < settings.largest_error_px)
        states[closed] = PointState.SEEN
        open_ = open_ & ~closed
    good = states == PointState.SEEN
    points[~good], used[~good] = np.nan, False
    residuals = np.where(
        good[:, None] & np.isfinite(pixels).all(axis=-1), _distances(points, pixels, lenses, T), np.nan
    )
    return Triangulated(
        points.reshape(*batch, 3), np.full((*batch, 3, 3), np.nan), residuals.reshape(*batch, count),
        used.reshape(*batch, count), states.reshape(batch),
    )  # fmt: skip


def _linear(normalised: Float64, weights: Float64, lenses: Float64, T: Float64) -> Float64:
    """Return the points as null vectors of the weighted rows, in undistorted pixels."""
    K = np.zeros((len(lenses), 3, 3))
    K[:, 0, 0], K[:, 1, 1], K[:, 0, 2], K[:, 1, 2], K[:, 2, 2] = *lenses.T[:4], 1.0
    P = K @ T[:, :3]
    ideal = normalised * lenses[:, :2] + lenses[:, 2:4]
    rows = P[:, :2] - ideal[..., None] * P[:, 2:3]
    A = (weights[..., None, None] * np.nan_to_num(rows)).reshape(len(weights), 2 * len(lenses), 4)
    last = np.linalg.svd(A)[2][:, -1]
    return np.asarray(last[:, :3] / last[:, 3:])


def _distances(points: Float64, pixels: Float64, lenses: Float64, T: Float64) -> Float64:
    seen = [project(apply(T[k], points), lens) for k, lens in enumerate(lenses)]
    return np.asarray(np.linalg.norm(np.stack(seen, axis=1) - pixels, axis=-1))


def _mean_error(points: Float64, pixels: Float64, kept: Any, lenses: Float64, T: Float64) -> Float64:
    distances = np.where(kept, _distances(points, pixels, lenses, T), 0.0)
    errors = distances.sum(axis=1) / kept.sum(axis=1)
    return np.where(np.isfinite(errors), errors, np.inf)
