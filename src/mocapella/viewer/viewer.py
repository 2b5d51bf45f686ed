"""Serve the live view: a web page with all stages and controls, for any number of browsers."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

from mocapella.conventions import NS_PER_S
from mocapella.errors import BusError
from mocapella.model.board_progress import BoardProgress
from mocapella.model.frame_types import FRAME_TYPES
from mocapella.model.scene import Scene
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.session import SessionStatus, Setup
from mocapella.model.study_status import LiveCheck
from mocapella.registry import load
from mocapella.viewer.browser import ASPECT, Browser, look_along, new_sight
from mocapella.viewer.camera_feed import Ask, CameraAnswer, CameraFeed, FeedMode
from mocapella.viewer.commands import Commander, SendCommand
from mocapella.viewer.gui_guard import guard_controls
from mocapella.viewer.lanes import kept
from mocapella.viewer.layout import Look
from mocapella.viewer.page import open_page, unprinted
from mocapella.viewer.panel import WIDTH_PX
from mocapella.viewer.picture_plane import SizedPicture
from mocapella.viewer.scenery import PROP as SCENERY
from mocapella.viewer.stages import Prop, StageChoice
from mocapella.viewer.timeline import LATEST_S, Moment, ShownPicture, Timeline
from mocapella.viewer.view_frame import Drawings, ViewNow
from mocapella.viewer.view_state import ViewMemory

BOARD_PX: Final = 560
"""Width of the camera images that are requested for the stage [px]."""
STALE_S: Final = 2.0
"""Largest age of a camera's last image that is still shown while requests to the camera fail [s]."""
_SAME_INSTANT_S: Final = 1.0
"""Largest time between an image and the stored scene that is drawn over it; else the newest scene is taken [s]."""
ROOM: Final = "mocapella.viewer.stages:ROOM"
_UP: Final = (0.0, 1.0, 0.0)


