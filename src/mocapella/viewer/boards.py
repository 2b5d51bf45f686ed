"""Panels above the stage, here called *boards*, with the cameras' images and the outlines of the fitted bodies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
import viser
from numpy.typing import NDArray

from mocapella.model.scene import Scene
from mocapella.viewer import layout
from mocapella.viewer.drawing import LineNode, Tag, TagNodes
from mocapella.viewer.palette import Rgb
from mocapella.viewer.picture_plane import Encoded, PictureNode, Plane, SizedPicture
from mocapella.viewer.plugin_errors import PluginErrors
from mocapella.viewer.room import ImageLines, called, drawing_of

Float64 = NDArray[np.float64]

BOARDS: Final = "/board"
"""Name of the boards' scene node; `BoardNodes.place` moves it, and all boards with it."""
EMPTY: Final = Rgb(106, 114, 129)
"""Colour of a board without an image, which looks dark in the light from behind."""
_RIM_M: Final = 0.015
"""Width of a board's border around its image, and distance of the image in front of the board [m]."""
_ROW_HIGH_M, _ROW_WIDE_M, _GAP_M = 1.9, 6.4, 0.06
"""Largest height and width of the row of images, and gap between two images [m]."""
_OVER_M, _BEHIND_M = 0.35, 1.2
"""Distance of the row above people's initial height, and behind the boards' origin [m]."""
BOARDS_BEHIND: Final = np.array([0.0, 0.0, layout.SENSORS_ORIGIN[2] - _BEHIND_M])
"""Origin (3,) of the boards if the camera does not follow people; they then stand above the sensors' gallery [m]."""
_LINES_LIFT: Final = 0.003
"""Distance of the lines in front of an image, as a fraction of its width."""
_LINE_M: Final = 0.014
_DEEPER: Final = 0.55
"""Factor of the lines' brightness: unlit lines look fully lit, so bright colours would be nearly white."""
_NEAR_M: Final = 1e-4
"""Boards are not moved by less than this [m]."""


@dataclass(frozen=True, eq=False)
class ShownBoard:
    """Content of one board.

    Attributes:
        words: the only text above the board; `ImageLines.words` of ``lines`` is not shown beside it.
        picture: the camera's image; None shows an empty board.
        lines: lines in pixels of the camera's image before scaling, drawn also on an empty board; None for no lines.
    """

    words: str
    picture: SizedPicture | None
    lines: ImageLines | None


def image_lines(scene: Scene, troubles: PluginErrors) -> dict[str, ImageLines]:
    """Return the lines to draw over camera images by camera, such as outlines of body models.

    The lines of several types of parts over one image are joined. A camera for which no drawing returns lines is left
    out; an entry may have a text alone.

    Args:
        scene: the scene whose parts are drawn.
        troubles: receives the errors of drawings, whose lines are left out.
    """
    found: dict[str, list[ImageLines]] = {}
    for name, parts in scene.parts.items():
        how = drawing_of(name, troubles)
        if how is None or not parts:
            continue
        nothing: Mapping[str, ImageLines] = {}
        for camera, lines in troubles.attempt(called(name), partial(how.images, parts), nothing).items():
            found.setdefault(camera, []).append(lines)
    return {camera: told[0] if len(told) == 1 else _joined(told) for camera, told in found.items()}


def _joined(told: list[ImageLines]) -> ImageLines:
    return ImageLines(
        " · ".join(one.words for one in told if one.words),
        np.concatenate([one.ends_px for one in told]),
        tuple(colour for one in told for colour in one.colours),
    )


def picture_row(sizes_px: Mapping[str, tuple[int, int]], tall_m: float) -> dict[str, Plane]:
    """Return the plane of each camera's image: equally high, side by side from the left of the screen.

    The planes' positions are relative to the boards' origin. The row is centred above it and 1.2 m behind it, at most
    1.9 m high and 6.4 m wide, and empty without cameras.

    Args:
        sizes_px: (width, height) of each camera's image, by camera.
        tall_m: height of the people or lanes below the images, which begin 0.35 m above it [m].
    """
    if not sizes_px:
        return {}
    ratios = [width / height for width, height in sizes_px.values()]
    gaps = _GAP_M * (len(ratios) - 1)
    high = min(_ROW_HIGH_M, (_ROW_WIDE_M - gaps) / sum(ratios))
    left = 0.5 * (high * sum(ratios) + gaps)
    middle_y = tall_m + _OVER_M + 0.5 * high
    planes = {}
    for (name, size), ratio in zip(sizes_px.items(), ratios, strict=True):
        wide = high * ratio
        planes[name] = Plane(np.array([left - 0.5 * wide, middle_y, _BEHIND_M]), wide, size)
        left -= wide + _GAP_M
    return planes


