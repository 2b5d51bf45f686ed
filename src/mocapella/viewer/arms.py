"""Arms on the Tracking stage: from the front, in perspective and from the side at once, several times their size.

An arm is eight balls, joined by lines: a colour for each digit, white for the rest. A joint that is only inferred is
hollow: a pale, translucent ball.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.rigid import rotation_about_x, rotation_about_y
from mocapella.model.arm_quality import ArmQuality
from mocapella.model.arms import ARM_BONES, ARM_JOINT_NAMES, ARM_JOINTS, PALM, ArmFrame
from mocapella.model.observations import JointState
from mocapella.model.scene import Scene, TrackedArm
from mocapella.viewer import layout
from mocapella.viewer.bones import Strokes, join, joint_strokes, line_strokes
from mocapella.viewer.drawing import Tag
from mocapella.viewer.lane_picture import LanePicture
from mocapella.viewer.meshes import Mesh
from mocapella.viewer.palette import Rgb

Float64 = NDArray[np.float64]

SCALE: Final = 2.3
_APART_M: Final = 1.75
_EYE_M: Final = 6.5
"""The panels face who stands so far before them."""
DIGIT_COLOURS: Final = (
    Rgb(255, 107, 107), Rgb(255, 184, 77), Rgb(154, 230, 72), Rgb(46, 196, 255), Rgb(190, 140, 255),
)  # fmt: skip
WHITE: Final = Rgb(235, 240, 248)
COLOURS: Final = (WHITE, WHITE, WHITE, *DIGIT_COLOURS)
"""Of the eight joints."""
_RADII_M: Final = np.array([0.024, 0.018, 0.02, *[0.0115] * 5])
_LINE_M: Final = np.array([0.010, 0.008, *[0.0055] * 5])
_HOLLOW: Final = 0.45
_NAME_HIGH_M: Final = 0.075
_BESIDE_M: Final = 0.19
"""Elbow, wrist and palm have their names beside them."""
_TIP_NAMES_M: Final = 0.29
"""From one fingertip's name to the next, in a row below the upper edge of the front view."""
_CHECKS: Final = 2
"""So many meshes wide are a cloth's checks, without which one does not see how it hangs."""
_TIPS: Final = (3, 4, 5, 6, 7)
"""Of the eight joints, the thumb's first."""
_LEAD_M: Final = 0.003
_FRAME: Final = Rgb(70, 88, 118)
_FORGET: Final = 0.05
_OF_LANE: Final = 0.6
"""So wide an image of a usual shape is seen whole above the panels."""
_STAYS_M: Final = 0.22
_HIGH_M, _WIDE_M = 1.9, 1.6
_MIDDLE: Final = np.array([0.0, 0.5 * _HIGH_M + 0.12, layout.stage_centre()[2]])


@dataclass(frozen=True)
class DrawingPanel:
    """One of the views: its title, where it is (to the left of the middle) [m], and from where it looks [rad]."""

    title: str
    left_m: float
    turn: float
    tilt: float = 0.0

    @property
    def R(self) -> Float64:  # noqa: N802 - the field's notation
        """(3, 3) from a world whose +z goes away from the camera; turned to who looks at the middle of the stage."""
        aside = np.arctan2(self.left_m, _EYE_M)
        return rotation_about_y(aside) @ rotation_about_x(-self.tilt) @ rotation_about_y(self.turn)

    @property
    def middle(self) -> Float64:
        """(3,) of it on the stage [m]."""
        return np.asarray(_MIDDLE + np.array([self.left_m, 0.0, 0.0]))


PANELS: Final = (
    DrawingPanel("Front", _APART_M, 0.0),
    DrawingPanel("Perspective", 0.0, np.radians(38.0), np.radians(18.0)),
    DrawingPanel("Side", -_APART_M, np.radians(90.0)),
)


@dataclass(frozen=True, eq=False)
class ArmsShown:
    """What the stage of arms needs beside a scene.

    Attributes:
        centre: (3,) of the world, that is in the middle of each panel [m].
        quality: how steady and right the arms are.
        cloth: (rows, columns, 3), world [m]; None where there is none.
    """

    centre: Float64
    quality: ArmQuality | None = None
    cloth: Float64 | None = None


def centre_of(arms: tuple[TrackedArm, ...], before: Float64 | None) -> Float64 | None:
    """What to look at: it stays while the palms are near, and follows slowly when they go away.

    Args:
        arms: that there are.
        before: (3,) what was looked at; None at first.
    """
    palms = np.array([arm.points[PALM] for arm in arms]).reshape(-1, 3)
    palms = palms[np.isfinite(palms).all(axis=-1)]
    if not len(palms):
        return before
    now = palms.mean(axis=0)
    if before is None:
        return now - np.array([0.0, 0.02, 0.0])
    away = float(np.linalg.norm(now - before))
    return before if away < _STAYS_M else before + _FORGET * (now - before)


