"""Arms before a simulated depth camera as a source of images."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Protocol

from mocapella.errors import SettingsError
from mocapella.sources.depth_options import DepthOptions
from mocapella.sources.picture_source import Image, SourceState
from mocapella.sources.simulate.rendered_source import RenderedSource

USUAL_FPS = 30.0


class Scene(Protocol):
    """What is rendered: `mocapella.sources.simulate.depth_scene.DepthScene`."""

    sensor: Any
    lens: Any

    def at(self, at_s: float) -> Any:
        """The image of that instant [s], and what is true of it."""
        ...


class RenderedDepth(RenderedSource):
    """A scene before its camera.

    Args:
        scene: what there is to see.
        name: as the user wrote it.
        options: what the user says; a lens and a unit that are not the scene's are taken as said.
        clock: the monotonic clock, in seconds.
    """

    def __init__(
        self,
        scene: Scene,
        name: str,
        options: DepthOptions | None = None,
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.scene, self.options = scene, options or DepthOptions()
        self.fps = self.options.fps or USUAL_FPS
        super().__init__(name, self.fps, clock=clock)

    def open(self) -> SourceState:
        """As `PictureSource.open`."""
        self.restart()
        o, sensor = self.options, self.scene.sensor
        lens = tuple(map(float, self.scene.lens)) if o.lens is None else o.lens
        return SourceState(sensor.size_px, self.fps, unit_m=sensor.unit_m if o.unit_m is None else o.unit_m, lens=lens)

    def render(self, at_s: float) -> Image:
        """As `RenderedSource.render`."""
        image: Image = self.scene.at(at_s).depth
        return image


def open_rendered(which: str, name: str, options: DepthOptions | None = None) -> RenderedDepth:
    """The source of NAME, NAME/SEED or NAME/SEED/SENSOR.

    Raises:
        SettingsError: there is no such scene or sensor, or the seed is no number.
    """
    from mocapella.sources.simulate.depth_scene import load_depth_scene

    scene, _, rest = which.partition("/")
    seed, _, sensor = rest.partition("/")
    if seed and not (seed.isascii() and seed.isdigit()):
        raise SettingsError(f"source {name!r} cannot be used; write rendered:NAME, or rendered:NAME/SEED/SENSOR")
    chosen = {"sensor": sensor} if sensor else {}
    return RenderedDepth(load_depth_scene(scene, seed=int(seed or 0), **chosen), name, options)
