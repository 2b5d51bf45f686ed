"""Noise models of depth cameras: noise, quantisation, shadows, holes and edge effects.

**Structured light** (`StructuredLight`): the standard deviation of depth is that of C. Nguyen, S. Izadi, D. Lovell,
"Modeling Kinect sensor noise for improved 3D reconstruction and tracking" (3DIMPVT 2012), equations 3 and 4; it grows
with z², as triangulation's does: K. Khoshelham, S. Elberink, "Accuracy and resolution of Kinect depth data for indoor
mapping applications" (Sensors 12, 2012), equation 11. Depth is rounded to whole steps of 1/z (their section 3.3).
Surfaces in the projector's shadow are not measured. Edges are displaced by their lateral noise of 0.8 px and have
holes, as do surfaces at grazing angles: T. Mallick, P. Das, A. Majumdar, "Characterizations of noise in Kinect depth
images: a review" (IEEE Sensors J. 14, 2014), section IV.

**Time of flight** (`TimeOfFlight`): the standard deviation is inverse to the amplitude, which falls with z² and the
angle; if a pixel sees two surfaces, their light adds up as phasors, which gives depths between them (flying pixels);
the light's odd harmonics make depth wiggle four times a period: S. Foix, G. Alenyà, C. Torras, "Lock-in time-of-flight
(ToF) cameras: a survey" (IEEE Sensors J. 11, 2011), sections II and III; M. Lindner, A. Kolb, "Lateral and depth
calibration of PMD-distance sensors" (ISVC 2006).

**Stereo** (`Stereo`): two cameras match blocks of pixels, so neighbours within a block have nearly the same error, of a
standard deviation in disparity: L. Keselman et al., "Intel RealSense stereoscopic depth cameras" (CVPR workshops 2017),
sections 3 and 5. A block that holds an edge is matched by its nearer side, which makes things wider by up to half a
block ("foreground fattening"): D. Scharstein, R. Szeliski, "A taxonomy and evaluation of dense two-frame stereo
correspondence algorithms" (IJCV 47, 2002), section 3.2. What the second camera does not see has no depth.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.special import ndtr, ndtri

from mocapella.settings import check

Float32 = NDArray[np.float32]
UInt16 = NDArray[np.uint16]


@dataclass(frozen=True)
class StructuredLight:
    """A camera that projects a pattern and triangulates; the defaults model the first Kinect.

    Attributes:
        least_m, most_m: range of measured depths [m].
        sd_m: standard deviation of depth at `sd_least_at_m`, at normal incidence [m].
        sd_per_m: growth of the standard deviation with the squared distance from there [1/m].
        sd_least_at_m: depth with the least standard deviation [m].
        sd_angle: factor of the term for the angle of incidence θ: this · z^−½ · θ²/(π/2 − θ)² [m^1.5].
        step_per_m: quantisation step of the inverse depth 1/z [1/m]; 0 for none.
        shared: fraction of the variance that neighbouring pixels have in common.
        shared_px: size of such a neighbourhood [px].
        edge_px: standard deviation of an edge's displacement [px].
        edge: relative change of depth within 2 px that makes an edge.
        edge_holes: fraction of the pixels at edges that are not measured.
        steep_deg: angle of incidence from which some pixels are lost, and angle from which all are lost [deg].
        dropout: fraction of all pixels that are lost at random.
        baseline_m: position of the projector along the camera's x axis [m].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    least_m: float = 0.4
    most_m: float = 4.0
    sd_m: float = 0.0012
    sd_per_m: float = 0.0019
    sd_least_at_m: float = 0.4
    sd_angle: float = 0.0001
    step_per_m: float = 0.0030711016
    shared: float = 0.4
    shared_px: int = 4
    edge_px: float = 0.8
    edge: float = 0.02
    edge_holes: float = 0.25
    steep_deg: tuple[float, float] = (70.0, 88.0)
    dropout: float = 0.001
    baseline_m: float = 0.075

    def __post_init__(self) -> None:
        check(0 < self.least_m < self.most_m <= 20, "least_m", (self.least_m, self.most_m), "above 0 and below most_m")
        for name in ("sd_m", "sd_per_m", "sd_least_at_m", "sd_angle", "step_per_m", "edge_px", "edge"):
            value = getattr(self, name)
            check(0 <= value < 10, name, value, "0 or more, below 10")
        for name in ("shared", "edge_holes", "dropout"):
            value = getattr(self, name)
            check(0 <= value <= 1, name, value, "from 0 to 1")
        check(1 <= self.shared_px <= 64, "shared_px", self.shared_px, "1 to 64")
        check(0 <= self.steep_deg[0] < self.steep_deg[1] <= 90, "steep_deg", self.steep_deg, "rising, within 0 to 90")
        check(0.001 <= abs(self.baseline_m) <= 1, "baseline_m", self.baseline_m, "1 mm to 1 m to either side")

    def sd_at(self, z: float, angle: float = 0.0) -> float:
        """Return the standard deviation of a depth z [m] at an angle of incidence [rad]."""
        more = self.sd_angle / math.sqrt(z) * angle**2 / (0.5 * math.pi - min(angle, 1.45)) ** 2
        return self.sd_m + self.sd_per_m * (z - self.sd_least_at_m) ** 2 + more


