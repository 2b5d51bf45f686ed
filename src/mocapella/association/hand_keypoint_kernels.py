"""Kernels of hands in images: their keypoints, distances from predicted hands, and rays; importing it imports numba.

``views`` (views, 25) are the cameras of `mocapella.geometry.triangulation.Views`, and n is the index of one.
"""

# ruff: noqa: PLR0917 - kernels take arrays by position and write loops out
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mocapella.compiled import njit
from mocapella.geometry.lens_kernels import distort, undistort

Float64 = NDArray[np.float64]

NEAREST_M = 0.05
"""Least depth of a landmark before a camera [m]."""
NEAREST_POINT_M = 0.1
"""Least depth of a point whose distance from a pixel is known [m]."""


@njit(cache=True, error_model="numpy")
def seen_at(views: Float64, n: int, X: float, Y: float, Z: float) -> tuple[float, float, float]:
    """Project a point of the world [m]; return its pixel (u, v) [px], NaN where it has none, and its depth [m]."""
    x = views[n, 10] * X + views[n, 11] * Y + views[n, 12] * Z + views[n, 19]
    y = views[n, 13] * X + views[n, 14] * Y + views[n, 15] * Z + views[n, 20]
    z = views[n, 16] * X + views[n, 17] * Y + views[n, 18] * Z + views[n, 21]
    if not z > 0.0:
        return math.nan, math.nan, z
    x, y = x / z, y / z
    if not x * x + y * y <= views[n, 9]:
        return math.nan, math.nan, z
    u, v, _, _, _ = distort(x, y, views[n, 4], views[n, 5], views[n, 6], views[n, 7], views[n, 8])
    return views[n, 0] * u + views[n, 2], views[n, 1] * v + views[n, 3], z


@njit(cache=True, error_model="numpy")
def sure_landmarks(
    pixels: Float64, confidences: Float64, hand_sd: float, least_sd_px: float, least: float, px: Float64, sds: Float64,
) -> int:  # fmt: skip
    """Write the pixels and standard deviations of confident landmarks; return their number.

    Args:
        pixels, confidences: (21, 2) [px] and (21,) of the detection.
        hand_sd: standard deviation relative to the longer side of the hand.
        least_sd_px: least standard deviation [px].
        least: least confidence.
        px, sds: (21, 2), (21,) written [px]; NaN where not confident.
    """
    count, low_x, high_x, low_y, high_y = 0, math.inf, -math.inf, math.inf, -math.inf
    for i in range(len(pixels)):
        px[i, 0] = px[i, 1] = sds[i] = math.nan
        x, y = pixels[i, 0], pixels[i, 1]
        if math.isfinite(x) and math.isfinite(y) and confidences[i] >= least:
            px[i, 0], px[i, 1], sds[i] = x, y, math.sqrt(confidences[i])
            low_x, high_x, low_y, high_y = min(low_x, x), max(high_x, x), min(low_y, y), max(high_y, y)
            count += 1
    sd = max(hand_sd * max(high_x - low_x, high_y - low_y), least_sd_px)
    for i in range(len(pixels)):
        sds[i] = sd / sds[i]
    return count


@njit(cache=True, error_model="numpy")
def mean_mismatch(
    views: Float64, n: int, landmarks: Float64, velocities: Float64, after_s: float, sd_m: float, pixels: Float64,
    sds_px: Float64, most: float,
) -> float:  # fmt: skip
    """Return the mean squared distance of a detection from predicted landmarks [squared standard deviations].

    Args:
        views, n: the camera.
        landmarks, velocities: (21, 3) predicted, world [m, m/s].
        after_s: time of the detection after the prediction [s].
        sd_m: standard deviation of the prediction [m].
        pixels, sds_px: (21, 2), (21,) the detection [px].
        most: limit of a landmark's squared distance, and the result if the camera cannot see the hand.
    """
    total, count = 0.0, 0
    for i in range(len(landmarks)):
        u, v, z = seen_at(
            views, n, landmarks[i, 0] + after_s * velocities[i, 0], landmarks[i, 1] + after_s * velocities[i, 1],
            landmarks[i, 2] + after_s * velocities[i, 2],
        )  # fmt: skip
        if not z > NEAREST_M:
            return most
        away = (u - pixels[i, 0]) ** 2 + (v - pixels[i, 1]) ** 2
        cost = 0.5 * away / (sds_px[i] ** 2 + (sd_m * views[n, 0] / z) ** 2)
        if math.isfinite(cost):
            total += min(cost, most)
            count += 1
    return total / count if count else most


