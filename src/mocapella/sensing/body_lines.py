"""The line skeleton of whole bodies in single depth images: range, floor, outlines, thinning and lines.

    seen = body_lines(depth_m, camera, BodyLinesSettings(far_m=3.5))
    for body in seen.bodies:
        body.segments, body.ends        # lines in space, and their ends: head, hands, feet

It runs the stages of `mocapella.sensing.line_skeleton`, from the separation of 16 and 8 bits to the Hough transform, at
room distances. It has no model of people: every object in the range is thinned.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.geometry.lens import undistort
from mocapella.model.camera import Camera
from mocapella.sensing.line_skeleton_outline import ArmOutline, Separated, filled, lines, outline, separated
from mocapella.sensing.line_skeleton_settings import LineSkeletonSettings
from mocapella.settings import check

UInt8 = NDArray[np.uint8]
Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

_HYPOTHESES: Final = 300
_STEP_PX: Final = 8
_INLIER_PART: Final = 0.012
"""Greatest distance of a plane's inlier, as a share of its depth: the noise of a camera at a slant."""
_LEAST_SHARE: Final = 0.05
_BELOW_SHARE: Final = 0.03
_NEIGHBOURS: Final = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], dtype=np.float32)


@dataclass(frozen=True)
class BodyLinesSettings:
    """Limits of bodies, floor and range.

    Attributes:
        near_m, far_m: range of depths along the optical axis [m]; a wall beyond it is left out.
        floor: whether the floor is detected and removed: the plane with most inliers among planes at most tilt_deg
            from level that have almost no points below them.
        floor_clear_m: points below this height are removed with the floor [m].
        tilt_deg: greatest tilt of the camera [°].
        least_m2: least area of a body's outline, at its distance [m²].
        image: settings of the later stages; its range and reach are replaced by the above.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    near_m: float = 0.8
    far_m: float = 4.0
    floor: bool = True
    floor_clear_m: float = 0.05
    tilt_deg: float = 40.0
    least_m2: float = 0.08
    image: LineSkeletonSettings = LineSkeletonSettings(  # noqa: RUF009 - frozen
        mirror=False, noise="median", least_area_px=200.0, ridge_least=110, hough_length_px=12.0, hough_votes=12
    )

    def __post_init__(self) -> None:
        check(0 < self.near_m < self.far_m <= 20, "near_m", self.near_m, f"above 0 and below far_m, {self.far_m}")
        check(0 <= self.floor_clear_m <= 1, "floor_clear_m", self.floor_clear_m, "0 to 1 m")
        check(0 <= self.tilt_deg <= 80, "tilt_deg", self.tilt_deg, "0 to 80°")
        check(0 <= self.least_m2 <= 10, "least_m2", self.least_m2, "0 to 10 m²")


@dataclass(frozen=True, eq=False)
class BodyLines:
    """The lines of one body.

    Attributes:
        mask: (height, width) 255 within its outline, else 0.
        thinned: (height, width) 255 on its thin lines, else 0.
        distance_m: median depth along the optical axis [m].
        segments_px: (n, 2, 2) x and y of both ends of each straight line, the longest first [px].
        segments: (n, 2, 3) the same ends on the body's surface, camera frame (x right, y down) [m]: at the median depth
            of the 7 × 7 pixels around, or ``distance_m`` if none of them is the body's.
        ends_px: (m, 2) ends of thin lines [px].
        ends: (m, 3) the same ends in the camera frame, as ``segments`` [m].
    """

    mask: UInt8
    thinned: UInt8
    distance_m: float
    segments_px: Float64
    segments: Float64
    ends_px: Float64
    ends: Float64


@dataclass(frozen=True, eq=False)
class BodyLinesResult:
    """The line skeletons in a depth image, and the results of earlier stages.

    Attributes:
        floor: (4,) unit normal n, upwards, and d of n·x + d = 0 in the camera frame (y down) [m]; None if not found.
        separated: the part of the depth image in the range and above the floor.
        outline: outlines of the objects, with the mask of the nearest one; None without any.
        bodies: the nearest first.
        reason: why there is no body; empty if there are any.
    """

    floor: Float64 | None
    separated: Separated
    outline: ArmOutline | None
    bodies: tuple[BodyLines, ...]
    reason: str = ""


def body_lines(depth: Float32, camera: Camera, settings: BodyLinesSettings | None = None) -> BodyLinesResult:
    """Return the lines of the bodies in a depth image.

    Args:
        depth: (height, width) [m]; values not above 0 were not measured.
        camera: its size and lens.
        settings: limits; None for the defaults.

    Returns:
        The bodies, or the reason why there is none, with the results of earlier stages.

    Raises:
        SettingsError: the image has another size than the camera's.
    """
    s, (width, height) = settings or BodyLinesSettings(), camera.size_px
    metres = np.asarray(depth, dtype=np.float32)
    if metres.shape != (height, width):
        given = " × ".join(map(str, metres.shape[::-1]))
        raise SettingsError(f"the depth image is {given}; camera {camera.name} has {width} × {height} px")
    metres = np.where(metres > 0, metres, np.float32(0))
    floor = floor_plane(metres, camera, s) if s.floor else None
    above = metres if floor is None else np.where(_height(metres, floor, camera) > s.floor_clear_m, metres, 0)
    image = replace(s.image, near_m=s.near_m, far_m=s.far_m, reach_m=s.far_m - s.near_m)
    first = separated(above.astype(np.float32), image)
    second = outline(first, image) if first.gray.any() else None
    if second is None:
        return BodyLinesResult(floor, first, None, (), _nothing(metres, s))
    bodies = []
    for one in second.outlines:
        mask = filled(one[:, None], (height, width))
        there = (mask > 0) & (above >= s.near_m) & (above <= s.far_m)
        if not there.any():
            continue
        distance_m = float(np.median(above[there]))
        if np.count_nonzero(mask) * (distance_m / float(camera.lens[0])) ** 2 >= s.least_m2:
            bodies.append(_of(replace(second, arm=mask, outlines=(one,)), np.where(there, above, 0), distance_m,
                              camera, image))  # fmt: skip
    bodies.sort(key=lambda body: body.distance_m)
    small = f"nothing in the range is larger than {s.least_m2:g} m²" if not bodies else ""
    return BodyLinesResult(floor, first, second, tuple(bodies), small)


def floor_plane(metres: Float32, camera: Camera, settings: BodyLinesSettings) -> Float64 | None:
    """Return the floor's plane in the camera frame (y down); None if it is not visible or too few pixels are measured.

    Random sample consensus (M. Fischler and R. Bolles, 1981), with the same samples for the same image; then least
    squares of the inliers.

    Args:
        metres: (height, width) depth [m]; values not above 0 were not measured.
        camera: its lens.
        settings: range of depths and greatest tilt.

    Returns:
        (4,) unit normal n, upwards, and d of n·x + d = 0 [m].
    """
    points = _points(metres, camera)
    if len(points) < 100:
        return None
    rng = np.random.default_rng(len(points))
    near = _INLIER_PART * points[:, 2]
    upright = np.cos(np.radians(settings.tilt_deg))
    best: Any = (0, None)
    low = points[points[:, 1] >= np.median(points[:, 1])]  # y is down: the floor is in the lower half
    for three in low[rng.integers(len(low), size=(_HYPOTHESES, 3))]:
        plane = _plane(three)
        if plane is None or plane[1] > -upright or plane[3] <= 0:  # the camera is above its floor: else a ceiling
            continue
        off = points @ plane[:3] + plane[3]
        count = np.count_nonzero(np.abs(off) < near)
        if count > best[0] and np.count_nonzero(off < -2 * near) <= _BELOW_SHARE * len(points):
            best = (count, plane)
    count, plane = best
    if plane is None or count < _LEAST_SHARE * len(points):
        return None
    for _ in range(3):
        off = np.abs(points @ plane[:3] + plane[3])
        # Objects on the floor have points near it, too: only points as near as most inliers are kept.
        flat = points[off < np.minimum(near, 3 * np.median(off[off < near]) + 1e-4)]
        middle = flat.mean(axis=0)
        normal = np.linalg.svd(flat - middle, full_matrices=False)[2][2]
        normal = normal if normal[1] < 0 else -normal
        plane = np.append(normal, -normal @ middle)
    return np.asarray(plane)


def pictures(seen: BodyLinesResult) -> Mapping[str, UInt8]:
    """Draw the result of each stage that was reached, by its name, in the order of processing.

    Returns:
        (height, width) gray or (height, width, 3) BGR uint8 images by name; some are arrays of ``seen``, not copies.
    """
    first = seen.separated
    most = max(int(first.millimetres.max()), 1)
    out: dict[str, UInt8] = {
        "16 bits above the floor": (first.millimetres.astype(np.float64) * (255 / most)).astype(np.uint8),
        "8 bits": first.gray, "median": first.median, "Gaussian": first.gaussian, "threshold": first.near,
    }  # fmt: skip
    if not seen.bodies:
        return out
    mask = np.bitwise_or.reduce([body.mask for body in seen.bodies])
    thinned = np.bitwise_or.reduce([body.thinned for body in seen.bodies])
    dim: Any = cv2.cvtColor((mask // 4).astype(np.uint8), cv2.COLOR_GRAY2BGR)
    drawn, lit = dim.copy(), dim.copy()
    lit[cv2.dilate(thinned, np.ones((2, 2), np.uint8)) > 0] = 255
    for body in seen.bodies:
        for a, b in np.rint(body.segments_px).astype(int).tolist():
            cv2.line(drawn, a, b, (60, 220, 255), 2, cv2.LINE_AA)
        for end in np.rint(body.ends_px).astype(int).tolist():
            cv2.circle(drawn, end, 5, (80, 220, 80), -1, cv2.LINE_AA)
    return out | {"outlines": mask, "thinning": lit, "lines": np.asarray(drawn)}


def _of(of: ArmOutline, metres: Float32, distance_m: float, camera: Camera, s: LineSkeletonSettings) -> BodyLines:
    """Return a body's lines; ``metres`` is 0 outside of it."""
    made = lines(of, s)
    thin = made.skeleton.thinned
    count = cv2.filter2D((thin > 0).astype(np.float32), -1, _NEIGHBOURS, borderType=cv2.BORDER_CONSTANT)
    y, x = np.nonzero((thin > 0) & (np.rint(count) == 1))
    ends = np.stack([x, y], axis=1).astype(np.float64)
    segments = made.segments.reshape(-1, 2, 2)
    return BodyLines(
        of.arm, thin, distance_m, segments, _on_surface(segments, metres, distance_m, camera), ends,
        _on_surface(ends, metres, distance_m, camera),
    )  # fmt: skip


