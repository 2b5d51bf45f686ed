"""The HANDS stage: enlarged hands with their markers, their cameras and the objects that they hold.

The cameras are in front of the stage, so that the viewer sees the hand as the cameras do.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.rigid import rotation_about_y
from mocapella.model.hand import DIGIT_ANGLES, hand_model
from mocapella.model.observations import JointState
from mocapella.model.scene import Scene, TrackedHand
from mocapella.viewer import layout
from mocapella.viewer.bones import bone_strokes, halo_strokes, join, joint_strokes, line_strokes
from mocapella.viewer.drawing import Tag
from mocapella.viewer.marker_lane import marker_colour
from mocapella.viewer.palette import AMBER, FUSED
from mocapella.viewer.sensor_marks import SensorMark, standing, words
from mocapella.viewer.stage import Stage, StageView, TrackingDrawing, enlarged_title

Float64 = NDArray[np.float64]

LARGEST_SCALE: Final = 6.0
_CAMERAS_WITHIN_M: Final = 3.0
"""Largest distance of a camera from the stage's centre [m]."""
_AHEAD_M: Final = 0.5
"""Distance in front of parallel cameras at which their common target is assumed [m]."""
_BONE_M, _JOINT_M, _MARKER_M, _OUTLINE_M = 0.004, 0.0055, 0.0068, 0.002
_AT_LIMIT: Final = np.radians(2.0)
_OVER: Final = np.array([0.0, 0.18, 0.0])


@dataclass(frozen=True, eq=False)
class StageOfHands:
    """Transform from the world to the stage: p_stage = scale · R · (p_world − centre) + the stage's centre.

    A similarity transform, so that hands are shown enlarged and centred.

    Attributes:
        R: (3, 3) rotation from the world to the stage.
        centre: (3,) world point at the stage's centre [m].
        scale: enlargement of the hands.
    """

    R: Float64
    centre: Float64
    scale: float

    @classmethod
    def of(cls, scene: Scene) -> StageOfHands:
        """Return the transform that centres the point that the cameras look at, or else the scene's hands.

        The scene is turned so that the cameras look along +z, and enlarged at most `LARGEST_SCALE` times, less if a
        camera would be far from the centre. Without cameras and hands, the world's origin is the centre.
        """
        places = np.array([place.T_world_sensor for place in scene.sensors if place.T_world_sensor is not None])
        if not len(places):
            seen = np.array([hand.landmarks for hand in scene.hands]).reshape(-1, 3)
            seen = seen[np.isfinite(seen).all(axis=-1)]
            return cls(np.eye(3), seen.mean(axis=0) if len(seen) else np.zeros(3), LARGEST_SCALE)
        axes, at = places[:, :3, 2], places[:, :3, 3]
        # Nearest to all optical axes; for parallel cameras, a prior half a metre ahead decides.
        across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
        ahead = (at + _AHEAD_M * axes).mean(axis=0)
        centre = np.linalg.solve(
            across.sum(axis=0) + 0.02 * np.eye(3), np.einsum("cij,cj->i", across, at) + 0.02 * ahead
        )
        forward = axes.sum(axis=0)
        farthest = float(np.linalg.norm(at - centre, axis=-1).max())
        scale = min(LARGEST_SCALE, _CAMERAS_WITHIN_M / max(farthest, 1e-3))
        return cls(rotation_about_y(-np.arctan2(forward[0], forward[2])), centre, scale)

    def place(self, points: Float64) -> Float64:
        """Transform points (..., 3) from the world to the stage [m]."""
        return self.scale * (points - self.centre) @ self.R.T + layout.stage_centre()

    def place_sensor(self, T_world_sensor: Float64) -> Float64:
        """Return a sensor's pose (4, 4) on the stage from its pose T_world_sensor (4, 4) [m]."""
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = self.R @ T_world_sensor[:3, :3], self.place(T_world_sensor[:3, 3])
        return T


