"""The view in one connected browser: panel, stages, camera, and position on the timeline."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import viser
from numpy.typing import NDArray

from mocapella.model.topology import UNKNOWN_FIELD_OF_VIEW_DEG
from mocapella.viewer import layout
from mocapella.viewer.boards import BOARDS_BEHIND, BoardNodes
from mocapella.viewer.browser_camera import BrowserCamera
from mocapella.viewer.camera_feed import CameraFeed
from mocapella.viewer.commands import Commander
from mocapella.viewer.framing import Framing
from mocapella.viewer.gallery import LANE_TAG_SIZE, GalleryDrawing, SensorsStage, lane_tags
from mocapella.viewer.layout import Look
from mocapella.viewer.legend import Legend
from mocapella.viewer.page_refusals import PageRefusals
from mocapella.viewer.panel import Aim, Panel, PanelNews
from mocapella.viewer.perspective import FREE, StageSpace
from mocapella.viewer.picture_plane import Plane
from mocapella.viewer.picture_stage import PictureStage
from mocapella.viewer.readout import condition_lines, stage_text
from mocapella.viewer.room import RoomView
from mocapella.viewer.stage import Stage, TrackingDrawing
from mocapella.viewer.timeline import Moment, Playhead, PlayState, Timeline
from mocapella.viewer.tracking_stage import TrackingStage
from mocapella.viewer.trails import TrailChoice, trail_lines
from mocapella.viewer.view_frame import Boards, ViewNow
from mocapella.viewer.view_state import ViewMemory

Float64 = NDArray[np.float64]

FOV: Final = float(np.radians(36.0))
_ELEVATION: Final = float(np.radians(13.0))
ROUND: Final = 1.2
"""Size of the browser's view relative to an image that is shown large in it, which leaves space for text."""
ASPECT: Final = 1.4
"""Width over height of a usual window beside the panel."""
_ELEVATION_ALONG: Final = float(np.radians(9.0))
_MARGIN_ALONG, _MARGIN_PICTURE = 1.06, 1.02
_HALF_M: Final = 0.45
"""Smallest half depth of the followed region, along z [m]."""
_WORDS_M: Final = 0.2
"""Height of the text above a camera image [m]."""
STILL_S, LONGEST_STILL_S = 0.5, 5.0
"""Times until the first camera images are replaced: after the browser's first answer; at most after its connection [s].

A browser drops an image that it has not decoded when the next one arrives; a busy browser would therefore show none.
"""


def new_sight(space: StageSpace, extent: tuple[Float64, Float64] | None, *, free: bool) -> Framing:
    """Return the region that the camera shows at first: around the stage's centre if free, else around the parts.

    Args:
        space: pose of the world on the stage, with the initial size of the parts.
        extent: opposite corners (3,) of the box around the parts, in the view's space [m]; None: the stage's centre.
        free: whether the perspective is `FREE`.
    """
    x, _, z = layout.stage_centre()
    middle = np.array([x, 0.0, z]) if free or extent is None else 0.5 * (extent[0] + extent[1]) * [1.0, 0.0, 1.0]
    return Framing(np.array([space.half_wide_m, _HALF_M]), space.tall_m, middle)


def look_along(sight: Framing, planes: Sequence[Plane], aspect: float) -> Look:
    """Return a camera that shows the followed region and all camera images above it.

    Args:
        sight: the region that the camera follows.
        planes: planes of the camera images, relative to the region's middle.
        aspect: width of the browser's canvas over its height.
    """
    corners = np.concatenate([sight.corners, *(plane.corners + sight.middle for plane in planes)])
    return layout.frame(corners, fov=FOV, aspect=aspect, elevation=_ELEVATION_ALONG, margin=_MARGIN_ALONG)


def look_at_picture(sight: Framing, plane: Plane, aspect: float) -> Look:
    """Return a camera in front of one camera image above the stage.

    Args:
        sight: the region that the camera follows.
        plane: plane of the camera image, relative to the region's middle.
        aspect: width of the browser's canvas over its height.
    """
    corners = plane.moved(sight.middle).corners
    return layout.frame(corners, fov=FOV, aspect=aspect, elevation=0.0, margin=_MARGIN_PICTURE)