@dataclass(frozen=True, eq=False)
class ArmsDrawing:
    """What is drawn of arms, in the view's own space.

    Attributes:
        lines, joints: of all that is known; joints only as far as they are measured.
        hollow: the joints that are inferred, which are translucent.
        tags: titles, names of joints, and a line for each arm.
        cloth: its checks, of both colours; None without a cloth.
    """

    lines: Strokes
    joints: Strokes
    hollow: Strokes
    tags: list[Tag]
    cloth: tuple[Mesh | None, Mesh | None]


def arms_drawing(scene: Scene | None, shown: ArmsShown) -> ArmsDrawing:
    """What a scene's arms show in all panels."""
    lines, joints, hollow, tags = [], [], [], []
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
    cloth = cloth_mesh(np.stack(clothes)) if clothes else (None, None)
    return ArmsDrawing(join(lines), join(joints), join(hollow), tags, cloth)


def arm_strokes(p: Float64, states: NDArray[np.uint8], scale: float) -> tuple[Strokes, Strokes, Strokes]:
    """Lines, balls and hollow balls of an arm.

    Args:
        p: (8, 3) of `mocapella.model.arms.ARM_JOINTS` where they are drawn [m].
        states: (8,) `JointState`.
        scale: how many times as large as it is.
    """
    known = np.isfinite(p).all(axis=-1) & (states != JointState.NOT_TRACKED)
    paints = np.array([colour.paint for colour in COLOURS], np.uint8)
    measured = known & (states == JointState.TRACKED)
    lines = []
    for (a, b), radius in zip(ARM_BONES, scale * _LINE_M, strict=True):
        if known[a] and known[b]:
            both = measured[a] and measured[b]
            lines.append(line_strokes(p[[a, b]], paints[b], radius * (1.0 if both else _HOLLOW)))
    radii = scale * _RADII_M
    solid = [joint_strokes(p[None, [k]], states[None, [k]], paints[[k]], radii[[k]]) for k in np.flatnonzero(measured)]
    pale = [_hollow(p[k], paints[k], 1.15 * radii[k]) for k in np.flatnonzero(known & ~measured)]
    return join(lines), join(solid), join(pale)


def _hollow(at: Float64, colour: NDArray[np.uint8], radius: float) -> Strokes:
    pale = (0.6 * colour + 0.4 * np.array(WHITE.paint)).round().astype(np.uint8)
    return Strokes(
        at[None].astype(np.float32), np.array([[1, 0, 0, 0]], np.float32), np.full((1, 3), radius, np.float32),
        pale[None], np.full(1, _HOLLOW, np.float32),
    )  # fmt: skip


def _level(scene: Scene | None) -> Float64:
    """(3, 3) the world turned about its vertical, so that the cameras look along +z."""
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
    """Names of the joints of an arm in the front view, and lines that lead from those of fingertips to the tips.

    Fingertips' names stand in a row above, which begins on the thumb's side: lines of an open hand do not cross. The
    others' stand beside their joints, away from the thumb, as far as they do not cover each other.

    Args:
        p: (8, 3) where the joints are drawn [m].
        states: (8,) `JointState`.
        place: of the arm among those that are drawn; each has a row of its own.
    """
    known = np.isfinite(p).all(axis=-1) & (states != JointState.NOT_TRACKED)
    aside = rotation_about_y(np.arctan2(PANELS[0].left_m, _EYE_M))
    thumb = -1.0 if p[_TIPS[0], 0] < p[_TIPS[-1], 0] else 1.0  # the side that it is on; x is to the left
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
    """Several pieces of cloth (pieces, rows, columns, 3) [m] as the checks of one colour, and of the other."""
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


def lane_arms(frame: ArmFrame, origin: Float64, colour: Rgb) -> tuple[Strokes, Strokes]:
    """A depth camera's image as it stands in its lane: its edge, and the arms in it.

    Args:
        frame: what the camera saw.
        origin: (3,) where the lane begins [m].
        colour: the camera's own.
    """
    picture = LanePicture(frame.size_px, origin, _OF_LANE)
    lines, balls = [picture.edge(colour)], []
    for arm in frame.arms:
        x, y, z = arm.joints.T
        with np.errstate(invalid="ignore", divide="ignore"):
            fx, fy, cx, cy = frame.lens[:4]
            pixels = np.where((z > 0)[:, None], np.stack([fx * x / z + cx, fy * y / z + cy], axis=-1), np.nan)
        near, solid, hollow = arm_strokes(picture.at(pixels), arm.joint_states, 1.6)
        lines.append(near)
        balls += [solid, hollow]
    return join(lines), join(balls)
