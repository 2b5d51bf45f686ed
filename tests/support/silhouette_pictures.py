"""Somebody before cameras in a ring, drawn so plainly that any tracker must see them: one colour before a wall."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from mocapella.geometry.rigid import inverse, rigid
from mocapella.kinematics.silhouette_fit import eye, figure, see
from mocapella.model.body_meshes import body_mesh
from mocapella.model.camera import Camera, CameraRig, PlacedCamera
from mocapella.model.rigged_mesh import posed
from mocapella.model.silhouettes import Silhouette
from mocapella.model.twist_tree import TreePose

SIZE_PX = (240, 200)


def ring(count=3, size_px=SIZE_PX, far_m=4.0, turn=0.3):
    """Cameras c1, c2, … at the height of a hip, looking at the origin's."""
    width, height = size_px
    lens = np.array([1.05 * height, 1.05 * height, 0.5 * width, 0.5 * height, 0, 0, 0, 0, 0], np.float64)
    cameras = {}
    for k in range(count):
        # No two of them opposite each other: either would see the other behind the body.
        angle = turn + np.radians(75.0) * k
        at = np.array([far_m * np.sin(angle), 1.0 + 0.15 * k, far_m * np.cos(angle)])
        z = np.array([0, 0.9, 0]) - at
        z /= np.linalg.norm(z)
        x = np.cross(z, [0.0, 1.0, 0.0])
        x /= np.linalg.norm(x)
        R = np.stack([x, np.cross(z, x), z], axis=1)
        name = f"c{k + 1}"
        cameras[name] = PlacedCamera(Camera(name, size_px, lens), inverse(rigid(R, at)), np.full((6, 6), np.nan))
    return CameraRig(cameras)


def somebody():
    return body_mesh("male", 1.75)


def pose_at(mesh, aside_m=0.0, elbow=0.4, up_m=0.0):
    """Stands upright, arms away from the trunk, elbows bent."""
    T = np.eye(4)
    T[:2, 3] = aside_m, up_m
    angles = np.zeros(len(mesh.joint_names))
    for side in ("left", "right"):
        angles[mesh.joint_names.index(f"{side} elbow flexion")] = elbow
    return TreePose(T, angles)


def silhouettes_of(mesh, rig, pose, step_px=1):
    """What the body covers, by camera that sees it."""
    body, vertices = figure(mesh), posed(mesh, pose)
    found = {}
    for name, placed in rig.cameras.items():
        outline = see(body, vertices, eye(placed), step_px=step_px)
        if outline is not None:
            found[name] = Silhouette(outline.origin_px, step_px, outline.mask.astype(np.float32) - 0.5)
    return found


class Room:
    """Its walls stay the same; every image has noise of its own."""

    def __init__(self, rig, seed=0):
        self.rig, self._rng = rig, np.random.default_rng(seed)
        self._walls = {}
        for name, placed in rig.cameras.items():
            width, height = placed.camera.size_px
            cells = self._rng.integers(110, 190, (height // 12 + 1, width // 12 + 1, 3)).astype(np.float32)
            self._walls[name] = cv2.resize(cells, (width, height), interpolation=cv2.INTER_CUBIC)

    def images(self, mesh=None, pose=None):
        covered = silhouettes_of(mesh, self.rig, pose) if mesh is not None else {}
        out = {}
        for name, wall in self._walls.items():
            image = wall + self._rng.normal(0, 2.0, wall.shape)
            if name in covered:
                image[covered[name].mask(self.rig.cameras[name].camera.size_px)] = [40, 30, 200]
            out[name] = np.clip(image, 0, 255).astype(np.uint8)
        return out


def write_folders(folder: Path, sequence):
    """A folder of PNGs for each camera."""
    for k, images in enumerate(sequence):
        for name, image in images.items():
            (folder / name).mkdir(parents=True, exist_ok=True)
            (folder / name / f"{k:04d}.png").write_bytes(cv2.imencode(".png", image)[1].tobytes())


def write_video(path: Path, images, hz=30.0):
    """An AVI."""
    height, width = images[0].shape[:2]
    out = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), hz, (width, height))
    assert out.isOpened()
    for image in images:
        out.write(image)
    out.release()
