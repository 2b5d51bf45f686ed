"""A body of one colour before cameras' textured walls: what the silhouettes' tracker can be tried on in little time."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache

import numpy as np
from numpy.typing import NDArray

from mocapella.kinematics.silhouette_fit import eye, figure, see
from mocapella.model.body_meshes import body_mesh
from mocapella.model.camera import Camera, CameraRig, PlacedCamera
from mocapella.model.rigged_mesh import RiggedMesh, posed
from mocapella.model.twist_tree import TreePose

Float64 = NDArray[np.float64]
UInt8 = NDArray[np.uint8]
Bool = NDArray[np.bool_]

FRAME_NS = 1_000_000_000 // 60


def looking(C: Float64, at: Float64) -> Float64:
    """T_camera_world of a camera at C that looks at a point, y up in the world."""
    z = (at - C) / np.linalg.norm(at - C)
    x = np.cross(z, [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3] = np.stack([x, np.cross(z, x), z])
    T[:3, 3] = -T[:3, :3] @ C
    return T


def ring(count: int = 4, size: tuple[int, int] = (320, 240), focal: float = 300.0, radius: float = 4.0) -> CameraRig:
    """Cameras about the origin, at the height of a face."""
    cameras = {}
    for k in range(count):
        angle = 2 * np.pi * k / count + 0.3
        C = np.array([radius * np.sin(angle), 1.5, radius * np.cos(angle)])
        lens = np.array([focal, focal, size[0] / 2 - 0.5, size[1] / 2 - 0.5, -0.05, 0.01, 0, 0, 0])
        camera = Camera(f"camera {k + 1}", size, lens)
        cameras[camera.name] = PlacedCamera(camera, looking(C, np.array([0.0, 0.9, 0.0])), np.full((6, 6), np.nan))
    return CameraRig(cameras)


def bent(mesh: RiggedMesh, degrees: dict[str, float], place: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> TreePose:
    """A pose of named angles, elsewhere 0."""
    angles = np.zeros(len(mesh.joint_names))
    for name, value in degrees.items():
        angles[mesh.joint_names.index(name)] = np.radians(value)
    T = np.eye(4)
    T[:3, 3] = place
    return TreePose(T, angles)


@cache
def _wall(seed: int, camera: int, size_px: tuple[int, int]) -> UInt8:
    width, height = size_px
    coarse = np.random.default_rng([seed, camera]).integers(60, 200, (-(-height // 8), -(-width // 8), 3))
    wall = coarse.astype(np.uint8).repeat(8, axis=0).repeat(8, axis=1)[:height, :width]
    wall.flags.writeable = False
    return wall


@dataclass
class Room:
    """Cameras, a body, and walls of another colour at every few pixels."""

    rig: CameraRig = field(default_factory=ring)
    mesh: RiggedMesh = field(default_factory=lambda: body_mesh("male", 1.78))
    noise: float = 3.0
    colour: tuple[int, int, int] = (60, 90, 200)
    seed: int = 0

    def walls(self) -> dict[str, UInt8]:
        """The room without anybody, as each camera sees it; images that nobody changes."""
        cameras = self.rig.cameras.items()
        return {name: _wall(self.seed, k, placed.camera.size_px) for k, (name, placed) in enumerate(cameras)}

    def masks(self, pose: TreePose) -> dict[str, Bool]:
        """Where the body is."""
        body, vertices, out = figure(self.mesh), posed(self.mesh, pose), {}
        for name, placed in self.rig.cameras.items():
            width, height = placed.camera.size_px
            mask = np.zeros((height, width), dtype=bool)
            seen = see(body, vertices, eye(placed), step_px=1, margin_px=2)
            if seen is not None:
                x, y = seen.origin_px
                part = seen.mask[max(-y, 0) : height - y, max(-x, 0) : width - x] > 0
                mask[max(y, 0) : max(y, 0) + part.shape[0], max(x, 0) : max(x, 0) + part.shape[1]] = part
            out[name] = mask
        return out

    def images(self, pose: TreePose, seed: int = 0) -> dict[str, UInt8]:
        """What the cameras see."""
        walls, out = self.walls(), {}
        for k, (name, mask) in enumerate(self.masks(pose).items()):
            rng = np.random.default_rng([self.seed, seed, k])
            image = np.where(mask[..., None], np.array(self.colour, float), walls[name])
            out[name] = np.clip(image + rng.normal(0, self.noise, image.shape), 0, 255).astype(np.uint8)
        return out
