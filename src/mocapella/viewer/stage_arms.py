"""The ARMS stage: enlarged arms from the front, in perspective and from the side at once.

An arm is eight balls, joined by lines: a colour for each digit, white for the other joints. An inferred joint is a
pale, translucent ball.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.geometry.rigid import rotation_about_x, rotation_about_y
from mocapella.model.arm_quality import ArmQuality
from mocapella.model.arms import ARM_JOINT_NAMES, ARM_JOINTS, PALM
from mocapella.model.observations import JointState
from mocapella.model.part_types import PART_TYPES
from mocapella.model.scene import Scene, TrackedArm
from mocapella.registry import load
from mocapella.viewer import layout
from mocapella.viewer.arm_panel import ArmPanel
from mocapella.viewer.arm_strokes import COLOURS, arm_strokes
from mocapella.viewer.bones import Strokes, join, line_strokes
from mocapella.viewer.drawing import Tag
from mocapella.viewer.meshes import Mesh
from mocapella.viewer.palette import CLOTH, Rgb
from mocapella.viewer.stage import Stage, StageView, Surface, TrackingDrawing, enlarged_title

Float64 = NDArray[np.float64]

SCALE: Final = 2.3
_APART_M: Final = 1.75
_EYE_M: Final = 6.5
"""Distance of the viewer whom the views on both sides face [m]."""
_NAME_HIGH_M: Final = 0.075
_BESIDE_M: Final = 0.19
"""Distance of their names from elbow, wrist and palm, to the side [m]."""
_TIP_NAMES_M: Final = 0.29
"""Distance between two fingertips' names, in a row below the upper edge of the front view [m]."""
_CLOTH_OPACITY: Final = 0.4
_CHECKS: Final = 2
"""Width of a cloth's checks in cells of its grid; the checks make its folds visible."""
_TIPS: Final = (3, 4, 5, 6, 7)
"""Indices of the fingertips among the eight joints, the thumb's first."""
_LEAD_M: Final = 0.003
_FRAME: Final = Rgb(70, 88, 118)
_FORGET: Final = 0.05
_STAYS_M: Final = 0.22
GONE_AFTER_S: Final = 5.0
"""Time after the last visible arm at which the stage is left [s]."""
CLOTH_PROP: Final = "cloth"
"""Name of the prop, a function given to the view, that creates a simulated cloth."""
_HIGH_M, _WIDE_M = 1.9, 1.6
_MIDDLE: Final = np.array([0.0, 0.5 * _HIGH_M + 0.12, layout.stage_centre()[2]])


@dataclass(frozen=True)
class DrawingPanel:
    """One of the views of the arms that are side by side on the stage.

    Attributes:
        title: title of the view.
        left_m: distance to the left of the stage's centre [m].
        turn: rotation of the arms about the vertical [rad].
        tilt: downward angle of the view [rad].
    """

    title: str
    left_m: float
    turn: float
    tilt: float = 0.0

    @property
    def R(self) -> Float64:  # noqa: N802 - the field's notation
        """Rotation (3, 3) to the stage, from the world turned about its vertical until the sensors look along +z."""
        aside = np.arctan2(self.left_m, _EYE_M)
        return rotation_about_y(aside) @ rotation_about_x(-self.tilt) @ rotation_about_y(self.turn)

    @property
    def middle(self) -> Float64:
        """Centre (3,) of the view, in the view's space [m]."""
        return np.asarray(_MIDDLE + np.array([self.left_m, 0.0, 0.0]))


PANELS: Final = (
    DrawingPanel("Front", _APART_M, 0.0),
    DrawingPanel("Perspective", 0.0, np.radians(38.0), np.radians(18.0)),
    DrawingPanel("Side", -_APART_M, np.radians(90.0)),
)


@dataclass(frozen=True, eq=False)
class ArmsShown:
    """Values that the ARMS stage draws with a scene.

    Attributes:
        centre: (3,) point of the world that is drawn at the centre of each view [m].
        quality: metrics of the joints' noise and of misdetections; None if not measured.
        cloth: (rows, columns, 3) points of a simulated cloth in the world [m]; None without a cloth.
    """

    centre: Float64
    quality: ArmQuality | None = None
    cloth: Float64 | None = None


def centre_of(arms: tuple[TrackedArm, ...], before: Float64 | None) -> Float64 | None:
    """Return the world point (3,) to show at the centre of each view [m].

    It stays at ``before`` while the mean of the visible palms is within `_STAYS_M` of it; else each call moves it by a
    fixed fraction of the way to that mean. The first result is 2 cm below the mean. Without a visible palm, it is
    ``before``.

    Args:
        arms: arms of the newest scene.
        before: (3,) previous result, world [m]; None at first.
    """
    palms = np.array([arm.points[PALM] for arm in arms]).reshape(-1, 3)
    palms = palms[np.isfinite(palms).all(axis=-1)]
    if not len(palms):
        return before
    now: Float64 = palms.mean(axis=0)
    if before is None:
        lower: Float64 = now - np.array([0.0, 0.02, 0.0])
        return lower
    away = float(np.linalg.norm(now - before))
    centre: Float64 = before if away < _STAYS_M else before + _FORGET * (now - before)
    return centre


