"""Draw rigid objects in the room: outlines and names."""

from __future__ import annotations

from typing import Final

import numpy as np

from mocapella.geometry.rigid import apply
from mocapella.model.observations import JointState
from mocapella.model.scene import Scene, TrackedObject
from mocapella.viewer.bones import Strokes, join, line_strokes
from mocapella.viewer.drawing import Tag
from mocapella.viewer.palette import AMBER
from mocapella.viewer.room import DrawPart, PartDrawing, RoomView

_OUTLINE_M: Final = 0.006
_OVER: Final = np.array([0.0, 0.05, 0.0])


def draw_objects(objects: tuple[TrackedObject, ...], scene: Scene, room: RoomView) -> PartDrawing:
    """Draw rigid objects in a perspective: the closed line of each outline, and the name above it.

    An object that is not measured now has thinner lines; one without a pose or an outline is left out. This is a
    `DrawPart.draw`.
    """
    bones: list[Strokes] = []
    tags = []
    for thing in objects:
        if thing.T_world_object is None or len(thing.outline) < 2:
            continue
        line = apply(room.T_stage_world @ thing.T_world_object, thing.outline)
        closed = np.concatenate([line, line[:1]])
        thick = _OUTLINE_M * (1.0 if thing.state == JointState.TRACKED else 0.45)
        bones.append(line_strokes(closed, AMBER.paint, thick))
        x, y, z = (closed[np.argmax(closed[:, 1])] + _OVER).tolist()
        tags.append(Tag(thing.name, (x, y, z)))
    return PartDrawing(join(bones), tags=tuple(tags))


OBJECTS: Final = DrawPart(draw_objects)
