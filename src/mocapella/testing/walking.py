"""People who walk along known paths, and sensors that see their skeletons: frames with an exact ground truth.

    arrivals = walking_arrivals({1: Walker(), 2: Walker(centre=(0.8, 3.4), phase=2.0)}, 4.0)
    scenes = check_tracker(lambda: make_tracker("default", sensors_expected=2), arrivals)

`mocapella.sources.simulate` renders occlusion and a sensor's real errors; this module has neither.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_x, rotation_about_y
from mocapella.model.bodies import Bodies
from mocapella.model.observations import Arrival, BodyFrame, JointState, body_frame
from mocapella.model.topology import topology

Float64 = NDArray[np.float64]

KINECT_V2: Final = topology("kinect_v2")
MIRROR: Final = np.array(KINECT_V2.mirror)
RATE_HZ: Final = 30.0

_CENTRE = {"SpineBase": 0.95, "SpineMid": 1.2, "SpineShoulder": 1.42, "Neck": 1.5, "Head": 1.65}  # height [m]
_SIDE = {  # across, height, forward, and amplitude of the swing [m]; arms swing against the legs
    "Shoulder": (0.18, 1.40, 0.0, 0.0), "Elbow": (0.25, 1.15, 0.0, -0.1), "Wrist": (0.27, 0.95, 0.08, -0.2),
    "Hand": (0.27, 0.88, 0.1, -0.22), "HandTip": (0.27, 0.8, 0.12, -0.25), "Thumb": (0.23, 0.87, 0.13, -0.22),
    "Hip": (0.08, 0.92, 0.0, 0.0), "Knee": (0.1, 0.5, 0.03, 0.12), "Ankle": (0.1, 0.1, -0.02, 0.25),
    "Foot": (0.1, 0.05, 0.1, 0.25),
}  # fmt: skip


def _standing_and_swing() -> tuple[Float64, Float64]:
    """Joints (25, 3) of a person 1.75 m tall who faces +z, and the amplitudes (25,) of their swing along z [m]."""
    joints, amplitudes = np.zeros((25, 3)), np.zeros(25)
    for name, height in _CENTRE.items():
        joints[KINECT_V2.index(name)] = (0.0, height, 0.02)
    for part, (across, height, forward, amplitude) in _SIDE.items():
        for side, sign in (("Left", 1.0), ("Right", -1.0)):
            joints[KINECT_V2.index(part + side)] = (sign * across, height, forward)
            amplitudes[KINECT_V2.index(part + side)] = sign * amplitude
    return joints, amplitudes


_STANDING, _SWING = _standing_and_swing()


@dataclass(frozen=True)
class Walker:
    """A person who walks a figure of eight, or stands and faces -z, towards `FRONT`, if ``speed`` is 0.

    Attributes:
        centre: centre of the figure of eight, (x, z) in the world [m].
        speed: approximate greatest speed along the figure; the mean is 0.65 times it [m/s].
        phase: phase on the figure at time 0 [rad]; 0 and π are at its centre.
        stature: height of the person; all proportions are scaled to it [m].
        size: half the figure's extent in x [m]; its extent in z is half as large.
    """

    centre: tuple[float, float] = (0.0, 2.8)
    speed: float = 0.7
    phase: float = 0.3
    stature: float = 1.75
    size: float = 0.8

    def at(self, t: float) -> Float64:
        """Return the exact joint positions at a time.

        Args:
            t: true time [s].

        Returns:
            (25, 3) joints of the topology ``kinect_v2`` in the world, y up, floor at 0 [m].
        """
        a = self.phase + self.speed / self.size * t / 1.5
        x, z = self.size * np.sin(a), self.size * np.sin(2 * a) / 2
        heading = np.arctan2(np.cos(a), np.cos(2 * a)) if self.speed else np.pi
        swing = np.sin(2 * np.pi * 0.9 * t) if self.speed else 0.0
        joints = _STANDING.copy()
        joints[:, 2] += _SWING * swing
        joints *= self.stature / 1.75
        pose = rigid(rotation_about_y(heading), (self.centre[0] + x, 0.0, self.centre[1] + z))
        return apply(pose, joints)


@dataclass
class WalkerSensor:
    """A sensor that sees every walker, with noise and without occlusion.

    Each call of `see` or `frame` draws new noise, so equal sensors agree only if they are called in the same order.

    Attributes:
        name: name of the sensor.
        T_world_sensor: (4, 4) from the sensor's camera space to the world.
        noise: standard deviation of every coordinate [m].
        clock: clock offset: the sensor's times minus the true times [s].
        phase: delay of its frames, which `walking_arrivals` adds to their times [s]; `see` and `frame` ignore it.
        mirrored: whether it swaps left and right joints, as for a person seen from behind.
        outliers: fraction of the joints that are displaced, by 1 m standard deviation in each coordinate.
        seed: random seed of the noise, together with the name.
        rng: the generator of the noise.
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

    def see(self, walkers: Mapping[int, Walker], t: float) -> Bodies:
        """Return the skeletons of the walkers with noise, every joint tracked.

        Args:
            walkers: the people, by tracking id.
            t: true time [s].

        Returns:
            Skeletons in the sensor's camera space, by ascending id.
        """
        seen = []
        T_sensor_world = inverse(self.T_world_sensor)
        for body in sorted(walkers):
            p = apply(T_sensor_world, walkers[body].at(t))
            p = p + self.noise * self.rng.normal(size=p.shape)
            wrong = self.rng.random(len(p)) < self.outliers
            p[wrong] += self.rng.normal(size=(wrong.sum(), 3))
            seen.append(p[MIRROR] if self.mirrored else p)
        positions = np.array(seen).reshape(-1, 25, 3)
        states = np.full(positions.shape[:2], JointState.TRACKED, dtype=np.uint8)
        return Bodies(self.name, KINECT_V2, tuple(sorted(walkers)), positions, states)

    def frame(self, walkers: Mapping[int, Walker], t: float, sequence: int = 0) -> BodyFrame:
        """Return the skeletons of `see` as a frame, with a capture time on the sensor's own clock.

        ``t`` is the true time [s], ``sequence`` the number of the frame.
        """
        return frame_of(self.see(walkers, t), round(1e9 * (t + self.clock)), sequence)


