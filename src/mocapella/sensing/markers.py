"""Detect colour markers in images, with confidence, and count rejected candidates.

    detector = MarkerDetector(profile)
    frame, report = detector.update(image, at_s), detector.report

Every marker is searched in a window around its prediction at constant velocity in the image; when one is not found, the
whole image is searched at once. In a window the scene's background counts less, which is used where a marker has hardly
any pixel that no background could have. `docs/markers.md` describes how markers are distinguished from similar objects.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.model.markers import MarkerFrame
from mocapella.sensing import marker_memory as at
from mocapella.sensing.colour_learning import check_image, light_of
from mocapella.sensing.colour_profile import ColourProfile
from mocapella.sensing.colour_table import TableSettings, lookup_table
from mocapella.settings import check

if TYPE_CHECKING:
    from mocapella.sensing.marker_piece_kernels import PieceBuffers

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]

RUNS: Final = 20_000
"""Largest number of runs (neighbouring pixels of one label in a row) in an image; `MarkerReport` counts overflows."""
LIGHT_STEP: Final = 16
"""Stride of the pixels and rows at which the light is measured [px]."""


@dataclass(frozen=True)
class MarkerSettings:
    """Parameters of the marker detection.

    Attributes:
        window_px: side of the search window around a prediction; 40 as in the thesis [px].
        acceleration_px_s2: unmodelled acceleration; each border of the window moves outwards by half of it times the
            square of the time since the last detection, at most by ``window_px`` [px/s²].
        forget_s: a marker unseen for longer has no prediction [s].
        whole_image_s: interval between searches of the whole image while no marker is lost [s].
        light_s: interval between measurements of the light [s].
        least_px: least area of a marker [px²].
        largest_share: largest area of a marker, as a share of the image.
        area_range: greatest factor between its area and the learnt one; 10 is three times as far or near.
        largest_elongation: long axis over short axis; a painted fingertip in motion blur stays below.
        least_fill: area over that of the ellipse with the same moments.
        near_change: greatest factor between the area and the last one, or the learnt one of a marker that was lost, of
            a marker that is found only by the colours of a window (`colour_table.classify`).
        sd_floor_px, sd_scale: a centre's standard deviation is the root of the sum of squares of the floor and of
            the scale times the roughness of the marker's edge.
        brighter: the report warns if the brightness differs from the profile's by more than this factor.
        chroma_drift: the report warns if u or v (see `colour_profile`) differs from the profile's by more.
        table: margins of the classification by colour.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    window_px: float = 40.0
    acceleration_px_s2: float = 20_000.0
    forget_s: float = 0.5
    whole_image_s: float = 1.0
    light_s: float = 1.0
    least_px: float = 12.0
    largest_share: float = 0.1
    area_range: float = 10.0
    largest_elongation: float = 4.0
    least_fill: float = 0.6
    near_change: float = 2.5
    sd_floor_px: float = 0.09
    sd_scale: float = 1.3
    brighter: float = 1.5
    chroma_drift: float = 0.2
    table: TableSettings = field(default_factory=TableSettings)

    def __post_init__(self) -> None:
        check(8 <= self.window_px <= 4000, "window_px", self.window_px, "from 8 to 4000 px")
        check(0 <= self.acceleration_px_s2 <= 1e9, "acceleration_px_s2", self.acceleration_px_s2, "0 px/s² or more")
        check(0 <= self.forget_s <= 1e6, "forget_s", self.forget_s, "0 s or more")
        check(0 <= self.whole_image_s <= 1e6, "whole_image_s", self.whole_image_s, "0 s or more")
        check(0 <= self.light_s <= 1e6, "light_s", self.light_s, "0 s or more")
        check(1 <= self.least_px <= 1e6, "least_px", self.least_px, "1 px or more")
        check(0 < self.largest_share <= 1, "largest_share", self.largest_share, "above 0, at most 1")
        check(1 < self.area_range <= 1e6, "area_range", self.area_range, "above 1")
        check(self.largest_elongation >= 1, "largest_elongation", self.largest_elongation, "1 or more")
        check(0 <= self.least_fill < 1, "least_fill", self.least_fill, "from 0 to below 1")
        check(1 < self.near_change <= 1e6, "near_change", self.near_change, "above 1")
        check(0 < self.sd_floor_px <= 100, "sd_floor_px", self.sd_floor_px, "above 0 px")
        check(0 <= self.sd_scale <= 100, "sd_scale", self.sd_scale, "from 0 to 100")
        check(self.brighter > 1, "brighter", self.brighter, "above 1")
        check(self.chroma_drift > 0, "chroma_drift", self.chroma_drift, "above 0")


