"""Depth from two parallel cameras: the formula of a pinhole pair, and a correction fitted to measured distances.

D = B·x₀ / (2·tan(φ₀/2)·(X_L − X_R)), with the baseline B, the image width x₀ [px] and its field of view φ₀
(Mrovlje, Vrančić: Distance measuring based on stereoscopic pictures, 9th International PhD Workshop on Systems and
Control, 2008, section 2). *Disparity* here is positive: the column [px] in the right image minus the column in the left
one, with left and right as for a person who faces the cameras. A negative disparity means that they are swapped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import InputError
from mocapella.settings import check

Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class ParallelPair:
    """Two equal cameras side by side with parallel optical axes.

    Attributes:
        baseline_m: distance between the camera centres [m].
        width_px: width of the image [px].
        view_angle_rad: horizontal field of view [rad].

    Raises:
        SettingsError: a value is 0 or less, or far too large, or the angle is π or more.
    """

    baseline_m: float
    width_px: float
    view_angle_rad: float

    def __post_init__(self) -> None:
        check(0 < self.baseline_m < 1e3, "baseline_m", self.baseline_m, "above 0 m")
        check(0 < self.width_px < 1e6, "width_px", self.width_px, "above 0 px")
        check(0 < self.view_angle_rad < math.pi, "view_angle_rad", self.view_angle_rad, "between 0 and π")

    @property
    def focal_px(self) -> float:
        """Focal length [px], which is ``width_px`` / (2·tan(``view_angle_rad``/2))."""
        return self.width_px / (2.0 * math.tan(self.view_angle_rad / 2.0))

    def depth(self, disparity_px: Any) -> Float64:
        """Return the depths (...,) [m] of disparities (...,) [px]; NaN where one is 0 or less, see `swapped`."""
        disparity = np.asarray(disparity_px, dtype=np.float64)
        return self.baseline_m * self.focal_px / np.where(disparity > 0, disparity, np.nan)

    def disparity(self, depth_m: Any) -> Float64:
        """Return the disparities (...,) [px] of depths (...,) [m], above 0; the inverse of `depth`."""
        return self.baseline_m * self.focal_px / np.asarray(depth_m, dtype=np.float64)

    def expected_error(self, depth_m: Any, pixels: float = 1.0) -> Float64:
        """Return the depth error that a disparity error of ``pixels`` causes at given depths (...,) [m].

        It is ΔD = D²/B·tan Δφ with Δφ = ``pixels``·φ₀/x₀ (section 2 of the paper).
        """
        angle = pixels * self.view_angle_rad / self.width_px
        return np.asarray(depth_m, dtype=np.float64) ** 2 / self.baseline_m * math.tan(angle)

    def points(self, one: Any, other: Any, depth_m: Any, height_px: float) -> Float64:
        """Return 3D points in the frame of a virtual camera midway between the two.

        Args:
            one, other: (..., 2) x, y of each point in the two rectified images, left and right in any order [px].
            depth_m: (...,) depths by any method [m].
            height_px: height of the image [px].

        Returns:
            (..., 3) [m]: x right, y down, z out of the lens; x and y are NaN where a pixel is, all where the depth is.
        """
        middle = (np.asarray(one, dtype=np.float64) + np.asarray(other, dtype=np.float64)) / 2.0
        depth = np.asarray(depth_m, dtype=np.float64)[..., None]
        centre = np.array([(self.width_px - 1.0) / 2.0, (height_px - 1.0) / 2.0])
        return np.concatenate([(middle - centre) / self.focal_px * depth, depth], axis=-1)


def view_angle_of(depth_m: Any, disparity_px: Any, baseline_m: float, width_px: float) -> float:
    """Estimate the cameras' horizontal field of view [rad] as the median over measured distances.

    Args:
        depth_m: (rows,) measured with a ruler [m].
        disparity_px: (rows,) their disparities [px].
        baseline_m: distance between the camera centres [m].
        width_px: width of the image [px].

    Returns:
        The angle, for `ParallelPair`.

    Raises:
        InputError: as `fit`, except that disparities may be alike.
    """
    depth, disparity = _checked(depth_m, disparity_px)
    focal = np.median(depth * disparity) / baseline_m
    return 2.0 * math.atan(width_px / (2.0 * float(focal)))


class PowerLaw(msgspec.Struct, frozen=True):
    """Fitted depth D = k·xᶻ of a disparity x [px].

    Attributes:
        k_cm: the distance at one pixel of disparity [cm], the customary unit.
        z: the exponent; −1 for ideal cameras.
    """

    k_cm: float
    z: float

    def depth(self, disparity_px: Any) -> Float64:
        """Return the depths (...,) [m] of disparities (...,) [px]; NaN where one is 0 or less."""
        disparity = np.asarray(disparity_px, dtype=np.float64)
        return np.asarray(0.01 * self.k_cm * np.where(disparity > 0, disparity, np.nan) ** self.z)

    def expected_error(self, disparity_px: Any, pixels: float = 1.0) -> Float64:
        """Return the depth error |∂D/∂x| (...,) [m] for a disparity error of ``pixels`` at disparities (...,) [px].

        It is NaN where a disparity is 0 or less.
        """
        disparity = np.asarray(disparity_px, dtype=np.float64)
        return np.asarray(np.abs(self.z * self.depth(disparity) / disparity) * pixels)


def fit(depth_m: Any, disparity_px: Any) -> PowerLaw:
    """Fit k and z to measured distances: a straight line in logarithms, by least squares.

    Args:
        depth_m: (rows,) measured with a ruler [m].
        disparity_px: (rows,) [px].

    Raises:
        InputError: fewer than three distances, a distance or disparity that is not finite and above 0, cameras swapped
            (most disparities negative), or disparities that do not differ.
    """
    depth, disparity = _checked(depth_m, disparity_px)
    x, y = np.log(disparity), np.log(100.0 * depth)
    spread = x - x.mean()
    if not (spread**2).sum() > 1e-9:
        raise InputError("all disparities are alike", fix="measure at distances that differ")
    z = float((spread * y).sum() / (spread**2).sum())
    return PowerLaw(float(np.exp(y.mean() - z * x.mean())), z)


def swapped(disparity_px: Any) -> bool:
    """Return whether most finite disparities (...,) are negative: the left and right cameras are swapped.

    It is False without a finite disparity.
    """
    disparity = np.asarray(disparity_px, dtype=np.float64)
    there = disparity[np.isfinite(disparity)]
    return bool((there < 0).sum() > 0.5 * len(there)) if len(there) else False


def _checked(depth_m: Any, disparity_px: Any) -> tuple[Float64, Float64]:
    depth, disparity = np.asarray(depth_m, dtype=np.float64), np.asarray(disparity_px, dtype=np.float64)
    if len(depth) < 3:
        raise InputError(f"{len(depth)} rows", fix="measure three distances or more")
    for row, value in enumerate(depth, start=1):
        if not 0 < value < math.inf:
            raise InputError("not a distance", row=row, value=float(value), fix="give a number above 0")
    if swapped(disparity):
        raise InputError(
            "most disparities are negative: the cameras are swapped",
            value=float(np.median(disparity)),
            fix="exchange left and right",
        )
    for row, value in enumerate(disparity, start=1):
        if not 0 < value < math.inf:
            raise InputError("not a disparity", row=row, value=float(value), fix="give pixels above 0")
    return depth, disparity


class DistanceTable(msgspec.Struct, frozen=True, eq=False):
    """Measured distances compared with those calculated from disparities.

    Attributes:
        law: the fitted power law.
        measured_m: (rows,) measured distances [m].
        disparity_px: (rows,) measured disparities [px].
        calculated_m: (rows,) distances by the pinhole formula [m].
        corrected_m: (rows,) distances by the power law [m].
        expected_error_m: (rows,) distance error that an error of one pixel in disparity causes [m].
    """

    law: PowerLaw
    measured_m: Float64
    disparity_px: Float64
    calculated_m: Float64
    corrected_m: Float64
    expected_error_m: Float64

    @property
    def mean_error(self) -> float:
        """Mean relative error of the pinhole formula: |calculated − measured| / measured."""
        return float(np.mean(np.abs(self.calculated_m - self.measured_m) / self.measured_m))

    @property
    def corrected_mean_error(self) -> float:
        """Mean relative error of the power law: |corrected − measured| / measured."""
        return float(np.mean(np.abs(self.corrected_m - self.measured_m) / self.measured_m))

    def rows_cm(self) -> Float64:
        """Return the table (rows, 5): measured [cm], disparity [px], calculated, corrected and expected error [cm]."""
        lengths = (self.calculated_m, self.corrected_m, self.expected_error_m)
        return np.stack([100 * self.measured_m, self.disparity_px, *(100 * length for length in lengths)], axis=-1)


def distance_table(depth_m: Any, disparity_px: Any, pair: ParallelPair) -> DistanceTable:
    """Fit a power law and tabulate measured, calculated and corrected distances.

    Args:
        depth_m: (rows,) measured with a ruler [m].
        disparity_px: (rows,) their disparities [px].
        pair: the cameras, for the pinhole formula and the expected errors.

    Raises:
        InputError: as `fit`.
    """
    law = fit(depth_m, disparity_px)
    depth, disparity = np.asarray(depth_m, dtype=np.float64), np.asarray(disparity_px, dtype=np.float64)
    error = pair.expected_error(depth)
    return DistanceTable(law, depth, disparity, pair.depth(disparity), law.depth(disparity), error)