def _on_surface(pixels: Float64, metres: Float32, otherwise_m: float, camera: Camera) -> Float64:
    """Return (..., 3) points of pixels (..., 2) at the median depth of 7 × 7 pixels, else of the whole body."""
    flat = pixels.reshape(-1, 2)
    wide = np.pad(np.where(metres > 0, metres, np.nan), 3, constant_values=np.nan)
    z = np.full(len(flat), otherwise_m)
    for k, (x, y) in enumerate(np.rint(flat).astype(int).tolist()):
        around = wide[y : y + 7, x : x + 7]
        if np.isfinite(around).any():
            z[k] = float(np.nanmedian(around))
    rays = np.concatenate([undistort(flat, camera.lens), np.ones((len(flat), 1))], axis=1)
    return np.asarray((rays * z[:, None]).reshape(*pixels.shape[:-1], 3))


def _points(metres: Float32, camera: Camera) -> Float64:
    """Return (n, 3) the measured points of every eighth pixel of every eighth row [m]."""
    y, x = np.mgrid[_STEP_PX // 2 : metres.shape[0] : _STEP_PX, _STEP_PX // 2 : metres.shape[1] : _STEP_PX]
    z = metres[y, x].astype(np.float64)
    there = z > 0
    pixels = np.stack([x[there], y[there]], axis=1).astype(np.float64)
    rays = np.concatenate([undistort(pixels, camera.lens), np.ones((len(pixels), 1))], axis=1)
    return np.asarray(rays * z[there][:, None])


def _plane(three: Float64) -> Float64 | None:
    """Return (4,) the plane through three points, its normal upwards; None if they are collinear."""
    normal = np.cross(three[1] - three[0], three[2] - three[0])
    size = float(np.linalg.norm(normal))
    if size < 1e-6:
        return None
    normal = normal / size if normal[1] < 0 else -normal / size
    return np.append(normal, -normal @ three[0])


def _height(metres: Float32, floor: Float64, camera: Camera) -> Float64:
    """Return (height, width) heights above the floor [m]; lens distortion is neglected."""
    fx, fy, cx, cy = camera.lens[:4]
    y, x = np.mgrid[: metres.shape[0], : metres.shape[1]]
    ray = floor[0] * (x - cx) / fx + floor[1] * (y - cy) / fy + floor[2]
    return np.asarray(metres * ray + floor[3])


def _nothing(metres: Float32, s: BodyLinesSettings) -> str:
    seen = metres[metres > 0]
    if not seen.size:
        return "nothing was measured in the whole image"
    within = (seen >= s.near_m) & (seen <= s.far_m)
    if not within.any():
        return (
            f"nothing lies between {s.near_m:g} and {s.far_m:g} m; the nearest is at {seen.min():.2f} m, the median at "
            f"{np.median(seen):.2f} m"
        )
    return "nothing but the floor lies in the range"
