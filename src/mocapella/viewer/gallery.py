"""The sensors' gallery: a lane for each sensor, with the newest frame of the sensor in its camera frame."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

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
from mocapella.viewer.scenery import lane_surfaces
from mocapella.viewer.stage import Surface
from mocapella.viewer.surface_nodes import SurfaceNodes
from mocapella.viewer.view_state import ViewMemory

Float64 = NDArray[np.float64]

_TITLE_SIZE = 1.2
LANE_TAG_SIZE = 0.9


@dataclass(frozen=True, eq=False)
class GalleryDrawing:
    """Content of the gallery, in the view's space.

    Attributes:
        spaces: position, orientation and colour of each lane by sensor, in the order of the lanes.
        lines, balls: strokes of all lanes together.
        surfaces: obstacles of a simulated room in the lanes, by ``sensor/name``.
    """

    spaces: Mapping[str, LaneSpace]
    lines: Strokes
    balls: Strokes
    surfaces: Mapping[str, Surface] = field(default_factory=dict)


def gallery_drawing(
    frames: Mapping[str, SensorFrame], known: ViewMemory, without: Collection[str] = ()
) -> GalleryDrawing:
    """Draw each sensor's newest frame in its lane; the lane of a sensor without a frame is empty.

    Args:
        frames: newest frame by sensor.
        known: memory of the view: which sensors there are, their colours and floors. It receives errors of drawings.
        without: sensors that get no lane.
    """
    sensors = [sensor for sensor in known.colours.sensors if sensor not in without]
    spaces = {
        sensor: LaneSpace(origin, known.floors.level(sensor), known.colours.of(sensor))
        for sensor, origin in zip(sensors, layout.lane_origins(len(sensors)), strict=True)
    }
    drawn = [draw_lane(frames[name], space, known.troubles) for name, space in spaces.items() if name in frames]
    surfaces = {
        f"{sensor}/{name}": surface
        for sensor, space in spaces.items()
        if known.scenery is not None
        for name, surface in lane_surfaces(known.scenery, sensor, _view_sensor(space)).items()
    }
    return GalleryDrawing(spaces, join([lane.lines for lane in drawn]), join([lane.balls for lane in drawn]), surfaces)


def lane_tags(drawing: GalleryDrawing) -> list[Tag]:
    """Return a label with the sensor's name in front of each lane."""
    return [Tag(sensor, _at(space.origin)) for sensor, space in drawing.spaces.items()]


class SensorsStage:
    """Scene nodes of the gallery in one browser.

    Args:
        scene: viser's 3D scene of the browser.
        fields: horizontal and vertical field of view by sensor [°], read at each drawing; a missing sensor has
            `UNKNOWN_FIELD_OF_VIEW_DEG`.
    """

    def __init__(self, scene: viser.SceneApi, fields: Mapping[str, tuple[float, float]]) -> None:
        self._scene, self._fields = scene, fields
        self._lines = StrokeNode(scene, "/sensors/bones", bone_mesh(), shadow=False)
        self._balls = StrokeNode(scene, "/sensors/markers", ball_mesh(), shadow=False)
        self._tags = TagNodes(scene, "/sensors/names", size=LANE_TAG_SIZE)
        self._title = TagNodes(scene, "/sensors/title", size=_TITLE_SIZE, anchor="bottom-left")
        self._surfaces = SurfaceNodes(scene, "/sensors/surfaces")
        self._floors: list[FloorNode] = []
        self._sensors: dict[str, SensorNode] = {}
        self._drawn: GalleryDrawing | None = None

    def draw(self, drawing: GalleryDrawing) -> None:
        """Show a drawing in place of the earlier one; nothing is sent if it is the same object."""
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
        self._surfaces.draw(drawing.surfaces)
        self._lines.draw(drawing.lines)
        self._balls.draw(drawing.balls)
        self._tags.draw(lane_tags(drawing))
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
            self._sensors[sensor] = SensorNode(self._scene, f"/sensors/{sensor}", scale=0.055, thickness=0.008)
        self._floors[lane].place(space.origin + np.array([0.0, 0.0, layout.LANE_DEPTH_M / 2 * SENSORS_SCALE]))
        T = space.T_level.copy()
        T[:3, 3] = space.origin + space.T_level[:3, 3] * SENSORS_SCALE
        field = self._fields.get(sensor, UNKNOWN_FIELD_OF_VIEW_DEG)
        self._sensors[sensor].place(T, space.colour, field)


def _view_sensor(space: LaneSpace) -> Float64:
    """Return the scaled transform (4, 4) from a sensor's camera space to its lane in the view's space."""
    T = space.T_level.copy()
    T[:3] *= SENSORS_SCALE
    T[:3, 3] += space.origin
    return T


def _at(origin: Float64) -> tuple[float, float, float]:
    x, y, z = origin.tolist()
    return x, y, z
