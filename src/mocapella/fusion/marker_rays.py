"""Track markers in space with cameras that are not synchronised and have rolling shutters.

A camera's pixel of a marker is an observation at its own time: the frame's time plus the readout time of its row, on
the rig's clock. Every marker has an extended Kalman filter of its position and velocity (white-noise acceleration:
Bar-Shalom, Li, Kirubarajan: Estimation with Applications to Tracking and Navigation, 2001, sections 6.2.2 and 10.3),
which takes the pixels of all cameras in order of time. So nothing is triangulated from observations at different
times, and a marker that one camera has lost is still tracked along the other's ray, with growing uncertainty.
Observations are stored for a while and filtered again with each new one, so that a late one is inserted in order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError, one_of
from mocapella.geometry.triangulation import Views, views
from mocapella.model.camera import CameraRig, PlacedCamera
from mocapella.settings import check

Float64 = NDArray[np.float64]
MEMORY = 16
"""Largest number of a marker's stored observations, which are filtered again when a late one comes."""


class RayState(IntEnum):
    """State of a marker's 3D point: seen, predicted, or unknown."""

    TRACKED = 0
    """Seen by two or more cameras in the last ``alone_s``."""
    INFERRED = 1
    """Seen by at most one camera in that time; predicted by its motion."""
    LOST = 2
    """Unknown: NaN."""


