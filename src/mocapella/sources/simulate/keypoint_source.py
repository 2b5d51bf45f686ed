"""A camera of a simulated crowd as a source of keypoints, which begins again when the scene ends."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from itertools import count
from typing import Final

import msgspec
import numpy as np

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
"""Least duration of a scene of wandering people, until it begins again [s]."""


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


def repeated(
    camera: SimulatedKeypointCamera, seconds: float, since_s: float = 0.0
) -> Iterator[tuple[float, KeypointFrame]]:
    """Yield a camera's frames, and after the scene's end those of the next round; it does not end.

    Args:
        camera: the camera.
        seconds: duration of a round [s].
        since_s: frames that are due earlier are left out, and take no time to make [s].

    Yields:
        Time at which the frame is due, since the source's time 0 [s], and the frame, with rising times.
    """
    round_ns, since_ns = round(seconds * NS_PER_S), round(since_s * NS_PER_S)
    # The last frames of a round can be due in the next one.
    first = max(0, int((since_ns - round(camera.settings.latency_s * NS_PER_S)) // round_ns))
    for k in count(first):
        later = k * round_ns
        for item in camera.frames(since_ns - later):
            sequence = k * camera.kept + item.frame.sequence
            frame = msgspec.structs.replace(item.frame, time_ns=item.frame.time_ns + later, sequence=sequence)
            yield (item.due_ns + later) / NS_PER_S, frame


def rig_of(scene: CrowdScene) -> CameraRig:
    """Return the scene's rig as a calibration would give it: with covariances of 2 mm and 0.05°."""
    sd = np.array([9e-4] * 3 + [2e-3] * 3)
    cameras = {
        name: msgspec.structs.replace(placed, covariance=np.diag(sd**2)) for name, placed in scene.rig.cameras.items()
    }
    return CameraRig(cameras)
