"""Draw arms as lines and balls, a colour for each digit and white for the other joints, on the stage and in lanes."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.model.arms import ARM_BONES, ArmFrame
from mocapella.model.observations import JointState
from mocapella.viewer.bones import Strokes, join, joint_strokes, line_strokes
from mocapella.viewer.lane_picture import LanePicture
from mocapella.viewer.palette import Rgb

Float64 = NDArray[np.float64]

DIGIT_COLOURS: Final = (
    Rgb(255, 107, 107), Rgb(255, 184, 77), Rgb(154, 230, 72), Rgb(46, 196, 255), Rgb(190, 140, 255),
)  # fmt: skip
WHITE: Final = Rgb(235, 240, 248)
COLOURS: Final = (WHITE, WHITE, WHITE, *DIGIT_COLOURS)
"""Colours of the eight joints `ARM_JOINTS`."""
_RADII_M: Final = np.array([0.024, 0.018, 0.02, *[0.0115] * 5])
_LINE_M: Final = np.array([0.010, 0.008, *[0.0055] * 5])
_HOLLOW: Final = 0.45
_OF_LANE: Final = 0.6
"""Width of an image as a fraction of the lane's, so that the ARMS stage in front of the lane hides none of it."""


def arm_strokes(p: Float64, states: NDArray[np.uint8], scale: float) -> tuple[Strokes, Strokes, Strokes]:
    """Return the strokes of an arm: lines, balls for measured joints, and translucent balls for inferred joints.

    A line is left out if one of its joints is unknown, and is thin unless both are measured. An unknown joint has no
    ball.

    Args:
        p: (8, 3) positions of the joints `mocapella.model.arms.ARM_JOINTS` in the view's space [m]; NaN if unknown.
        states: (8,) `JointState` of each joint.
        scale: enlargement of lines and balls.
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


def lane_arms(frame: ArmFrame, origin: Float64, colour: Rgb) -> tuple[Strokes, Strokes]:
    """Return the lines and the balls of a depth camera's lane: the image's border, bones and joints of the arms in it.

    The arms are projected without the lens's distortion; inferred joints have paler balls.

    Args:
        frame: the arms that were detected in the camera's image.
        origin: (3,) middle of the lane's front edge, in the view's space [m].
        colour: colour of the border, which is the camera's.
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
