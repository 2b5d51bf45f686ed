"""Depth images of a simulated room's people, from head to foot.

    scene = room_depth_scene("stand", seed=1, sensor="kinect")
    shot = scene.at(2.5)
    shot.depth, shot.unit_m, shot.people       # (480, 640) uint16, metres per unit, (people, 25, 3) joints

Bones are tapered capsules with the same radii as for occlusion in the room (`body`), in front of a floor and a wall.
Camera and noise are as in `depth_scene`. The camera has the pose of a sensor of the room, by default of the first one,
which in the named scenes looks along the world's z axis.
"""

from __future__ import annotations

import math
import zlib
from collections import deque
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.geometry.rigid import apply, rigid
from mocapella.sources.simulate.body import JOINT, body_template
from mocapella.sources.simulate.depth_noise import measured
from mocapella.sources.simulate.depth_scene import Sensor, Shot, depth_sensor
from mocapella.sources.simulate.room import Room
from mocapella.sources.simulate.scenes import load_scene

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
UInt8 = NDArray[np.uint8]

WALL_M: Final = 5.0
"""Distance of the wall, which is vertical, from the camera in its horizontal direction [m]."""
FLOOR, WALL, FIRST_PERSON = 1, 2, 3
"""Labels in `RoomShot.parts`; person n is `FIRST_PERSON` + n."""
_AROUND, _ALONG = 24, 6
_ABOVE_EYES: Final = 1.23
"""Height of the head above its joint, which is at eye level, in radii of the head: 0.064 of the stature."""


class RoomShot(Shot, frozen=True, eq=False):
    """A depth image (see `Shot`) and its ground truth.

    Attributes:
        people: (people, 25, 3) joints of `mocapella.sources.simulate.body.BODY` in the camera frame [m].
        parts: (height, width) uint8 label of each pixel before noise: `FLOOR`, `WALL`, `FIRST_PERSON` and above; 0
            without a surface.
        exact_m: (height, width) float32 depth before noise [m]; infinite without a surface.
    """

    people: Float64
    parts: UInt8
    exact_m: Float32


class RoomDepthScene:
    """A room seen by one depth camera; made by `room_depth_scene`. The room's obstacles are not drawn.

    Args:
        room: the room with its people.
        sensor: the camera.
        seed: random seed of the noise.
        view: name of the room's sensor whose pose the camera has; the first one's if empty.

    Attributes:
        room, sensor: as given.
        T_camera_world: (4, 4) from the room's world to the camera frame (x right, y down, z out of the lens).
        period_s: period of everything except the noise [s].
    """

    def __init__(self, room: Room, sensor: Sensor, seed: int, view: str = "") -> None:
        self.room, self.sensor = room, sensor
        placed = self._placed = room.settings.sensors[room.sensor_index(view or 1)]
        R = np.diag([-1.0, -1.0, 1.0]) @ placed.T_world_sensor[:3, :3].T  # a body sensor's x is to its left, its y up
        self.T_camera_world = rigid(R, -R @ np.array(placed.position))
        self.period_s = room.duration_s
        self._key = zlib.crc32(f"{room.name}/{seed}{view and '/'}{view}".encode())
        self._background = self._draw_background()
        self._recent: deque[RoomShot] = deque(maxlen=4)

    @property
    def lens(self) -> Float64:
        """(9,) intrinsics and distortion: fx fy cx cy [px], k1 k2 p1 p2 k3, as in `mocapella.geometry.lens`."""
        return np.array([*self.sensor.lens, *[0.0] * 5])

    def at(self, at_s: float) -> RoomShot:
        """Render the depth image at a time since the room's start [s], with its ground truth.

        The last images are kept: who asks for one again, such as a simulated detector, gets it without rendering.
        """
        for shot in tuple(self._recent):
            if shot.at_s == at_s:
                return shot
        shot = self._rendered(at_s)
        self._recent.append(shot)
        return shot

    def near(self, time_ns: int) -> RoomShot:
        """Return the image at a time since the room's start [ns]; see `at`."""
        for shot in tuple(self._recent):
            if round(NS_PER_S * shot.at_s) == time_ns:
                return shot
        return self.at(time_ns / NS_PER_S)

    def _rendered(self, at_s: float) -> RoomShot:
        people = apply(self.T_camera_world, self.room.positions_at(round(1e9 * at_s)))
        depth, parts, slope = self._background[0].copy(), self._background[1].copy(), self._background[2].copy()
        for number, (joints, radii) in enumerate(zip(people, self.room.motion.radii, strict=True)):
            for vertices, triangles in self._limbs(joints, radii):
                seen = np.empty_like(vertices)
                _kernels().project(vertices, np.array(self.lens), seen)
                labels = np.zeros(len(triangles), np.uint8)
                first = np.uint8(FIRST_PERSON + number)
                _kernels().draw(seen, triangles, labels, first, vertices, depth, parts, slope)
        noise = self.sensor.noise
        units = measured(
            depth, slope, noise, focal_px=self.sensor.lens[0], unit_m=self.sensor.unit_m,
            key=self._key + round(1e9 * at_s),
        )  # fmt: skip
        return RoomShot(at_s, units, self.sensor.unit_m, self.lens, people, parts, depth)

    def _limbs(self, joints: Float64, radii: Float64) -> list[tuple[Float64, Int64]]:
        """Meshes of each bone's capsule, the sides of the chest, and the head above the eyes."""
        parents, made = body_template().parents, []
        for joint, parent in enumerate(parents):
            if joint != parent and radii[joint] > 0:
                begin = radii[parent] if 0 < radii[parent] < radii[joint] else radii[joint]
                made.append(capsule(joints[parent], joints[joint], float(begin), float(radii[joint])))
        for side in ("Left", "Right"):  # the chest is as wide as shoulders and hips
            a, b = joints[JOINT[f"Shoulder{side}"]], joints[JOINT[f"Hip{side}"]]
            a = a + 0.35 * (joints[JOINT["SpineShoulder"]] - a)
            hip = float(radii[JOINT[f"Hip{side}"]])
            made.append(capsule(a, b, hip, hip))
        head = JOINT["Head"]
        up = joints[head] - joints[parents[head]]
        radius = float(radii[head])
        top = joints[head] + up / np.linalg.norm(up) * (_ABOVE_EYES - 1) * radius
        made.append(capsule(joints[head], top, radius, radius))
        return made

    def _draw_background(self) -> tuple[Float32, UInt8, Float32]:
        """Depth, parts and slope of floor and wall; of a ray that meets neither, infinite, 0 and any."""
        width, height = self.sensor.size_px
        fx, fy, cx, cy = self.sensor.lens
        x, y = np.meshgrid((np.arange(width) - cx) / fx, (np.arange(height) - cy) / fy)
        R, sight = self.T_camera_world[:3, :3], self.T_camera_world[2, :3]
        down = R @ np.array([0.0, -1.0, 0.0])
        ahead = R @ np.array([sight[0], 0.0, sight[2]]) / math.hypot(sight[0], sight[2])
        to_floor, to_wall = (n[0] * x + n[1] * y + n[2] for n in (down, ahead))
        camera_m = self._placed.position[1]
        with np.errstate(divide="ignore"):
            floor = np.where(to_floor > 0, camera_m / to_floor, np.inf)
            wall = np.where(to_wall > 0, WALL_M / to_wall, np.inf)
        depth = np.minimum(floor, wall)
        parts = np.where(floor < wall, FLOOR, np.where(np.isfinite(wall), WALL, 0))
        slope = np.where(floor < wall, to_floor, to_wall) / np.sqrt(x * x + y * y + 1.0)
        return depth.astype(np.float32), parts.astype(np.uint8), slope.astype(np.float32)


