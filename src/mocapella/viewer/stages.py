"""The two stages: what the tracker makes of the people, and what each sensor says of itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from mocapella.geometry.rigid import apply, inverse
from mocapella.model.arms import ArmFrame
from mocapella.model.markers import MarkerFrame
from mocapella.model.observations import BodyFrame
from mocapella.model.scene import Person, Scene
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.topology import UNKNOWN_FIELD_OF_VIEW_DEG
from mocapella.viewer import layout
from mocapella.viewer.arms import SCALE as ARMS_SCALE
from mocapella.viewer.arms import ArmsShown, arms_drawing, lane_arms
from mocapella.viewer.bones import (
    NO_STROKES,
    Float32,
    Strokes,
    bone_strokes,
    doubt,
    halo_strokes,
    join,
    joint_strokes,
)
from mocapella.viewer.drawing import ClothNode, FloorNode, LineNode, SensorNode, StrokeNode, Tag, TagNodes
from mocapella.viewer.hands import hands_drawing, lane_picture
from mocapella.viewer.layout import SENSORS_SCALE
from mocapella.viewer.meshes import Mesh, ball_mesh, bone_mesh
from mocapella.viewer.palette import CLOTH, FUSED, SensorColours, person_colour
from mocapella.viewer.perspective import FREE, Float64, Floors, Perspectives
from mocapella.viewer.sensor_marks import PlaceState, SensorMark, field_lines, marks
from mocapella.viewer.trails import TrailChoice, Trails

FUSED_RADIUS_M, POTENTIAL_RADIUS_M, SENSOR_RADIUS_M = 0.025, 0.014, 0.03
JOINT_RADIUS_M, HEAD_RADIUS_M = 0.03, 0.095
_TITLE_SIZE = 1.2
_OVER_HEAD = np.array([0.0, 0.22, 0.0])
_OVER_SENSOR = np.array([0.0, 0.2, 0.0])
_OVER_TITLE = np.array([0.0, 0.16, 0.0])

Fields = Mapping[str, tuple[float, float]]
"""Each sensor's field of view, across and high [°]."""


@dataclass(frozen=True, eq=False)
class TrackingDrawing:
    """The Tracking stage of one perspective, ready to be drawn, in the view's own space.

    ``halos`` are about the joints that are unsure. ``unseen`` is what people are called whom the perspective's sensor
    never saw, who therefore cannot be placed in it. ``scale``: how many times larger than they are things are drawn.
    ``arms``: that it is the stage of arms, from three sides; ``cloth`` is what they hold there, by its colours.
    """

    bones: Strokes
    joints: Strokes
    halos: Strokes
    tags: list[Tag]
    sensors: dict[str, SensorMark]
    unseen: tuple[str, ...]
    scale: float = 1.0
    arms: bool = False
    cloth: tuple[Mesh | None, Mesh | None] = (None, None)


