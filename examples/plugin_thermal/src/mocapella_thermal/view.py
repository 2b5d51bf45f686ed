"""Drawings of spots: in their sensor's lane, and in the room."""

import numpy as np

from mocapella.geometry.rigid import apply
from mocapella.model.scene import Scene
from mocapella.viewer.bones import Strokes, joint_strokes
from mocapella.viewer.drawing import Tag
from mocapella.viewer.lanes import LaneDrawing, LaneSpace
from mocapella.viewer.layout import SENSORS_SCALE
from mocapella.viewer.palette import AMBER
from mocapella.viewer.room import PartDrawing, RoomView
from mocapella_thermal.frame import HeatFrame
from mocapella_thermal.spots import Spot


def balls(points: np.ndarray, colour: tuple[int, int, int], radius_m: float) -> Strokes:
    """A ball at each of (n, 3) points [m]."""
    n = len(points)
    return joint_strokes(points[:, None], np.full((n, 1), 2), np.tile(colour, (n, 1)), np.array([radius_m]))


def lane(frame: HeatFrame, space: LaneSpace) -> LaneDrawing:
    """A frame's spots in the gallery's scale."""
    points = np.array([(x, 0.0, z) for x, z, _ in frame.spots]).reshape(-1, 3)
    return LaneDrawing(balls=balls(points * SENSORS_SCALE + space.origin, space.colour.paint, 0.1 * SENSORS_SCALE))


def draw(spots: tuple[Spot, ...], scene: Scene, room: RoomView) -> PartDrawing:
    """Spots as balls on the floor, with their temperature over them."""
    points = apply(room.T_stage_world, np.array([(spot.x, 0.1, spot.z) for spot in spots]))
    tags = [Tag(f"{s.celsius:.1f} °C", (x, y + 0.25, z)) for s, (x, y, z) in zip(spots, points.tolist(), strict=True)]
    return PartDrawing(joints=balls(points, AMBER.paint, 0.1), tags=tuple(tags))
