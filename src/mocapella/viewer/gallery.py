"""The sensors' gallery in one browser: a lane for every sensor, where what it sees is in its camera space."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
import viser
from numpy.typing import NDArray

from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.topology import UNKNOWN_FIELD_OF_VIEW_DEG
from mocapella.viewer import layout
from mocapella.viewer.bones import Strokes, join
from mocapella.viewer.drawing import FloorNode, SensorNode, StrokeNode, Tag, TagNodes
from mocapella.viewer.lanes import LaneSpace, draw_lane
from mocapella.viewer.layout import SENSORS_SCALE
from mocapella.viewer.meshes import ball_mesh, bone_mesh
from mocapella.viewer.view_state import Known

Float64 = NDArray[np.float64]

_TITLE_SIZE = 1.2


@dataclass(frozen=True, eq=False)
class GalleryDrawing:
    """The gallery, ready to be drawn.

    Attributes:
        spaces: of the lanes, by sensor, in their order.
        lines, balls: of all lanes.
    """

    spaces: Mapping[str, LaneSpace]
    lines: Strokes
    balls: Strokes


def gallery_drawing(frames: Mapping[str, SensorFrame], known: Known, without: Collection[str] = ()) -> GalleryDrawing:
    """Each sensor's newest frame in its lane; the lane of a sensor without one is empty.

    Args:
        frames: by sensor.
        known: all sensors that there were, and how they stand.
        without: sensors that have no lane.
    """
    sensors = [sensor for sensor in known.colours.sensors if sensor not in without]
    spaces = {
        sensor: LaneSpace(origin, known.floors.level(sensor), known.colours.of(sensor))
        for sensor, origin in zip(sensors, layout.lane_origins(len(sensors)), strict=True)
    }
    drawn = [draw_lane(frames[name], space, known.troubles) for name, space in spaces.items() if name in frames]
    return GalleryDrawing(spaces, join([lane.lines for lane in drawn]), join([lane.balls for lane in drawn]))


class SensorsStage:
    """Draws it."""

    def __init__(self, scene: viser.SceneApi, fields: Mapping[str, tuple[float, float]]) -> None:
        self._scene, self._fields = scene, fields
        self._lines = StrokeNode(scene, "/sensors/bones", bone_mesh(), shadow=False)
        self._balls = StrokeNode(scene, "/sensors/markers", ball_mesh(), shadow=False)
        self._tags = TagNodes(scene, "/sensors/names", size=0.9)
        self._title = TagNodes(scene, "/sensors/title", size=_TITLE_SIZE, anchor="bottom-left")
        self._floors: list[FloorNode] = []
        self._sensors: dict[str, SensorNode] = {}
        self._drawn: GalleryDrawing | None = None

    def draw(self, drawing: GalleryDrawing) -> None:
        """Show exactly this; nothing is sent where it is the one already shown."""
        if drawing is self._drawn:
            return
        self._drawn = drawing
        for lane, (sensor, space) in enumerate(drawing.spaces.items()):
            self._place_lane(lane, sensor, space)
        for floor in self._floors[len(drawing.spaces) :]:
            floor.hide()
        for sensor, node in self._sensors.items():
            if sensor not in drawing.spaces:
                node.hide()
        self._lines.draw(drawing.lines)
        self._balls.draw(drawing.balls)
        self._tags.draw([Tag(sensor, _at(space.origin)) for sensor, space in drawing.spaces.items()])
        box = layout.sensors_box(len(drawing.spaces))
        self._title.draw([Tag("Sensors", layout.title_place(box))] if drawing.spaces else [])

    def _place_lane(self, lane: int, sensor: str, space: LaneSpace) -> None:
        if lane == len(self._floors):
            self._floors.append(
                FloorNode(
                    self._scene,
                    f"/sensors/floor/{lane}",
                    width=layout.LANE_WIDTH_M,
                    depth=layout.LANE_DEPTH_M,
                    scale=SENSORS_SCALE,
                )
            )
        if sensor not in self._sensors:
            self._sensors[sensor] = SensorNode(self._scene, f"/sensors/{sensor}", scale=0.09)
        self._floors[lane].place(space.origin + np.array([0.0, 0.0, layout.LANE_DEPTH_M / 2 * SENSORS_SCALE]))
        T = space.T_level.copy()
        T[:3, 3] = space.origin + space.T_level[:3, 3] * SENSORS_SCALE
        field = self._fields.get(sensor, UNKNOWN_FIELD_OF_VIEW_DEG)
        self._sensors[sensor].place(T, space.colour, field)


def _at(origin: Float64) -> tuple[float, float, float]:
    x, y, z = origin.tolist()
    return x, y, z