class ArmsMemory:
    """Memory of the ARMS stage: the point to look at, the quality of the arms, and a cloth that the hands move.

    Args:
        props: functions by name that create props, objects to be shown beside a scene. The function `CLOTH_PROP`, if
            present, creates a cloth simulation. Its method ``update(arms, eye, at_s)`` receives the arms, the position
            (3,) of a camera in the world [m] or None, and the scene's time [s]. It returns a cloth with ``positions``
            (n, 3) in the world [m] and ``shape`` (rows, columns), or None.
    """

    def __init__(self, props: Mapping[str, Callable[[], Any]]) -> None:
        kind = PART_TYPES["arms"]
        self._meter = load(kind.meter)()
        self._cloth = props[CLOTH_PROP]() if CLOTH_PROP in props else None
        self._centre: Float64 | None = None
        self._scene: Scene | None = None
        self._seen_s = 0.0
        self._shown: ArmsShown | None = None

    def update(self, scene: Scene | None) -> ArmsShown | None:
        """Return the values to draw with the newest scene; None if no arm was visible in the last `GONE_AFTER_S`.

        None also without a scene. The same scene object again returns the same values and changes nothing. Time is that
        of the scenes.
        """
        if scene is None or scene is self._scene:
            self._shown = None if scene is None else self._shown
            return self._shown
        self._scene, at_s = scene, scene.at_ns / NS_PER_S
        if scene.arms:
            self._seen_s = at_s
            self._centre = centre_of(scene.arms, self._centre)
        if self._centre is None or not 0 <= at_s - self._seen_s <= GONE_AFTER_S:
            self._centre = self._shown = None
            return None
        eye = next((place.T_world_sensor[:3, 3] for place in scene.sensors if place.T_world_sensor is not None), None)
        cloth = None if self._cloth is None else self._cloth.update(scene.arms, eye, at_s)
        quality = self._meter.update(scene.arms, at_s)
        grid = None if cloth is None else cloth.positions.reshape(*cloth.shape, 3).copy()
        self._shown = ArmsShown(self._centre, quality, grid)
        return self._shown


def arms_drawing(scene: Scene | None, shown: ArmsShown) -> TrackingDrawing:
    """Draw a scene's arms in all views of the stage; the drawing's ``halos`` are the inferred joints.

    Args:
        scene: the scene; None draws the empty views.
        shown: the values of `ArmsMemory.update` for the scene.
    """
    joints: list[Any] = []
    hollow: list[Any] = []
    lines, tags = [], []
    arms = () if scene is None else scene.arms
    R_level = _level(scene)
    clothes = []
    for panel in PANELS:
        R = panel.R @ R_level

        def stand(points: Float64, R: Float64 = R, panel: DrawingPanel = panel) -> Float64:
            return SCALE * (points - shown.centre) @ R.T + panel.middle

        lines.append(_frame(panel))
        tags.append(_tag(panel.title, panel.middle, -0.5 * _HIGH_M - 0.12))
        for place, arm in enumerate(arms):
            p = stand(arm.joints)
            drawn = arm_strokes(p, arm.joint_states, SCALE)
            for parts, part in zip((lines, joints, hollow), drawn, strict=True):
                parts.append(part)
            if panel is PANELS[0]:
                named, leads = _names(p, arm.joint_states, place)
                tags += named
                lines += leads
        if shown.cloth is not None:
            clothes.append(stand(shown.cloth))
    tags += [_headline(arm, k) for k, arm in enumerate(arms)]
    surfaces = {}
    if clothes:
        for k, (mesh, colour) in enumerate(zip(cloth_mesh(np.stack(clothes)), CLOTH, strict=True)):
            surfaces[f"cloth/{k}"] = Surface(mesh, colour, _CLOTH_OPACITY)
    return TrackingDrawing(join(lines), join(joints), join(hollow), tags, scale=SCALE, surfaces=surfaces)


def _level(scene: Scene | None) -> Float64:
    """Return the rotation (3, 3) of the world about its vertical after which the cameras look along +z."""
    places = [] if scene is None else [p.T_world_sensor for p in scene.sensors if p.T_world_sensor is not None]
    if not places:
        return np.eye(3)
    forward = np.sum([T[:3, 2] for T in places], axis=0)
    return rotation_about_y(-np.arctan2(forward[0], forward[2]))


