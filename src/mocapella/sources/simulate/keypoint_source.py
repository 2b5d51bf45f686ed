"""A camera of a simulated crowd as a source of keypoints, which begins again when the scene ends."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Final

import msgspec

from mocapella.conventions import NS_PER_S
from mocapella.errors import SettingsError, one_of
from mocapella.model.camera import CameraRig
from mocapella.model.keypoints import KeypointFrame
from mocapella.sources.simulate.crowd import CrowdScene, build_crowd, crowd_names, crowd_settings
from mocapella.sources.simulate.keypoint_camera import SimulatedKeypointCamera

SIMULATED: Final = "simulated:"
"""Prefix of a simulated camera's name: ``simulated:SCENE/CAMERA``."""
DEFAULT_CROWD: Final = "two-walk"
LEAST_S: Final = 45.0
"""Least duration of a scene in which people wander, until it begins again [s]."""


def shown_crowd(name: str, seed: int = 0) -> CrowdScene:
    """Build a scene for a demonstration: people who wander do so for at least `LEAST_S`.

    Raises:
        SettingsError: unknown scene; lists the known ones.
    """
    settings = dataclasses.replace(crowd_settings(name), seed=seed)
    if all(person.scenario == "wander" for person in settings.people):
        settings = dataclasses.replace(settings, seconds=max(settings.seconds, LEAST_S))
    return build_crowd(settings)


def simulated_camera(text: str, seed: int = 0) -> tuple[SimulatedKeypointCamera, float]:
    """Return the camera that a name means, and the duration of its scene [s].

    Args:
        text: ``simulated:SCENE/CAMERA``.
        seed: random seed of the scene.

    Raises:
        SettingsError: another form, or an unknown scene or camera.
    """
    name, slash, camera = text.removeprefix(SIMULATED).partition("/")
    if not slash or name not in crowd_names():
        raise SettingsError(
            f"source {text!r} cannot be used; write it as {SIMULATED}{DEFAULT_CROWD}/c1; scenes: "
            f"{one_of(name, crowd_names())}"
        )
    scene = shown_crowd(name, seed)
    found = {one.name: one for one in scene.cameras}
    if camera not in found:
        raise SettingsError(f"the scene {name} has no camera {camera!r}; it has {one_of(camera, found)}")
    return found[camera], scene.settings.seconds


def repeated(camera: SimulatedKeypointCamera, seconds: float) -> Iterator[tuple[float, KeypointFrame]]:
    """Yield a camera's frames, and after the scene's end those of the next round; it does not end.

    Yields:
        Time at which the frame is due, since the source's time 0 [s], and the frame, with rising times.
    """
    later, sequence = 0, 0
    while True:
        for item in camera.frames():
            frame = msgspec.structs.replace(item.frame, time_ns=item.frame.time_ns + later, sequence=sequence)
            sequence += 1
            yield (item.due_ns + later) / NS_PER_S, frame
        later += round(seconds * NS_PER_S)


def rig_of(scene: CrowdScene) -> CameraRig:
    """Return the scene's rig as a calibration would give it: with covariances of 2 mm and 0.05°."""
    import numpy as np

    sd = np.array([9e-4] * 3 + [2e-3] * 3)
    cameras = {
        name: msgspec.structs.replace(placed, covariance=np.diag(sd**2)) for name, placed in scene.rig.cameras.items()
    }
    return CameraRig(cameras)
