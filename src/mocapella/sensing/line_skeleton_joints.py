"""Locate the eight joints of an arm in the mirrored image, from its outline and lines.

The second half of `mocapella.sensing.line_skeleton`: elbow, palm, wrist, fingers on the outline, and fingers in front
of the hand.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from mocapella.sensing.line_skeleton_outline import ArmOutline, Lines
from mocapella.sensing.line_skeleton_settings import LineSkeletonSettings

UInt8 = NDArray[np.uint8]
Int32 = NDArray[np.int32]
Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

FINGERS: Final = 5
UPRIGHT_DEGREES: Final = 60.0
LEVEL_DEGREES: Final = 130.0
_HARRIS_BLOCK: Final = 5
_HARRIS_K: Final = 0.04


@dataclass(frozen=True, eq=False)
class PointGrid:
    """Points of the arm in the cube region (see `LineSkeletonSettings`), on a grid in the mirrored image.

    Attributes:
        pixels: (n, 2) x and y [px].
        metres: (n,) their depths [m].
    """

    pixels: Int32
    metres: Float64


@dataclass(frozen=True, eq=False)
class HandJoints:
    """Joints in the mirrored image [px], and intermediate results.

    Attributes:
        elbow, palm, wrist: (2,) x and y.
        inside_px: radius of the largest circle about the palm within the outline [px]; 0 if the palm is outside of it.
        corners: (n, 2) Harris corners on the outline.
        hulls: (n, 2) int32 each; convex hulls that pass the area filter.
        outer: (n, 2) fingertips on the outline.
        blobs: (n, 2) fingertips in front of the palm: centres of the hand's nearer parts.
        tips: (5, 2), thumb to little finger by the order of their angles; (0, 0) for none.
    """

    elbow: Float64
    palm: Float64
    wrist: Float64
    inside_px: float
    corners: Float64
    hulls: tuple[Int32, ...]
    outer: Float64
    blobs: Float64
    tips: Float64


def grid(of: ArmOutline, rays: Float64, s: LineSkeletonSettings) -> PointGrid:
    """Return every ``grid_px``-th pixel of every ``grid_px``-th row that is on the arm and in the cube region.

    Args:
        of: the arm.
        rays: (height, width, 2) x/z and y/z of the mirrored image's pixels.
        s: stride and cube region, a box in front of the camera.
    """
    step = s.grid_px
    z, side = of.metres[::step, ::step], 0.5 * (s.far_m - s.near_m)
    seen = (of.arm[::step, ::step] > 0) & (z >= s.near_m) & (z <= s.far_m)
    y, x = np.nonzero(seen)
    pixels, metres = np.stack([step * x, step * y], axis=-1), z[y, x].astype(np.float64)
    within = (np.abs(rays[pixels[:, 1], pixels[:, 0]]) * metres[:, None] <= side).all(axis=-1)
    return PointGrid(pixels[within].astype(np.int32), metres[within])


@dataclass(frozen=True, eq=False)
class Place:
    """Positions of an arm's joints in the mirrored image, as in `HandJoints`.

    Attributes:
        elbow, palm, wrist: (2,) x and y [px].
        inside_px: radius of the largest circle about the palm within the outline; 0 if the palm is outside of it [px].
        px_per_m: scale of the image at the palm's depth [px/m].
    """

    elbow: Float64
    palm: Float64
    wrist: Float64
    inside_px: float
    px_per_m: float


def elbow_of(segments: Float64, rotation_degrees: float, centre: Float64) -> Float64:
    """Select the line end that is the elbow, by the arm's angle of rotation.

    Below 60° the first point, from 60 to 130° the one with least x, above 130° the one with greatest x or the first.
    The document defines neither the first point nor when it is used: here it is the lowest, because the document's arms
    enter from below, and above 130° it is used if the point with greatest x lies above the centre.

    Args:
        segments: (n, 4) x and y of both ends of each line, of `Lines`, n > 0 [px].
        rotation_degrees: the arm's rotation, 0 upright, 90 level, of `Lines` [°].
        centre: (2,) centre of the arm's circular region [px].

    Returns:
        (2,) x and y of the elbow [px].
    """
    ends = segments.reshape(-1, 2)
    first: Float64 = ends[ends[:, 1].argmax()]
    least: Float64 = ends[ends[:, 0].argmin()]
    greatest: Float64 = ends[ends[:, 0].argmax()]
    if rotation_degrees < UPRIGHT_DEGREES:
        return first
    if rotation_degrees <= LEVEL_DEGREES:
        return least
    return greatest if greatest[1] >= centre[1] else first


def palm_and_wrist(centre: Float64, elbow: Float64) -> tuple[Float64, Float64]:
    """Compute palm and wrist from the arm's circular region and elbow.

    Args:
        centre: (..., 2) R, centre of the region [px].
        elbow: (..., 2) E [px].

    Returns:
        Palm P = 2R − (E + R)/2 and wrist ((E + P)/2 + P)/2, (..., 2) each [px].
    """
    palm = 2.0 * centre - (elbow + centre) / 2.0
    return palm, ((elbow + palm) / 2.0 + palm) / 2.0


def place_of(of: ArmOutline, found: Lines, points: PointGrid, focal_px: float) -> Place:
    """Locate elbow, palm and wrist of an arm with at least one line and one grid point; arguments as in `hand`."""
    elbow = elbow_of(found.segments, found.rotation_degrees, of.centre)
    palm, wrist = palm_and_wrist(of.centre, elbow)
    px_per_m = focal_px / float(points.metres[nearest(points, palm)])
    return Place(elbow, palm, wrist, _inside(found.skeleton.distance, palm), px_per_m)


def hand(of: ArmOutline, found: Lines, points: PointGrid, focal_px: float, s: LineSkeletonSettings) -> HandJoints:
    """Locate all joints of an arm with at least one line and one grid point.

    Args:
        of, found, points, s: the arm, its lines, its grid points and the settings.
        focal_px: the depth camera's focal length, to convert the settings' metres to pixels [px].
    """
    place = place_of(of, found, points, focal_px)
    elbow, palm, wrist, px_per_m = place.elbow, place.palm, place.wrist, place.px_per_m
    corners, hulls = _corners(of, s), _hulls(of, place, s)
    at = palm if s.angle_at == "palm" else wrist
    outer = _outer(of, corners, hulls, place, s)
    outer = outer[np.abs(angles(outer, at, at - elbow)) <= math.radians(s.finger_degrees)]
    outer = outer[np.argsort(-np.hypot(*(outer - palm).T), kind="stable")][:FINGERS]
    outer = points.pixels[[nearest(points, tip) for tip in outer]].astype(np.float64).reshape(-1, 2)
    blobs = _blobs(points, place, s)
    tips = np.zeros((FINGERS, 2))
    both = _merged(outer, blobs, 2.0 * s.tip_radius_m * px_per_m)
    order = np.argsort(angles(both, at, at - elbow), kind="stable")
    tips[: len(both)] = both[order]
    return HandJoints(elbow, palm, wrist, place.inside_px, corners, hulls, outer, blobs, tips)


def nearest(points: PointGrid, pixel: Float64) -> int:
    """Return the index of the grid point nearest to a pixel (2,), whose depth is used for the pixel; needs a point."""
    return int(((points.pixels - pixel) ** 2).sum(axis=-1).argmin())


def _inside(distance: Float32, palm: Float64) -> float:
    """Return the radius of the largest circle about the palm within the outline; 0 if the palm is outside of it."""
    height, width = distance.shape
    x, y = round(float(palm[0])), round(float(palm[1]))
    return float(distance[y, x]) if 0 <= x < width and 0 <= y < height else 0.0


def angles(pixels: Float64, at: Float64, direction: Float64) -> Float64:
    """Return (n,) signed angles [rad] from a direction (2,) to pixels (n, 2), seen from the pixel ``at`` (2,).

    Clockwise in the image is positive.
    """
    x, y = (pixels - at).reshape(-1, 2).T
    dx, dy = direction
    return np.asarray(np.arctan2(dx * y - dy * x, dx * x + dy * y))


def _corners(of: ArmOutline, s: LineSkeletonSettings) -> Float64:
    """Return (n, 2) Harris corners of the arm's mask [px]."""
    x, y, width, height = cv2.boundingRect(of.arm)
    response = cv2.cornerHarris(of.arm[y : y + height, x : x + width], _HARRIS_BLOCK, 3, _HARRIS_K)
    most = cv2.dilate(response, np.ones((_HARRIS_BLOCK, _HARRIS_BLOCK), dtype=np.uint8))
    peak = (response == most) & (response > s.corner_part * response.max())
    rows, columns = np.nonzero(peak)
    return np.asarray(np.stack([columns + x, rows + y], axis=-1), dtype=np.float64)


