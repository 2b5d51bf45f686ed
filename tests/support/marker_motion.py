"""A rig of two cameras, and markers that move before it, as rolling shutters see them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, rigid, rotation_about_y
from mocapella.model.camera import Camera, CameraRig, PlacedCamera

LENS = np.array([530.0, 530.0, 319.5, 239.5, -0.1, 0.02, 0, 0, 0])


def pair(baseline_m: float = 0.4, readout_s: float = 0.025, clock_s: float = 0.0) -> CameraRig:
    """Two cameras that look at what is half a metre before their middle."""
    cameras = {}
    for name, x in (("left", -baseline_m / 2), ("right", baseline_m / 2)):
        R = rotation_about_y(np.arctan2(x, 0.5))
        camera = Camera(name, (640, 480), LENS, readout_s)
        T = rigid(R, -R @ np.array([x, 0.0, 0.0]))
        cameras[name] = PlacedCamera(camera, T, np.full((6, 6), np.nan), clock_s if name == "right" else 0.0)
    return CameraRig(cameras)


def hand(at_s: float, points: int = 5) -> np.ndarray:
    """(points, 3) of a fast hand: up to 1.3 m/s [m]."""
    phase = 0.7 * np.arange(points)
    x, y, z = (
        a * np.sin(2 * np.pi * f * at_s + phase + p) for a, f, p in ((0.12, 1.5, 0), (0.08, 1.1, 0), (0.06, 1.3, 1))
    )
    return np.stack([x, y, 0.5 + z], axis=-1)


def shot(rig: CameraRig, name: str, at_s: float, where: Callable[[float], np.ndarray]) -> np.ndarray:
    """(points, 2) without noise of a frame whose first row is captured at an instant of the rig's clock [px]."""
    placed = rig.cameras[name]
    rows = np.full(len(where(at_s)), 240.0)
    for _ in range(6):  # a marker is in the row that is read when it is there
        times = at_s + rows * placed.camera.readout_s / (placed.camera.size_px[1] - 1)
        points = np.stack([where(float(t))[k] for k, t in enumerate(times)])
        pixels = project(apply(placed.T_camera_world, points), placed.camera.lens)
        rows = pixels[:, 1]
    return pixels