def tracking_drawing(
    scene: Scene | None, perspective: str, seen: Perspectives, floors: Floors, arms: ArmsShown | None = None
) -> TrackingDrawing:
    """What the Tracking stage shows from that perspective; without a scene, an empty stage.

    Args:
        scene: the newest.
        perspective: a sensor's name, or `FREE`.
        seen: from where each person was seen; has learned the scene.
        floors: how high the perspective is over the floor.
        arms: what the stage of arms needs; None where there are none.
    """
    if arms is not None:
        made = arms_drawing(scene, arms)
        return TrackingDrawing(made.lines, made.joints, made.hollow, made.tags, {}, (), ARMS_SCALE, True, made.cloth)
    if scene is not None and scene.topology.name == "hand":
        shown = hands_drawing(scene)
        return TrackingDrawing(shown.bones, shown.joints, shown.halos, shown.tags, shown.sensors, (), shown.scale)
    positions, states, sds, colours, radii = [], [], [], [], []
    fused, tags, unseen = [], [], []
    views_from: dict[str, Float64] = {}
    T_stage = floors.level(perspective)
    for person in scene.people if scene else ():
        T = seen.from_world(person, perspective)
        if T is None or scene is None:
            unseen.append(_called(person))
            continue
        views = person.views
        fused.append(len(states))
        positions.append(apply(T_stage @ T, np.stack([person.positions, *(view.positions for view in views)])))
        states += [person.states, *(view.states for view in views)]
        sds.append(person.sd)
        colours += [FUSED, *([person_colour(person.id).paint] * len(views))]
        radii += [FUSED_RADIUS_M, *([POTENTIAL_RADIUS_M] * len(views))]
        tags += _person_tag(person, positions[-1][0], len(views))
        for view in views:
            if view.sensor not in views_from:
                views_from[view.sensor] = T @ view.T_world_sensor
    bones = joints = halos = NO_STROKES
    if scene is not None and positions:  # all skeletons at once: one by one they would cost several times as much
        p, s, white = np.concatenate(positions), np.stack(states), [FUSED] * len(fused)
        doubts, of_fused = None, None
        if any(sd is not None for sd in sds):
            said = np.array([np.full(s.shape[1], np.nan) if sd is None else sd for sd in sds], np.float32)
            halos = halo_strokes(p[fused], s[fused], said, white)
            doubts, of_fused = np.zeros(s.shape, np.float32), doubt(said)
            doubts[fused] = of_fused
        bones = bone_strokes(p, s, scene.topology, colours, radii, doubts=doubts)
        joints = joint_strokes(p[fused], s[fused], white, _joint_radii(scene), doubts=of_fused)
    sensors = _sensor_marks(scene, perspective, seen, T_stage)
    for sensor, T in views_from.items():
        sensors.setdefault(sensor, SensorMark(T_stage @ T, PlaceState.GOOD, sensor))
    return TrackingDrawing(bones, joints, halos, tags, sensors, tuple(unseen))


def _sensor_marks(scene: Scene | None, perspective: str, seen: Perspectives, T_stage: Float64) -> dict[str, SensorMark]:
    """The sensors of which the tracker tells, and the perspective's own, which is at home wherever it stands."""
    made: dict[str, SensorMark] = {}
    if scene is not None and scene.sensors:
        T = np.eye(4) if perspective == FREE else seen.places.get(perspective)
        T_world = T if T is None or perspective == FREE else inverse(T)
        made = marks(scene.sensors, seen.places, None if T_world is None else T_stage @ T_world)
    if perspective != FREE:
        told = made.get(perspective, SensorMark(T_stage, PlaceState.GOOD, perspective))
        made[perspective] = replace(told, T=T_stage)
    return made


def _joint_radii(scene: Scene) -> Float32:
    radii = np.full(len(scene.topology), JOINT_RADIUS_M, np.float32)
    radii[scene.topology.parts["head"]] = HEAD_RADIUS_M
    return radii


def tracking_title(drawing: TrackingDrawing, perspective: str) -> Tag:
    """What stands before the Tracking stage: whose perspective it is, and who cannot be shown in it."""
    box = layout.arms_box() if drawing.arms else layout.tracking_box()
    return Tag(_title(drawing, perspective), layout.title_place(box))


def _title(drawing: TrackingDrawing, perspective: str) -> str:
    if drawing.scale != 1.0:
        return f"Tracking · {drawing.scale:.1f} times as large"
    title = "Tracking · free" if perspective == FREE else f"Tracking · seen from {perspective}"
    if drawing.unseen and drawing.sensors[perspective].standing is PlaceState.UNKNOWN:
        return f"{title} (not calibrated yet: look from another sensor, or free)"
    return f"{title} (never saw {', '.join(drawing.unseen)})" if drawing.unseen else title


def _called(person: Person) -> str:
    return person.name or f"person {person.id}"


def _person_tag(person: Person, fused: Float64, views: int) -> list[Tag]:
    there = np.isfinite(fused).all(axis=-1)
    if not there.any():
        return []
    top = fused[there][np.argmax(fused[there][:, 1])] + _OVER_HEAD
    who = _called(person)
    return [Tag(f"{who[0].upper()}{who[1:]} · {views} view{'' if views == 1 else 's'}", tuple(top.tolist()))]


