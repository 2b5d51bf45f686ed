"""People who walk, exactly known at any time, and sensors that see them: for the tests of calibration."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_x, rotation_about_y
from mocapella.model.bodies import Bodies
from mocapella.model.observations import JointState
from mocapella.model.topology import topology

Float64 = NDArray[np.float64]

KINECT_V2 = topology("kinect_v2")
MIRROR = np.array(KINECT_V2.mirror)
RATE_HZ = 30.0

_HEIGHTS = {"SpineBase": 0.95, "SpineMid": 1.2, "SpineShoulder": 1.42, "Neck": 1.5, "Head": 1.65}
_SIDE = {  # across, height, forward, and how far it swings
    "Shoulder": (0.18, 1.40, 0.0, 0.0), "Elbow": (0.25, 1.15, 0.0, 0.1), "Wrist": (0.27, 0.95, 0.08, 0.2),
    "Hand": (0.27, 0.88, 0.1, 0.22), "HandTip": (0.27, 0.8, 0.12, 0.25), "Thumb": (0.23, 0.87, 0.13, 0.22),
    "Hip": (0.08, 0.92, 0.0, 0.0), "Knee": (0.1, 0.5, 0.03, 0.12), "Ankle": (0.1, 0.1, -0.02, 0.25),
    "Foot": (0.1, 0.05, 0.1, 0.25),
}  # fmt: skip


@dataclass(frozen=True)
class Walker:
    """Somebody who walks an eight, or stands where ``speed`` is 0.

    Attributes:
        centre: of the eight, (x, z) [m]. speed: along it [m/s]. phase: where on it at time 0.
        stature: [m].
    """

    centre: tuple[float, float] = (0.0, 2.8)
    speed: float = 0.7
    phase: float = 0.3
    stature: float = 1.75
    size: float = 0.8

    def at(self, t: float) -> Float64:
        """(25, 3) joints in the world, y up, floor at 0 [m]."""
        a = self.phase + self.speed / self.size * t / 1.5
        x, z = self.size * np.sin(a), self.size * np.sin(2 * a) / 2
        heading = np.arctan2(np.cos(a), np.cos(2 * a)) if self.speed else np.pi
        swing = np.sin(2 * np.pi * 0.9 * t) if self.speed else 0.0
        joints = np.zeros((25, 3))
        for name, height in _HEIGHTS.items():
            joints[KINECT_V2.index(name)] = (0.0, height, 0.02)
        for part, (across, height, forward, reach) in _SIDE.items():
            arm = -1.0 if part in ("Elbow", "Wrist", "Hand", "HandTip", "Thumb") else 1.0
            for side, sign in (("Left", 1.0), ("Right", -1.0)):
                joints[KINECT_V2.index(part + side)] = (sign * across, height, forward + sign * arm * reach * swing)
        joints *= self.stature / 1.75
        place = rigid(rotation_about_y(heading), (self.centre[0] + x, 0.0, self.centre[1] + z))
        return apply(place, joints)


@dataclass
class Sensor:
    """A sensor that sees everybody, with noise.

    Attributes:
        T_world_sensor: (4, 4). noise: standard deviation of every coordinate [m].
        clock: what its times are ahead [s]. phase: time of its first frame [s].
        mirrored: whether it swaps left and right.
        outliers: part of the joints that are anywhere within a metre.
    """

    name: str
    T_world_sensor: Float64
    noise: float = 0.0
    clock: float = 0.0
    phase: float = 0.0
    mirrored: bool = False
    outliers: float = 0.0
    seed: int = 0
    rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng([self.seed, *self.name.encode()])

    def see(self, walkers: dict[int, Walker], t: float) -> Bodies:
        """Its bodies, by tracking id, at a true time."""
        seen = []
        for body in sorted(walkers):
            p = apply(inverse(self.T_world_sensor), walkers[body].at(t))
            p = p + self.noise * self.rng.normal(size=p.shape)
            wrong = self.rng.random(len(p)) < self.outliers
            p[wrong] += self.rng.normal(size=(wrong.sum(), 3))
            seen.append(p[MIRROR] if self.mirrored else p)
        positions = np.array(seen).reshape(-1, 25, 3)
        states = np.full(positions.shape[:2], JointState.TRACKED, dtype=np.uint8)
        return Bodies(self.name, KINECT_V2, tuple(sorted(walkers)), positions, states)


def standing_at(x: float, z: float, yaw_deg: float = 0.0, height: float = 1.0, tilt_deg: float = 0.0) -> Float64:
    """``T_world_sensor`` of a sensor there; yaw as in the simulated room, tilt upwards positive."""
    turn = rotation_about_y(np.radians(yaw_deg)) @ rotation_about_x(-np.radians(tilt_deg))
    return rigid(turn, (x, height, z))


FRONT = standing_at(0.0, 0.0)
SIDE = standing_at(-2.0, 0.8, 45.0, height=1.1, tilt_deg=-3.0)
LEFT = standing_at(2.0, 0.8, -45.0, height=0.9, tilt_deg=4.0)
BACK = standing_at(0.0, 5.6, 180.0, height=1.3, tilt_deg=-5.0)


def errors(T: Float64, truth: Float64) -> tuple[float, float]:
    """How wrong a motion is [m], [rad]."""
    d = inverse(truth) @ T
    angle = np.arccos(np.clip((np.trace(d[:3, :3]) - 1) / 2, -1.0, 1.0))
    return float(np.linalg.norm(T[:3, 3] - truth[:3, 3])), float(angle)
