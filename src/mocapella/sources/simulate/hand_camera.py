"""A simulated marker camera in front of a simulated hand: frames as a node sends them, with ground truth."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Final, NamedTuple

import msgspec
import numpy as np

from mocapella.conventions import NS_PER_S
from mocapella.errors import SettingsError
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply
from mocapella.model.markers import MarkerFrame
from mocapella.sensing.colour_learning import ColourSample, learn_colours
from mocapella.sensing.colour_profile import SKIN, ColourProfile
from mocapella.sensing.markers import MarkerDetector, MarkerSettings
from mocapella.sources.simulate.hand_motion import HandMotionSettings
from mocapella.sources.simulate.hand_scene import HandScene, HandShot, SimulatedCamera

_LEARN_EVERY_S: Final = 0.31
_SAMPLES: Final = 3
_MOST_SAMPLES: Final = 60
_CLEARLY: Final = 0.85
"""Least visible share of each marker in an image that is used for learning the colours."""


class HandCameraFrame(NamedTuple):
    """The markers detected in a rendered image, its due time on the scene's clock [s], and image with ground truth."""

    due_s: float
    frame: MarkerFrame
    shot: HandShot


class SimulatedHandCamera:
    """One camera of a scene with a marker detector, which learns the colours from images marked as by a user.

    The constructor renders images until enough show all markers.

    Args:
        scene: the scene.
        camera: name of one of its cameras.
        settings: settings of the marker detector; None for the defaults.
        learn_from_s: time of the first image for learning, on the scene's clock [s].

    Attributes:
        scene: as given.
        camera: the camera.
        profile: the learnt colours.
        detector: the marker detector; it has memory, which a new call of `frames` does not reset.

    Raises:
        SettingsError: there are too few images with all markers visible.
        KeyError: unknown camera.
    """

    def __init__(
        self, scene: HandScene, camera: str, settings: MarkerSettings | None = None, *, learn_from_s: float = 0.0
    ) -> None:
        self.scene, self.camera = scene, scene.cameras[camera]
        self.profile = pointed_at(scene, camera, learn_from_s)
        self.detector = MarkerDetector(self.profile, settings)

    def frames(
        self,
        start_s: float = 0.0,
        stop_s: float | None = None,
        now_s: Callable[[], float] | None = None,
    ) -> Iterator[HandCameraFrame]:
        """Yield frames from ``start_s`` until before ``stop_s`` of the scene's time, at the camera's rate and phase.

        Args:
            start_s, stop_s: times on the scene's clock [s]; if ``stop_s`` is None, it does not end.
            now_s: function that returns the present time on the scene's clock [s]. Overdue frames are skipped, as by a
                camera whose reader is late; None skips no frame.
        """
        camera, k = self.camera, math.ceil((start_s - self.camera.phase_s) * self.camera.fps)
        while True:
            if now_s is not None:
                k = max(k, math.ceil((now_s() - camera.phase_s) * camera.fps))
            at_s = camera.phase_s + k / camera.fps
            if stop_s is not None and at_s >= stop_s:
                return
            shot = self.scene.at(camera.name, at_s)
            frame = self.detector.update(shot.image, at_s)
            yield HandCameraFrame(at_s, replace_time(frame, at_s), shot)
            k += 1


def replace_time(frame: MarkerFrame, at_s: float) -> MarkerFrame:
    """Return a copy of a frame with its capture time set to a time of the scene [s]; time 0 is 1 ns."""
    return msgspec.structs.replace(frame, time_ns=round(at_s * NS_PER_S) + 1)


def pointed_at(
    scene: HandScene, camera: str, from_s: float = 0.0, taken_by: SimulatedCamera | None = None
) -> ColourProfile:
    """Learn a camera's colour profile from three rendered images with all markers and the skin marked.

    The images show the scene's hand with a calmer motion.

    Args:
        scene: the scene; not changed.
        camera: name of one of its cameras.
        from_s: time of the first image that is tried [s].
        taken_by: as in `HandScene.at`.

    Raises:
        SettingsError: there are too few images with all markers visible, or the camera is unknown.
        InputError: a marker's colour cannot be learnt from the images.
    """
    samples: list[ColourSample] = []
    calm = HandMotionSettings(scene.settings.motion.centre_m, (0.03, 0.02, 0.03), turn_deg=(6, 6, 6), bend=0, spread=0)
    shown = HandScene(replace(scene.settings, motion=calm), scene.seed)
    for k in range(_MOST_SAMPLES):
        shot = shown.at(camera, from_s + k * _LEARN_EVERY_S, taken_by)
        if (shot.visible >= _CLEARLY).all():
            clicks = {name: (float(x), float(y)) for name, (x, y) in zip(scene.names, shot.centres_px, strict=True)}
            if not samples:
                clicks[SKIN] = _palm_px(shown, shot)
            samples.append(ColourSample(shot.image, clicks))
        if len(samples) == _SAMPLES:
            break
    else:
        raise SettingsError(f"{camera} hardly ever sees all markers well enough to point at; move the camera")
    profile = learn_colours(camera, samples)
    colours = sorted(profile.colours, key=lambda colour: scene.names.index(colour.name))
    return replace(profile, colours=tuple(colours))


def _palm_px(scene: HandScene, shot: HandShot) -> tuple[float, float]:
    """A point on the palm, in the image."""
    camera = scene.cameras[shot.camera]
    between = 0.5 * (shot.landmarks[0] + np.mean(shot.landmarks[[5, 17]], axis=0))
    x, y = project(apply(camera.T_camera_world, between[None]), camera.lens)[0]
    return float(x), float(y)
