"""A keypoint detector for tests: it knows where a walking person is, and the camera from the image's brightness."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from mocapella.detectors.keypoint_detector import KEYPOINT_DETECTORS, KeypointDetector, SeenPeople
from mocapella.detectors.people_slots import SlotSettings
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply
from mocapella.model.camera import CameraRig, PlacedCamera
from mocapella.model.topology import topology
from mocapella.tracker.webcams_warmup import circle_of_cameras, standing_person

RIG = circle_of_cameras(3)
STEP = 60
NAME = "known"
NO_HANDS = "no-hands"


def brightness(camera: int) -> int:
    """Grey level of all images of a camera."""
    return STEP * (camera + 1)


def joints_at(at_s: float) -> np.ndarray:
    """Where the person is: (26, 3) [m]."""
    return standing_person() + np.array([0.5 * at_s, 0.0, 0.0])


def placed(camera: int) -> PlacedCamera:
    return list(RIG.cameras.values())[camera]


class KnownPeople:
    """A `PeopleDetector` that sees the person in grey images and nobody in black ones; it keeps the regions."""

    def __init__(self) -> None:
        self.topology = topology("halpe_26")
        self.regions: list[Any] = []

    def update(self, image: Any, at_s: float, regions_px: Any = None) -> SeenPeople:
        self.regions.append(regions_px)
        camera = round(float(image.mean()) / STEP) - 1
        if camera < 0:
            return SeenPeople(np.zeros(0, np.int64), np.zeros((0, 26, 2), np.float32), np.zeros((0, 26), np.float32))
        one = placed(camera)
        px = project(apply(one.T_camera_world, joints_at(at_s)), one.camera.lens)[None].astype(np.float32)
        return SeenPeople(np.zeros(1, np.int64), px, np.full((1, 26), 0.9, np.float32))

    def reset(self) -> None:
        """Nothing is remembered."""


class NoHands:
    """A `PeopleDetector` of hands alone, which finds none."""

    def __init__(self) -> None:
        self.topology = topology("hand")

    def update(self, image: Any, at_s: float, regions_px: Any = None) -> SeenPeople:
        return SeenPeople(np.zeros(0, np.int64), np.zeros((0, 21, 2), np.float32), np.zeros((0, 21), np.float32))

    def reset(self) -> None:
        """Nothing is remembered."""


@contextmanager
def known_detector() -> Iterator[None]:
    """While the context is active, `KnownPeople` is the detector ``known`` of this process, `NoHands` ``no-hands``."""
    KEYPOINT_DETECTORS[NAME] = KeypointDetector(
        1, NAME, "A person who walks.", lambda: SlotSettings, lambda settings, model: KnownPeople(), lambda: ""
    )
    KEYPOINT_DETECTORS[NO_HANDS] = KeypointDetector(
        1, NO_HANDS, "No hand.", lambda: SlotSettings, lambda settings, model: NoHands(), lambda: ""
    )
    try:
        yield
    finally:
        del KEYPOINT_DETECTORS[NAME], KEYPOINT_DETECTORS[NO_HANDS]


def write_films(folder: Path, rig: CameraRig, count: int) -> list[Path]:
    """Write a folder of grey images for each camera, named like it."""
    cv2 = __import__("cv2")
    found = []
    for k, (name, one) in enumerate(rig.cameras.items()):
        film = folder / name
        film.mkdir()
        width, height = one.camera.size_px
        for number in range(count):
            cv2.imwrite(str(film / f"{number:04d}.png"), np.full((height, width, 3), brightness(k), np.uint8))
        found.append(film)
    return found