class Viewer:
    """Serves the view on one address. Call its methods from one thread only; commands run on a separate thread.

    Args:
        host: address of the only network interface to serve on.
        port: TCP port; 0 takes a free one.
        command: sends a command and its arguments to the server; may block. None for a run on files without a server:
            then controls for commands are hidden, and a ``status`` of None is normal.
        methods: references ``module:name`` to the stages of each tracking method that the Setup form offers, by the
            method's name; other methods have the stage ROOM.
        props: functions, or references to functions, that create objects to be shown beside a scene, such as a cloth,
            by name; the function ``scenery`` returns a `mocapella.model.scenery.Scenery`.
        ask: sends a request to a camera's node; may block. Without it, no camera images are requested.

    Attributes:
        timeline: the stored moments.

    Raises:
        AddressInUseError: the port is in use.
        SettingsError: this machine cannot listen at the address, or the view's token is invalid or cannot be stored.
        InputError: the file of the view's token cannot be read.
        PluginError: a prop cannot be imported.
    """

    def __init__(
        self,
        host: str,
        port: int,
        *,
        command: SendCommand | None,
        methods: Mapping[str, Sequence[str]] | None = None,
        props: Mapping[str, Prop] | None = None,
        ask: Ask | None = None,
    ) -> None:
        methods = {Setup.method: (ROOM,)} if methods is None else methods
        made = dict(props or {})
        scenery = made.pop(SCENERY, None)
        self._known = ViewMemory()
        if scenery is not None:
            self._known = ViewMemory(scenery=load(scenery)() if isinstance(scenery, str) else scenery())
        self._stages = StageChoice(methods, made, self._known.troubles)
        self._server = open_page(host, port, WIDTH_PX, command)
        self._methods = tuple(methods)
        self._commander = None if command is None else Commander(command)
        self._feed = CameraFeed(ask or _nobody)
        self._asks = ask is not None
        self._browsers: dict[int, Browser] = {}
        self._drawings = Drawings(self._known)
        self._method = ""
        self.timeline = Timeline()
        self._moment: Moment | None = None
        self._pictures: dict[str, ShownPicture] = {}
        self._kept: dict[str, tuple[SensorFrame, SensorFrame | None]] = {}
        self._home: tuple[object, Look | None] = (None, None)

    @property
    def pages(self) -> int:
        """Number of browser pages that draw the view at present."""
        return len(self._browsers)

    @property
    def url(self) -> str:
        """URL of the page, with the operator's token."""
        return self._server.url

    @property
    def watch_url(self) -> str:
        """URL of the page for viewers without rights to control the session."""
        return self._server.watch_url

    def study_url(self, page: str) -> str:
        """Address of a page of a study, ``study`` or ``participant``."""
        return self._server.study_url(page)

    def show(
        self,
        scene: Scene | None,
        frames: Mapping[str, SensorFrame],
        status: SessionStatus | None,
        board: BoardProgress | None = None,
        *,
        pictures: Mapping[str, SizedPicture] | None = None,
        keep: bool = True,
        check: LiveCheck | None = None,
    ) -> None:
        """Show the newest state in every browser; costs little while no browser is connected.

        Call it regularly, at up to 30 Hz, even if nothing has changed, because it also serves new browsers.

        Args:
            scene: the tracker's newest result; None before the first.
            frames: newest frame of each sensor, by sensor; the mapping is copied, the frames are kept.
            status: newest status of the session; None while no server answers.
            board: progress of a camera calibration; None if the server cannot calibrate.
            pictures: encoded image of each camera at the scene's time, by camera; a camera that is not in it keeps its
                last image for `LATEST_S`. None lets the view request images itself.
            keep: whether the scene is stored on the timeline; a scene object that is shown again is stored once.
            check: quality of the newest data, for the pages of a study; None if it is not known.

        Raises:
            Exception: the first error of drawing in a browser; the other browsers are drawn before.
        """
        now_s = time.monotonic()
        self._server.study.show(None if status is None else status.study, check)
        self._welcome(now_s)
        self._known.learn(scene, frames, status)
        self._method = self._method if status is None else status.setup.method
        self._take_pictures(scene, status, pictures, now_s)
        moment = self._moment = self._newest(scene, frames)
        if keep and moment.scene is not None:
            self.timeline.add(replace(moment, frames=self._thin(frames)))
        if not self._browsers:
            return
        self._drawings.begin()
        now = ViewNow(moment, status, board, self._drawings, self._look_home(moment), now_s)
        errors = []
        for browser in self._browsers.values():
            try:
                browser.show(now)
            except Exception as error:  # noqa: BLE001 - it is raised once all others are drawn
                errors.append(error)
        if errors:
            raise errors[0]

    def tell_fields(self, fields_deg: Mapping[str, tuple[float, float]]) -> None:
        """Set the horizontal and vertical field of view [°] of sensors whose frames do not define it, by sensor."""
        self._known.fields.update(fields_deg)

    def end(self) -> None:
        """Mark the timeline as complete after a run on files, so that browsers can replay it from the beginning."""
        self.timeline.done = True

    def close(self) -> None:
        """Stop serving the page, and drop waiting commands and requests; the viewer cannot be used afterwards."""
        if self._commander is not None:
            self._commander.close()
        self._feed.close()
        with unprinted():
            self._server.stop()

    def _newest(self, scene: Scene | None, frames: Mapping[str, SensorFrame]) -> Moment:
        """Return the newest moment; the same object while nothing changes."""
        stage, shown = self._stages.update(scene, self._method)
        last = self._moment
        if (
            last is not None
            and last.scene is scene
            and last.stage is stage
            and last.shown is shown
            and last.pictures == self._pictures
            and frames.keys() == last.frames.keys()
            and all(frame is last.frames[name] for name, frame in frames.items())
        ):
            return last
        at_s = 0.0 if scene is None else scene.at_ns / NS_PER_S
        return Moment(at_s, scene, dict(frames), stage, shown, self._known.seen.copy(), dict(self._pictures))

    def _thin(self, frames: Mapping[str, SensorFrame]) -> dict[str, SensorFrame]:
        """Return the frames in the form that the timeline keeps."""
        for name, frame in frames.items():
            if name not in self._kept or self._kept[name][0] is not frame:
                self._kept[name] = frame, kept(frame, self._known.troubles)
        return {name: thin for name in frames if (thin := self._kept[name][1]) is not None}

    def _take_pictures(
        self,
        scene: Scene | None,
        status: SessionStatus | None,
        given: Mapping[str, SizedPicture] | None,
        now_s: float,
    ) -> None:
        """Update the cameras' pictures from the ``given`` ones, or without these from the cameras' answers."""
        if given is not None:
            at_s = 0.0 if scene is None else scene.at_ns / NS_PER_S
            before = {name: one for name, one in self._pictures.items() if 0 <= at_s - one.at_s <= LATEST_S}
            fresh = {name: self._same(name, ShownPicture(one, scene, at_s)) for name, one in given.items()}
            self._pictures = before | fresh
            return
        rows = status.sensors if status is not None and self._asks else ()
        answering = {row.name: row for row in rows if row.pictures and row.connected}
        if not self._browsers:
            return
        self._feed.beat(
            list(answering), now_s, [name for name, row in answering.items() if _nothing_counted(row.sends)]
        )
        wanted = self._drawings.cameras(scene) if any(one.live for one in self._browsers.values()) else ()
        self._pictures = {name: one for name, one in self._pictures.items() if name in answering}
        for name in wanted:
            if name not in answering:
                continue
            shot = self._feed.want(name, FeedMode.PICTURE, BOARD_PX, now_s)
            if shot.answer is None or shot.problem:
                if name in self._pictures and now_s - self._pictures[name].at_s > STALE_S:
                    del self._pictures[name]
            elif name not in self._pictures or self._pictures[name].picture is not shot.answer:
                offset = answering[name].capture_offset
                of = None
                if offset is not None:
                    of = self.timeline.scene_near(shot.answer.time_ns / NS_PER_S + offset, _SAME_INSTANT_S)
                self._pictures[name] = ShownPicture(shot.answer, of or scene, now_s)

    def _same(self, name: str, shown: ShownPicture) -> ShownPicture:
        """Return the camera's present picture if it has the same image and scene, else ``shown``."""
        before = self._pictures.get(name)
        if before is not None and before.picture is shown.picture and before.scene is shown.scene:
            return before
        return shown

    def _look_home(self, moment: Moment) -> Look | None:
        """Return the initial camera of a new page, and of "Reset View", for a camera that follows."""
        space, boards = self._known.ground.space, self._drawings.boards(moment)
        if space is None:
            return None
        key = (space, boards.planes)
        if key != self._home[0]:
            look = look_along(new_sight(space, None, free=True), list(boards.planes.values()), ASPECT)
            self._home = key, look
            begin = self._server.initial_camera
            begin.fov, begin.up, begin.position, begin.look_at = look.fov, _UP, look.position, look.target
        return self._home[1]

    def _welcome(self, now_s: float) -> None:
        clients = self._server.get_clients()
        for number in self._browsers.keys() - clients.keys():
            if self._commander is not None:
                self._commander.forget(self._browsers[number].client)
            del self._browsers[number]
        for number, client in clients.items():
            if number not in self._browsers:
                guard_controls(client)
                self._browsers[number] = Browser(
                    client, self._commander, self._methods, self._known, operates=self._server.operates(client),
                    refusals=self._server.refusals, feed=self._feed, timeline=self.timeline, now_s=now_s,
                )  # fmt: skip


def _nothing_counted(sends: str) -> bool:
    """Whether frames of that type carry no count of detections."""
    kind = FRAME_TYPES.get(sends)
    return kind is not None and kind.counted is None


def _nobody(camera: str, question: dict[str, Any], timeout_s: float) -> CameraAnswer:
    raise BusError(f"{camera}: this view has no way to ask cameras")