@dataclass(frozen=True)
class MarkerRaysSettings:
    """Motion of markers, and gating of observations.

    Attributes:
        acceleration_density: power spectral density of the white-noise acceleration along an axis; larger: less lag,
            more jitter [m²/s³].
        speed_sd: standard deviation of a new marker's speed along an axis; larger: its motion is followed sooner, with
            more jitter at first [m/s].
        gate_sd: an observation with a larger innovation is rejected; larger: sudden motion is followed, but wrong
            detections are used, too [standard deviations].
        keep_s: an observation that is older than the marker's newest one by more than this is dropped; larger: later
            cameras count, at more work [s].
        together_s: largest time between the observations of two cameras that initialise a marker [s].
        image_speed_px: assumed speed of a marker in an image; in initialising, the standard deviation of an older
            observation grows by it with time [px/s].
        least_angle_rad: least angle between the rays of two cameras that initialise a marker; smaller: markers are
            found farther away, at less certain depths [rad].
        alone_s: a marker that only one camera has seen for this long is inferred [s].
        forget_after_s: a marker unseen for this long is lost [s].
        largest_sd_m: an inferred marker is lost if the standard deviation of a coordinate is larger; larger: it is
            predicted for longer [m].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    acceleration_density: float = 20.0
    speed_sd: float = 2.0
    gate_sd: float = 5.0
    keep_s: float = 0.06
    together_s: float = 0.05
    image_speed_px: float = 1500.0
    least_angle_rad: float = math.radians(0.5)
    alone_s: float = 0.08
    forget_after_s: float = 0.3
    largest_sd_m: float = 0.1

    def __post_init__(self) -> None:
        check(0 < self.acceleration_density < 1e9, "acceleration_density", self.acceleration_density, "above 0 m²/s³")
        check(0 < self.speed_sd < 1e3, "speed_sd", self.speed_sd, "above 0 m/s")
        check(0 < self.gate_sd < 1e6, "gate_sd", self.gate_sd, "above 0")
        check(0 <= self.keep_s < 1e3, "keep_s", self.keep_s, "0 s or more")
        check(0 <= self.together_s < 1e3, "together_s", self.together_s, "0 s or more")
        check(0 <= self.image_speed_px < 1e9, "image_speed_px", self.image_speed_px, "0 px/s or more")
        check(0 <= self.least_angle_rad < math.pi / 2, "least_angle_rad", self.least_angle_rad, "0 to below π/2")
        check(0 < self.alone_s < 1e3, "alone_s", self.alone_s, "above 0 s")
        check(0 < self.forget_after_s < 1e3, "forget_after_s", self.forget_after_s, "above 0 s")
        check(0 < self.largest_sd_m < 1e3, "largest_sd_m", self.largest_sd_m, "above 0 m")


class RayMemory(NamedTuple):
    """State of all markers, for the kernels; one row per marker.

    Attributes:
        states, covariances: (points, 6), (points, 6, 6) position [m] and velocity [m/s] in the world, at ``begins``,
            and their covariance.
        begins: (points,) time of the state, on the rig's clock [s]; NaN for a lost marker.
        counts: (points,) number of stored observations.
        times, cameras, pixels, variances: (points, MEMORY), (points, MEMORY), (points, MEMORY, 2), (points, MEMORY) the
            stored observations in the order of time: capture time on the rig's clock [s], index of the camera, pixel
            [px] and variance of a coordinate [px²].
        used_s: (points, cameras) capture time of the newest used observation of each camera [s]; −inf if none.
        refused: (points,) number of rejected observations in a row.
    """

    states: Float64
    covariances: Float64
    begins: Float64
    counts: NDArray[np.int64]
    times: Float64
    cameras: NDArray[np.int64]
    pixels: Float64
    variances: Float64
    used_s: Float64
    refused: NDArray[np.int64]


class RayParameters(NamedTuple):
    """The values of `MarkerRaysSettings` for the kernels.

    Attributes:
        least_sin2: squared sine of ``least_angle_rad``. The other fields are the settings of the same names and units.
    """

    acceleration_density: float
    speed_sd: float
    gate_sd: float
    keep_s: float
    together_s: float
    image_speed_px: float
    least_sin2: float
    alone_s: float
    forget_after_s: float
    largest_sd_m: float


class CameraPixels(NamedTuple):
    """One camera's frame, for the kernels.

    Attributes:
        camera: index of the camera.
        pixels: (points, 2) [px]; NaN where not seen.
        variances: (points,) variance of a pixel's coordinate [px²].
        times: (points,) capture times of the pixels' rows, on the rig's clock [s].
    """

    camera: int
    pixels: Float64
    variances: Float64
    times: Float64


class RayOutput(NamedTuple):
    """Arrays that the kernel writes, for `MarkerPoints`; NaN where a marker is lost.

    Attributes:
        positions, velocities: (points, 3) in the world [m], [m/s].
        covariances: (points, 3, 3) covariance of the positions [m²].
        states: (points,) a `RayState`.
    """

    positions: Float64
    velocities: Float64
    covariances: Float64
    states: NDArray[np.uint8]


class MarkerPoints(msgspec.Struct, frozen=True, eq=False):
    """Markers at one time.

    Attributes:
        at_s: the time, on the rig's clock [s].
        points: (points, 3) in the world [m]; NaN where lost.
        velocities: (points, 3) in the world [m/s]; NaN where lost.
        covariances: (points, 3, 3) covariance of the points in the world [m²]; NaN where lost.
        states: (points,) a `RayState`.
    """

    at_s: float
    points: Float64
    velocities: Float64
    covariances: Float64
    states: NDArray[np.uint8]


class RayReport(msgspec.Struct, frozen=True):
    """Counts of the observations so far.

    Attributes:
        received: number of observations with a pixel, a standard deviation and a time.
        used, refused, late: number used by the filters, rejected by the gate, and too old to be inserted.
        begun, forgotten: how often a marker was initialised, and lost.
        frames_late: number of frames not later than an earlier received one of the same camera.
    """

    received: int
    used: int
    refused: int
    late: int
    begun: int
    forgotten: int
    frames_late: int


class MarkerRays:
    """Tracker of a fixed set of markers with a rig's cameras: a Kalman filter for each marker.

    A filter's stored state is somewhat old: the observations since then are stored, too, in order of time, and filtered
    again for each result. `RayMemory` describes all arrays.

    Args:
        rig: the cameras' lenses, poses, clock offsets and readout times.
        points: number of markers; a marker's index identifies it in every array.
        settings: motion of markers, and gates; the defaults if None.
    """

    def __init__(self, rig: CameraRig, points: int, settings: MarkerRaysSettings | None = None) -> None:
        self.settings = settings or MarkerRaysSettings()
        self.rig = rig
        self._order = list(rig.cameras)
        self._views = views_of(rig)
        self._points = points
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        n, cameras = self._points, len(self._order)
        self._states, self._covariances = np.zeros((n, 6)), np.zeros((n, 6, 6))
        self._begins, self._counts = np.full(n, np.nan), np.zeros(n, dtype=np.int64)
        self._times, self._cameras = np.zeros((n, MEMORY)), np.zeros((n, MEMORY), dtype=np.int64)
        self._pixels, self._variances = np.zeros((n, MEMORY, 2)), np.zeros((n, MEMORY))
        self._used_s, self._refused = np.full((n, cameras), -np.inf), np.zeros(n, dtype=np.int64)
        self._counted = np.zeros(6, dtype=np.int64)
        self._frames_late = 0
        self._newest_s, self._frame_s = -math.inf, np.full(cameras, -np.inf)

    @property
    def report(self) -> RayReport:
        """Counts of pixels (used, rejected by the gate, late) and of markers since the last `reset`."""
        received, used, refused, late, begun, forgotten = map(int, self._counted)
        return RayReport(received, used, refused, late, begun, forgotten, self._frames_late)

    def update(self, camera: str, pixels: Any, sd_px: Any, at_s: float) -> MarkerPoints:
        """Update the markers with a camera's frame; return them at the newest time of any camera, see `at`.

        Frames may come in any order. Observations that are too old (``keep_s``) or too far off (``gate_sd``) are only
        counted in `report`. A lost marker begins again once two cameras have seen it.

        Args:
            camera: its name in the rig.
            pixels: (points, 2) x, y in its distorted image [px]; NaN where a marker is not seen.
            sd_px: standard deviation of a pixel's coordinate, a number or (points,); a pixel where it is not finite and
                above 0 is ignored [px].
            at_s: capture time of the image's first row, on the camera's clock [s].

        Raises:
            SettingsError: there is no such camera, or another number of points.
        """
        if camera not in self.rig.cameras:
            raise SettingsError(f"camera {camera!r} is not of the rig; known: {one_of(camera, self._order)}")
        seen = np.ascontiguousarray(pixels, dtype=np.float64)
        if seen.shape != (self._points, 2):
            raise SettingsError(
                f"pixels of the shape {seen.shape}; there are {self._points} points: ({self._points}, 2)"
            )
        k = self._order.index(camera)
        if at_s <= self._frame_s[k]:
            self._frames_late += 1
        self._frame_s[k] = max(self._frame_s[k], at_s)
        times = captured(self.rig.cameras[camera], seen[:, 1], at_s)
        variances = np.empty(self._points)
        variances[:] = np.square(sd_px)
        frame = CameraPixels(k, seen, variances, times)
        _kernels().observe(frame, self._memory, self._views.numbers, self._counted, _parameters(self.settings))
        # A frame without markers advances the time as well, so that lost markers expire.
        first_row_s = float(at_s - self.rig.cameras[camera].clock_s)
        self._newest_s = max(self._newest_s, first_row_s, *times[np.isfinite(times)].tolist())
        return self.at(self._newest_s)

    def at(self, at_s: float) -> MarkerPoints:
        """Predict the markers to the time ``at_s`` on the rig's clock [s], from all observations.

        A marker that is lost at that time (see `MarkerRaysSettings`) is also reset, so a time far ahead loses all.

        Returns:
            New arrays, with all markers by index; lost ones are NaN.
        """
        n = self._points
        points, velocities, covariances = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3, 3))
        states = np.empty(n, dtype=np.uint8)
        _kernels().locate(
            float(at_s), self._memory, self._views.numbers, self._counted, _parameters(self.settings),
            RayOutput(points, velocities, covariances, states),
        )  # fmt: skip
        return MarkerPoints(at_s, points, velocities, covariances, states)

    @property
    def _memory(self) -> RayMemory:
        return RayMemory(
            self._states, self._covariances, self._begins, self._counts, self._times, self._cameras, self._pixels,
            self._variances, self._used_s, self._refused,
        )  # fmt: skip


@cache
def _parameters(s: MarkerRaysSettings) -> RayParameters:
    """Return the settings for the kernels; as floats, for which alone these are compiled."""
    least_sin2 = math.sin(s.least_angle_rad) ** 2
    return RayParameters(*map(float, (
        s.acceleration_density, s.speed_sd, s.gate_sd, s.keep_s, s.together_s, s.image_speed_px, least_sin2, s.alone_s,
        s.forget_after_s, s.largest_sd_m,
    )))  # fmt: skip


def captured(camera: PlacedCamera, rows_px: Any, at_s: float) -> Float64:
    """Return the capture times (...,) of a frame's rows, on the rig's clock [s].

    Args:
        camera: whose clock offset and readout time are used.
        rows_px: (...,) image rows, from 0 [px]; NaN gives NaN.
        at_s: capture time of the first row, on the camera's own clock [s].
    """
    height = camera.camera.size_px[1]
    rows = np.asarray(rows_px, dtype=np.float64)
    return np.asarray(at_s - camera.clock_s + rows * (camera.camera.readout_s / max(height - 1, 1)))


def views_of(rig: CameraRig) -> Views:
    """Return the cameras of a rig for `geometry.triangulation`, in its order."""
    cameras = list(rig.cameras.values())
    return views([c.camera.lens for c in cameras], [c.T_camera_world for c in cameras])


@cache
def _kernels() -> Any:
    """Return the compiled steps; numba is imported at the first use."""
    from mocapella.fusion import ray_kernels

    return ray_kernels
