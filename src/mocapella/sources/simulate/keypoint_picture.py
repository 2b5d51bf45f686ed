"""Images of a simulated camera that has a detector of keypoints: the bodies as limbs above a floor."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply
from mocapella.sources.simulate.keypoint_body import HALPE
from mocapella.sources.simulate.keypoint_camera import SimulatedKeypointCamera

UInt8 = NDArray[np.uint8]
Float64 = NDArray[np.float64]

WALL: Final = (92, 84, 78)
"""Colour of the walls, blue, green, red."""
_FLOOR: Final = (120, 110, 104)
_CLOTHES: Final = ((60, 70, 170), (150, 95, 50), (70, 130, 60), (40, 130, 180), (130, 60, 120), (110, 110, 30))
_SKIN: Final = (140, 170, 215)
_LIMB_M: Final = 0.10
_HEAD_M: Final = 0.11
_NEAREST_M: Final = 0.2
_FLOOR_M: Final = 4.0
_BITS: Final = 4
"""Fractional bits of a pixel, for a sub-pixel position."""
_TORSO: Final = tuple(HALPE.index(name) for name in ("LShoulder", "RShoulder", "RHip", "LHip"))
_HEAD: Final = HALPE.index("Head"), HALPE.index("Neck")


def draw_bodies(camera: SimulatedKeypointCamera, time_ns: int) -> UInt8:
    """Draw what a simulated camera sees, without obstacles and mirror images.

    Nearer bodies are drawn over farther ones. The floor is a grid of lines each metre.

    Args:
        camera: the camera.
        time_ns: time on its clock, within the scene's duration [ns].

    Returns:
        Image (height, width, 3) uint8, blue, green, red.
    """
    width, height = camera.placed.camera.size_px
    image = np.full((height, width, 3), WALL, np.uint8)
    _draw_floor(image, camera)
    bodies = apply(camera.placed.T_camera_world, camera.bodies_at(time_ns))
    for i in np.argsort(-bodies[:, HALPE.index("Hip"), 2]):
        _draw_body(image, camera, bodies[i], _CLOTHES[i % len(_CLOTHES)])
    return image


def _draw_floor(image: UInt8, camera: SimulatedKeypointCamera) -> None:
    along = np.arange(-_FLOOR_M, _FLOOR_M + 0.1, 0.25)
    for at in np.arange(-_FLOOR_M, _FLOOR_M + 0.1, 1.0):
        same = np.full_like(along, at)
        for x, z in ((along, same), (same, along)):
            line = apply(camera.placed.T_camera_world, np.stack([x, np.zeros_like(x), z], axis=-1))
            _draw_line(image, camera, line, _FLOOR, 0.0)


def _draw_body(image: UInt8, camera: SimulatedKeypointCamera, joints: Float64, colour: tuple[int, int, int]) -> None:
    if (joints[:, 2] <= _NEAREST_M).any():  # too close for a picture of it
        return
    pixels = project(joints, camera.placed.camera.lens)
    if not np.isfinite(pixels).all() or np.abs(pixels).max() > 1e5:
        return
    cv2.fillConvexPoly(image, cv2.convexHull(_fixed(pixels[list(_TORSO)])), colour, cv2.LINE_AA, _BITS)
    for a, b in HALPE.bones:
        _draw_line(image, camera, joints[[a, b]], colour, _LIMB_M)
    head, neck = joints[_HEAD[0]], joints[_HEAD[1]]
    centre = 0.6 * head + 0.4 * neck
    radius = camera.placed.camera.lens[0] * _HEAD_M / centre[2]
    (at,) = _fixed(project(centre[None], camera.placed.camera.lens))
    cv2.circle(image, at.tolist(), round(radius * 2**_BITS), _SKIN, -1, cv2.LINE_AA, _BITS)


def _draw_line(
    image: UInt8, camera: SimulatedKeypointCamera, points: Float64, colour: tuple[int, int, int], width_m: float
) -> None:
    """Draw the parts of a line (n, 3) in the camera's frame [m] that are before the camera."""
    lens = camera.placed.camera.lens
    for first, second in pairwise(points):
        depth = min(first[2], second[2])
        if depth <= _NEAREST_M:
            continue
        pixels = project(np.stack([first, second]), lens)
        if not np.isfinite(pixels).all() or np.abs(pixels).max() > 1e5:
            continue
        a, b = _fixed(pixels).tolist()
        cv2.line(image, a, b, colour, max(1, round(lens[0] * width_m / depth)), cv2.LINE_AA, _BITS)


def _fixed(pixels: Float64) -> Any:
    return np.round(pixels * 2**_BITS).astype(np.int32)
