"""Scene nodes of the Scene stage in one browser, because each browser may have another perspective."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from mocapella.model.topology import UNKNOWN_FIELD_OF_VIEW_DEG
from mocapella.viewer import layout
from mocapella.viewer.drawing import FloorNode, LineNode, SensorNode, SkinNode, StrokeNode, Tag, TagNodes
from mocapella.viewer.label_layout import LabelCamera, apart
from mocapella.viewer.meshes import ball_mesh, bone_mesh
from mocapella.viewer.palette import SensorColours
from mocapella.viewer.perspective import Float64
from mocapella.viewer.sensor_marks import PlaceState, SensorMark, field_lines
from mocapella.viewer.stage import Stage, TrackingDrawing
from mocapella.viewer.surface_nodes import SurfaceNodes

Fields = Mapping[str, tuple[float, float]]
"""Horizontal and vertical field of view of each sensor [°], by sensor."""

_TITLE_SIZE, _PEOPLE_SIZE, _NAME_SIZE = 1.2, 0.9, 0.8
_OVER_SENSOR_M = 0.2
_OVER_TITLE = np.array([0.0, 0.16, 0.0])
SENSOR_M, SENSOR_LINE_M = 0.12, 0.01
_OF_DISTANCE, _LINE_OF_SIZE = 0.012, 0.09
"""For sensors of one size on the screen: size over the distance from the viewer, and line thickness over size."""
FLOOR_STEP_M = 1.0
"""Step of a floor that follows people: one square, so that its grid lines stay in place [m]."""
_TITLE_BESIDE = np.array([2.5, 0.0, 0.0])
"""Offset of a stage's title from the point that the camera follows [m]."""
_FLOOR = np.array([0.0, 0.0, layout.TRACKING_DEPTH_M / 2 - layout.BEHIND_SENSOR_M])


def tracking_title(stage: Stage, drawing: TrackingDrawing, perspective: str) -> Tag:
    """Return a label with the title of a stage, at the front edge of the stage."""
    return Tag(stage.title(drawing, perspective), layout.title_place(stage.box))


