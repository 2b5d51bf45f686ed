"""Detect square tags (ArUco, AprilTag) in images, with their four corners as markers.

Tags are found and read by OpenCV (S. Garrido-Jurado et al., Pattern Recognition 47 (2014) 2280; E. Olson, ICRA 2011,
for the AprilTag dictionaries). Corners are then refined: many short profiles across each side locate its edge, by the
area under the profile, which blur does not change; a line is fitted to the edges, and two lines intersect in a corner.
The lines' uncertainty gives the corner's standard deviation.

Corners are markers with names of their own, ``tag7.0`` to ``tag7.3``, clockwise from the upper left one of the upright
tag as OpenCV draws it. `mocapella.model.markers.joined` joins them with the colour markers of the same image.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.errors import SettingsError, one_of
from mocapella.model.board import DICTIONARIES
from mocapella.model.markers import MarkerFrame, marker_frame
from mocapella.model.observations import check_sensor_name
from mocapella.model.tags import corner_names
from mocapella.sensing.markers import linear_light
from mocapella.settings import check

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]

_LINEAR: Final = 255.0 * linear_light()
_STEP_PX: Final = 0.5
"""Distance between the samples of a profile."""
_REFINED_TWICE: Final = 2
_FRAME_PX: Final = 16
_UNREFINED_SD_PX: Final = 0.7
"""Standard deviation of OpenCV's corner, from a contour of whole pixels."""


@dataclass(frozen=True)
class TagSettings:
    """Tags to detect, and precision of their corners.

    Attributes:
        dictionary: OpenCV's name of the set of tags, in any case, with or without ``DICT_``.
        ids: numbers of the wanted tags; empty for all of the dictionary. Small dictionaries give false detections: name
            the wanted tags.
        sd_floor_px: least standard deviation of a corner: lens and print bend sides a little [px].
        reach_px: greatest length of a profile across a tag's side, to either side of the expected edge [px].
        least_contrast: least difference of dark and light at a side, of 255; other sides are not measured [grey
            levels].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    dictionary: str = "APRILTAG_36H11"
    ids: tuple[int, ...] = ()
    sd_floor_px: float = 0.03
    reach_px: float = 4.0
    least_contrast: float = 20.0

    def __post_init__(self) -> None:
        known = f"one of {one_of(self.opencv_name, DICTIONARIES)}"
        check(self.opencv_name in DICTIONARIES, "dictionary", self.dictionary[:80], known)
        most = len(_dictionary(self.opencv_name).bytesList)
        right = len(set(self.ids)) == len(self.ids) <= 256 and all(0 <= i < most for i in self.ids)
        check(right, "ids", self.ids, f"0 to {most - 1}, each once, at most 256 of them")
        check(0 < self.sd_floor_px <= 10, "sd_floor_px", self.sd_floor_px, "above 0, up to 10 px")
        check(1 <= self.reach_px <= 50, "reach_px", self.reach_px, "from 1 to 50 px")
        check(0 < self.least_contrast < 255, "least_contrast", self.least_contrast, "above 0, below 255")

    @property
    def opencv_name(self) -> str:
        """OpenCV's name of the dictionary."""
        name = self.dictionary.upper()
        return name if name.startswith("DICT_") else f"DICT_{name}"


class TagReport(msgspec.Struct, frozen=True):
    """Counts of a camera's images and tags.

    Attributes:
        images: number of images processed.
        found: number of tags that were reported.
        unwanted: number of tags that are not among the wanted ones.
        twice: number of tag numbers that occurred more than once in an image, and were not reported.
        unrefined: number of corners whose sides could not be measured; they have OpenCV's position.
    """

    images: int = 0
    found: int = 0
    unwanted: int = 0
    twice: int = 0
    unrefined: int = 0