@dataclass(frozen=True)
class TimeOfFlight:
    """A camera that measures the phase of modulated light.

    Attributes:
        least_m, most_m: range of measured depths [m].
        sd_at_1m: standard deviation of depth at 1 m and normal incidence; elsewhere this · z² / cos θ [m].
        faintest: least measurable amplitude, relative to the amplitude at 1 m and normal incidence.
        spread: fraction of a pixel's light that falls into its neighbours, along each axis.
        low_hz: lowest modulation frequency, which determines the unambiguous range [Hz].
        wiggle_m: amplitude of the periodic error [m].
        wiggle_hz: modulation frequency that causes the periodic error [Hz].
        dropout: fraction of all pixels that are lost at random.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    least_m: float = 0.4
    most_m: float = 4.5
    sd_at_1m: float = 0.0017
    faintest: float = 0.05
    spread: float = 0.3
    low_hz: float = 16e6
    wiggle_m: float = 0.002
    wiggle_hz: float = 80e6
    dropout: float = 0.0005

    def __post_init__(self) -> None:
        check(0 < self.least_m < self.most_m <= 20, "least_m", (self.least_m, self.most_m), "above 0 and below most_m")
        for name in ("spread", "dropout"):
            value = getattr(self, name)
            check(0 <= value <= 1, name, value, "from 0 to 1")
        for name in ("sd_at_1m", "faintest", "wiggle_m"):
            value = getattr(self, name)
            check(0 <= value < 1, name, value, "0 or more, below 1")
        reach = 299792458.0 / (2 * self.low_hz) if self.low_hz > 0 else 0.0
        check(reach > self.most_m, "low_hz", self.low_hz, f"low enough for {self.most_m} m to be within a period")
        check(0 <= self.wiggle_hz <= 1e9, "wiggle_hz", self.wiggle_hz, "0 to 1e9 Hz")


@dataclass(frozen=True)
class Stereo:
    """Two cameras that match blocks of a textured image; the defaults model a RealSense D435 of 640 × 480 pixels.

    Attributes:
        least_m, most_m: range of measured depths [m].
        baseline_m: position of the second camera along the first one's x axis [m].
        block_px: width of a matched block [px].
        sd_px: standard deviation of the disparity [px].
        fatten: growth of things on each side, in half blocks, from 0 to 1.
        unmatched: share of the surface, in pieces of a block's size, that is not matched.
        edge_unmatched: the same where a block holds an edge.
        step_px: rounding step of the disparity [px].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    least_m: float = 0.28
    most_m: float = 4.0
    baseline_m: float = 0.05
    block_px: int = 9
    sd_px: float = 0.1
    fatten: float = 0.8
    unmatched: float = 0.01
    edge_unmatched: float = 0.1
    step_px: float = 1 / 32

    def __post_init__(self) -> None:
        check(0 < self.least_m < self.most_m <= 20, "least_m", (self.least_m, self.most_m), "above 0 and below most_m")
        check(0.001 <= abs(self.baseline_m) <= 1, "baseline_m", self.baseline_m, "1 mm to 1 m to either side")
        check(1 <= self.block_px <= 31, "block_px", self.block_px, "1 to 31")
        check(0 <= self.sd_px < 10, "sd_px", self.sd_px, "0 or more, below 10")
        check(0 < self.step_px < 1, "step_px", self.step_px, "above 0, below 1")
        for name in ("fatten", "unmatched", "edge_unmatched"):
            check(0 <= getattr(self, name) <= 1, name, getattr(self, name), "from 0 to 1")


