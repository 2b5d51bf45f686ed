"""Parameters of a depth camera as a user gives them, and checks that they are plausible."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import InputError, SettingsError
from mocapella.geometry.kinect_depth import NOTHING
from mocapella.model.arms import SeenArm
from mocapella.model.camera import Camera
from mocapella.model.observations import JointState
from mocapella.sources.picture_source import SourceState

UInt16 = NDArray[np.uint16]

KINECT_RAW: Final = "kinect-raw"
"""Value of ``--unit`` for images that are a Kinect v1's disparities."""
NARROWEST_DEG: Final = 15.0
WIDEST_DEG: Final = 140.0
"""`NARROWEST_DEG` to `WIDEST_DEG` is the range of plausible horizontal fields of view of depth cameras [deg]."""
NEAREST_M: Final = 0.05
FARTHEST_M: Final = 20.0
"""`NEAREST_M` to `FARTHEST_M` is the range of plausible median distances in a depth image [m]."""
_USUAL_M: Final = (0.2, 6.0)
"""Range of usual median distances in a depth image [m]; units that give one are suggested."""
_UNITS_M: Final = (0.001, 0.000125, 0.0001, 0.00025, 0.0002, 0.01, 1e-6)
"""Units of depth in cameras and data sets, the most common first [m]."""
_FOCAL_PX: Final = {
    (640, 480): 575.8, (320, 240): 287.9, (512, 424): 365.5, (848, 480): 425.0, (1280, 720): 640.0,
    (640, 576): 504.0, (640, 400): 475.0, (1280, 800): 620.0,
}  # fmt: skip
"""Focal lengths of common cameras by image size, for suggestions [px]."""
SHORTEST_HAND_M: Final = 0.14
LONGEST_HAND_M: Final = 0.235
"""Longest hand, from wrist to middle fingertip; like `SHORTEST_HAND_M`, it includes errors of the fit [m]."""
_SHORTEST_BENT_M: Final = 0.12
"""Shortest hand with bent or partly hidden fingers, whose fitted lengths are inferred and mostly too short [m]."""
_HAND_M: Final = 0.186
_LEAST_M, _MOST_M = 0.03, 1.0
_HANDS_WANTED: Final = 5
_HANDS_KEPT: Final = 300
_MIDDLE: Final = (0, 9, 10, 11, 12)
_STRAIGHT: Final = 0.9
"""Least ratio of the distance from wrist to middle fingertip to the length along the bones; a fist's is 0.3 to 0.6."""
_ALIKE: Final = 0.45
"""Largest |ln| of the ratio of a common focal length or unit to the computed one at which the common one is suggested.
It is large because detectors limit a hand's size, which then shows only part of an error."""
_ENOUGH_PX: Final = 100
"""Least number of measured pixels for a check of the unit."""


@dataclass(frozen=True)
class DepthOptions:
    """A depth camera's parameters as a user gives them; they take precedence over a file's or camera's own.

    Attributes:
        unit_m: length of a unit of the depth images [m].
        kinect_raw: whether images are a Kinect v1's 11-bit disparities instead of depths; then ``unit_m`` is None. If
            False without ``unit_m``, a file's ``depth.toml`` decides.
        lens: (9,) intrinsics and distortion: fx fy cx cy [px], k1 k2 p1 p2 k3.
        fps: frame rate to assume for files, or to request from a camera [Hz].
        size_px: (width, height) to request from a camera.
        colour: whether colour images of the same instants are wanted.

    None keeps the file's or camera's own value. Nothing is checked here: see `complete` and `UnitCheck`.
    """

    unit_m: float | None = None
    kinect_raw: bool = False
    lens: tuple[float, ...] | None = None
    fps: float | None = None
    size_px: tuple[int, int] | None = None
    colour: bool = False


