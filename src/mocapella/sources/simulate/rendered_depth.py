"""Arms before a simulated depth camera as a source of images."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, Final, Protocol

from mocapella.conventions import NS_PER_S
from mocapella.errors import SettingsError
from mocapella.sources.depth_files import RecordedDepth
from mocapella.sources.depth_options import DepthOptions
from mocapella.sources.picture_source import Image, SourceState
from mocapella.sources.simulate.rendered_source import RenderedSource

if TYPE_CHECKING:
    from mocapella.sources.simulate.depth_scene import Shot

USUAL_FPS: Final = 30.0
ROOM: Final = "room-"
"""Before the name of a room's scene: people from head to foot."""


class RenderedScene(Protocol):
    """What is rendered: a `mocapella.sources.simulate.depth_scene.DepthScene` or `room_depth.RoomDepthScene`."""

    sensor: Any
    period_s: float

    @property
    def lens(self) -> Any:
        """(9,) of `mocapella.geometry.lens`."""
        ...

    def at(self, at_s: float) -> Shot:
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
        scene: RenderedScene,
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
        return _state(self.scene, self.options, self.fps)

    def render(self, at_s: float) -> Image:
        """As `RenderedSource.render`."""
        image: Image = self.scene.at(at_s).depth
        return image


class RenderedRecording:
    """One period of a scene as a recording: a `mocapella.sources.depth_files.DepthRecording`.

    Args:
        scene, name, options: as of `RenderedDepth`.
    """

    def __init__(self, scene: RenderedScene, name: str, options: DepthOptions | None = None) -> None:
        options = options or DepthOptions()
        fps = options.fps or USUAL_FPS
        self.scene, self.name, self.fps = scene, name, fps
        self.state = _state(scene, options, fps)
        self.count = max(math.floor(scene.period_s * fps), 1)

    def images(self) -> Iterator[RecordedDepth]:
        """As `DepthRecording.images`."""
        for number in range(self.count):
            at_s = number / self.fps
            yield RecordedDepth(f"{self.name}/{number}", round(at_s * NS_PER_S) + 1, self.scene.at(at_s).depth)


def open_rendered(which: str, name: str, options: DepthOptions | None = None) -> RenderedDepth:
    """The source of NAME, NAME/SEED or NAME/SEED/SENSOR.

    Raises:
        SettingsError: there is no such scene or sensor, or the seed is no number.
    """
    return RenderedDepth(rendered_scene(which, name), name, options)


def rendered_scene(which: str, name: str) -> RenderedScene:
    """The scene of NAME, NAME/SEED or NAME/SEED/SENSOR: of an arm, or of people where it begins with `ROOM`.

    Raises:
        SettingsError: as of `open_rendered`.
    """
    scene, _, rest = which.partition("/")
    seed, _, sensor = rest.partition("/")
    if seed and not (seed.isascii() and seed.isdigit()):
        raise SettingsError(f"source {name!r} cannot be used; write rendered:NAME, or rendered:NAME/SEED/SENSOR")
    chosen = {"sensor": sensor} if sensor else {}
    if scene.startswith(ROOM):
        from mocapella.sources.simulate.room_depth import room_depth_scene

        return room_depth_scene(scene.removeprefix(ROOM), seed=int(seed or 0), **chosen)
    from mocapella.sources.simulate.depth_scene import load_depth_scene

    return load_depth_scene(scene, seed=int(seed or 0), **chosen)


def _state(scene: RenderedScene, o: DepthOptions, fps: float) -> SourceState:
    sensor = scene.sensor
    lens = tuple(map(float, scene.lens)) if o.lens is None else o.lens
    return SourceState(sensor.size_px, fps, unit_m=sensor.unit_m if o.unit_m is None else o.unit_m, lens=lens)
