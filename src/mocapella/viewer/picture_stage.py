"""A camera image shown large, in front of the 3D scene of one browser."""

from __future__ import annotations

import numpy as np
import viser

from mocapella.viewer.camera_html import radius_px
from mocapella.viewer.camera_panel import Large
from mocapella.viewer.drawing import LineNode, Tag, TagNodes
from mocapella.viewer.marker_lane import marker_colour
from mocapella.viewer.palette import Rgb
from mocapella.viewer.picture_plane import PictureNode, Plane, rings
from mocapella.viewer.pointing import SKIN

_LARGE_AT = np.array([0.0, 60.0, 0.0])
"""Centre of the large image, far above the stages, so that nothing is in front of or behind it [m]."""
_LARGE_M = 4.0
_OVER_M = 0.06


def large_plane(size_px: tuple[int, int]) -> Plane:
    """Return the plane in the view's space for an image that is shown large; ``size_px`` is (width, height)."""
    return Plane(_LARGE_AT, _LARGE_M, size_px)


class PictureStage:
    """Scene nodes of the large image of `mocapella.viewer.camera_panel.CameraPanel` in one browser.

    Args:
        scene: viser's 3D scene of the browser.

    Attributes:
        plane: plane of the large image; None if no image is shown.
    """

    def __init__(self, scene: viser.SceneApi) -> None:
        self.plane: Plane | None = None
        self._large = PictureNode(scene, "/picture/large")
        self._rings = LineNode(scene, "/picture/rings", thickness=0.016)
        self._names = TagNodes(scene, "/picture/names", size=0.8, anchor="bottom-left")
        self._words = TagNodes(scene, "/picture/words", size=1.3, anchor="bottom-left")

    def draw(self, large: Large | None) -> None:
        """Show a large image with its circles, their labels and its text; None, or an unknown size, hides them."""
        if large is None or large.answer.size_px is None:
            self.plane = None
            self._large.hide()
            self._rings.draw(np.zeros((0, 2, 3), np.float32), np.zeros((0, 2, 3), np.uint8))
            self._names.draw([])
            self._words.draw([])
            return
        size = large.answer.size_px
        self.plane = plane = large_plane(size)
        self._large.draw(plane, large.answer)
        radius, points = radius_px(size), large.points
        self._rings.draw(*rings(plane, points, {name: colour_of(name) for name in points}, radius))
        beside = {name: plane.place(np.array([x + radius, y - radius]), 0.02) for name, (x, y) in points.items()}
        self._names.draw([Tag(name, tuple(at.tolist())) for name, at in beside.items()] if large.named else [])
        over = plane.corners[0] + np.array([0.0, _OVER_M, 0.0])
        self._words.draw([Tag(large.words, tuple(over.tolist()))])


def colour_of(name: str) -> Rgb:
    """Return the colour of the circle around a marker, by the marker's name; white for skin."""
    return Rgb(255, 255, 255) if name == SKIN else marker_colour(name)
