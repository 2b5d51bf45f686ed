"""Compute the drawings of one update of the view, once for all browsers that show the same."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, TypeVar

from mocapella.model.board_progress import BoardProgress
from mocapella.model.scene import Scene
from mocapella.model.session import SessionStatus
from mocapella.viewer import layout
from mocapella.viewer.boards import ShownBoard, image_lines, picture_row
from mocapella.viewer.gallery import GalleryDrawing, gallery_drawing
from mocapella.viewer.picture_plane import Plane
from mocapella.viewer.room import ImageLines
from mocapella.viewer.stage import StageView, TrackingDrawing
from mocapella.viewer.timeline import Moment
from mocapella.viewer.view_state import ViewMemory

T = TypeVar("T")

_KEPT: Final = 64
"""Number of scenes whose image lines are cached, because many images belong to slightly older scenes."""
_NOTHING: Final = TrackingDrawing(there=False)


@dataclass(frozen=True, eq=False)
class Boards:
    """Panels with camera images above a stage.

    Attributes:
        planes: rectangle of each panel by camera, relative to the origin of `mocapella.viewer.boards.BoardNodes`.
        shown: content of each panel by camera.
    """

    planes: Mapping[str, Plane]
    shown: Mapping[str, ShownBoard]


class Drawings:
    """Caches drawings: each moment is drawn once for all browsers, and kept while successive updates use it.

    Args:
        known: memory of the view.
    """

    def __init__(self, known: ViewMemory) -> None:
        self._known = known
        self._before: dict[tuple[object, ...], tuple[object, Any]] = {}
        self._now: dict[tuple[object, ...], tuple[object, Any]] = {}
        self._lines: dict[int, tuple[Scene, dict[str, ImageLines]]] = {}
        self._planes: tuple[object, Mapping[str, Plane]] = (None, {})

    def begin(self) -> None:
        """Begin the next update of the view: drop the drawings that the last update did not use."""
        self._before, self._now = self._now, {}

    def tracking(self, moment: Moment, perspective: str) -> TrackingDrawing:
        """Return the drawing of a moment's stage in a perspective; empty if drawing fails (reported once)."""
        known, stage = self._known, moment.stage
        view = StageView(perspective, moment.seen, known.floors, known.troubles, known.scenery)

        def make() -> TrackingDrawing:
            return known.troubles.attempt(
                f"stage {stage.name}", lambda: stage.draw(moment.scene, moment.shown, view), _NOTHING
            )

        return self._once(("tracking", id(moment), perspective), moment, make)

    def gallery(self, moment: Moment, without: tuple[str, ...]) -> GalleryDrawing:
        """Return the drawing of the sensors' gallery at a moment; ``without`` names sensors that get no lane."""
        lanes = (known := self._known).colours.sensors
        key = ("gallery", id(moment), lanes, without)
        return self._once(key, moment, lambda: gallery_drawing(moment.frames, known, without))

    def boards(self, moment: Moment) -> Boards:
        """Return the panels with camera images above the stage at a moment; none for a stage without them."""
        return self._once(("boards", id(moment)), moment, lambda: self._make_boards(moment))

    def cameras(self, scene: Scene | None) -> tuple[str, ...]:
        """Return the cameras whose images a scene's parts draw lines over, in the panels' order; none if it is None."""
        return tuple(self._image_lines(scene))

    def _make_boards(self, moment: Moment) -> Boards:
        lines, known = self._image_lines(moment.scene) if moment.stage.pictures else {}, self._known
        pictures = {camera: moment.pictures[camera] for camera in lines if camera in moment.pictures}
        sizes = {
            camera: size_px
            for camera in lines
            if (size_px := _size_px(pictures[camera].picture.size_px if camera in pictures else None)
                or known.sizes_px.get(camera)) is not None
        }  # fmt: skip
        shown = {}
        for camera in sizes:
            picture = pictures.get(camera)
            of = lines if picture is None or picture.scene is None else self._image_lines(picture.scene)
            words = " · ".join(filter(None, (camera, lines[camera].words)))
            shown[camera] = ShownBoard(words, None if picture is None else picture.picture, of.get(camera))
        lanes = len([name for name in known.colours.sensors if name not in sizes])
        return Boards(self._row(sizes, lanes), shown)

    def _row(self, sizes_px: Mapping[str, tuple[int, int]], lanes: int) -> Mapping[str, Plane]:
        space = self._known.ground.space
        tall = float(layout.sensors_box(lanes).high[1]) if space is None else space.tall_m
        key = (tuple(sizes_px.items()), tall)
        if key != self._planes[0]:
            self._planes = key, picture_row(sizes_px, tall)
        return self._planes[1]

    def _image_lines(self, scene: Scene | None) -> dict[str, ImageLines]:
        if scene is None:
            return {}
        if id(scene) not in self._lines:
            self._lines[id(scene)] = scene, image_lines(scene, self._known.troubles)
            while len(self._lines) > _KEPT:
                del self._lines[next(iter(self._lines))]
        return self._lines[id(scene)][1]

    def _once(self, key: tuple[object, ...], of: object, make: Callable[[], T]) -> T:
        """Return a key's cached drawing, or make it. ``of`` is cached with it, so that no other object gets its id."""
        if key not in self._now:
            self._now[key] = self._before.get(key) or (of, make())
        found: T = self._now[key][1]
        return found


def _size_px(size_px: tuple[int, int] | None) -> tuple[int, int] | None:
    return None if size_px is None else (int(size_px[0]), int(size_px[1]))


@dataclass(frozen=True, eq=False)
class ViewNow:
    """Input of all browsers for one update.

    Attributes:
        moment: the newest moment.
        status: newest status of the session; None without a server, or while the server does not answer.
        board: progress of a camera calibration; None if calibration is not available.
        drawings: computes and caches the drawings of moments.
        home: camera pose of the button "Reset View"; None for viser's default.
        now_s: the present time on this process's monotonic clock [s].
    """

    moment: Moment
    status: SessionStatus | None
    board: BoardProgress | None
    drawings: Drawings
    home: layout.Look | None
    now_s: float
