"""Measure the accuracy of calibrated cameras in millimetres.

Corners are triangulated one by one, without the board's shape, and distances between them compared with the board's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.alignment import cross_matrix
from mocapella.geometry.lens_jacobian import project_with_jacobian
from mocapella.geometry.triangulation import EVERY_CAMERA, triangulate
from mocapella.geometry.triangulation import views as triangulation_views
from mocapella.model.board import Board, BoardView
from mocapella.model.camera import PlacedCamera

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]


Pairs = tuple[Int64, Int64]


@dataclass(frozen=True)
class CameraNoise:
    """Uncertainty of cameras and corners.

    Attributes:
        sigma_px: standard deviation of a corner's coordinate [px].
        covariance: (cameras, 15, cameras, 15) of `board_bundle.Adjusted`.
    """

    sigma_px: float
    covariance: Float64


@dataclass(frozen=True)
class CornerQuality:
    """Errors of triangulated corners.

    Attributes:
        points: number of corners seen by two or more cameras.
        distances: number of pairs of corners in one group of simultaneous views.
        distance_rms_mm: root mean square of measured minus true distance [mm].
        distance_median_mm: median magnitude of measured minus true distance [mm].
        scale_percent: median of (measured / true distance − 1) [%].
        reprojection_median_px, reprojection_rms_px: reprojection error of the triangulated corners, as a distance, not
            of a coordinate [px].
        predicted_rms_mm: distance_rms_mm as expected from the covariance of the cameras and the noise of corners; NaN
            if these are not given [mm].
    """

    points: int
    distances: int
    distance_rms_mm: float
    distance_median_mm: float
    scale_percent: float
    reprojection_median_px: float
    reprojection_rms_px: float
    predicted_rms_mm: float


def corner_quality(
    views: Sequence[BoardView],
    instant_of: Mapping[tuple[str, int], int],
    cameras: Mapping[str, PlacedCamera],
    board: Board,
    noise: CameraNoise | None = None,
) -> CornerQuality:
    """Triangulate every corner that two or more cameras saw at the same time, and compare distances.

    Args:
        views: views of all cameras.
        instant_of: group of simultaneous frames, by camera and frame number.
        cameras: the rig's cameras, by name.
        board: gives the true distances.
        noise: uncertainty of the cameras, in the order of ``cameras``; None if unknown.

    Returns:
        The errors; NaN where there is nothing to measure, as where no two cameras saw a corner together.
    """
    nan = float("nan")
    names = list(cameras)
    rows: dict[tuple[int, int], Float64] = {}
    for view in views:
        for corner, pixel in zip(view.ids.tolist(), view.corners_px, strict=True):
            row = rows.setdefault((instant_of[view.camera, view.frame], corner), np.full((len(names), 2), np.nan))
            row[names.index(view.camera)] = pixel
    seen = {key: row for key, row in rows.items() if np.isfinite(row[:, 0]).sum() >= 2}
    if not seen:
        return CornerQuality(0, 0, nan, nan, nan, nan, nan, nan)
    pixels = np.array(list(seen.values()))
    placed = [cameras[name] for name in names]
    cameras_of = triangulation_views([one.camera.lens for one in placed], [one.T_camera_world for one in placed])
    found = triangulate(pixels, cameras_of, settings=EVERY_CAMERA)
    points, residual = found.points, found.residuals_px[np.isfinite(found.residuals_px)]
    instants, corners = np.array(list(seen)).T
    i, j = (np.concatenate(side) for side in zip(*map(_pairs, _groups(instants)), strict=True))
    at = board.corners_m[corners]
    d, d0 = np.linalg.norm(points[i] - points[j], axis=1), np.linalg.norm(at[i] - at[j], axis=1)
    if not len(d):
        return CornerQuality(len(points), 0, nan, nan, nan, *_median_and_rms(residual), nan)
    predicted = nan if noise is None else _predicted_rms(points, pixels, placed, (i, j), noise)
    median, rms = _median_and_rms(abs(d - d0))
    scale = float(100 * np.median(d / d0 - 1))
    return CornerQuality(
        len(points), len(d), 1e3 * rms, 1e3 * median, scale, *_median_and_rms(residual), 1e3 * predicted
    )


def _median_and_rms(values: Float64) -> tuple[float, float]:
    return float(np.median(values)), float(np.sqrt((values**2).mean()))


def _groups(instants: Int64) -> list[Int64]:
    return [np.flatnonzero(instants == instant) for instant in np.unique(instants)]


def _pairs(group: Int64) -> Pairs:
    i, j = np.triu_indices(len(group), 1)
    return group[i], group[j]


def _predicted_rms(
    points: Float64, pixels: Float64, cameras: Sequence[PlacedCamera], pairs: Pairs, noise: CameraNoise
) -> float:
    """Return the expected root mean square error of distances, to first order, from errors of cameras and corners."""
    size = 15
    information = np.zeros((len(points), 3, 3))
    by_cameras = np.zeros((len(points), 3, len(cameras) * size))
    for c, placed in enumerate(cameras):
        some = np.isfinite(pixels[:, c, 0])
        R, t = placed.T_camera_world[:3, :3], placed.T_camera_world[:3, 3]
        p = points[some] @ R.T + t
        _, J, by_lens = project_with_jacobian(p, placed.camera.lens)
        by_camera = np.concatenate([J, -J @ cross_matrix(p), by_lens], axis=-1)
        by_world = np.swapaxes(J @ R, 1, 2)
        information[some] += by_world @ np.swapaxes(by_world, 1, 2)
        by_cameras[some, :, size * c : size * (c + 1)] -= by_world @ by_camera
    spread = np.linalg.inv(information)
    by_cameras = spread @ by_cameras
    i, j = pairs
    along = points[i] - points[j]
    along /= np.linalg.norm(along, axis=1)[:, None]
    of_corners = noise.sigma_px**2 * np.einsum("na,nab,nb->n", along, spread[i] + spread[j], along)
    moved = np.einsum("na,nab->nb", along, by_cameras[i] - by_cameras[j])
    covariance = noise.covariance.reshape(moved.shape[1], -1)
    return float(np.sqrt((of_corners + ((moved @ covariance) * moved).sum(axis=1)).mean()))
