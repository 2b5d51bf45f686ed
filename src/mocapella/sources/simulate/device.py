"""Settings of a simulated Kinect v2: its pose, its image, its clock and its noise.

The noise of a joint is modelled along the optical axis and across the image, or replaced by measured errors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.geometry.rigid import rigid, rotation_about_x, rotation_about_y, rotation_about_z
from mocapella.model.observations import Edge, check_sensor_name
from mocapella.settings import check

Float64 = NDArray[np.float64]

ERRORS = ("model", "kinect-v2-measured")
"""Sources of a sensor's errors."""


@dataclass(frozen=True)
class Noise:
    """Noise model of the joints; ``docs/simulation.md`` gives its sources.

    Attributes:
        axial_gain: ratio of a joint's noise along the optical axis to the depth camera's.
        lateral_px: standard deviation across the image [px], the same at every distance.
        inferred_gain: factor of the noise of an inferred joint.
        inferred_bias: length of the constant error of an inferred joint, in a random direction per joint [m].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    axial_gain: float = 1.5
    lateral_px: float = 0.35
    inferred_gain: float = 4.0
    inferred_bias: float = 0.05

    def __post_init__(self) -> None:
        for name in ("axial_gain", "lateral_px", "inferred_gain", "inferred_bias"):
            check(0 <= getattr(self, name) <= 100, name, getattr(self, name), "from 0 to 100")


@dataclass(frozen=True)
class SensorSettings:
    """Settings of a simulated sensor: pose, image, clock, latency and errors.

    Room time is the simulation's true time, from 0.

    Attributes:
        name: name of the sensor, as in its frames.
        position: position of the lens in the world; the second coordinate is the height above the floor [m].
        yaw_deg: rotation about the vertical; 0 looks along the world's z, growing towards x (the sensor's left) [deg].
        tilt_deg: tilt, upwards positive [deg].
        roll_deg: rotation about the optical axis; positive lifts the sensor's left side, 180 is upside down. Frames do
            not report it: their tilt and height are those of a sensor that stands upright [deg].
        fov_deg: horizontal and vertical field of view [deg].
        range_m: nearest and farthest depth along the optical axis [m].
        depth_size_px: width and height of the depth image [px].
        rate_hz: frame rate [Hz].
        phase_s: room time of frame 0 [s].
        clock_offset_s: time on the sensor's clock at room time 0 [s].
        clock_drift_ppm: drift of the sensor's clock relative to room time [ppm].
        latency_s: delay from the capture of a frame to its arrival at the node [s].
        latency_jitter_s: standard deviation of the latency, cut at three standard deviations [s].
        lost: fraction of frames that are lost, 0 to 1.
        max_bodies: number of people tracked at once; a Kinect v2 tracks 6.
        forget_s: how long a hidden joint is inferred before it counts as not tracked [s].
        mirror_beyond_deg: angle of the facing away from the sensor beyond which it takes a person's back for the front
            [deg].
        noise: noise of the joints, if ``errors`` is ``model``.
        errors: ``model``, or ``kinect-v2-measured``: `mocapella.sources.simulate.measured` in place of ``noise`` and
            ``mirror_beyond_deg``, with its losses of people and its errors of tilt and height.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    name: str
    position: tuple[float, float, float] = (0.0, 1.0, 0.0)
    yaw_deg: float = 0.0
    tilt_deg: float = 0.0
    roll_deg: float = 0.0
    fov_deg: tuple[float, float] = (70.6, 60.0)
    range_m: tuple[float, float] = (0.5, 4.5)
    depth_size_px: tuple[int, int] = (512, 424)
    rate_hz: float = 30.0
    phase_s: float = 0.0
    clock_offset_s: float = 0.0
    clock_drift_ppm: float = 0.0
    latency_s: float = 0.06
    latency_jitter_s: float = 0.003
    lost: float = 0.0
    max_bodies: int = 6
    forget_s: float = 2.0
    mirror_beyond_deg: float = 120.0
    noise: Noise = field(default_factory=Noise)
    errors: str = "model"

    def __post_init__(self) -> None:
        check_sensor_name(self.name)
        check(all(math.isfinite(x) for x in self.position), "position", self.position, "three finite numbers")
        check(self.position[1] >= 0, "position", self.position, "on or above the floor")
        check(-90 < self.tilt_deg < 90, "tilt_deg", self.tilt_deg, "within ±90")
        check(-180 <= self.roll_deg <= 180, "roll_deg", self.roll_deg, "from -180 to 180")
        check(all(0 < a < 180 for a in self.fov_deg), "fov_deg", self.fov_deg, "between 0 and 180")
        check(0 < self.range_m[0] < self.range_m[1], "range_m", self.range_m, "a nearest and a greater farthest depth")
        check(all(n > 0 for n in self.depth_size_px), "depth_size_px", self.depth_size_px, "positive")
        check(1 <= self.rate_hz <= 1000, "rate_hz", self.rate_hz, "from 1 to 1000")
        check(0 <= self.phase_s < 1 / self.rate_hz, "phase_s", self.phase_s, "from 0 to less than one frame's duration")
        check(abs(self.clock_offset_s) < 1e9, "clock_offset_s", self.clock_offset_s, "within ±1e9")
        check(abs(self.clock_drift_ppm) <= 10_000, "clock_drift_ppm", self.clock_drift_ppm, "within ±10000")
        check(0 <= self.latency_s <= 10, "latency_s", self.latency_s, "from 0 to 10")
        most = 1 / self.rate_hz / 6
        jitter = self.latency_jitter_s
        check(0 <= jitter <= most, "latency_jitter_s", jitter, f"from 0 to {most:.4f}, or frames would overtake")
        check(0 <= self.lost < 1, "lost", self.lost, "from 0 to less than 1")
        check(self.max_bodies >= 1, "max_bodies", self.max_bodies, "1 or more")
        check(0 <= self.forget_s <= 60, "forget_s", self.forget_s, "from 0 to 60")
        beyond = self.mirror_beyond_deg
        check(0 <= beyond <= 180, "mirror_beyond_deg", beyond, "from 0 to 180")
        check(self.errors in ERRORS, "errors", self.errors, " or ".join(ERRORS))

    @property
    def focal_px(self) -> tuple[float, float]:
        """Focal lengths along x and y at which the image covers the field of view [px]."""
        (width, height), (across, up) = self.depth_size_px, self.fov_deg
        return width / 2 / math.tan(math.radians(across) / 2), height / 2 / math.tan(math.radians(up) / 2)

    @property
    def T_world_sensor(self) -> Float64:  # noqa: N802 - the field's notation
        """(4, 4) from the camera frame to the world: roll about its z, tilt about x, then yaw, then translation."""
        yaw, tilt, roll = math.radians(self.yaw_deg), math.radians(self.tilt_deg), math.radians(self.roll_deg)
        return rigid(rotation_about_y(yaw) @ rotation_about_x(-tilt) @ rotation_about_z(roll), self.position)

    def project(self, points: Float64) -> Float64:
        """Project points (..., 3) in the camera frame [m] to pixels (..., 2) [px]; u grows with x, v downwards.

        (0, 0) is the image's corner. NaN for a point that is not in front of the lens.
        """
        (fx, fy), (width, height) = self.focal_px, self.depth_size_px
        depth = np.where(points[..., 2] > 1e-6, points[..., 2], np.nan)
        u = width / 2 + fx * points[..., 0] / depth
        v = height / 2 - fy * points[..., 1] / depth
        return np.stack([u, v], axis=-1)

    def in_view(self, points: Float64, pixels: Float64) -> NDArray[np.bool_]:
        """Return whether points are in field of view and range (...,); False for NaN. Occlusion is not considered.

        ``points`` (..., 3) are in the camera frame [m], ``pixels`` (..., 2) their projections [px].
        """
        inside = (pixels >= 0) & (pixels <= self.depth_size_px)
        depth = points[..., 2]
        return np.asarray(inside.all(axis=-1) & (depth >= self.range_m[0]) & (depth <= self.range_m[1]))

    def clipped_edges(self, pixels: Float64) -> NDArray[np.uint8]:
        """Return the `Edge` bits (bodies,) of the image edges that bodies extend beyond.

        ``pixels`` (bodies, joints, 2) are the joints' projections [px].
        """
        u, v, (width, height) = pixels[..., 0], pixels[..., 1], self.depth_size_px
        over = ((u > width, Edge.RIGHT), (u < 0, Edge.LEFT), (v < 0, Edge.TOP), (v > height, Edge.BOTTOM))
        return np.asarray(sum(np.where(out.any(axis=-1), np.uint8(bit), np.uint8(0)) for out, bit in over))

    def clock_ns(self, room_ns: int) -> int:
        """Return the time on the sensor's own clock, with offset and drift, at a room time (true time) [ns]."""
        return round(self.clock_offset_s * NS_PER_S) + room_ns + round(room_ns * self.clock_drift_ppm * 1e-6)

    def frame_ns(self, index: int) -> int:
        """Return the room time (true time) at which the frame of an index, from 0, is captured [ns]."""
        # In integers: with times since 1970, a float would be wrong by some hundred nanoseconds.
        rate = Fraction(self.rate_hz).limit_denominator(1_000_000)
        return round(self.phase_s * NS_PER_S) + index * NS_PER_S * rate.denominator // rate.numerator


def axial_noise(depth: Float64, oblique: Float64) -> Float64:
    """Return the standard deviation of a Kinect v2's depth [m], at a depth [m] and an angle of incidence [rad].

    P. Fankhauser et al., "Kinect v2 for Mobile Robot Navigation: Evaluation and Modeling" (ICAR 2015), the axial
    noise model: 1.5 − 0.5 z + 0.3 z² + 0.1 z^(3/2) θ² / (π/2 − θ)² millimetres. θ is limited to 75°, the end of the
    measurements.
    """
    theta = np.minimum(oblique, math.radians(75))
    grazing = 0.1 * depth**1.5 * theta**2 / (math.pi / 2 - theta) ** 2
    return np.asarray(1e-3 * (1.5 - 0.5 * depth + 0.3 * depth**2 + grazing))
