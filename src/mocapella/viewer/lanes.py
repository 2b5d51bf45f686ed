"""Lanes of the sensors' gallery: how a frame of each type is drawn.

A frame type names its lane by reference (`mocapella.model.frame_types.FrameType.lane`). A plug-in's lane is a `Lane`,
or only a function like `Lane.draw`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.rigid import apply
from mocapella.model.arms import ArmFrame
from mocapella.model.frame_types import frame_type_of, what_it_sends
from mocapella.model.images import ImageFrame
from mocapella.model.keypoints import KeypointFrame
from mocapella.model.markers import MarkerFrame
from mocapella.model.observations import BodyFrame, JointState
from mocapella.model.sensor_frame import SensorFrame
from mocapella.registry import load
from mocapella.viewer.arm_strokes import lane_arms
from mocapella.viewer.bones import NO_STROKES, Strokes, bone_strokes, checked
from mocapella.viewer.keypoint_lane import lane_people
from mocapella.viewer.lane_picture import LanePicture
from mocapella.viewer.layout import SENSORS_SCALE
from mocapella.viewer.marker_lane import lane_picture
from mocapella.viewer.palette import Rgb
from mocapella.viewer.plugin_errors import PluginErrors

Float64 = NDArray[np.float64]

SENSOR_RADIUS_M: Final = 0.03


@dataclass(frozen=True, eq=False)
class LaneSpace:
    """Position, orientation and colour of a lane.

    A point p in camera space is drawn at ``SENSORS_SCALE · (T_level @ p) + origin`` in the view's space.

    Attributes:
        origin: (3,) middle of the lane's front edge, in the view's space [m].
        T_level: (4, 4) transform from the sensor's camera space to a frame whose floor is level and at y = 0 [m].
        colour: colour of the sensor.
    """

    origin: Float64
    T_level: Float64
    colour: Rgb


@dataclass(frozen=True, eq=False)
class LaneDrawing:
    """Drawing of a frame in its lane, in the view's space of `mocapella.viewer.layout`: y up, x to the screen's left.

    Attributes:
        lines: strokes of bones and lines; ``scales`` are radius, length and radius [m].
        balls: strokes of balls; ``scales`` are the ball's radius along each axis [m].
    """

    lines: Strokes = NO_STROKES
    balls: Strokes = NO_STROKES


EMPTY: Final = LaneDrawing()


def _as_it_is(frame: Any) -> Any:
    return frame


def _no_size(frame: Any) -> tuple[int, int] | None:
    return None


@dataclass(frozen=True)
class Lane:
    """Descriptor of how frames of one type are drawn.

    Attributes:
        draw: function of a frame and its `LaneSpace` that returns a `LaneDrawing`.
        keep: function that reduces a frame to the data needed to draw it again, for the timeline; by default the frame
            itself is kept.
        on_floor: whether frames are `mocapella.viewer.perspective.OnFloor`, so that the floor's height is estimated
            from them.
        size_px: function that returns the (width, height) of a frame's image, None for a frame without one.
    """

    draw: Callable[[Any, LaneSpace], LaneDrawing]
    keep: Callable[[Any], SensorFrame] = _as_it_is
    on_floor: bool = False
    size_px: Callable[[Any], tuple[int, int] | None] = _no_size


def _skeletons(frame: BodyFrame, space: LaneSpace) -> LaneDrawing:
    return LaneDrawing(lane_bones(frame, space)) if frame.bodies else EMPTY


def _markers(frame: MarkerFrame, space: LaneSpace) -> LaneDrawing:
    return LaneDrawing(*lane_picture(frame, space.origin, space.colour))


def _keypoints(frame: KeypointFrame, space: LaneSpace) -> LaneDrawing:
    return LaneDrawing(*lane_people(frame, space.origin, space.colour))


def _keypoint_image_size(frame: KeypointFrame) -> tuple[int, int] | None:
    return frame.size_px if min(frame.size_px) >= 1 else None


def _arms(frame: ArmFrame, space: LaneSpace) -> LaneDrawing:
    return LaneDrawing(*lane_arms(frame, space.origin, space.colour))


def _image(frame: ImageFrame, space: LaneSpace) -> LaneDrawing:
    if min(frame.size_px) < 1:
        return EMPTY
    return LaneDrawing(LanePicture(frame.size_px, space.origin, 0.6).edge(space.colour))


def _without_pixels(frame: ImageFrame) -> ImageFrame:
    return msgspec.structs.replace(frame, format="", data=b"")


def _image_size(frame: ImageFrame) -> tuple[int, int] | None:
    return frame.size_px if min(frame.size_px) >= 1 else None


def lane_bones(frame: BodyFrame, space: LaneSpace) -> Strokes:
    """Return the strokes of a frame's skeletons in its lane, at the gallery's scale; inferred bones are faint."""
    positions = apply(space.T_level, frame.positions) * SENSORS_SCALE + space.origin
    ends = np.asarray(frame.states)[:, np.array(frame.topology.bones)]
    measured = (ends == JointState.TRACKED).all(axis=-1)
    colours = np.where(measured[..., None], space.colour.paint, space.colour.faint)
    radii = [SENSOR_RADIUS_M * SENSORS_SCALE] * frame.bodies
    return bone_strokes(positions, frame.states, frame.topology, colours, radii)


SKELETONS: Final = Lane(_skeletons, on_floor=True)
MARKERS: Final = Lane(_markers)
KEYPOINTS: Final = Lane(_keypoints, size_px=_keypoint_image_size)
ARMS: Final = Lane(_arms)
IMAGES: Final = Lane(_image, keep=_without_pixels, size_px=_image_size)


def lane_of(frame: SensorFrame, troubles: PluginErrors) -> Lane | None:
    """Return the lane descriptor of a frame's type; None if the type has none.

    If the descriptor cannot be imported, the error is reported to ``troubles``, and None is returned.
    """
    kind = frame_type_of(frame)
    if kind is None or not kind.lane:
        return None
    return troubles.attempt(_called(frame), lambda: _lane(kind.lane), None)


def draw_lane(frame: SensorFrame, space: LaneSpace, troubles: PluginErrors) -> LaneDrawing:
    """Draw a frame in its lane; empty if its type has no lane, or if drawing fails (reported to ``troubles``)."""
    lane = lane_of(frame, troubles)
    return EMPTY if lane is None else troubles.attempt(_called(frame), lambda: _drawn(lane, frame, space), EMPTY)


def _drawn(lane: Lane, frame: SensorFrame, space: LaneSpace) -> LaneDrawing:
    drawing = lane.draw(frame, space)
    if not isinstance(drawing, LaneDrawing):
        raise TypeError(f"it makes {type(drawing).__name__}; a LaneDrawing is wanted")
    return LaneDrawing(checked(drawing.lines), checked(drawing.balls))


def kept(frame: SensorFrame, troubles: PluginErrors) -> SensorFrame | None:
    """Return a frame with only what its lane draws (`Lane.keep`), such as an image without pixels, for the timeline.

    None if its type has no lane, or if reducing it fails (reported to ``troubles``).
    """
    lane = lane_of(frame, troubles)
    return None if lane is None else troubles.attempt(_called(frame), lambda: lane.keep(frame), None)


def _called(frame: SensorFrame) -> str:
    return f"lane of {what_it_sends(frame)}"


@cache
def _lane(reference: str) -> Lane:
    found = load(reference)
    return found if isinstance(found, Lane) else Lane(found)
