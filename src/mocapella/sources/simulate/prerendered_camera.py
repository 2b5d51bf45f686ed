"""A rendered camera whose images are made before the start, for rates that rendering cannot keep."""

from __future__ import annotations

from typing import Final

from mocapella.errors import SettingsError
from mocapella.model.camera_controls import ControlDescription
from mocapella.sensing.colour_profile import CameraControls
from mocapella.settings import check
from mocapella.sources.picture_source import Image, SourceState
from mocapella.sources.simulate.hand_scene import HandScene
from mocapella.sources.simulate.rendered_camera import RenderedCamera

LONGEST: Final = 1000
"""Largest number of images; at 640 × 480 px they are 0.9 GB."""


class PrerenderedCamera(RenderedCamera):
    """A camera of a hand's scene that repeats its first images, forwards and backwards, so that nothing jumps.

    An image costs a copy, as a camera's does that comes developed. Its controls are set before the images are rendered;
    later, they cannot be.

    Args:
        scene: the scene.
        camera: name of one of its cameras.
        name: name of the source, as the user wrote it.
        count: number of images, 2 to `LONGEST`.
        fps: frame rate [Hz]; None for the scene's.
        wanted: values of its controls, see `RenderedCamera`.

    Raises:
        SettingsError: unknown camera, or a value is out of range.
    """

    def __init__(
        self,
        scene: HandScene,
        camera: str,
        name: str,
        count: int,
        fps: float | None = None,
        *,
        wanted: CameraControls | None = None,
    ) -> None:
        super().__init__(scene, camera, name, wanted)
        check(2 <= count <= LONGEST, "prerender", count, f"from 2 to {LONGEST} images")
        self._fps = fps or self._fps
        self._images: list[Image] = []
        self._count = count

    def open(self) -> SourceState:
        """Render the images, if they are not yet, and return image size, rate and the controls that they have."""
        if not self._images:
            images = [super(PrerenderedCamera, self).render(k / self._fps) for k in range(self._count)]
            self._images = images
        return super().open()

    def controls(self) -> tuple[ControlDescription, ...]:
        """Return none: the images are rendered already, and no control acts on them."""
        return ()

    def set_controls(self, values: object, automatic: object) -> tuple[str, ...]:
        """Refuse.

        Raises:
            SettingsError: always.
        """
        raise SettingsError(
            f"{self.name} is rendered beforehand: controls are set at its start only; leave the setting prerender out"
        )

    def render(self, at_s: float) -> Image:
        """Return a copy of the image at a time on the scene's clock [s]; before `open`, it is rendered."""
        if not self._images:
            return super().render(at_s)
        k = round((at_s - self._phase_s) * self._fps) % (2 * self._count - 2)
        return self._images[min(k, 2 * self._count - 2 - k)].copy()
