"""What the method ``silhouettes`` does before the first frame, so that everything is compiled: somebody goes aside."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.rigid import inverse, rigid, rotation_about_y
from mocapella.kinematics.silhouette_fit import eye, figure, see
from mocapella.model.body_meshes import body_mesh
from mocapella.model.camera import Camera, CameraRig, PlacedCamera
from mocapella.model.observations import Arrival
from mocapella.model.rigged_mesh import RiggedMesh, posed
from mocapella.model.twist_tree import TreePose
from mocapella.tracker.image_arrivals import arrivals_of
from mocapella.tracker.silhouettes import SilhouettesTracker
from mocapella.tracker.starting_body import StartingBody

_RATE_HZ: Final = 30
_FRAMES: Final = 12
_SIZE: Final = (160, 120)
_LENS: Final = np.array([126.0, 126.0, 80.0, 60.0, 0, 0, 0, 0, 0], np.float64)
_TURNS_RAD: Final = {"practice-0": 0.3, "practice-1": 1.6}


def practice() -> tuple[SilhouettesTracker, Iterator[Arrival]]:
    """A tracker, and the images that it is given."""
    mesh, rig = body_mesh("male", 1.75), _rig()
    return SilhouettesTracker({"": StartingBody(mesh, _pose(mesh, 0.0))}, rig), _somebody(mesh, rig)


def _rig() -> CameraRig:
    cameras = {}
    for name, turn in _TURNS_RAD.items():
        R = rotation_about_y(turn + np.pi) @ np.diag([-1.0, -1.0, 1.0])
        place = rigid(R, (4.0 * np.sin(turn), 0.95, 4.0 * np.cos(turn)))
        cameras[name] = PlacedCamera(Camera(name, _SIZE, _LENS), inverse(place), np.zeros((6, 6)))
    return CameraRig(cameras)


def _pose(mesh: RiggedMesh, aside_m: float) -> TreePose:
    T = np.eye(4)
    T[0, 3] = aside_m
    return TreePose(T, np.zeros(len(mesh.joint_names)))


def _somebody(mesh: RiggedMesh, rig: CameraRig) -> Iterator[Arrival]:
    """Somebody who goes aside before two cameras; one image is black."""
    body, rng = figure(mesh), np.random.default_rng(0)
    width, height = _SIZE
    rooms = {name: rng.integers(90, 160, (height, width, 3), np.uint8) for name in rig.cameras}
    for k in range(_FRAMES):
        images: dict[str, NDArray[np.uint8]] = {}
        vertices = posed(mesh, _pose(mesh, 0.01 * k))
        for name, placed in rig.cameras.items():
            seen = see(body, vertices, eye(placed), step_px=1, margin_px=2)
            image = rooms[name].copy()
            if seen is not None:
                image[seen.silhouette.mask(_SIZE)] = (40, 60, 230)
            images[name] = image if k != _FRAMES - 2 or name != "practice-0" else np.zeros_like(image)
        yield from arrivals_of(images, round(1e9 * (k + 1) / _RATE_HZ), cameras=rig.cameras, number=k)
