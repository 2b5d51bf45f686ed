"""Draw the people that a camera sees in its lane of the gallery: skeletons in the plane of the image."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.model.keypoints import KeypointFrame
from mocapella.model.observations import JointState
from mocapella.viewer.bones import NO_STROKES, Strokes, bone_strokes, join
from mocapella.viewer.lane_picture import LanePicture
from mocapella.viewer.palette import Rgb

Float64 = NDArray[np.float64]

SURE: Final = 0.5
"""Least confidence of a keypoint that is drawn as seen; below it is faint and thin."""
SHOWN: Final = 0.1
"""Confidence below which a keypoint is not drawn."""
THICK: Final = 0.012
"""Thickness of a bone, as a part of the image's width in the view."""
PART: Final = 0.85
"""Width of an image in landscape format as a part of the lane's."""
TALLEST: Final = 0.75
"""Height of an image as a part of that width at most: an upright image is smaller."""


def lane_people(frame: KeypointFrame, origin: Float64, colour: Rgb) -> tuple[Strokes, Strokes]:
    """Return the strokes of a webcam's lane: the image's border with the people's bones, and no balls.

    Keypoints that are not seen, or outside of the image, have no bones; keypoints of a low confidence are faint.

    Args:
        frame: the people in the camera's image.
        origin: (3,) middle of the lane's front edge, in the view's space [m].
        colour: colour of the camera.
    """
    if min(frame.size_px) < 1:
        return NO_STROKES, NO_STROKES
    width, height = frame.size_px
    picture = LanePicture(frame.size_px, origin, PART * min(1.0, TALLEST * width / height))
    edge = picture.edge(colour)
    if not frame.bodies:
        return edge, NO_STROKES
    inside = ((frame.positions_px >= -0.5) & (frame.positions_px <= np.array(frame.size_px) - 0.5)).all(axis=-1)
    sure = frame.confidences
    states = np.where(sure >= SURE, JointState.TRACKED, JointState.INFERRED)
    states[~inside | (sure < SHOWN)] = JointState.NOT_TRACKED
    ends = states[:, np.array(frame.topology.bones)]
    measured = (ends == JointState.TRACKED).all(axis=-1)
    colours = np.where(measured[..., None], colour.paint, colour.faint)
    radii = [0.5 * THICK * picture.wide_m] * frame.bodies
    positions = picture.at(frame.positions_px.astype(np.float64))
    return join([edge, bone_strokes(positions, states, frame.topology, colours, radii)]), NO_STROKES