def frame_of(bodies: Bodies, time_ns: int, sequence: int, ids: Mapping[int, int] | None = None) -> BodyFrame:
    """Return skeletons of the topology ``kinect_v2`` as a frame.

    Args:
        bodies: the skeletons.
        time_ns: capture time, on the sensor's own clock.
        sequence: number of the frame.
        ids: mapping from old to new tracking ids; other ids, or all if None, are kept.
    """
    return body_frame(
        bodies.sensor,
        KINECT_V2,
        time_ns=time_ns,
        positions=bodies.positions,
        states=bodies.states,
        tracking_ids=[(ids or {}).get(body, body) for body in bodies.ids],
        sequence=sequence,
    )


def standing_at(x: float, z: float, yaw_deg: float = 0.0, height: float = 1.0, tilt_deg: float = 0.0) -> Float64:
    """Return the pose ``T_world_sensor`` (4, 4) of a sensor on a stand.

    Args:
        x, z: its position in the world [m].
        yaw_deg: rotation about the vertical [deg]; 0 looks along +z, positive turns it towards +x.
        height: its height above the floor [m].
        tilt_deg: upward tilt [deg].
    """
    turn = rotation_about_y(np.radians(yaw_deg)) @ rotation_about_x(-np.radians(tilt_deg))
    return rigid(turn, (x, height, z))


FRONT: Final = standing_at(0.0, 0.0)
SIDE: Final = standing_at(-2.0, 0.8, 45.0, height=1.1, tilt_deg=-3.0)
LEFT: Final = standing_at(2.0, 0.8, -45.0, height=0.9, tilt_deg=4.0)
BACK: Final = standing_at(0.0, 5.6, 180.0, height=1.3, tilt_deg=-5.0)


def walking_arrivals(
    walkers: Mapping[int, Walker],
    seconds: float,
    sensors: Mapping[str, Float64] | None = None,
    *,
    begin_s: float = 0.0,
    noise: float = 0.0,
    outliers: float = 0.0,
) -> list[Arrival]:
    """Return the frames of sensors that see the walkers, at 30 Hz each, in the order of capture.

    The sensors' clocks have no offset, and a frame arrives at its capture time. Equal calls give equal frames.

    Args:
        walkers: the people, by tracking id.
        seconds: duration [s].
        sensors: poses ``T_world_sensor`` (4, 4), by name; a sensor in front and one at the side if None. Their frames
            are evenly staggered.
        begin_s: true time of the first frame [s], rounded to 1/30 s; frames are numbered from ``30 * begin_s``.
        noise, outliers: fields of each `WalkerSensor`: standard deviation of a coordinate [m], and fraction of joints.
    """
    poses = {"front": FRONT, "side": SIDE} if sensors is None else sensors
    made = [
        WalkerSensor(name, T, noise=noise, outliers=outliers, phase=k / RATE_HZ / len(poses))
        for k, (name, T) in enumerate(poses.items())
    ]
    return [
        Arrival(sensor.frame(walkers, k / RATE_HZ + sensor.phase, k), round(1e9 * (k / RATE_HZ + sensor.phase)))
        for k in range(round(begin_s * RATE_HZ), round((begin_s + seconds) * RATE_HZ))
        for sensor in made
    ]
