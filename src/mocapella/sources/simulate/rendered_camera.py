"""A camera of a simulated hand's scene as an image source."""

from __future__ import annotations

import time
from collections.abc import Callable

from mocapella.errors import SettingsError, one_of
from mocapella.sensing.colour_profile import ColourProfile
from mocapella.sources.picture_source import Image, SourceState
from mocapella.sources.simulate.hand_camera import pointed_at
from mocapella.sources.simulate.hand_scene import HandScene
from mocapella.sources.simulate.rendered_source import RenderedSource


class RenderedCamera(RenderedSource):
    """One camera of a scene of a hand with markers, as an image source in real time; see `RenderedSource`.

    Args:
        scene: the scene.
        camera: name of one of its cameras.
        name: name of the source, as the user wrote it.
        clock: the monotonic clock, in seconds.

    Attributes:
        scene: as given.
        camera: the camera.

    Raises:
        SettingsError: unknown camera; lists the known ones.
    """

    def __init__(
        self, scene: HandScene, camera: str, name: str, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        if camera not in scene.cameras:
            raise SettingsError(f"unknown camera {camera!r}; known: {one_of(camera, scene.cameras)}")
        self.scene, self.camera = scene, scene.cameras[camera]
        super().__init__(name, self.camera.fps, self.camera.phase_s, clock=clock)

    def open(self) -> SourceState:
        """Render an image, so that kernels are compiled, begin with the first one, and return image size and rate."""
        self.restart()
        return SourceState(self.camera.size_px, self.camera.fps)

    def profile(self) -> ColourProfile:
        """Return a colour profile that is learnt from images of the hand with all markers marked."""
        return pointed_at(self.scene, self.camera.name)

    def render(self, at_s: float) -> Image:
        """Render the image, (height, width, 3) uint8 BGR, at a time on the scene's clock [s]."""
        return self.scene.at(self.camera.name, at_s).image