DepthNoise = StructuredLight | TimeOfFlight | Stereo


def measured(
    exact_m: Float32, slope: Float32, noise: DepthNoise | None, *, focal_px: float, unit_m: float,
    key: int,
) -> UInt16:  # fmt: skip
    """Apply a camera's noise to exact depths; return the image (height, width) uint16 in units, a new array.

    A pixel is 0 without a measurement, such as beyond the camera's range or, without noise, above 65535 units.

    Args:
        exact_m: (height, width) exact depths [m]; infinite without a surface.
        slope: (height, width) cosine of the angle between the surface's normal and the ray.
        noise: noise model of the camera; None for a perfect camera, whose depths are only rounded.
        focal_px: focal length along x, for the projector's shadow [px].
        unit_m: length of a unit of the result [m].
        key: key of the random numbers; the same key gives the same noise.
    """
    out = np.zeros(exact_m.shape, np.uint16)
    if noise is None:
        units = np.rint(np.where(np.isfinite(exact_m), exact_m, 0.0) / unit_m)
        return np.where(units <= np.iinfo(np.uint16).max, units, 0).astype(np.uint16)
    seed = np.uint64(key % (1 << 64))
    if isinstance(noise, StructuredLight):
        lit = np.empty(exact_m.shape, np.bool_)
        _kernels().light_reaches(exact_m, focal_px * noise.baseline_m, lit)
        values = _kernels().StructuredLightNoise(
            *map(float, (noise.least_m, noise.most_m, noise.sd_m, noise.sd_per_m, noise.sd_least_at_m, noise.sd_angle)),
            float(noise.step_per_m), float(noise.shared), int(noise.shared_px),
            *map(float, (noise.edge_px, noise.edge, noise.edge_holes, *np.radians(noise.steep_deg), noise.dropout)),
        )  # fmt: skip
        _kernels().structured_light(exact_m, slope, lit, seed, values, unit_m, out)
    elif isinstance(noise, Stereo):
        depth = _matched(exact_m, noise, focal_px, key)
        out[:] = np.minimum(np.rint(depth / unit_m), np.iinfo(np.uint16).max)
    else:
        values = _kernels().TimeOfFlightNoise(*map(float, astuple(noise)))
        _kernels().time_of_flight(exact_m, slope, seed, values, unit_m, out)
    return out


def _matched(exact_m: Float32, noise: Stereo, focal_px: float, key: int) -> Float32:
    """Return the depths (height, width) that a stereo camera matches [m]; 0 without a match."""
    rng = np.random.default_rng(key)
    half, shape = noise.block_px // 2, exact_m.shape
    lit = np.empty(shape, np.bool_)
    _kernels().light_reaches(exact_m, focal_px * noise.baseline_m, lit)
    block = max(noise.block_px / 2.355, 0.3)

    def blobs() -> Float32:
        rough = ndimage.gaussian_filter(rng.standard_normal(shape, np.float32), block)
        return np.asarray(rough / max(float(rough.std()), 1e-12), dtype=np.float32)

    wide = exact_m
    for reach in range(1, half + 1):  # the edge is ragged: not every block is won by the nearer side
        wins = blobs() < ndtri(noise.fatten) if reach * noise.fatten > 0 else np.zeros(shape, np.bool_)
        wide = np.where(wins, ndimage.minimum_filter(wide, 3), wide)
    edge = wide != exact_m
    lost = np.where(edge, noise.edge_unmatched, noise.unmatched)
    there = np.isfinite(wide) & (lit | edge) & (ndtr(blobs()) >= lost)
    disparity = focal_px * abs(noise.baseline_m) / np.where(there, wide, 1.0)
    disparity = np.rint((disparity + noise.sd_px * blobs()) / noise.step_px) * noise.step_px
    depth = focal_px * abs(noise.baseline_m) / np.maximum(disparity, 1e-6)
    return np.where(there & (depth >= noise.least_m) & (depth <= noise.most_m), depth, 0.0).astype(np.float32)


@cache
def _kernels() -> Any:
    """Import the kernels, and numba, on first use."""
    from mocapella.sources.simulate import depth_noise_kernels

    return depth_noise_kernels
