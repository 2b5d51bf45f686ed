"""Extract the outline of an arm, its circular region and the lines of its skeleton from a depth image.

The first half of `mocapella.sensing.line_skeleton`: images in the order of processing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mocapella.sensing.line_skeleton_settings import LineSkeletonSettings
from mocapella.sensing.line_skeleton_thinning import Skeleton, skeleton

UInt8 = NDArray[np.uint8]
UInt16 = NDArray[np.uint16]
Int32 = NDArray[np.int32]
Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

_PAD_PX = 2
"""Padding around the image, so that objects at its border have closed outlines."""
_LEAST_OUTLINE = 5
"""Least number of points to fit an ellipse."""
_NEIGHBOURS = ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1))


@dataclass(frozen=True, eq=False)
class Separated:
    """A depth image in 16 and 8 bits, and its near part; (height, width) each.

    Attributes:
        millimetres: uint16 depth [mm], 0 where nothing was measured.
        gray: uint8, 255 at the near end of the cube region (see `LineSkeletonSettings`), 1 at its far end, 0 elsewhere.
        median: ``gray`` after the median blur.
        gaussian: ``median`` after the Gaussian blur.
        near: 255 where the blurred image is above the threshold, else 0.
        mirrored: ``near`` mirrored, if the settings require it; else the same array.
    """

    millimetres: UInt16
    gray: UInt8
    median: UInt8
    gaussian: UInt8
    near: UInt8
    mirrored: UInt8


@dataclass(frozen=True, eq=False)
class ArmOutline:
    """An arm in the mirrored image; images are (height, width).

    Attributes:
        edges: 255 on Canny edges, else 0.
        outlines: (n, 2) int32 each [px]: all that pass the area filter, the nearest first.
        arm: 255 within the nearest outline, else 0.
        centre: (2,) centre of the smallest circle around it [px]; this circle is the circular region.
        radius_px: the circle's radius [px].
        metres: float32 mirrored depth [m]; unmeasured pixels within the region are replaced.
        noisy: bool, the replaced pixels.
    """

    edges: UInt8
    outlines: tuple[Int32, ...]
    arm: UInt8
    centre: Float64
    radius_px: float
    metres: Float32
    noisy: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Lines:
    """An arm's straight line segments in the mirrored image.

    Attributes:
        skeleton: the intermediate images of the line detection.
        segments: (n, 4) x and y of the first and of the last point [px], the longest first.
        rotation_degrees: rotation of the outline's fitted ellipse: 0 upright, 90 level, below 90 leans right [deg].
    """

    skeleton: Skeleton
    segments: Float64
    rotation_degrees: float


def separated(metres: Float32, s: LineSkeletonSettings) -> Separated:
    """Convert depth to 16 bits for measuring and 8 bits for image processing; blur and threshold the latter.

    Args:
        metres: (height, width) depth [m]; values not above 0 were not measured.
        s: the cube region, the sizes of the blurs, and whether to mirror left and right.

    Returns:
        The image after each step. The threshold is ``s.reach_m`` behind the nearest 1 % of the pixels in the region.
    """
    measured = np.where(metres > 0, metres, np.float32(0))  # NaN, too
    millimetres = np.minimum(np.rint(measured * np.float32(1000)), np.float32(65535)).astype(np.uint16)
    within = (measured >= s.near_m) & (measured <= s.far_m)
    gray = np.zeros(metres.shape, dtype=np.uint8)
    gray[within] = np.rint(_gray(measured[within], s)).astype(np.uint8)
    median: Any = cv2.medianBlur(gray, s.median_px) if s.median_px > 1 else gray
    gaussian: Any = cv2.GaussianBlur(median, (s.gaussian_px, s.gaussian_px), 0)
    # The nearest 1 % of the pixels: a single nearest pixel is noise.
    counts = np.cumsum(np.bincount(median.ravel(), minlength=256)[:0:-1])
    nearest = 255 - int(np.searchsorted(counts, 0.01 * counts[-1], side="right")) if counts[-1] else 255
    threshold = nearest - 254.0 * s.reach_m / (s.far_m - s.near_m)
    near: Any = cv2.threshold(gaussian, max(threshold, 0.5), 255, cv2.THRESH_BINARY)[1]
    mirrored = np.ascontiguousarray(near[:, ::-1]) if s.mirror else near
    return Separated(millimetres, gray, median, gaussian, near, mirrored)


def outline(pictures: Separated, s: LineSkeletonSettings) -> ArmOutline | None:
    """Detect the arm in the mirrored image: edges, outlines, area filter, circular region and noise replacement.

    Args:
        pictures: the near part of the depth image.
        s: thresholds.

    Returns:
        The arm; None if no outline is large enough.
    """
    p = _PAD_PX
    padded = cv2.copyMakeBorder(pictures.mirrored, p, p, p, p, cv2.BORDER_CONSTANT, value=(0,))
    edges = cv2.Canny(padded, s.canny_low, s.canny_high)
    # With the enclosed area, because an edge with a gap of one pixel would have an outline of no area.
    found, _ = cv2.findContours(cv2.bitwise_or(edges, padded), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    large = [one for one in found if len(one) >= _LEAST_OUTLINE and cv2.contourArea(one) >= max(s.least_area_px, 1.0)]
    if not large:
        return None
    gray = pictures.gaussian[:, ::-1] if s.mirror else pictures.gaussian
    fillings = [filled(one, padded.shape)[p:-p, p:-p] for one in large]
    order = np.argsort([-float(gray[(filling > 0) & (pictures.mirrored > 0)].mean()) for filling in fillings])
    height, width = pictures.mirrored.shape
    outlines = tuple(np.clip(large[k][:, 0] - p, 0, (width - 1, height - 1)).astype(np.int32) for k in order)
    arm = np.ascontiguousarray(fillings[order[0]])
    centre, radius = cv2.minEnclosingCircle(cv2.convexHull(outlines[0]))
    metres = pictures.millimetres.astype(np.float32) * np.float32(0.001)
    if s.mirror:
        metres = np.ascontiguousarray(metres[:, ::-1])
    noisy = (arm > 0) & (metres == 0)
    metres[noisy] = _medians(metres, noisy) if s.noise == "median" else s.noise_m
    return ArmOutline(
        np.ascontiguousarray(edges[p:-p, p:-p]), outlines, arm, np.array(centre), float(radius), metres, noisy
    )


def lines(of: ArmOutline, s: LineSkeletonSettings) -> Lines:
    """Detect the straight lines of an arm's skeleton by thinning and the probabilistic Hough transform.

    Args:
        of: the outline of the arm.
        s: thresholds of the thinning and of the Hough transform.

    Returns:
        The lines, with segments (0, 4) if there is none, and the intermediate images.
    """
    made = skeleton(of.arm, s.ridge_least)
    found = cv2.HoughLinesP(made.lines, 1, np.pi / 180, s.hough_votes, None, s.hough_length_px, s.hough_gap_px)
    segments = np.zeros((0, 4)) if found is None else np.asarray(found, dtype=np.float64).reshape(-1, 4)
    lengths = np.hypot(segments[:, 2] - segments[:, 0], segments[:, 3] - segments[:, 1])
    return Lines(made, segments[np.argsort(-lengths, kind="stable")], float(cv2.fitEllipse(of.outlines[0])[2]))


def filled(contour: Any, shape: tuple[int, ...]) -> UInt8:
    """Return a uint8 image of a shape with 255 within a contour (n, 1, 2) [px], as of OpenCV, else 0."""
    out = np.zeros(shape, dtype=np.uint8)
    cv2.drawContours(out, [contour], -1, (255,), cv2.FILLED)
    return out


def _gray(metres: Float32, s: LineSkeletonSettings) -> Float32:
    return 255 - 254 * (metres - np.float32(s.near_m)) / np.float32(s.far_m - s.near_m)


def _medians(metres: Float32, where: NDArray[np.bool_]) -> Float32:
    """Return the median of the neighbours above 0 of each pixel ``where``; 0 without any."""
    wide = np.pad(metres, 1)
    y, x = np.nonzero(where)
    around = np.stack([wide[y + 1 + dy, x + 1 + dx] for dy, dx in _NEIGHBOURS], axis=-1)
    around[around == 0] = np.nan
    some = np.isfinite(around).any(axis=-1)
    out = np.zeros(len(around), dtype=np.float32)
    out[some] = np.nanmedian(around[some], axis=-1)
    return out
