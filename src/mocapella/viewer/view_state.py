"""The memory of the view, shared by all browsers: sensors, floors, perspectives and trails."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Final

import numpy as np

from mocapella.model.scene import Scene
from mocapella.model.scenery import Scenery
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.session import SessionStatus
from mocapella.model.topology import UNKNOWN_FIELD_OF_VIEW_DEG
from mocapella.viewer.lanes import lane_of
from mocapella.viewer.palette import SensorColours
from mocapella.viewer.perspective import Floors, Perspectives, StageSpace
from mocapella.viewer.plugin_errors import PluginErrors
from mocapella.viewer.room import called, drawing_of
from mocapella.viewer.trails import Trails

_LONGER_SIDE_DEG: Final = 60.0
"""Field of view along the longer side of an image, for a camera with an unknown lens [°]."""


class Ground:
    """Keeps the transform from the world to the stage constant over a session, so that the picture does not jump.

    It is taken from the first scene whose parts define one, such as fitted bodies, and dropped when a new tracker
    begins. It applies to the perspective `FREE` and, through the sensors' poses, to the floor of the others.

    Attributes:
        space: the remembered pose of the world on the stage; None if unknown.
    """

    def __init__(self) -> None:
        self.space: StageSpace | None = None
        self._step = -1

    def learn(self, scene: Scene, troubles: PluginErrors) -> StageSpace | None:
        """Update with the newest scene; return the remembered pose, None if it is unknown.

        Only the first part type of the scene can define the pose, by its `DrawPart.space`. A step number that goes back
        means a new tracker, and drops the pose. Errors of a drawing are reported to ``troubles``.
        """
        if scene.step < self._step:
            self.space = None
        self._step = scene.step
        name, parts = next(iter(scene.parts.items()), ("", ()))  # the scene's main part type
        if self.space is None and parts:
            how = drawing_of(name, troubles)
            if how is not None:
                self.space = troubles.attempt(called(name), partial(how.space, parts), None)
        return self.space


@dataclass(frozen=True)
class ViewMemory:
    """The memory of the view, shared by all browsers; only the drawing loop changes it.

    Attributes:
        troubles: errors of plug-ins' drawings.
        colours: names and colours of all sensors so far.
        fields: horizontal and vertical field of view of each sensor [°], by sensor; from its frames, or if they do not
            know it, a guess from the first image's proportions.
        sizes_px: (width, height) of the images that sensors send, by sensor.
        floors: tilt and height above the floor of each sensor.
        seen: last known poses of the sensors and of each person's views.
        ground: pose of the world on the stage.
        trails: recent positions of people.
        scenery: obstacles of a simulated room; None without one.
    """

    troubles: PluginErrors = field(default_factory=PluginErrors)
    colours: SensorColours = field(default_factory=SensorColours)
    fields: dict[str, tuple[float, float]] = field(default_factory=dict)
    sizes_px: dict[str, tuple[int, int]] = field(default_factory=dict)
    floors: Floors = field(default_factory=Floors)
    seen: Perspectives = field(default_factory=Perspectives)
    ground: Ground = field(default_factory=Ground)
    trails: Trails = field(default_factory=Trails)
    scenery: Scenery | None = None

    def learn(self, scene: Scene | None, frames: Mapping[str, SensorFrame], status: SessionStatus | None) -> None:
        """Update the memory; call it in every update of the view, also with unchanged arguments.

        Args:
            scene: the newest scene; None before the first.
            frames: newest frame of each sensor, by sensor.
            status: the session's status, whose setup may have the sensors' poses; None without a server.
        """
        self.colours.learn({row.name for row in status.sensors} if status else set())
        self.colours.learn(set(frames))
        if scene is not None:
            space = self.ground.learn(scene, self.troubles)
            self.seen.learn(scene, space)
            self.floors.learn_scene(scene, space)
            self.trails.learn(scene, self.seen.world)
        poses = status.setup.sensors if status else {}
        for name, frame in frames.items():
            lane = lane_of(frame, self.troubles)
            size_px = None if lane is None else lane.size_px(frame)
            if size_px is not None:
                self.sizes_px[name] = size_px
            if frame.field_of_view_deg != UNKNOWN_FIELD_OF_VIEW_DEG:
                self.fields[name] = frame.field_of_view_deg
            elif name not in self.fields:
                self.fields[name] = UNKNOWN_FIELD_OF_VIEW_DEG if size_px is None else _field_deg(size_px)
            if lane is not None and lane.on_floor:
                self.floors.learn_frame(frame, poses.get(name))  # type: ignore[arg-type]  # its lane declares the fields


def _field_deg(size_px: tuple[int, int]) -> tuple[float, float]:
    """Return the horizontal and vertical field of view [°] of a camera with images of (width, height)."""
    half = np.tan(np.radians(0.5 * _LONGER_SIDE_DEG)) / max(size_px)
    across, high = np.degrees(2 * np.arctan(half * np.array(size_px)))
    return float(across), float(high)