def parse_unit(text: str | None) -> tuple[float | None, bool]:
    """Parse the option ``--unit`` to ``unit_m`` and ``kinect_raw`` of `DepthOptions`.

    ``0.001`` gives (0.001, False), ``kinect-raw`` (None, True), and None (None, False).

    Raises:
        SettingsError: the text is neither.
    """
    if text is None or text == KINECT_RAW:
        return None, text is not None
    try:
        unit_m = float(text)
    except ValueError:
        unit_m = math.nan
    if not 0 < unit_m < math.inf:
        raise SettingsError(
            f"--unit {text!r} cannot be used; write the metres a unit, such as 0.001 where units are millimetres, "
            f"or {KINECT_RAW} of a Kinect v1's 11-bit images"
        )
    return unit_m, False


def lens_of(numbers: Sequence[float]) -> tuple[float, ...] | None:
    """Complete 3, 4 or 9 numbers to intrinsics and distortion: fx fy cx cy [px], k1 k2 p1 p2 k3.

    F,CX,CY is short for F,F,CX,CY [px]; without distortion coefficients they are 0. None is returned for another count,
    a number that is not finite, or a focal length of 0 or less.
    """
    values = tuple(map(float, numbers))
    if len(values) == 3:
        values = (values[0], *values)
    if len(values) not in (4, 9) or not all(map(math.isfinite, values)) or min(values[:2]) <= 0:
        return None
    return values + (0.0,) * (9 - len(values))


def parse_lens(text: str | None) -> tuple[float, ...] | None:
    """Parse the option ``--intrinsics``, such as ``476,313.7,242.8`` (F,CX,CY), to nine numbers; None gives None.

    Raises:
        SettingsError: the text is no lens.
    """
    if text is None:
        return None
    try:
        lens = lens_of([float(part) for part in text.split(",")])
    except ValueError:
        lens = None
    if lens is None:
        raise SettingsError(
            f"--intrinsics {text!r} cannot be used; write F,CX,CY or FX,FY,CX,CY in pixels, such as 475.0,319.5,239.5, "
            "and after the latter K1,K2,P1,P2,K3 where the lens is distorted"
        )
    return lens


def _usual_focal_px(size_px: tuple[int, int]) -> float:
    return _FOCAL_PX.get(size_px, 0.9 * size_px[0])


def _usual_lens(size_px: tuple[int, int]) -> str:
    """F,CX,CY of common cameras with images of this size."""
    width, height = size_px
    return f"{_usual_focal_px(size_px):g},{(width - 1) / 2:g},{(height - 1) / 2:g}"


def check_lens(lens: Sequence[float], size_px: tuple[int, int], source: object) -> None:
    """Check that a lens is plausible for a depth camera with images of this size.

    Args:
        lens: (9,) intrinsics and distortion: fx fy cx cy [px], k1 k2 p1 p2 k3.
        size_px: (width, height) of the images.
        source: named in the error.

    Raises:
        InputError: the principal point is outside the image, or the field of view is too narrow or too wide; suggests a
            usual lens.
    """
    (width, height), (fx, fy, cx, cy) = size_px, lens[:4]
    usual = f"{_usual_lens(size_px)} would be usual for {width} × {height}"
    fix = f"--intrinsics F,CX,CY are in pixels of these images; {usual}"
    if not (0 <= cx <= width - 1 and 0 <= cy <= height - 1):
        problem = f"the lens' centre ({cx:g}, {cy:g}) lies outside the image of {width} × {height} px"
        raise InputError(problem, file=source, field="intrinsics", fix=fix)
    for side, f, name in ((width, fx, "wide"), (height, fy, "high")):
        angle = _view_deg(side, f)
        if not (NARROWEST_DEG if name == "wide" else 0.5 * NARROWEST_DEG) <= angle <= WIDEST_DEG:
            problem = f"a focal length of {f:g} px makes the view {angle:.3g}° {name}, which no depth camera has"
            raise InputError(problem, file=source, field="intrinsics", fix=fix)