def _hulls(of: ArmOutline, at: Place, s: LineSkeletonSettings) -> tuple[Int32, ...]:
    """Return the convex hulls of the arm's parts beyond the wrist."""
    height, width = of.arm.shape
    along = at.palm - at.wrist
    y, x = np.ogrid[:height, :width]
    beyond: Any = of.arm * ((x - at.wrist[0]) * along[0] + (y - at.wrist[1]) * along[1] >= 0)
    found, _ = cv2.findContours(beyond, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    hulls = (np.asarray(cv2.convexHull(one)[:, 0], dtype=np.int32) for one in found)
    return tuple(one for one in hulls if len(one) > 2 and cv2.contourArea(one) >= s.least_hull_px2)


def _outer(of: ArmOutline, corners: Float64, hulls: tuple[Int32, ...], at: Place, s: LineSkeletonSettings) -> Float64:
    """Return hull corners that are also Harris corners and narrow enough for a tip; one of each close group."""
    radius = s.tip_radius_m * at.px_per_m
    kept: list[Float64] = []
    for corner in np.concatenate(hulls).astype(np.float64) if hulls else np.zeros((0, 2)):
        if not len(corners) or np.hypot(*(corners - corner).T).min() > radius / 2:
            continue
        if np.hypot(*(corner - at.palm)) <= at.inside_px or _fill(of.arm, corner, radius) > s.tip_fill_most:
            continue
        close = [k for k, other in enumerate(kept) if np.hypot(*(other - corner)) <= radius]
        if not close:
            kept.append(corner)
        elif np.hypot(*(corner - at.palm)) > np.hypot(*(kept[close[0]] - at.palm)):
            kept[close[0]] = corner
    return np.array(kept).reshape(-1, 2)


def _fill(arm: UInt8, tip: Float64, radius: float) -> float:
    """Return the share of the disc around a tip that is arm; pixels outside the image count as background."""
    height, width = arm.shape
    r, x, y = max(math.ceil(radius), 1), round(float(tip[0])), round(float(tip[1]))
    x0, x1, y0, y1 = max(x - r, 0), min(x + r + 1, width), max(y - r, 0), min(y + r + 1, height)
    dy, dx = np.ogrid[y0 - y : y1 - y, x0 - x : x1 - x]
    disc = dx * dx + dy * dy <= r * r
    return float((disc & (arm[y0:y1, x0:x1] > 0)).sum() / (math.pi * r * r))


def _blobs(points: PointGrid, at: Place, s: LineSkeletonSettings) -> Float64:
    """Return the centres of the hand's parts that are nearer than the palm."""
    if at.inside_px <= 0:
        return np.zeros((0, 2))
    in_hand = np.hypot(*(points.pixels - at.palm).T) <= at.inside_px
    if not in_hand.any():
        return np.zeros((0, 2))
    nearer = in_hand & (points.metres < np.median(points.metres[in_hand]) - s.blob_nearer_m)
    if not nearer.any():
        return np.zeros((0, 2))
    cells = points.pixels[nearer] // s.grid_px
    picture = np.zeros(cells.max(axis=0)[::-1] + 1, dtype=np.uint8)
    picture[cells[:, 1], cells[:, 0]] = 255
    count, _, statistics, middles = cv2.connectedComponentsWithStats(picture, connectivity=8)
    least = s.blob_least_m2 * (at.px_per_m / s.grid_px) ** 2
    large = [k for k in range(1, count) if statistics[k, cv2.CC_STAT_AREA] >= max(least, 1.0)]
    return np.asarray(s.grid_px * middles[large], dtype=np.float64).reshape(-1, 2)


def _merged(outer: Float64, blobs: Float64, apart_px: float) -> Float64:
    """Return the tips on the outline and the blobs apart from them, five at most."""
    both = list(outer)
    for blob in blobs:
        if len(both) < FINGERS and all(np.hypot(*(blob - other)) > apart_px for other in outer):
            both.append(blob)
    return np.array(both).reshape(-1, 2)
