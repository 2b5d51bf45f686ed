"""A camera of a simulated hand's scene as an image source."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from mocapella.errors import SettingsError, one_of
from mocapella.model.camera_controls import ControlDescription
from mocapella.sensing.colour_profile import CameraControls, ColourProfile
from mocapella.sources.picture_source import Image, SourceState, controls_of, set_at_start
from mocapella.sources.simulate.hand_camera import pointed_at
from mocapella.sources.simulate.hand_scene import HandScene
from mocapella.sources.simulate.rendered_controls import RenderedControls
from mocapella.sources.simulate.rendered_source import RenderedSource


class RenderedCamera(RenderedSource):
    """One camera of a scene of a hand with markers, as an image source in real time; see `RenderedSource`.

    Args:
        scene: the scene.
        camera: name of one of its cameras.
        name: name of the source, as the user wrote it.
        wanted: values of its controls (`RenderedControls`); automatic modes are off but for those in ``automatic``.
        clock: the monotonic clock, in seconds.

    Attributes:
        scene: as given.
        camera: the camera.

    Raises:
        SettingsError: unknown camera; lists the known ones.
    """

    def __init__(
        self,
        scene: HandScene,
        camera: str,
        name: str,
        wanted: CameraControls | None = None,
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        if camera not in scene.cameras:
            raise SettingsError(f"unknown camera {camera!r}; known: {one_of(camera, scene.cameras)}")
        self.scene, self.camera = scene, scene.cameras[camera]
        self._controls = RenderedControls(self.camera)
        self._problems = set_at_start(self._controls, wanted or CameraControls())
        super().__init__(name, self.camera.fps, self.camera.phase_s, clock=clock)

    def open(self) -> SourceState:
        """Render an image, so that kernels are compiled, begin with the first one, and return image size and rate."""
        self.restart()
        controls = controls_of(self._controls.controls())
        return SourceState(self.camera.size_px, self._fps, controls, problems=self._problems)

    def controls(self) -> tuple[ControlDescription, ...]:
        """Return the camera's controls, see `mocapella.sources.picture_source.ControlledSource`."""
        return self._controls.controls()

    def set_controls(self, values: Mapping[str, float], automatic: Mapping[str, bool]) -> tuple[str, ...]:
        """Set controls for the next image on, see `mocapella.sources.picture_source.ControlledSource`."""
        return self._controls.set_controls(values, automatic)

    def profile(self) -> ColourProfile:
        """Return a colour profile that is learnt from images of the hand with all markers marked."""
        learnt = pointed_at(self.scene, self.camera.name, taken_by=self._controls.camera)
        return replace(learnt, controls=controls_of(self._controls.controls()))

    def render(self, at_s: float) -> Image:
        """Render the image, (height, width, 3) uint8 BGR, at a time on the scene's clock [s]."""
        image = self.scene.at(self.camera.name, at_s, self._controls.camera).image
        self._controls.adapt(np.asarray(image))
        return image