def complete(state: SourceState, source: object) -> Camera:
    """Return the camera, named ``depth``, of an opened depth source whose size, lens and unit are known.

    ``source`` is named in errors.

    Raises:
        InputError: one of these is missing or implausible; states how to give it.
    """
    wanted = (("--intrinsics F,CX,CY", state.lens), ("--unit METRES", state.unit_m))
    missing = [option for option, value in wanted if value is None]
    if missing or state.lens is None or state.size_px is None:
        options = " and ".join(missing) or "images"
        fix = f"give {options}, or write a depth.toml beside the images (docs/arms/recordings.md)"
        raise InputError("the camera's size, lens or unit is unknown", file=source, fix=fix)
    check_lens(state.lens, state.size_px, source)
    return Camera("depth", state.size_px, np.array(state.lens))


class UnitCheck:
    """Check of the unit, on the first image with enough measured pixels; later images are only counted.

    Args:
        unit_m: length of a unit of the images [m].
        source: named in the error.

    Attributes:
        images: number of images given to `update`.
        empty: number of these images without a measured pixel.
    """

    def __init__(self, unit_m: float, source: object) -> None:
        self.unit_m, self.source = unit_m, source
        self.images = self.empty = 0
        self._median: float | None = None

    def update(self, depth: UInt16) -> None:
        """Check the next image (height, width), in units; 0 is not measured.

        Raises:
            InputError: its median distance is implausible; suggests a unit.
        """
        self.images += 1
        if self._median is not None:
            self.empty += not depth.any()
            return
        there = depth[depth > 0]
        self.empty += there.size == 0
        if there.size < _ENOUGH_PX:
            return
        self._median = float(np.median(there))
        if problem := unit_problem(there, self.unit_m):
            words, fix = problem
            raise InputError(words, file=self.source, field="unit", value=self.unit_m, fix=fix)

    def doubt(self, camera: Camera) -> str:
        """Return a text that suggests a unit and a lens, for use when no arm was detected in any image.

        It is empty if no image had enough measured pixels.

        A unit or lens that is wrong by a small factor gives a plausible room, but an implausible arm.
        """
        if self._median is None:
            return ""
        likely = [unit for unit in _likely_units(self._median) if not math.isclose(unit, self.unit_m, rel_tol=0.01)]
        named = " or ".join(f"{unit:g} ({_length(self._median * unit)})" for unit in likely[:2])
        width, height = camera.size_px
        return (
            f"if there is an arm, unit or lens are wrong: with {self.unit_m:g} m a unit the median distance is "
            f"{_length(self._median * self.unit_m)}{f', likely would be --unit {named}' if named else ''}; a lens of f "
            f"{camera.lens[0]:g} px sees {_view_deg(width, camera.lens[0]):.0f}° across, usual for {width} × {height} "
            f"is --intrinsics {_usual_lens(camera.size_px)}"
        )


def check_disparities(raw: UInt16, source: object) -> None:
    """Check that an image ``raw`` (height, width) can be a Kinect v1's disparities, which have 11 bits.

    Raises:
        InputError: it has more than 11 bits; names ``source`` and suggests a unit.
    """
    if (most := int(raw.max(initial=0))) <= NOTHING:
        return
    likely = " or ".join(f"{unit:g}" for unit in _likely_units(float(np.median(raw[raw > 0])))) or "METRES"
    fix = f"these are depths, not a Kinect v1's disparities, which end at {NOTHING}: --unit {likely}"
    raise InputError(f"has values up to {most}", file=source, field="unit", value=KINECT_RAW, fix=fix)


def unit_problem(there: UInt16, unit_m: float) -> tuple[str, str] | None:
    """Return the problem with a unit, and a suggestion; None if the image's median distance is plausible.

    Args:
        there: (pixels,) the measured depths of an image, in units; at least one.
        unit_m: length of a unit [m].
    """
    units = float(np.median(there))
    median_m = units * unit_m
    if NEAREST_M <= median_m <= FARTHEST_M:
        return None
    likely = _likely_units(units)
    named = " or ".join(f"{unit:g} ({_length(units * unit)})" for unit in likely)
    fix = f"--unit {named} would be likely" if likely else "look up how many metres a unit of this camera is"
    if there.max() == NOTHING:
        fix += f"; of a Kinect v1's 11-bit images, --unit {KINECT_RAW}"
    return f"the median distance would be {_length(median_m)}", fix