class TagDetector:
    """Detects the tags in the images of one camera.

    Args:
        camera: its name, the sensor of the frames.
        settings: wanted tags and precision; the defaults if None.
        node_id: number of the node, which the frames carry.

    Attributes:
        camera, settings, node_id: as given.
        report: counts since the detector was made; each `update` replaces it.

    Raises:
        SettingsError: an invalid name of the camera.
    """

    def __init__(self, camera: str, settings: TagSettings | None = None, *, node_id: int = 0) -> None:
        self.camera, self.node_id = check_sensor_name(camera), node_id
        self.settings = s = settings or TagSettings()
        dictionary = _dictionary(s.opencv_name)
        self._cells = dictionary.markerSize + 2
        self._detector = cv2.aruco.ArucoDetector(dictionary)
        self.report = TagReport()

    def update(self, image: UInt8, at_s: float) -> MarkerFrame:
        """Return the wanted tags in the next image.

        Args:
            image: (height, width) gray or (height, width, 3) BGR, uint8.
            at_s: the image's capture time, for the result [s].

        Returns:
            The corners of the tags that are seen, by ascending tag number; no markers if none is. A corner outside of
            the image is NaN.

        Raises:
            SettingsError: the array is not an image.
        """
        if image.dtype != np.uint8 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3):
            wanted = "(height, width) gray or (height, width, 3) BGR, uint8"
            raise SettingsError(f"an image of the shape {image.shape}, {image.dtype}; wanted is {wanted}")
        grey: Any = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        gray: UInt8 = np.ascontiguousarray(grey)
        # Some versions of OpenCV (4.14) find no tags at the image's border, so the image is padded.
        framed = cv2.copyMakeBorder(gray, _FRAME_PX, _FRAME_PX, _FRAME_PX, _FRAME_PX, cv2.BORDER_REPLICATE)
        outlines, numbers, _ = self._detector.detectMarkers(framed)
        ids = [] if numbers is None else [int(i) for i in numbers.ravel()]
        wanted_ids = self.settings.ids
        twice = {i for i in ids if ids.count(i) > 1}
        told: list[tuple[int, Float64, Float64]] = []
        for i, outline in zip(ids, outlines, strict=True):
            if i not in twice and (not wanted_ids or i in wanted_ids):
                told.append((i, *self._corners(gray, outline.reshape(4, 2).astype(np.float64) - _FRAME_PX)))
        told.sort(key=lambda tag: tag[0])
        was = self.report
        self.report = TagReport(
            was.images + 1,
            was.found + len(told),
            was.unwanted + sum(bool(wanted_ids) and i not in wanted_ids for i in ids),
            was.twice + len(twice),
            was.unrefined + sum(int((sd >= _UNREFINED_SD_PX).sum()) for _, _, sd in told),
        )
        size = (gray.shape[1], gray.shape[0])
        px = np.concatenate([corners for _, corners, _ in told]) if told else np.empty((0, 2))
        px[~((px >= -0.5) & (px <= np.array(size) - 0.5)).all(axis=1)] = np.nan
        return marker_frame(
            self.camera,
            [name for i, _, _ in told for name in corner_names(i)],
            time_ns=round(at_s * NS_PER_S),
            size_px=size,
            positions_px=px,
            sd_px=np.concatenate([sd for _, _, sd in told]) if told else 0.0,
            areas_px=np.concatenate([np.full(4, _area(corners)) for _, corners, _ in told]) if told else 0.0,
            node_id=self.node_id,
            sequence=was.images,
        )

    def _corners(self, gray: UInt8, corners: Float64) -> tuple[Float64, Float64]:
        """Return refined corners (4, 2) and their standard deviations (4,) [px]."""
        s, found = self.settings, corners
        sd = np.full(4, np.nan)
        for _ in range(_REFINED_TWICE):
            found, sd = refined_corners(gray, found, self._cells, s.reach_px, s.least_contrast)
        # A corner far from OpenCV's belongs to another edge.
        cell = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).min() / self._cells
        good = np.isfinite(sd) & (np.linalg.norm(found - corners, axis=1) < max(2.0, 0.5 * cell))
        return np.where(good[:, None], found, corners), np.where(good, np.maximum(sd, s.sd_floor_px), _UNREFINED_SD_PX)


def refined_corners(
    gray: UInt8, corners: Float64, cells: int, reach_px: float, least_contrast: float
) -> tuple[Float64, Float64]:
    """Refine the corners of a dark square on light ground.

    Args:
        gray: (height, width) uint8.
        corners: (4, 2) approximate, in order round the square [px]; not modified.
        cells: number of cells along a side of the square; the outermost are dark.
        reach_px: greatest length of a profile across a side, to either side of the expected edge [px].
        least_contrast: least difference of dark and light at a side, of 255 [grey levels].

    Returns:
        (4, 2) corners, unchanged if a side cannot be measured, and (4,) their standard deviations [px], NaN then.
    """
    centre = corners.mean(axis=0)
    lines = []
    for k in range(4):
        side = np.stack([corners[k], corners[(k + 1) % 4]])
        lines.append(_side(gray, side, centre, min(reach_px, 0.8 * _length(side) / cells), least_contrast))
    found, sd = corners.copy(), np.full(4, np.nan)
    for k in range(4):
        before, after = lines[k - 1], lines[k]
        if before is None or after is None:
            continue
        N = np.stack([before[0], after[0]])
        sine = abs(float(np.linalg.det(N)))
        if sine < 0.2:
            continue
        found[k] = np.linalg.solve(N, [before[1], after[1]])
        sd[k] = np.hypot(before[2], after[2]) / (np.sqrt(2.0) * sine)
    return found, sd