def _frame(panel: DrawingPanel) -> Strokes:
    aside = rotation_about_y(np.arctan2(panel.left_m, _EYE_M))
    half = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1], [1, 1]]) * [0.5 * _WIDE_M, 0.5 * _HIGH_M]
    corners = np.column_stack([half, np.full(5, 0.55)]) @ aside.T + panel.middle
    return line_strokes(corners, _FRAME.paint, 0.006)


def _names(p: Float64, states: NDArray[np.uint8], place: int) -> tuple[list[Tag], list[Strokes]]:
    """Return labels of an arm's joints in the front view, and lines from the fingertips' labels to the tips.

    Fingertips' labels are in a row above, from the thumb's side on, so that lines of an open hand do not cross. The
    others are beside their joints, away from the thumb, and invisible where they would cover another.

    Args:
        p: (8, 3) where the joints are drawn [m].
        states: (8,) `JointState`.
        place: index of the arm among the drawn arms; each has a row of its own.
    """
    known = np.isfinite(p).all(axis=-1) & (states != JointState.NOT_TRACKED)
    aside = rotation_about_y(np.arctan2(PANELS[0].left_m, _EYE_M))
    thumb = -1.0 if p[_TIPS[0], 0] < p[_TIPS[-1], 0] else 1.0  # the thumb's side; x is to the left
    tags, leads, taken = [], [], np.inf
    for k, name in enumerate(ARM_JOINT_NAMES):
        if k in _TIPS:
            row = [thumb * (2 - _TIPS.index(k)) * _TIP_NAMES_M, 0.5 * _HIGH_M - 0.12 - 0.1 * place, 0.0]
            at, room = aside @ row + PANELS[0].middle, True
            if known[k]:
                leads.append(line_strokes(np.stack([at, p[k]]), COLOURS[k].paint, _LEAD_M))
        else:
            at = np.nan_to_num(p[k]) - [thumb * _BESIDE_M, 0.5 * _NAME_HIGH_M, 0.0]
            room = bool(known[k] and abs(taken - p[k, 1]) > _NAME_HIGH_M)
            taken = p[k, 1] if room else taken
        tags.append(_tag(name.removesuffix(" tip"), at, 0.0, bool(known[k] and room)))
    return tags, leads


def _headline(arm: TrackedArm, place: int) -> Tag:
    words = [f"{'Left' if arm.left else 'Right'} arm"]
    if arm.gesture:
        words.append(f"{arm.gesture} {100 * arm.gesture_sure:.0f} %")
    if arm.grabbing:
        words.append("grabbing")
    measured = (arm.joint_states == JointState.TRACKED) & np.isfinite(arm.joints).all(axis=-1)
    words.append(f"{int(measured.sum())} of {len(ARM_JOINTS)} measured")
    return _tag(" · ".join(words), _MIDDLE, -0.5 * _HIGH_M - 0.30 - 0.14 * place)


def _tag(text: str, at: Float64, above_m: float, visible: bool = True) -> Tag:
    x, y, z = at.round(3).tolist()
    return Tag(text, (x, y + above_m, z), visible)


def cloth_mesh(grids: Float64) -> tuple[Mesh, Mesh]:
    """Return pieces of cloth as two meshes, one for each colour of a chequered pattern, with the same vertices.

    Args:
        grids: (pieces, rows, columns, 3) points of each piece [m].
    """
    pieces, rows, columns, _ = grids.shape
    vertices = grids.reshape(-1, 3).astype(np.float32)
    one, other = _cloth_faces(pieces, rows, columns)
    return Mesh(vertices, one), Mesh(vertices, other)


@cache
def _cloth_faces(pieces: int, rows: int, columns: int) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    number = np.arange(pieces * rows * columns, dtype=np.uint32).reshape(pieces, rows, columns)
    a, b, c, d = number[:, :-1, :-1], number[:, :-1, 1:], number[:, 1:, :-1], number[:, 1:, 1:]
    faces = np.stack([np.stack([a, c, b], axis=-1), np.stack([b, c, d], axis=-1)])
    row, column = np.indices((rows - 1, columns - 1)) // _CHECKS
    first = (row + column) % 2 == 0
    return (
        np.ascontiguousarray(faces[:, :, first].reshape(-1, 3)),
        np.ascontiguousarray(faces[:, :, ~first].reshape(-1, 3)),
    )


def _draw(scene: Scene | None, shown: ArmsShown, view: StageView) -> TrackingDrawing:
    return arms_drawing(scene, shown)


ARMS: Final = Stage(
    "arms", _draw, enlarged_title, layout.arms_box(), float(np.radians(7.0)), ArmsMemory, perspectives=False,
    box_with_sensors=False, panel=ArmPanel,
)  # fmt: skip