@njit(cache=True, error_model="numpy")
def point_distances(
    views: Float64, n: int, points: Float64, x: float, y: float, allowed_m: float, away: Float64
) -> None:
    """Write the distances of points from a pixel in the image, as a ratio to the allowed distance.

    Args:
        views, n: the camera.
        points: (points, 3) world [m].
        x, y: the pixel [px].
        allowed_m: allowed distance at a point's depth [m].
        away: (points,) written: the ratios; infinite for a point that the camera cannot see.
    """
    for i in range(len(points)):
        u, v, z = seen_at(views, n, points[i, 0], points[i, 1], points[i, 2])
        d = math.sqrt((u - x) ** 2 + (v - y) ** 2) / (allowed_m * views[n, 0] / z)
        away[i] = d if math.isfinite(d) and z > NEAREST_POINT_M else math.inf


@njit(cache=True, error_model="numpy")
def move_pixels(
    views: Float64, n: int, landmarks: Float64, velocities: Float64, after_s: float, pixels: Float64
) -> None:
    """Move a camera's pixels by the predicted motion to the time of the prediction.

    Args:
        views, n: the camera.
        landmarks, velocities: (21, 3) predicted, world [m, m/s].
        after_s: time of the pixels after the prediction [s].
        pixels: (21, views, 2) changed where the camera sees the landmark at both times [px].
    """
    for i in range(len(landmarks)):
        X, Y, Z = landmarks[i, 0], landmarks[i, 1], landmarks[i, 2]
        u, v, _ = seen_at(views, n, X, Y, Z)
        x, y, _ = seen_at(
            views, n, X + after_s * velocities[i, 0], Y + after_s * velocities[i, 1], Z + after_s * velocities[i, 2]
        )
        if math.isfinite(u - x) and math.isfinite(v - y):
            pixels[i, n, 0] += u - x
            pixels[i, n, 1] += v - y


@njit(cache=True, error_model="numpy")
def add_rays(
    views: Float64, n: int, pixels: Float64, sds_px: Float64, near: Float64, depth_sd_m: float, points: Float64,
    covariances: Float64,
) -> None:  # fmt: skip
    """Add landmarks that are not triangulated: on the camera's ray, nearest to a predicted place.

    Args:
        views, n: the camera.
        pixels, sds_px: (21, 2), (21,) the detection [px]; NaN where not seen.
        near: (21, 3) predicted places, world [m]; NaN where unknown.
        depth_sd_m: standard deviation along the ray [m].
        points, covariances: (21, 3), (21, 3, 3) written where the point is NaN [m, m²].
    """
    d, o = np.empty(3), np.empty(3)
    for i in range(len(points)):
        if not math.isnan(points[i, 0]):
            continue
        u, v = (pixels[i, 0] - views[n, 2]) / views[n, 0], (pixels[i, 1] - views[n, 3]) / views[n, 1]
        edge = views[n, 9] if math.isfinite(views[n, 9]) else 0.0
        x, y = undistort(u, v, views[n, 4], views[n, 5], views[n, 6], views[n, 7], views[n, 8], edge)
        length, depth = math.sqrt(x * x + y * y + 1.0), 0.0
        for c in range(3):
            d[c] = (views[n, 10 + c] * x + views[n, 13 + c] * y + views[n, 16 + c]) / length
            o[c] = views[n, 22 + c]
            depth += d[c] * (near[i, c] - o[c])
        if not depth > NEAREST_M:  # also where the landmark or its place is not known
            continue
        across = (sds_px[i] / views[n, 0] * depth) ** 2
        for a in range(3):
            points[i, a] = o[a] + depth * d[a]
            for b in range(3):
                along = d[a] * d[b]
                covariances[i, a, b] = across * ((1.0 if a == b else 0.0) - along) + depth_sd_m**2 * along