def _side(
    gray: UInt8, side: Float64, centre: Float64, reach: float, least_contrast: float
) -> tuple[Float64, float, float] | None:
    """Return n and d of a side's line n·x = d, and the standard deviation of d at its ends; None without a line."""
    a, b = side
    length = _length(side)
    if reach < 1.0:
        return None
    along = (b - a) / length
    outwards = np.array([along[1], -along[0]])
    if outwards @ (0.5 * (a + b) - centre) < 0:
        outwards = -outwards
    count = int(np.clip(length * 0.8, 6, 48))
    at = a + np.linspace(0.1, 0.9, count)[:, None] * (b - a)
    across = np.arange(-reach, reach + 0.5 * _STEP_PX, _STEP_PX)
    x, y = np.moveaxis(at[:, None] + across[:, None] * outwards, -1, 0)
    height, width = gray.shape
    inside = ((x >= 0) & (x < width - 1) & (y >= 0) & (y < height - 1)).all(axis=1)
    if inside.sum() < 6:
        return None
    at, x, y = at[inside], x[inside], y[inside]
    i, j = x.astype(np.intp), y.astype(np.intp)
    u, v = x - i, y - j
    # In linear light: in encoded values blur shifts the edge of a bright area outwards, by half a pixel.
    w = _LINEAR
    value = (1 - v) * ((1 - u) * w[gray[j, i]] + u * w[gray[j, i + 1]]) + v * (
        (1 - u) * w[gray[j + 1, i]] + u * w[gray[j + 1, i + 1]]
    )
    dark, light = float(np.median(value[:, :2])), float(np.median(value[:, -2:]))
    if light - dark < least_contrast:
        return None
    risen = np.clip((value - dark) / (light - dark), -0.5, 1.5)
    edge = across[-1] - _STEP_PX * (risen.sum(axis=1) - 0.5 * (risen[:, 0] + risen[:, -1]))
    points = at + edge[:, None] * outwards
    return _line(points, outwards)


def _line(points: Float64, outwards: Float64) -> tuple[Float64, float, float] | None:
    """Fit a line to points (n, 2) by total least squares, without outliers."""
    keep = np.ones(len(points), dtype=np.bool_)
    for _ in range(3):
        if keep.sum() < 5:
            return None
        middle = points[keep].mean(axis=0)
        n = np.linalg.svd(points[keep] - middle)[2][-1]
        off = np.abs((points - middle) @ n)
        keep = off <= max(3.0 * 1.48 * float(np.median(off)), 0.05)
    n = n if n @ outwards > 0 else -n
    rest = (points[keep] - middle) @ n
    scatter = float(np.sqrt((rest @ rest) / max(keep.sum() - 2, 1)))
    # At its end a fitted line's variance is four times a mean's, and more beyond the outermost point.
    return n, float(n @ middle), scatter * float(np.sqrt(6.0 / keep.sum()))


def _length(side: Float64) -> float:
    return float(np.linalg.norm(side[1] - side[0]))


def _area(corners: Float64) -> float:
    x, y = corners.T
    return float(0.5 * abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def draw_tag(dictionary: str, number: int, side_px: int) -> UInt8:
    """Draw a tag for printing, with a white margin of two cells.

    Args:
        dictionary: OpenCV's name of the set of tags, in any case, with or without ``DICT_``.
        number: the tag's number in the dictionary.
        side_px: side of the tag itself, without the margin [px].

    Returns:
        (height, width) uint8 gray.

    Raises:
        SettingsError: the dictionary or tag does not exist, or the side is out of range.
    """
    settings = TagSettings(dictionary, (number,))
    tags = _dictionary(settings.opencv_name)
    least = tags.markerSize + 2
    check(least <= side_px <= 20_000, "side_px", side_px, f"{least} to 20000")
    image = cv2.aruco.generateImageMarker(tags, number, side_px)
    return np.asarray(np.pad(image, 2 * side_px // least, constant_values=255), dtype=np.uint8)


def _dictionary(opencv_name: str) -> Any:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, opencv_name))