@dataclass(frozen=True)
class MarkerReport:
    """Counts since the detector was made or reset; arrays have one element per marker.

    Attributes:
        names: the markers, in the order of the arrays.
        images: number of images processed.
        whole_images: number of images that were searched as a whole.
        overflows: number of images with more than `RUNS` runs, whose last rows were not searched.
        found: number of images with the marker.
        ambiguous: number of images with more than one candidate; the likeliest was taken.
        near: number of images where it was found only by the colours of a window; its confidence is halved there.
        merged: number of pieces of its colour that were joined to it.
        too_small, too_big, wrong_shape: number of pieces of its colour that were rejected, by reason.
        brightness: brightness of the last measured image over the profile's; 1 is as learnt.
        chroma_shift: the larger of the differences in u and in v between last measured image and profile.
        light: a warning about the light, in a sentence; empty if there is none.
    """

    names: tuple[str, ...]
    images: int
    whole_images: int
    overflows: int
    found: NDArray[np.int64]
    ambiguous: NDArray[np.int64]
    near: NDArray[np.int64]
    merged: NDArray[np.int64]
    too_small: NDArray[np.int64]
    too_big: NDArray[np.int64]
    wrong_shape: NDArray[np.int64]
    brightness: float
    chroma_shift: float
    light: str


