"""Draw a camera's markers in its lane of the gallery, in the colours that their names describe."""

from __future__ import annotations

import colorsys
import hashlib
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.model.markers import MarkerFrame
from mocapella.model.observations import JointState
from mocapella.viewer.bones import Strokes, join, joint_strokes
from mocapella.viewer.lane_picture import LanePicture
from mocapella.viewer.palette import Rgb

Float64 = NDArray[np.float64]

_NAMED: Final = {
    **{"red": (230, 60, 60), "green": (70, 200, 90), "blue": (70, 110, 255), "yellow": (245, 215, 60)},
    **{"magenta": (235, 70, 190), "cyan": (70, 215, 230), "orange": (255, 150, 50), "purple": (160, 90, 230)},
    **{"pink": (255, 140, 190), "white": (240, 240, 240), "black": (60, 60, 60), "brown": (150, 100, 60)},
}


def marker_colour(name: str) -> Rgb:
    """Return the colour that a marker's name contains, such as red; else a colour that depends on the name only."""
    for word in name.lower().replace("-", " ").split():
        if word in _NAMED:
            return Rgb(*_NAMED[word])
    hue = int.from_bytes(hashlib.blake2s(name.encode(), digest_size=2).digest()) / 65536
    return Rgb(*(round(255 * channel) for channel in colorsys.hsv_to_rgb(hue, 0.6, 0.95)))


def lane_picture(frame: MarkerFrame, origin: Float64, colour: Rgb) -> tuple[Strokes, Strokes]:
    """Return the strokes of a marker camera's lane: lines for the image's border, and balls for the markers.

    A marker's ball has the area of its pixels, and at least a visible size; a marker that is not found has none.

    Args:
        frame: the markers that were detected in the camera's image.
        origin: (3,) middle of the lane's front edge, in the view's space [m].
        colour: colour of the border, which is the camera's.
    """
    picture = LanePicture(frame.size_px, origin)
    p = picture.at(frame.positions_px.astype(np.float64))
    radii = np.sqrt(np.maximum(frame.areas_px, 0.0) / np.pi)
    radii = picture.px * np.maximum(radii, 0.006 * frame.size_px[0])
    states = np.where(frame.found, JointState.TRACKED, JointState.NOT_TRACKED)
    balls = [
        joint_strokes(p[None, i : i + 1], states[None, i : i + 1], [marker_colour(name).paint], radii[i : i + 1])
        for i, name in enumerate(frame.names)
    ]
    return picture.edge(colour), join(balls)