class TrackingStage:
    """The Tracking stage in one browser: each browser may take another perspective."""

    def __init__(self, scene: viser.SceneApi, colours: SensorColours, fields: Fields) -> None:
        self._scene, self._colours, self._fields = scene, colours, fields
        self._bones = StrokeNode(scene, "/tracking/bones", bone_mesh())
        self._joints = StrokeNode(scene, "/tracking/joints", ball_mesh())
        self._halos = StrokeNode(scene, "/tracking/halos", ball_mesh(), shadow=False, translucent=True)
        self._cloth = [ClothNode(scene, f"/tracking/cloth/{k}", colour) for k, colour in enumerate(CLOTH)]
        self._trails = LineNode(scene, "/tracking/trails", thickness=0.02)
        self._field_lines = LineNode(scene, "/tracking/fields", thickness=0.008)
        self._trails_of: tuple[object, ...] = ()
        self._fields_of: tuple[object, ...] = ()
        self._tags = TagNodes(scene, "/tracking/people", size=0.9)
        self._names = TagNodes(scene, "/tracking/names", size=0.8)
        self._conditions = TagNodes(scene, "/tracking/conditions", size=0.9, anchor="bottom-left")
        self._title = TagNodes(scene, "/tracking/title", size=_TITLE_SIZE, anchor="bottom-left")
        self._empty = TagNodes(scene, "/tracking/empty", size=_TITLE_SIZE)
        self._sensors: dict[str, SensorNode] = {}
        floor = FloorNode(scene, "/tracking/floor", width=layout.TRACKING_WIDTH_M, depth=layout.TRACKING_DEPTH_M)
        floor.place(np.array([0.0, 0.0, layout.TRACKING_DEPTH_M / 2 - layout.BEHIND_SENSOR_M]))

    def draw(
        self,
        drawing: TrackingDrawing,
        perspective: str,
        empty: str,
        conditions: tuple[str, ...],
        *,
        eyes: bool,
        fields: bool,
    ) -> None:
        """Show it; ``empty`` stands on the stage while nobody does, ``conditions`` while somebody does.

        ``eyes``: the browser looks through the perspective's sensor, which would be in the way. ``fields``: what each
        sensor can see is drawn.
        """
        nobody = not drawing.tags and not drawing.unseen
        self._empty.draw([Tag(empty, layout.stage_centre())] if nobody else [])
        title = tracking_title(drawing, perspective)
        self._title.draw([title])
        over = [title.position + (len(conditions) - k) * _OVER_TITLE for k in range(len(conditions))]
        lines = [Tag(text, tuple(at.tolist())) for text, at in zip(conditions, over, strict=True)]
        self._conditions.draw([] if nobody else lines)
        self._bones.draw(drawing.bones)
        self._joints.draw(drawing.joints)
        self._halos.draw(drawing.halos)
        for node, part in zip(self._cloth, drawing.cloth, strict=True):
            node.draw(part)
        self._tags.draw(drawing.tags)
        shown = {name: mark for name, mark in drawing.sensors.items() if not (eyes and name == perspective)}
        self._draw_sensors(shown, fields)

    def draw_trails(
        self, trails: Trails, shown: TrailChoice, perspective: str, T_stage: Callable[[Person], Float64 | None]
    ) -> None:
        """Show the trails; nothing is sent where there is no newer sample and nothing else was chosen."""
        if self._trails_of != (what := (trails.number, shown, perspective)):
            self._trails_of = what
            self._trails.draw(*trails.lines(shown.of, shown.seconds, T_stage))

    def _draw_sensors(self, marked: Mapping[str, SensorMark], fields: bool) -> None:
        for sensor, mark in marked.items():
            if sensor not in self._sensors:
                self._sensors[sensor] = SensorNode(self._scene, f"/tracking/sensors/{sensor}", scale=0.15)
            self._sensors[sensor].place(mark.T, mark.colour(self._colours.of(sensor)), self._field(sensor))
        for sensor, node in self._sensors.items():
            if sensor not in marked:
                node.hide()
        places = {sensor: (mark.T[:3, 3] + _OVER_SENSOR).round(2) for sensor, mark in marked.items()}
        self._names.draw([Tag(mark.words, tuple(places[sensor].tolist())) for sensor, mark in marked.items()])
        looking = [s for s, mark in marked.items() if fields and mark.standing in (PlaceState.GOOD, PlaceState.DOUBTED)]
        drawn = [(s, marked[s].T.round(2), self._field(s)) for s in looking]
        if (key := tuple((s, T.tobytes(), field) for s, T, field in drawn)) != self._fields_of:
            self._fields_of = key
            lines = [field_lines(T, field) for _, T, field in drawn]
            colours = [np.full((8, 2, 3), self._colours.of(s).faint, np.uint8) for s in looking]
            self._field_lines.draw(_joined(lines, np.float32), _joined(colours, np.uint8))

    def _field(self, sensor: str) -> tuple[float, float]:
        return self._fields.get(sensor, UNKNOWN_FIELD_OF_VIEW_DEG)