class MarkerDetector:
    """Tracks the markers of a profile through the images of its camera.

    Args:
        profile: the markers' colours in the images of this camera.
        settings: parameters; the defaults if None.
        node_id: number of the node, which the frames carry.

    Attributes:
        profile, settings, node_id: as given.
    """

    def __init__(self, profile: ColourProfile, settings: MarkerSettings | None = None, *, node_id: int = 0) -> None:
        self.profile, self.settings, self.node_id = profile, settings or MarkerSettings(), node_id
        s, (width, height) = self.settings, profile.size_px
        self._table = lookup_table(profile, s.table)
        k = _kernels()
        self._near = lookup_table(profile, s.table, near_px=s.window_px)
        self._colours = k.MarkerColours(self._table, self._near, linear_light())
        self._limits = k.MarkerLimits(
            least_px=float(s.least_px),
            most_px=float(s.largest_share * width * height),
            elongation=float(s.largest_elongation),
            fill=float(s.least_fill),
            window_px=float(s.window_px),
            sd_floor_px=float(s.sd_floor_px),
            sd_scale=float(s.sd_scale),
            area_range=float(s.area_range),
            acceleration_px_s2=float(s.acceleration_px_s2),
            forget_s=float(s.forget_s),
            near_change=float(s.near_change),
        )
        self._names, self._follow, self._rows = profile.names, k.follow, k.MarkerRows
        self._buffers = piece_buffers(width, RUNS)
        self._out = np.zeros((len(profile.colours), at.OUT))
        self.reset()

    def reset(self) -> None:
        """Forget all images, and restart counts and sequence numbers at 0."""
        self._memory = np.zeros((len(self.profile.colours), at.MEMORY))
        self._memory[:, at.SEEN_S] = -np.inf
        self._memory[:, at.USUAL] = [colour.area_px for colour in self.profile.colours]
        self._whole_s = self._light_s = -np.inf
        self._sums = np.zeros((len(self.profile.colours), at.OUT))
        self._images = self._whole = self._overflows = 0
        self._brightness, self._chroma_shift = 1.0, 0.0

    def update(self, image: UInt8, at_s: float) -> MarkerFrame:
        """Return the markers in the next image.

        Args:
            image: (height, width, 3) uint8 blue, green, red, of the profile's size.
            at_s: the image's capture time [s]; not before the last image's, on the same clock.

        Returns:
            All markers of the profile, in new arrays; the position of a marker is NaN if it is not found.

        Raises:
            SettingsError: the array is not an image, or of another size than the profile's.
        """
        profile, s = self.profile, self.settings
        width, height = profile.size_px
        if image.shape != (height, width, 3) or image.dtype != np.uint8:
            check_image(image)
            profile.check_camera(profile.camera, (image.shape[1], image.shape[0]))
        if not image.flags.c_contiguous or not image.flags.writeable:
            image = image.copy()  # a view, or read-only: the kernel is compiled for one array layout
        reported = np.empty(self._out.shape, np.float32)
        rows = self._rows(self._memory, self._out, self._sums, reported)
        whole = at_s - self._whole_s >= s.whole_image_s
        flags = self._follow(image, self._colours, rows, at_s, whole, self._limits, self._buffers)
        sequence = self._images
        self._images += 1
        if flags:
            self._whole += 1
            self._overflows += flags == 3
            self._whole_s = at_s
        if at_s - self._light_s >= s.light_s:
            self._light_s = at_s
            self._compare_light(image)
        return MarkerFrame(
            sensor=profile.camera,
            node_id=self.node_id,
            sequence=sequence,
            time_ns=round(at_s * NS_PER_S),
            sent_ns=0,
            size_px=profile.size_px,
            names=self._names,
            positions_px=reported[:, :2],
            sd_px=reported[:, at.SD],
            areas_px=reported[:, at.AREA],
            elongations=reported[:, at.ELONGATION],
            confidences=reported[:, at.CONFIDENCE],
            candidates=reported[:, at.CANDIDATES].astype(np.uint8),
        )

    def _compare_light(self, image: UInt8) -> None:
        luma, u, v = light_of(image[LIGHT_STEP // 2 :: LIGHT_STEP, LIGHT_STEP // 2 :: LIGHT_STEP])
        was = self.profile.background
        self._brightness = (luma + 1) / (was.luma + 1)
        self._chroma_shift = max(abs(u - was.chromaticity[0]), abs(v - was.chromaticity[1]))

    @property
    def table(self) -> UInt8:
        """The look-up table (32768,) of `mocapella.sensing.colour_table.lookup_table`."""
        return self._table

    @property
    def report(self) -> MarkerReport:
        """Counts since the detector was made or reset."""
        sums, s = self._sums, self.settings
        light = ""
        if abs(math.log(self._brightness)) > math.log(s.brighter):
            light = f"images are {self._brightness:.1f} times as bright as when the colours were learnt"
        elif self._chroma_shift > s.chroma_drift:
            light = f"the light has another colour than when the colours were learnt, by {self._chroma_shift:.2f}"
        if light:
            light += "; light the room as then, set the camera as the profile says, or learn the colours anew"
        return MarkerReport(
            names=self.profile.names,
            images=self._images,
            whole_images=self._whole,
            overflows=self._overflows,
            found=sums[:, at.FOUND].astype(np.int64),
            ambiguous=sums[:, at.CANDIDATES].astype(np.int64),
            near=sums[:, at.NEAR].astype(np.int64),
            merged=sums[:, at.MERGED].astype(np.int64),
            too_small=sums[:, at.REJECTED_SMALL].astype(np.int64),
            too_big=sums[:, at.REJECTED_BIG].astype(np.int64),
            wrong_shape=sums[:, at.REJECTED_SHAPE].astype(np.int64),
            brightness=self._brightness,
            chroma_shift=self._chroma_shift,
            light=light,
        )


def linear_light() -> Float64:
    """Return (256,) linear light, 0 to 1, of 8-bit values by sRGB (IEC 61966-2-1), which approximates any camera's."""
    x = np.arange(256) / 255
    return np.asarray(np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4))


def piece_buffers(width: int, runs: int) -> PieceBuffers:
    """Return workspace of `marker_piece_kernels.pieces` for rows of ``width`` pixels and at most ``runs`` runs.

    A run is a group of neighbouring pixels of one label in a row.
    """
    from mocapella.sensing.marker_piece_kernels import PieceBuffers

    labels = np.zeros(8 * (width // 8 + 2), np.uint8)
    index, parent = np.empty(width, np.uint16), np.empty(runs, np.int64)
    return PieceBuffers(index, labels, np.empty((runs, 4), np.int64), parent, np.empty((runs, 11)))


@cache
def _kernels() -> Any:
    """Import the compiled kernels, and with them numba, on first use."""
    from mocapella.sensing import marker_kernels

    return marker_kernels
