"""The two stages: what the tracker makes of the people, and what each sensor says of itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import viser

from mocapella.geometry.rigid import apply
from mocapella.model.observations import BodyFrame
from mocapella.model.scene import Person, Scene
from mocapella.viewer import layout
from mocapella.viewer.bones import NO_STROKES, Float32, Strokes, bone_strokes, join, joint_strokes
from mocapella.viewer.drawing import FloorNode, SensorNode, StrokeNode, Tag, TagNodes
from mocapella.viewer.layout import SENSORS_SCALE
from mocapella.viewer.meshes import ball_mesh, bone_mesh
from mocapella.viewer.palette import FUSED, SensorColours, person_colour
from mocapella.viewer.perspective import FREE, Float64, Floors, Perspectives

FUSED_RADIUS_M, POTENTIAL_RADIUS_M, SENSOR_RADIUS_M = 0.025, 0.014, 0.03
JOINT_RADIUS_M, HEAD_RADIUS_M = 0.03, 0.095
_TITLE_SIZE = 1.2
_OVER_HEAD = np.array([0.0, 0.22, 0.0])


@dataclass(frozen=True, eq=False)
class TrackingDrawing:
    """The Tracking stage of one perspective, ready to be drawn, in the view's own space.

    ``unseen`` are the ids of people whom the perspective's sensor never saw, who therefore cannot be placed in it.
    """

    bones: Strokes
    joints: Strokes
    tags: list[Tag]
    sensors: dict[str, Float64]
    unseen: tuple[int, ...]


def tracking_drawing(scene: Scene | None, perspective: str, seen: Perspectives, floors: Floors) -> TrackingDrawing:
    """What the Tracking stage shows from that perspective; without a scene, an empty stage.

    Args:
        scene: the newest.
        perspective: a sensor's name, or `FREE`.
        seen: from where each person was seen; has learned the scene.
        floors: how high the perspective is over the floor.
    """
    positions, states, colours, radii = [], [], [], []
    fused, tags, unseen = [], [], []
    sensors: dict[str, Float64] = {}
    if perspective != FREE:
        sensors[perspective] = np.eye(4)
    T_stage = floors.level(perspective)
    for person in scene.people if scene else ():
        T = seen.from_world(person, perspective)
        if T is None or scene is None:
            unseen.append(person.id)
            continue
        views = person.views
        fused.append(len(states))
        positions.append(apply(T_stage @ T, np.stack([person.positions, *(view.positions for view in views)])))
        states += [person.states, *(view.states for view in views)]
        colours += [FUSED, *([person_colour(person.id).paint] * len(views))]
        radii += [FUSED_RADIUS_M, *([POTENTIAL_RADIUS_M] * len(views))]
        tags += _person_tag(person, positions[-1][0], len(views))
        for view in views:
            if view.sensor not in sensors:
                sensors[view.sensor] = T @ view.T_world_sensor
    placed = {sensor: T_stage @ T for sensor, T in sensors.items()}
    bones = joints = NO_STROKES
    if scene is not None and positions:  # all skeletons at once: one by one they would cost several times as much
        p, s = np.concatenate(positions), np.stack(states)
        bones = bone_strokes(p, s, scene.topology, colours, radii)
        joints = joint_strokes(p[fused], s[fused], [FUSED] * len(fused), _joint_radii(scene))
    return TrackingDrawing(bones, joints, tags, placed, tuple(unseen))


def _joint_radii(scene: Scene) -> Float32:
    radii = np.full(len(scene.topology), JOINT_RADIUS_M, np.float32)
    radii[scene.topology.parts["head"]] = HEAD_RADIUS_M
    return radii


def tracking_title(drawing: TrackingDrawing, perspective: str) -> str:
    """What stands before the Tracking stage: whose perspective it is, and who cannot be shown in it."""
    title = "Tracking · free" if perspective == FREE else f"Tracking · seen from {perspective}"
    unseen = ", ".join(str(person) for person in drawing.unseen)
    return f"{title} (never saw person {unseen})" if unseen else title


def _person_tag(person: Person, fused: Float64, views: int) -> list[Tag]:
    there = np.isfinite(fused).all(axis=-1)
    if not there.any():
        return []
    top = fused[there][np.argmax(fused[there][:, 1])] + _OVER_HEAD
    return [Tag(f"Person {person.id} · {views} view{'' if views == 1 else 's'}", tuple(top.tolist()))]


class TrackingStage:
    """The Tracking stage in one browser: each browser may take another perspective."""

    def __init__(self, scene: viser.SceneApi, colours: SensorColours) -> None:
        self._scene, self._colours = scene, colours
        self._bones = StrokeNode(scene, "/tracking/bones", bone_mesh())
        self._joints = StrokeNode(scene, "/tracking/joints", ball_mesh())
        self._tags = TagNodes(scene, "/tracking/people", size=0.9)
        self._title = TagNodes(scene, "/tracking/title", size=_TITLE_SIZE, anchor="bottom-left")
        self._empty = TagNodes(scene, "/tracking/empty", size=_TITLE_SIZE)
        self._sensors: dict[str, SensorNode] = {}
        floor = FloorNode(scene, "/tracking/floor", width=layout.TRACKING_WIDTH_M, depth=layout.TRACKING_DEPTH_M)
        floor.place(np.array([0.0, 0.0, layout.TRACKING_DEPTH_M / 2 - layout.BEHIND_SENSOR_M]))

    def draw(self, drawing: TrackingDrawing, perspective: str, empty: str, *, eyes: bool) -> None:
        """Show it; ``empty`` stands on the stage while nobody does.

        ``eyes``: the browser looks through the perspective's sensor, which would be in the way.
        """
        nobody = not drawing.tags and not drawing.unseen
        self._empty.draw([Tag(empty, layout.stage_centre())] if nobody else [])
        self._title.draw([Tag(tracking_title(drawing, perspective), layout.title_place(layout.tracking_box()))])
        self._bones.draw(drawing.bones)
        self._joints.draw(drawing.joints)
        self._tags.draw(drawing.tags)
        for sensor, T in drawing.sensors.items():
            if sensor not in self._sensors:
                self._sensors[sensor] = SensorNode(self._scene, f"/tracking/sensors/{sensor}", scale=0.12)
            self._sensors[sensor].place(T, self._colours.of(sensor))
        for sensor, node in self._sensors.items():
            if sensor not in drawing.sensors or (eyes and sensor == perspective):
                node.hide()


class SensorsStage:
    """The gallery, the same in all browsers: a lane for every sensor, where its skeletons are in its camera space."""

    def __init__(self, scene: viser.SceneApi, colours: SensorColours) -> None:
        self._scene, self._colours = scene, colours
        self._bones = StrokeNode(scene, "/sensors/bones", bone_mesh(), shadow=False)
        self._tags = TagNodes(scene, "/sensors/names", size=0.9)
        self._title = TagNodes(scene, "/sensors/title", size=_TITLE_SIZE, anchor="bottom-left")
        self._floors: list[FloorNode] = []
        self._sensors: dict[str, SensorNode] = {}

    def draw(self, frames: Mapping[str, BodyFrame], floors: Floors) -> None:
        """Show each sensor's newest frame; the lane of a sensor without one is empty."""
        sensors = self._colours.sensors
        origins = layout.lane_origins(len(sensors))
        bones, tags = [], []
        for lane, (sensor, origin) in enumerate(zip(sensors, origins, strict=True)):
            frame = frames.get(sensor)
            T_lane = floors.level(sensor)
            self._place_lane(lane, sensor, origin, T_lane)
            tags.append(Tag(sensor, tuple(origin.tolist())))
            if frame is not None and frame.bodies:
                bones.append(lane_bones(frame, T_lane, origin, self._colours))
        self._bones.draw(join(bones))
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
        self._sensors[sensor].place(T, self._colours.of(sensor))


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