class HandSizeCheck:
    """Check of lens and unit by the size of the detected hands.

    A wrong focal length or unit changes all lengths by one factor, which appears in the hands of a detector that
    estimates sizes. Only hands with a straight and measured middle finger count, or all hands if these are too few.

    Args:
        lens: (9,) intrinsics and distortion in use: fx fy cx cy [px], k1 k2 p1 p2 k3.
        size_px: (width, height) of the images.
        unit_m: length of a unit of the images [m].
    """

    def __init__(self, lens: Sequence[float] | NDArray[np.float64], size_px: tuple[int, int], unit_m: float) -> None:
        self._focal_px, self._size_px, self._unit_m = float(lens[0]), size_px, unit_m
        self._lengths_m: deque[float] = deque(maxlen=_HANDS_KEPT)
        self._straight_m: deque[float] = deque(maxlen=_HANDS_KEPT)

    def update(self, arms: Sequence[SeenArm]) -> None:
        """Add the arms of the next image; a hand with a NaN in the middle finger or of absurd length is ignored.

        The last 300 hands count.
        """
        for arm in arms:
            joints = arm.points[list(_MIDDLE)]
            length_m = float(np.linalg.norm(np.diff(joints, axis=0), axis=1).sum())
            if not _LEAST_M < length_m < _MOST_M:  # also false for NaN
                continue
            self._lengths_m.append(length_m)
            straight = np.linalg.norm(joints[-1] - joints[0]) >= _STRAIGHT * length_m
            if straight and arm.states[_MIDDLE[-1]] == JointState.TRACKED:
                self._straight_m.append(length_m)

    @property
    def problem(self) -> str:
        """Text with the likely error and a suggestion; empty if the median size is plausible, or with too few hands."""
        lengths_m, shortest_m = self._straight_m, SHORTEST_HAND_M
        if len(lengths_m) < _HANDS_WANTED:
            lengths_m, shortest_m = self._lengths_m, _SHORTEST_BENT_M
        if len(lengths_m) < _HANDS_WANTED:
            return ""
        length_m = float(np.median(lengths_m))
        if shortest_m <= length_m <= LONGEST_HAND_M:
            return ""
        factor = length_m / _HAND_M
        focal_px, unit_m = self._focal_px * factor, self._unit_m / factor
        usual_px = _usual_focal_px(self._size_px)
        focal = f"about {focal_px:.0f}"
        if abs(math.log(usual_px / focal_px)) < min(_ALIKE, abs(math.log(usual_px / self._focal_px))):
            focal = f"{usual_px:g}, which is usual for {self._size_px[0]} × {self._size_px[1]}"
        known = min(_UNITS_M, key=lambda known: abs(math.log(known / unit_m)))
        unit = f"about {unit_m:.2g}"
        if abs(math.log(known / unit_m)) < min(_ALIKE, abs(math.log(known / self._unit_m))):
            unit = f"{known:g}"
        return (
            f"hands are {100 * length_m:.0f} cm long, people's {100 * SHORTEST_HAND_M:.0f} to "
            f"{100 * LONGEST_HAND_M:.1f} cm; --intrinsics with an F of {focal}, or --unit {unit}, would be likely"
        )


def _likely_units(median: float) -> list[float]:
    """At most three common units with which a median in units is a usual distance, the most common first."""
    return [unit for unit in _UNITS_M if _USUAL_M[0] <= median * unit <= _USUAL_M[1]][:3]


def _view_deg(side_px: int, focal_px: float) -> float:
    return math.degrees(2 * math.atan(side_px / (2 * focal_px)))


def _length(metres: float) -> str:
    for factor, unit in ((1e-3, "km"), (1.0, "m"), (1e2, "cm"), (1e3, "mm")):
        if metres * factor >= 1 or unit == "mm":
            return f"{metres * factor:.2g} {unit}" if metres * factor < 100 else f"{metres * factor:.0f} {unit}"
    raise AssertionError
