"""Synthetic images of people before two walls, to compile the kernels of ``silhouettes`` before the first image."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.geometry.rigid import inverse, rigid, rotation_about_y
from mocapella.kinematics.silhouette_fit import eye, figure, see
from mocapella.model.body_meshes import body_mesh
from mocapella.model.camera import Camera, CameraRig, PlacedCamera
from mocapella.model.observations import Arrival
from mocapella.model.rigged_mesh import posed
from mocapella.model.twist_tree import TreePose
from mocapella.tracker.image_arrivals import arrivals_of
from mocapella.tracker.initial_body import InitialBody
from mocapella.tracker.silhouettes import SilhouettesTracker

UInt8 = NDArray[np.uint8]

_SIZE: Final = (160, 120)
_LENS: Final = np.array([130.0, 130.0, 79.5, 59.5, -0.05, 0.0, 0.0, 0.0, 0.0])
_RATE_HZ: Final = 30
_FRAMES: Final = 30
_SPECKLED: Final = (4, 8)
"""Frames with single wrong pixels."""
_AWAY: Final = (10, 28)
"""Range of the frames without people, the end excluded."""


def warm_up_tracker() -> SilhouettesTracker:
    """Return a tracker of two bodies and two synthetic cameras, for `warm_up_arrivals`."""
    mesh = body_mesh("male", 1.75)
    return SilhouettesTracker({name: InitialBody(mesh, pose) for name, pose in _poses(0).items()}, _rig())


def warm_up_arrivals() -> Iterator[Arrival]:
    """Yield BGR images of the empty room, then of both bodies, which leave for a while; some have wrong pixels."""
    rig, mesh, rng = _rig(), body_mesh("male", 1.75), np.random.default_rng(0)
    walls = {name: np.kron(rng.integers(60, 200, (15, 20, 3)), np.ones((8, 8, 1))) for name in rig.cameras}
    body, eyes = figure(mesh), {name: eye(placed) for name, placed in rig.cameras.items()}

    def seen(frame: int | None) -> dict[str, UInt8]:
        found = {}
        for name, wall in walls.items():
            image = wall + rng.normal(0.0, 2.0, wall.shape)
            for pose in () if frame is None else _poses(frame).values():
                outline = see(body, posed(mesh, pose), eyes[name], step_px=1)
                if outline is not None:
                    image[outline.silhouette.mask(_SIZE)] = (40, 60, 210)
            if frame is not None and _SPECKLED[0] <= frame < _SPECKLED[1]:
                image[rng.random(image.shape[:2]) < 0.15] = 255
            found[name] = np.clip(image, 0, 255).astype(np.uint8)
        return found

    yield from arrivals_of(seen(None), 0, empty_room=True)
    for k in range(_FRAMES):
        there = None if _AWAY[0] <= k < _AWAY[1] else k
        yield from arrivals_of(seen(there), round((k + 1) * NS_PER_S / _RATE_HZ), number=k)


def _rig() -> CameraRig:
    cameras = {}
    for k, angle in enumerate((0.0, 1.2)):
        camera = Camera(f"warm-up-{k}", _SIZE, _LENS)
        # x right, y down, z away from the camera, which looks at the middle of a body from 3 m.
        turned = rotation_about_y(angle) @ np.diag([1.0, -1.0, -1.0])
        place = rotation_about_y(angle) @ np.array([0.0, 0.0, 3.0]) + [0.0, 0.9, 0.0]
        cameras[camera.name] = PlacedCamera(camera, inverse(rigid(turned, place)), np.full((6, 6), np.nan))
    return CameraRig(cameras)


def _poses(frame: int) -> dict[str, TreePose]:
    mesh, found = body_mesh("male", 1.75), {}
    for name, aside_m in (("one", -0.35), ("two", 0.35)):
        angles = np.zeros(len(mesh.joint_names))
        angles[mesh.joint_names.index("left elbow flexion")] = 0.3 + 0.03 * frame
        found[name] = TreePose(rigid(np.eye(3), (aside_m, 0.0, 0.01 * frame)), angles)
    return found
