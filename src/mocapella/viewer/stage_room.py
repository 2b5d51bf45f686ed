"""The ROOM stage: all parts of a scene life-size in one room, in a sensor's or the `FREE` perspective."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.rigid import inverse
from mocapella.model.scene import Scene
from mocapella.viewer import layout
from mocapella.viewer.bones import join
from mocapella.viewer.perspective import FREE, Perspectives
from mocapella.viewer.room import PartDrawing, RoomView, draw_parts
from mocapella.viewer.scenery import room_surfaces
from mocapella.viewer.sensor_marks import PlaceState, SensorMark, marks
from mocapella.viewer.stage import Stage, StageView, TrackingDrawing

Float64 = NDArray[np.float64]


def draw_room(scene: Scene | None, shown: Any, view: StageView) -> TrackingDrawing:
    """Draw all parts of a scene in a perspective; the drawing is empty without a scene. This is a `Stage.draw`.

    Args:
        scene: the scene; None before the first.
        shown: value of the stage's memory, not used.
        view: viewpoint of the drawing.
    """
    room = RoomView(view.perspective, view.seen, view.floors)
    drawn: dict[str, PartDrawing] = {}
    for name, parts in scene.parts.items() if scene is not None else ():
        assert scene is not None
        drawn[name] = draw_parts(name, parts, scene, room, view.troubles)
    parts_of = tuple(drawn.values())
    sensors = _sensor_marks(scene, view.perspective, view.seen, room.T_stage_perspective)
    for one in parts_of:
        for sensor, T in one.sensors.items():
            sensors.setdefault(sensor, SensorMark(T, PlaceState.GOOD, sensor))
    extents = [one.extent for one in parts_of if one.extent is not None]
    return TrackingDrawing(
        bones=join([one.bones for one in parts_of]),
        joints=join([one.joints for one in parts_of]),
        halos=join([one.halos for one in parts_of]),
        tags=[tag for one in parts_of for tag in one.tags],
        sensors=sensors,
        unseen=tuple(name for one in parts_of for name in one.unseen),
        remarks=tuple(text for one in parts_of for text in one.remarks),
        there=any(one.there for one in parts_of),
        surfaces={f"{name}/{key}": part for name, one in drawn.items() for key, part in one.surfaces.items()}
        | ({} if view.scenery is None else room_surfaces(view.scenery, room)),
        skins={f"{name}/{key}": part for name, one in drawn.items() for key, part in one.skins.items()},
        extent=_around(extents),
    )


def _around(extents: list[tuple[Float64, Float64]]) -> tuple[Float64, Float64] | None:
    if not extents:
        return None
    return np.min([low for low, _ in extents], axis=0), np.max([high for _, high in extents], axis=0)


def _sensor_marks(scene: Scene | None, perspective: str, seen: Perspectives, T_stage: Float64) -> dict[str, SensorMark]:
    """Return the marks of the scene's sensors, and of the perspective's sensor at the stage's origin."""
    made: dict[str, SensorMark] = {}
    if scene is not None and scene.sensors:
        T = seen.places.get(perspective)
        T_world = seen.T_free_world if perspective == FREE else T if T is None else inverse(T)
        made = marks(scene.sensors, seen.places, None if T_world is None else T_stage @ T_world)
    if perspective != FREE:
        told = made.get(perspective, SensorMark(T_stage, PlaceState.GOOD, perspective))
        made[perspective] = replace(told, T=T_stage)
    return made


def room_title(drawing: TrackingDrawing, perspective: str) -> str:
    """Return the stage's title: the frame of reference, the people who cannot be shown in it, and remarks."""
    title = "Scene · world frame" if perspective == FREE else f"Scene · camera frame of {perspective}"
    if drawing.unseen and drawing.sensors[perspective].standing is PlaceState.UNKNOWN:
        return f"{title} (not calibrated yet: look from another sensor, or free)"
    unseen = [f"never saw {', '.join(drawing.unseen)}"] if drawing.unseen else []
    said = "; ".join([*unseen, *drawing.remarks])
    return f"{title} ({said})" if said else title


ROOM: Final = Stage("room", draw_room, room_title, layout.tracking_box(), float(np.radians(13.0)), pictures=True)
