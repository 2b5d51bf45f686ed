"""A camera of a simulated hand's scene as a source of pictures: each rendered just before it is due."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable

from mocapella.conventions import NS_PER_S
from mocapella.errors import SettingsError, one_of
from mocapella.sensing.colour_profile import ColourProfile
from mocapella.sources.picture_source import Picture, SourceState
from mocapella.sources.simulate.hand_camera import pointed_at
from mocapella.sources.simulate.hand_scene import HandScene


class RenderedCamera:
    """One camera of a scene. Its clock is the scene's, from 1 ns; what there is no time to render is left out.

    Args:
        scene: what there is to see.
        camera: which of its cameras.
        name: as the user wrote it.
        clock: the monotonic clock, in seconds.

    Raises:
        SettingsError: no such camera; lists those there are.
    """

    live = False

    def __init__(
        self, scene: HandScene, camera: str, name: str, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        if camera not in scene.cameras:
            raise SettingsError(f"unknown camera {camera!r}; known: {one_of(camera, scene.cameras)}")
        self.name, self.times = name, "the scene's own"
        self.scene, self.camera = scene, scene.cameras[camera]
        self._clock, self._zero_s = clock, 0.0
        self._turn = self._number = 0

    def open(self) -> SourceState:
        """As `PictureSource.open`."""
        self.scene.at(self.camera.name, 0.0)  # compiles before the clock matters
        self._turn = 0
        return SourceState(self.camera.size_px, self.camera.fps)

    def begin(self, zero_s: float) -> None:
        """As `PictureSource.begin`."""
        self._zero_s = zero_s

    def profile(self) -> ColourProfile:
        """The colours after somebody held the hand before the camera and pointed at all markers."""
        return pointed_at(self.scene, self.camera.name)

    def read(self, stop: threading.Event) -> Picture | None:
        """As `PictureSource.read`; it never ends by itself."""
        camera = self.camera
        self._turn = max(self._turn, math.ceil((max(0.0, self._clock() - self._zero_s) - camera.phase_s) * camera.fps))
        at_s = camera.phase_s + self._turn / camera.fps
        self._turn += 1
        begin_s = self._clock()
        image = self.scene.at(camera.name, at_s).image
        rendered_s = self._clock() - begin_s
        if stop.wait(max(0.0, self._zero_s + at_s - self._clock())):
            return None
        number, self._number = self._number, self._number + 1
        return Picture(image, round(at_s * NS_PER_S) + 1, number, self._clock(), rendered_s)

    def close(self) -> None:
        """Nothing is held."""
