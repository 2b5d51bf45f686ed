"""Simulated depth cameras as image sources and as recordings."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.errors import SettingsError
from mocapella.sources.depth_files import RecordedDepth
from mocapella.sources.depth_options import DepthOptions
from mocapella.sources.picture_source import ColourCamera, Image, SourceState
from mocapella.sources.simulate.rendered_source import RenderedSource

if TYPE_CHECKING:
    from mocapella.sources.simulate.depth_scene import Shot

USUAL_FPS: Final = 30.0
_PAINT: Final = np.array(
    [(30, 30, 30), (110, 115, 120), (205, 205, 200), (160, 90, 40), (50, 120, 60), (60, 60, 170), (120, 60, 120)],
    np.uint8,
)
"""Colours (n, 3) of nothing, floor, wall and the people of a room, blue, green, red."""
ROOM: Final = "room-"
"""Prefix of the name of a room's scene, with people from head to foot."""
RENDERED_ROOM: Final = "rendered:room-SCENE/SEED/SENSOR/VIEW, such as rendered:room-walk/0/kinect/right"


class RenderedScene(Protocol):
    """A renderable scene: `mocapella.sources.simulate.depth_scene.DepthScene` or `room_depth.RoomDepthScene`.

    Attributes:
        sensor: the camera, a `depth_scene.Sensor`.
        period_s: period of the motion, of two arms that of the first [s].
    """

    sensor: Any
    period_s: float

    @property
    def lens(self) -> Any:
        """(9,) intrinsics and distortion: fx fy cx cy [px], k1 k2 p1 p2 k3, as in `mocapella.geometry.lens`."""
        ...

    def at(self, at_s: float) -> Shot:
        """Render the image at a time since the scene's start [s], with its ground truth."""
        ...


class RenderedDepth(RenderedSource):
    """A rendered scene's depth images as an image source in real time; see `RenderedSource`.

    Args:
        scene: the scene, with its camera.
        name: name of the source, as the user wrote it.
        options: the user's parameters; a lens and a unit replace the scene's in the state, even if they are wrong, but
            do not change the images. The frame rate is `USUAL_FPS` if not given; a size is ignored.
        clock: the monotonic clock, in seconds.

    Attributes:
        scene, options: as given.
        fps: frame rate [Hz].
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
        """Render an image, so that kernels are compiled, begin with the first one, and return the source's state."""
        self.restart()
        return _state(self.scene, self.options, self.fps)

    def render(self, at_s: float) -> Image:
        """Render the image, (height, width) uint16 in the scene's unit, at a time on the scene's clock [s]."""
        shot = self.scene.at(at_s)
        if self.options.colour:
            self.colour = coloured(shot)
        image: Image = shot.depth
        return image


def coloured(shot: Any) -> NDArray[np.uint8]:
    """Return a colour image (height, width, 3) uint8 BGR of a `room_depth.RoomShot`: one colour for each thing."""
    return np.asarray(_PAINT[np.minimum(shot.parts, len(_PAINT) - 1)])


class RenderedRecording:
    """One period of a scene as a recording: a `mocapella.sources.depth_files.DepthRecording`.

    Args:
        scene: the scene, with its camera.
        name: name of the recording, for messages.
        options: the user's parameters: the frame rate; lens and unit replace the scene's in the state.

    Attributes:
        scene: as given.
        name, state, count: name of the recording, the camera's parameters, and number of images.
        fps: frame rate [Hz].
    """

    def __init__(self, scene: RenderedScene, name: str, options: DepthOptions | None = None) -> None:
        options = options or DepthOptions()
        fps = options.fps or USUAL_FPS
        self.scene, self.name, self.fps = scene, name, fps
        self.state = _state(scene, options, fps)
        self.count = max(math.floor(scene.period_s * fps), 1)

    def images(self) -> Iterator[RecordedDepth]:
        """Render and yield the images of one period, from the first at the scene's time 0, which is 1 ns."""
        for number in range(self.count):
            at_s = number / self.fps
            yield RecordedDepth(f"{self.name}/{number}", round(at_s * NS_PER_S) + 1, self.scene.at(at_s).depth)


def open_rendered(which: str, name: str, options: DepthOptions | None = None) -> RenderedDepth:
    """Return the image source of a simulated depth camera.

    Args:
        which: the scene: NAME, NAME/SEED, NAME/SEED/SENSOR or, of a room, NAME/SEED/SENSOR/VIEW, a sensor of the room
            from whose place it is seen; the seed is 0 and the sensor a Kinect if not given.
        name: name of the source, as the user wrote it.
        options: the user's parameters of the camera; None if none is given.

    Raises:
        SettingsError: unknown scene, sensor or view, the seed is not a number, or colour is wanted of a scene of arms.
    """
    if options is not None and options.colour and not which.startswith(ROOM):
        raise SettingsError(f"source {name!r} has no colour; write {RENDERED_ROOM}")
    return RenderedDepth(rendered_scene(which, name), name, options)


def rendered_scene(which: str, name: str) -> RenderedScene:
    """Load a scene of people if ``which`` begins with `ROOM`, else of arms.

    Args:
        which: the scene, see `open_rendered`.
        name: name of the source, as the user wrote it, for errors.

    Raises:
        SettingsError: unknown scene or sensor, or the seed is not a number.
    """
    scene, _, rest = which.partition("/")
    seed, _, rest = rest.partition("/")
    sensor, _, view = rest.partition("/")
    if seed and not (seed.isascii() and seed.isdigit()):
        raise SettingsError(f"source {name!r} cannot be used; write rendered:NAME, or rendered:NAME/SEED/SENSOR")
    chosen = {"sensor": sensor} if sensor else {}
    if scene.startswith(ROOM):
        from mocapella.sources.simulate.room_depth import room_depth_scene

        return room_depth_scene(scene.removeprefix(ROOM), seed=int(seed or 0), view=view, **chosen)
    from mocapella.sources.simulate.depth_scene import load_depth_scene

    return load_depth_scene(scene, seed=int(seed or 0), **chosen)


def _state(scene: RenderedScene, o: DepthOptions, fps: float) -> SourceState:
    sensor = scene.sensor
    lens = tuple(map(float, scene.lens)) if o.lens is None else o.lens
    colour = ColourCamera(sensor.size_px, lens) if o.colour else None
    unit_m = sensor.unit_m if o.unit_m is None else o.unit_m
    return SourceState(sensor.size_px, fps, unit_m=unit_m, lens=lens, colour=colour)