class TrackingStage:
    """The Scene stage in one browser's 3D scene: people, meshes, trails, sensors, labels and the floor.

    A drawing that is already shown is not sent again.

    Args:
        scene: viser's 3D scene of the browser.
        colours: colours of the sensors.
        fields: horizontal and vertical field of view of each sensor [°], by the sensor's name. Each `draw` reads it, so
            later changes count; a missing sensor has `UNKNOWN_FIELD_OF_VIEW_DEG`.
    """

    def __init__(self, scene: viser.SceneApi, colours: SensorColours, fields: Fields) -> None:
        self._scene, self._colours, self._fields = scene, colours, fields
        self._bones = StrokeNode(scene, "/tracking/bones", bone_mesh())
        self._joints = StrokeNode(scene, "/tracking/joints", ball_mesh())
        self._halos = StrokeNode(scene, "/tracking/halos", ball_mesh(), shadow=False, translucent=True)
        self._surfaces = SurfaceNodes(scene, "/tracking/surfaces")
        self._skins: dict[str, SkinNode] = {}
        self._trails = LineNode(scene, "/tracking/trails", thickness=0.02)
        self._field_lines = LineNode(scene, "/tracking/fields", thickness=0.008)
        self._trails_of: tuple[object, ...] = ()
        self._fields_of: tuple[object, ...] = ()
        self._tags = TagNodes(scene, "/tracking/people", size=_PEOPLE_SIZE)
        self._names = TagNodes(scene, "/tracking/names", size=_NAME_SIZE)
        self._conditions = TagNodes(scene, "/tracking/conditions", size=0.9, anchor="bottom-left")
        self._title = TagNodes(scene, "/tracking/title", size=_TITLE_SIZE, anchor="bottom-left")
        self._empty = TagNodes(scene, "/tracking/empty", size=_TITLE_SIZE)
        self._sensors: dict[str, SensorNode] = {}
        self._floor = FloorNode(scene, "/tracking/floor", width=layout.TRACKING_WIDTH_M, depth=layout.TRACKING_DEPTH_M)
        self._drawn: TrackingDrawing | None = None
        self._floor.place(_FLOOR)

    def draw(
        self,
        stage: Stage,
        drawing: TrackingDrawing,
        perspective: str,
        empty: str,
        conditions: tuple[str, ...],
        *,
        eyes: bool,
        fields: bool,
        named: bool = True,
        along: Float64 | None = None,
        eye: Float64 | None = None,
        camera: LabelCamera | None = None,
        lanes: Sequence[tuple[float, Sequence[Tag]]] = (),
    ) -> None:
        """Show a drawing in place of the earlier one. Bones, joints and meshes of the same object are not sent again.

        Args:
            stage: the stage that made the drawing.
            drawing: content of the stage.
            perspective: a sensor's name, or `mocapella.viewer.perspective.FREE`.
            empty: text on an empty stage.
            conditions: text lines above the title of a stage with content, such as problems.
            eyes: whether the browser looks through the perspective's sensor, which is then hidden.
            fields: whether the sensors' fields of view are drawn.
            named: whether the sensors' names are shown.
            along: (3,) point in the view's space that the browser's camera follows [m]; floor and title move with it.
                None if they stay.
            eye: (3,) viewpoint in the view's space [m]; all sensors then appear equally large from it. None for their
                usual size.
            camera: camera of the browser, to keep labels apart on the screen; None if unknown.
            lanes: font scales and labels of the gallery, which the labels of this stage must not cover.
        """
        self._empty.draw([] if drawing.there else [Tag(empty, layout.stage_centre())])
        title = tracking_title(stage, drawing, perspective)
        at = np.array(title.position)
        if along is None:
            self._floor.place(_FLOOR)
        else:
            ground = along * [1.0, 0.0, 1.0]
            self._floor.place(FLOOR_STEP_M * np.round(ground / FLOOR_STEP_M))
            at = ground + _TITLE_BESIDE
        self._title.draw([Tag(title.text, _place(at))])
        over = [at + (len(conditions) - k) * _OVER_TITLE for k in range(len(conditions))]
        lines = [Tag(text, _place(place)) for text, place in zip(conditions, over, strict=True)]
        self._conditions.draw(lines if drawing.there else [])
        if drawing is not self._drawn:
            self._drawn = drawing
            self._bones.draw(drawing.bones)
            self._joints.draw(drawing.joints)
            self._halos.draw(drawing.halos)
            self._draw_meshes(drawing)
        shown = {name: mark for name, mark in drawing.sensors.items() if not (eyes and name == perspective)}
        names = self._draw_sensors(shown, fields=fields, named=named, eye=eye)
        people = drawing.tags
        if camera is not None:
            *_, names, people = apart([*lanes, (_NAME_SIZE, names), (_PEOPLE_SIZE, people)], camera)
        self._names.draw(names)
        self._tags.draw(people)

    def draw_trails(self, key: tuple[object, ...], lines: Any) -> None:
        """Show people's trails, if they have changed.

        Args:
            key: identity of the trails; they are drawn only if it differs from the last call's.
            lines: function that returns the trails as line segments, see `mocapella.viewer.trails.trail_lines`.
        """
        if self._trails_of != key:
            self._trails_of = key
            self._trails.draw(*lines())

    def _draw_meshes(self, drawing: TrackingDrawing) -> None:
        self._surfaces.draw(drawing.surfaces)
        for name, skin in drawing.skins.items():
            if name not in self._skins:
                self._skins[name] = SkinNode(self._scene, f"/tracking/skins/{len(self._skins)}")
            self._skins[name].draw(skin.mesh, skin.T_stage_parts, skin.colour, skin.opacity)
        for name, skin_node in self._skins.items():
            if name not in drawing.skins:
                skin_node.hide()

    def _draw_sensors(
        self, marked: Mapping[str, SensorMark], *, fields: bool, named: bool, eye: Float64 | None
    ) -> list[Tag]:
        """Draw the sensors and their fields of view; return the labels of their names."""
        sizes = {}
        for sensor, mark in marked.items():
            if sensor not in self._sensors:
                node = SensorNode(self._scene, f"/tracking/sensors/{sensor}", scale=SENSOR_M, thickness=SENSOR_LINE_M)
                self._sensors[sensor] = node
            size = SENSOR_M if eye is None else _OF_DISTANCE * float(np.linalg.norm(mark.T[:3, 3] - eye))
            sizes[sensor] = size
            self._sensors[sensor].resize(size, SENSOR_LINE_M if eye is None else _LINE_OF_SIZE * size)
            self._sensors[sensor].place(mark.T, mark.colour(self._colours.of(sensor)), self._field(sensor))
        for sensor, node in self._sensors.items():
            if sensor not in marked:
                node.hide()
        over = {sensor: _OVER_SENSOR_M if eye is None else 1.3 * size for sensor, size in sizes.items()}
        places = {sensor: (mark.T[:3, 3] + [0.0, over[sensor], 0.0]).round(2) for sensor, mark in marked.items()}
        looking = [s for s, mark in marked.items() if fields and mark.standing in (PlaceState.GOOD, PlaceState.DOUBTED)]
        drawn = [(s, marked[s].T.round(2), self._field(s)) for s in looking]
        if (key := tuple((s, T.tobytes(), field) for s, T, field in drawn)) != self._fields_of:
            self._fields_of = key
            lines = [field_lines(T, field) for _, T, field in drawn]
            colours = [np.full((8, 2, 3), self._colours.of(s).faint, np.uint8) for s in looking]
            self._field_lines.draw(_joined(lines, np.float32), _joined(colours, np.uint8))
        return [Tag(mark.words, _place(places[sensor]), named) for sensor, mark in marked.items()]

    def _field(self, sensor: str) -> tuple[float, float]:
        return self._fields.get(sensor, UNKNOWN_FIELD_OF_VIEW_DEG)


def _place(at: Float64) -> tuple[float, float, float]:
    x, y, z = at.tolist()
    return x, y, z


def _joined(parts: list[NDArray[Any]], dtype: type) -> NDArray[Any]:
    return np.concatenate([np.zeros((0, 2, 3), dtype), *parts])