def hands_drawing(scene: Scene) -> TrackingDrawing:
    """Draw a scene's hands, markers, cameras and objects, enlarged.

    Landmarks at a joint limit (`at_limit`) are amber; a hand without known landmarks is left out. The stage counts as
    empty (`TrackingDrawing.there`) without a hand and an object.
    """
    stage = StageOfHands.of(scene)
    bones, joints, halos, tags = [], [], [], []
    hands = [hand for hand in scene.hands if np.isfinite(hand.landmarks).all(axis=-1).any()]
    if hands:
        p = stage.place(np.stack([hand.landmarks for hand in hands]))
        s, white = np.stack([hand.states for hand in hands]), [FUSED] * len(hands)
        bones.append(bone_strokes(p, s, scene.topology, white, [stage.scale * _BONE_M] * len(hands)))
        joints.append(joint_strokes(p, s, white, np.full(s.shape[1], stage.scale * _JOINT_M)))
        halos.append(halo_strokes(p, s, stage.scale * np.stack([hand.sd for hand in hands]), white))
        limited = np.stack([at_limit(hand) for hand in hands])
        joints.append(
            joint_strokes(p, np.where(limited, s, 0), [AMBER.paint] * len(hands),
                          np.full(s.shape[1], 1.25 * stage.scale * _JOINT_M))
        )  # fmt: skip
        tags += [_hand_tag(hand, where) for hand, where in zip(hands, p, strict=True)]
    if scene.points is not None and len(scene.points.names):
        p = stage.place(scene.points.positions)
        seen = np.where(scene.points.cameras >= 2, JointState.TRACKED, JointState.INFERRED)
        colours = [marker_colour(name).paint for name in scene.points.names]
        joints.append(joint_strokes(p[:, None], seen[:, None], colours, [stage.scale * _MARKER_M]))
    for thing in scene.objects:
        if thing.T_world_object is None or len(thing.outline) < 2:
            continue
        line = thing.outline @ thing.T_world_object[:3, :3].T + thing.T_world_object[:3, 3]
        closed = stage.place(np.concatenate([line, line[:1]]))
        bones.append(line_strokes(closed, AMBER.paint, stage.scale * _OUTLINE_M))
        top = closed[np.argmax(closed[:, 1])] + _OVER
        tags.append(Tag(thing.name, tuple(top.tolist())))
    return TrackingDrawing(
        join(bones), join(joints), join(halos), tags, _marks(scene, stage), scale=stage.scale, there=bool(tags)
    )


def at_limit(hand: TrackedHand) -> NDArray[np.bool_]:
    """Return for each landmark of a hand (21,) whether an angle of its joint is within 2° of a joint limit.

    A lower limit of 0 or above, as of a straight finger, does not count. Unknown angles (NaN), the wrist and the
    fingertips give False.
    """
    limits, angles = hand_model("full").limits, hand.angles
    at_end = (angles >= limits[:, 1] - _AT_LIMIT) | ((angles <= limits[:, 0] + _AT_LIMIT) & (limits[:, 0] < 0))
    at_end &= limits[:, 1] > limits[:, 0]
    out = np.zeros(21, dtype=np.bool_)
    for digit, (flexion, abduction, middle, last, second_abduction) in enumerate(DIGIT_ANGLES):
        base = 1 + 4 * digit
        out[base] = at_end[flexion] or at_end[abduction]
        out[base + 1] = at_end[middle] or (second_abduction >= 0 and at_end[second_abduction])
        out[base + 2] = at_end[last]
    return out


def _hand_tag(hand: TrackedHand, where: Float64) -> Tag:
    top = where[np.isfinite(where).all(axis=-1)]
    measured = int((hand.states == JointState.TRACKED).sum())
    holds = f" · holds {hand.holds}" if hand.holds else ""
    known = f"{measured} of {len(hand.states)} measured" if measured else "predicted: no marker is measured now"
    text = f"{'Left' if hand.left else 'Right'} hand · {known}{holds}"
    return Tag(text, tuple((top[np.argmax(top[:, 1])] + _OVER).tolist()))


def _marks(scene: Scene, stage: StageOfHands) -> dict[str, SensorMark]:
    made, aside = {}, 0
    for place in scene.sensors:
        how = standing(place, False)
        if place.T_world_sensor is None:
            where, aside = layout.aside(aside), aside + 1
        else:
            where = stage.place_sensor(place.T_world_sensor)
        made[place.sensor] = SensorMark(where, how, words(place, how))
    return made


def _draw(scene: Scene | None, shown: Any, view: StageView) -> TrackingDrawing:
    if scene is None:
        return TrackingDrawing(scale=LARGEST_SCALE, there=False)
    return hands_drawing(scene)


HANDS: Final = Stage("hands", _draw, enlarged_title, layout.tracking_box(), float(np.radians(13.0)), perspectives=False)