def _joined(parts: list[NDArray[Any]], dtype: type) -> NDArray[Any]:
    return np.concatenate([np.zeros((0, 2, 3), dtype), *parts])


class SensorsStage:
    """The gallery, the same in all browsers: a lane for every sensor, where its skeletons are in its camera space."""

    def __init__(self, scene: viser.SceneApi, colours: SensorColours, fields: Fields) -> None:
        self._scene, self._colours, self._fields = scene, colours, fields
        self._bones = StrokeNode(scene, "/sensors/bones", bone_mesh(), shadow=False)
        self._balls = StrokeNode(scene, "/sensors/markers", ball_mesh(), shadow=False)
        self._tags = TagNodes(scene, "/sensors/names", size=0.9)
        self._title = TagNodes(scene, "/sensors/title", size=_TITLE_SIZE, anchor="bottom-left")
        self._floors: list[FloorNode] = []
        self._sensors: dict[str, SensorNode] = {}

    def draw(self, frames: Mapping[str, SensorFrame], floors: Floors) -> None:
        """Show each sensor's newest frame; the lane of a sensor without one is empty."""
        sensors = self._colours.sensors
        origins = layout.lane_origins(len(sensors))
        bones, balls, tags = [], [], []
        for lane, (sensor, origin) in enumerate(zip(sensors, origins, strict=True)):
            frame = frames.get(sensor)
            T_lane = floors.level(sensor)
            self._place_lane(lane, sensor, origin, T_lane)
            tags.append(Tag(sensor, tuple(origin.tolist())))
            if isinstance(frame, MarkerFrame):
                edge, markers = lane_picture(frame, origin, self._colours.of(sensor))
                bones.append(edge)
                balls.append(markers)
            elif isinstance(frame, ArmFrame):
                lines, joints = lane_arms(frame, origin, self._colours.of(sensor))
                bones.append(lines)
                balls.append(joints)
            elif isinstance(frame, BodyFrame) and frame.bodies:
                bones.append(lane_bones(frame, T_lane, origin, self._colours))
        self._bones.draw(join(bones))
        self._balls.draw(join(balls))
        self._tags.draw(tags)
        self._title.draw([Tag("Sensors", layout.title_place(layout.sensors_box(len(sensors))))] if sensors else [])

    def _place_lane(self, lane: int, sensor: str, origin: Float64, T_lane: Float64) -> None:
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
        self._floors[lane].place(origin + np.array([0.0, 0.0, layout.LANE_DEPTH_M / 2 * SENSORS_SCALE]))
        T = T_lane.copy()
        T[:3, 3] = origin + T_lane[:3, 3] * SENSORS_SCALE
        field = self._fields.get(sensor, UNKNOWN_FIELD_OF_VIEW_DEG)
        self._sensors[sensor].place(T, self._colours.of(sensor), field)


def lane_bones(frame: BodyFrame, T_lane: Float64, origin: Float64, colours: SensorColours) -> Strokes:
    """The frame's skeletons in the gallery's scale, in the lane that begins at ``origin`` (3,) [m]."""
    positions = apply(T_lane, frame.positions) * SENSORS_SCALE + origin
    radius = SENSOR_RADIUS_M * SENSORS_SCALE
    return bone_strokes(
        positions,
        frame.states,
        frame.topology,
        [colours.of(frame.sensor).paint] * frame.bodies,
        [radius] * frame.bodies,
    )