class Browser:
    """The view in one browser.

    Only the drawing loop may call its methods; callbacks of the browser only leave requests, which `show` carries out.

    Args:
        client: viser's connection to the browser.
        commander: sends commands to the server; None without a server.
        methods: names of the tracking methods that the Setup form offers.
        known: memory of the view, shared by all browsers.
        operates: whether the browser may control the session; if not, it only watches.
        refusals: the view's refused requests, which operators see.
        feed: requests camera images, for all browsers.
        timeline: the stored moments, shared by all browsers.
        now_s: time of the connection on this process's monotonic clock [s].

    Attributes:
        client: viser's connection to the browser.
        playhead: position of this browser on the timeline.
        camera: camera of this browser.
    """

    def __init__(
        self,
        client: viser.ClientHandle,
        commander: Commander | None,
        methods: Sequence[str],
        known: ViewMemory,
        *,
        operates: bool,
        refusals: PageRefusals,
        feed: CameraFeed,
        timeline: Timeline,
        now_s: float,
    ) -> None:
        self.client, self._known, self._came_s = client, known, now_s
        self._served, self._timeline = commander is not None, timeline
        self.playhead = Playhead(timeline)
        self.camera = BrowserCamera(client)
        self._wish: Aim | None = Aim.BOTH
        self._aim = Aim.BOTH
        self._framed: tuple[object, ...] | None = None
        self._stage_name = ""
        self._stage = TrackingStage(client.scene, known.colours, known.fields)
        self._gallery = SensorsStage(client.scene, known.fields)
        self._boards = BoardNodes(client.scene)
        self._pictures = PictureStage(client.scene)
        self._legend = Legend(client.gui)
        self._sight: Framing | None = None
        self._sight_of: tuple[object, ...] = ()
        self._picture_before = ""
        self._hears_clicks = self._before_picture = False
        self._panel = Panel(
            client, commander, methods, known, operates=operates, refusals=refusals, aim=self._want, feed=feed,
            timeline=timeline, playhead=self.playhead,
        )  # fmt: skip

    @property
    def live(self) -> bool:
        """Whether the browser shows the newest scene, rather than an earlier one of the timeline."""
        return self.playhead.number is None

    def show(self, now: ViewNow) -> None:
        """Update the whole page: show the newest scene, or the scene chosen on the timeline.

        Only changes since the last call are sent to the browser. ``now`` is the input of all browsers for this update.
        """
        self.playhead.update(now.now_s)
        self.camera.beat(now.now_s)
        self.camera.home = None if now.home is None else np.asarray(now.home.position)
        moment = now.moment if self.live or not len(self._timeline) else self._timeline[self.playhead.shown]
        stage, boards = moment.stage, now.drawings.boards(moment)
        with self.client.atomic():
            self._panel.show(PanelNews(now.status, moment, now.board, tuple(boards.planes), now.now_s))
            self._change_stage(stage)
            wish, self._wish = self._wish, None  # before the perspective: a callback sets it first, and then the wish
            perspective = self._panel.perspective
            drawing = now.drawings.tracking(moment, perspective)
            gallery = now.drawings.gallery(moment, tuple(boards.planes))
            self._go_along(stage, drawing, perspective, now.now_s)
            self._draw_stage(now, moment, drawing, perspective, gallery)
            self._draw_boards(boards, now.now_s)
            self._gallery.draw(gallery)
            self._draw_pictures()
            self._draw_trails(moment, perspective)
            self._move_camera(stage, perspective, len(gallery.spaces), wish)

    def _change_stage(self, stage: Stage) -> None:
        """Let the camera show a new stage, unless the user moved it or chose another view."""
        if stage.name == self._stage_name:
            return
        first, self._stage_name = not self._stage_name, stage.name
        if self._wish in (None, Aim.BOTH) and (first or not self.camera.touched):
            self._wish = Aim.BOTH if stage.box_with_sensors else Aim.SCENE

    def _draw_stage(
        self, now: ViewNow, moment: Moment, drawing: TrackingDrawing, perspective: str, gallery: GalleryDrawing
    ) -> None:
        conditions = condition_lines(now.status) if self.live else self._behind()
        self._stage.draw(
            moment.stage,
            drawing,
            perspective,
            self._empty_text(now, moment),
            conditions,
            eyes=self._aim is Aim.EYES,
            fields=self._panel.fields,
            named=not self._panel.picture,
            along=None if self._sight is None else self._sight.middle,
            eye=None if now.home is None or self._sight is None else np.asarray(now.home.position),
            camera=self.camera.labels,
            lanes=[(LANE_TAG_SIZE, lane_tags(gallery))],
        )
        shown = () if moment.scene is None else moment.scene.people
        people = bool(shown) and moment.stage.perspectives
        obstacle = self._known.scenery is not None and bool(self._known.scenery.solids)
        views = any(person.views for person in shown)
        self._legend.show(perspective, people=people, obstacle=obstacle, views=views)

    def _empty_text(self, now: ViewNow, moment: Moment) -> str:
        if self._served:
            return stage_text(now.status) if self.live else "Nothing was there"
        return str(PlayState.NOTHING) if moment.scene is None else "Nothing is there"

    def _behind(self) -> tuple[str, ...]:
        """Return a line with the shown scene's age; none after a run on files has ended."""
        return () if self._timeline.done else (f"{self.playhead.state} · {self.playhead.behind_s:.1f} s ago",)

    def _draw_boards(self, boards: Boards, now_s: float) -> None:
        self._boards.place(BOARDS_BEHIND if self._sight is None else self._sight.middle)
        still_s = min(self.camera.answered_s + STILL_S, self._came_s + LONGEST_STILL_S)
        self._boards.draw(boards.planes, boards.shown, new_pictures=now_s >= still_s)

    def _draw_pictures(self) -> None:
        cameras = self._panel.cameras
        self._pictures.draw(cameras.large)
        if cameras.wants_clicks != self._hears_clicks:
            self._hears_clicks = cameras.wants_clicks
            if self._hears_clicks:
                self.client.scene.on_click()(self._clicked)
            else:
                self.client.scene.remove_click_callback()

    def _clicked(self, event: viser.SceneClickEvent) -> None:
        plane = self._pictures.plane
        at = None if plane is None else plane.pixel(np.array(event.ray_origin), np.array(event.ray_direction))
        if at is not None:
            self._panel.cameras.click(at)

    def _draw_trails(self, moment: Moment, perspective: str) -> None:
        trails, shown = self._known.trails, self._panel.trails
        if moment.scene is None or not moment.stage.perspectives:
            shown = TrailChoice()
        room = RoomView(perspective, moment.seen, self._known.floors)
        until_s = np.inf if self.live else moment.at_s
        self._stage.draw_trails(
            (trails.number, shown, perspective, until_s), lambda: trail_lines(trails, shown, room, until_s)
        )

    def _want(self, aim: Aim) -> None:
        self._wish = aim

    def _go_along(self, stage: Stage, drawing: TrackingDrawing, perspective: str, now_s: float) -> None:
        """Move the followed region with the parts, if they define the pose of the world."""
        space, extent = self._known.ground.space, drawing.extent
        if space is None or not stage.pictures:
            self._sight, self._sight_of = None, ()
            return
        key = (id(space), perspective, self._stage_name)
        if self._sight is None or key != self._sight_of:
            self._sight, self._sight_of = new_sight(space, extent, free=perspective == FREE), key
        if extent is None:
            self._sight.rest(now_s)
        else:
            self._sight.follow(*extent, now_s)

    def _move_camera(self, stage: Stage, perspective: str, lanes: int, wish: Aim | None) -> None:
        camera, plane = self.camera, self._pictures.plane
        if plane is not None and wish is None:
            self._look_at_large(plane)
            return
        if self._before_picture:
            self._before_picture, wish = False, wish or self._aim
            self._panel.cameras.leave()
        self._aim = wish or self._aim
        along = self._aim in (Aim.SCENE, Aim.BOTH) or (self._aim is Aim.SENSORS and not lanes)
        if self._sight is not None and (self._panel.picture or along):
            self._look_along(lanes, wish)
            return
        self._picture_before = ""
        fits: tuple[object, ...] = (lanes, camera.aspect, stage.name)
        if wish is None and (fits == self._framed or camera.touched or self._aim is Aim.EYES):
            return
        self._framed = fits
        floors = self._known.floors
        if self._aim is Aim.EYES:
            _, high = self._known.fields.get(perspective, UNKNOWN_FIELD_OF_VIEW_DEG)
            camera.put(layout.eyes(floors.tilt(perspective), floors.height(perspective), np.radians(high)))
            return
        tracking, sensors = stage.box.corners, layout.sensors_box(lanes).corners
        over = BOARDS_BEHIND + np.array([0.0, _WORDS_M, 0.0])
        pictures = [plane.corners + over for plane in self._boards.planes.values()]
        both = np.concatenate([tracking, sensors, *pictures])
        seen = {Aim.SCENE: tracking, Aim.SENSORS: np.concatenate([sensors, *pictures])}.get(self._aim, both)
        elevation = stage.elevation if self._aim is Aim.SCENE else _ELEVATION
        camera.put(layout.frame(seen, fov=FOV, aspect=camera.aspect, elevation=elevation))

    def _look_at_large(self, plane: Plane) -> None:
        """Put the camera in front of a picture as large as the window."""
        camera = self.camera
        fits: tuple[object, ...] = (plane.size_px, camera.aspect)
        if self._framed is None or not self._before_picture or (fits != self._framed and not camera.touched):
            self._framed, self._before_picture = fits, True
            camera.put(layout.frame(plane.corners, fov=FOV, aspect=camera.aspect, elevation=0.0, margin=ROUND))

    def _look_along(self, lanes: int, wish: Aim | None) -> None:
        """Follow the region in sight, or one picture above it."""
        assert self._sight is not None
        camera, planes, picture = self.camera, self._boards.planes, self._panel.picture
        self._framed = None
        if not camera.ready:
            return
        if picture in planes:
            look = look_at_picture(self._sight, planes[picture], camera.aspect)
        else:
            look = look_along(self._sight, list(planes.values()), camera.aspect)
            if self._aim is Aim.BOTH and lanes:
                corners = np.concatenate([
                    self._sight.corners, *(plane.corners + self._sight.middle for plane in planes.values()),
                    layout.sensors_box(lanes).corners,
                ])  # fmt: skip
                look = layout.frame(corners, fov=FOV, aspect=camera.aspect, elevation=_ELEVATION)
        if picture != self._picture_before or wish is not None:
            self._picture_before = picture
            camera.put(look)
        camera.follow(look)