def capsule(a: Float64, b: Float64, radius_a: float, radius_b: float) -> tuple[Float64, Int64]:
    """Return the closed mesh of a tapered capsule: vertices (n, 3) [m] and triangles (m, 3), which face outwards.

    Args:
        a, b: (3,) ends of its axis [m]; if they are equal, the axis is z.
        radius_a, radius_b: radii at the ends [m].
    """
    along = b - a
    length = float(np.linalg.norm(along))
    w = along / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])
    u = np.cross(w, np.eye(3)[int(np.argmin(np.abs(w)))])
    u /= np.linalg.norm(u)
    ring = 2 * math.pi * np.arange(_AROUND) / _AROUND
    round_ = np.cos(ring)[:, None] * u + np.sin(ring)[:, None] * np.cross(w, u)
    angles = 0.5 * math.pi * np.arange(_ALONG) / _ALONG
    rings = [
        *((a, radius_a, -math.sin(angle), math.cos(angle)) for angle in angles[::-1]),
        *((b, radius_b, math.sin(angle), math.cos(angle)) for angle in angles),
    ]
    vertices = np.concatenate([
        *(centre + radius * (back * w + wide * round_) for centre, radius, back, wide in rings),
        [a - radius_a * w, b + radius_b * w],
    ])  # fmt: skip
    return np.ascontiguousarray(vertices), _triangles(len(rings))


@cache
def _triangles(rings: int) -> Int64:
    """Triangles (m, 3) between rings of vertices and the two poles, which come after them."""
    i, j = np.arange(_AROUND), (np.arange(_AROUND) + 1) % _AROUND
    found = []
    for ring in range(rings - 1):
        low, high = ring * _AROUND, (ring + 1) * _AROUND
        found += [np.stack([low + i, low + j, high + i], axis=1), np.stack([low + j, high + j, high + i], axis=1)]
    first, last = rings * _AROUND, rings * _AROUND + 1
    found.append(np.stack([np.full(_AROUND, first), j, i], axis=1))
    found.append(np.stack([np.full(_AROUND, last), (rings - 1) * _AROUND + i, (rings - 1) * _AROUND + j], axis=1))
    return np.ascontiguousarray(np.concatenate(found))


def room_depth_scene(name: str, *, seed: int = 0, sensor: str = "kinect", view: str = "") -> RoomDepthScene:
    """Load the people of a room, seen by a depth camera.

    Args:
        name: one of `mocapella.sources.simulate.scenes.scene_names`.
        seed: random seed of the people's motion and of the noise.
        sensor: one of `depth_scene.depth_sensor_names`.
        view: name of the room's sensor whose pose the camera has; the first one's if empty.

    Raises:
        SettingsError: unknown scene, sensor or view; lists the known ones.
    """
    return RoomDepthScene(load_scene(name, seed=seed), depth_sensor(sensor), seed, view)


@cache
def _kernels() -> Any:
    """Import the kernels, and numba, on first use."""
    from mocapella.sources.simulate import depth_scene_kernels

    return depth_scene_kernels