class BoardNodes:
    """Scene nodes of the boards in one browser.

    Args:
        scene: viser's 3D scene of the browser.

    Attributes:
        planes: plane of each board by camera, relative to the origin that `place` moves.
    """

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._root = scene.add_frame(BOARDS, show_axes=False)
        self._nodes: dict[str, _BoardNode] = {}
        self._words = TagNodes(scene, f"{BOARDS}/words", size=0.9, anchor="bottom-left")
        self.planes: Mapping[str, Plane] = {}

    def place(self, at: Float64) -> None:
        """Move the common origin of all boards to a position (3,) in the view's space [m]."""
        if np.abs(at - self._root.position).max() > _NEAR_M:
            self._root.position = at

    def draw(self, planes: Mapping[str, Plane], boards: Mapping[str, ShownBoard], *, new_pictures: bool) -> None:
        """Show exactly these boards on their planes, by camera; boards of other cameras are hidden.

        Args:
            planes: plane of each board, relative to the boards' origin; kept as the attribute.
            boards: content of each board, at least for the cameras of ``planes``.
            new_pictures: whether a board that shows an image takes a newer one. Lines and texts are always replaced.
        """
        self.planes = planes
        for name, plane in planes.items():
            node = self._nodes.get(name)
            if node is None or node.size_px != plane.size_px:
                if node is not None:
                    node.remove()
                self._nodes[name] = node = _BoardNode(self._scene, f"{BOARDS}/{name}", plane.size_px)
            node.draw(plane, boards[name], new_picture=new_pictures)
        for name, node in self._nodes.items():
            if name not in planes:
                node.hide()
        over = {name: plane.corners[0] + [0.0, 0.03, 0.0] for name, plane in planes.items()}
        self._words.draw([Tag(boards[name].words, (float(x), float(y), float(z))) for name, (x, y, z) in over.items()])


class _BoardNode:
    """One board: a background in place of a missing image, a rim, the image, and lines in front of it."""

    def __init__(self, scene: viser.SceneApi, name: str, size_px: tuple[int, int]) -> None:
        self._scene, self._name, self.size_px = scene, name, size_px
        self._frame = scene.add_frame(name, show_axes=False)
        self._picture = PictureNode(scene, f"{name}/picture")
        self._lines = LineNode(scene, f"{name}/lines", thickness=_LINE_M)
        self._plane: Plane | None = None
        self._shown: Encoded | None = None
        self._drawn: ImageLines | None = None
        self._empty: viser.MeshHandle | None = None

    def draw(self, plane: Plane, board: ShownBoard, *, new_picture: bool) -> None:
        moved = self._plane is None or (self._plane.wide_m, *self._plane.middle) != (plane.wide_m, *plane.middle)
        if moved:
            self._plane = plane
            self._frame.position = plane.middle
            self._add_empty(plane.at_origin)
        if not self._frame.visible:
            self._frame.visible = True
        if board.picture is None:
            self._shown = None
            self._picture.hide()
        elif self._shown is None or new_picture or moved:
            self._shown = board.picture
            self._picture.draw(plane.at_origin, board.picture)
        if board.lines is not self._drawn or moved:
            self._drawn = board.lines
            self._draw_lines(plane.at_origin, board.lines)

    def hide(self) -> None:
        if self._frame.visible:
            self._frame.visible = False

    def remove(self) -> None:
        self._frame.remove()  # and all that is in it

    def _draw_lines(self, plane: Plane, lines: ImageLines | None) -> None:
        if lines is None or not len(lines.ends_px):
            self._lines.draw(np.zeros((0, 2, 3), np.float32), np.zeros((0, 2, 3), np.uint8))
            return
        ends = plane.place(lines.ends_px.astype(np.float64), _LINES_LIFT * plane.wide_m)
        colours = (_DEEPER * np.array([colour.paint for colour in lines.colours])).astype(np.uint8)
        colours = colours[:, None].repeat(2, axis=1)
        self._lines.draw(ends.astype(np.float32), colours)

    def _add_empty(self, plane: Plane) -> None:
        if self._empty is not None:
            self._empty.remove()
        px = _RIM_M / plane.px_m
        width, height = plane.size_px
        corners = plane.place(
            np.array([[-px, -px], [width + px, -px], [width + px, height + px], [-px, height + px]]) - 0.5
        )
        self._empty = self._scene.add_mesh_simple(
            f"{self._name}/empty", (corners + np.array([0.0, 0.0, _RIM_M])).astype(np.float32),
            np.array([[0, 1, 2], [0, 2, 3]], np.uint32), color=EMPTY.paint, side="double", cast_shadow=False,
            receive_shadow=False,
        )  # fmt: skip
