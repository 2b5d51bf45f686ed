"""The panel beside the 3D scene in one browser, with all controls and readouts.

They show the session's status, never what this browser requested, so that all browsers agree.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from typing import Any, Final

import viser

from mocapella.model.board_progress import BoardProgress
from mocapella.model.session import SessionStatus
from mocapella.viewer import readout
from mocapella.viewer.board_panel import BoardPanel, BoardPlace
from mocapella.viewer.camera_feed import CameraFeed
from mocapella.viewer.camera_panel import CameraPanel
from mocapella.viewer.commands import Commander, notify
from mocapella.viewer.controls import (
    FIRST_TAKE,
    Allowed,
    allowed,
    default_perspective,
    part_names,
    perspectives,
    progress_percent,
    take_name,
)
from mocapella.viewer.inputs import set_value
from mocapella.viewer.page_refusals import PageRefusals
from mocapella.viewer.part_panel import MakePanel, PanelPlace, PanelState, PartPanel
from mocapella.viewer.perspective import FREE
from mocapella.viewer.room import called, drawing_of
from mocapella.viewer.setup_panel import SetupPanel
from mocapella.viewer.timeline import Moment, Playhead, Timeline
from mocapella.viewer.timeline_panel import TimelinePanel
from mocapella.viewer.trails import LONGEST_S, TrailChoice, TrailOf
from mocapella.viewer.view_state import ViewMemory
from mocapella.viewer.watchdog import Watchdog

WIDTH_PX = 340
SHORTEST_TRAIL_S = 2
NO_PICTURE: Final = "–"
"""The dropdown's text while no camera image is chosen."""
_BESIDE: Final = 0.01
"""Difference between the orders of two folders that are made on demand, less than between the other folders."""


class Aim(StrEnum):
    """Views of the 3D scene that the user can choose; the values are the labels of the buttons.

    Attributes:
        BOTH: the stage, the sensors' lanes, and the cameras' pictures.
        SCENE: the stage.
        SENSORS: the sensors' lanes, and the cameras' pictures.
        EYES: the stage from the pose of the sensor that is chosen as perspective; if none is, of the default one.
    """

    BOTH = "Both"
    SCENE = "Scene"
    SENSORS = "Sensors"
    EYES = "Sensor's eyes"


@dataclass(frozen=True, eq=False)
class PanelNews:
    """The state that a browser's panel shows.

    Attributes:
        status: newest status of the session; None without a server, or while it does not answer.
        moment: the moment of the timeline that this browser shows.
        board: progress of a camera calibration; None if calibration is unavailable.
        pictures: names of the cameras whose images are shown above the stage.
        now_s: the present time on this process's monotonic clock [s].
    """

    status: SessionStatus | None
    moment: Moment
    board: BoardProgress | None
    pictures: tuple[str, ...]
    now_s: float


class Panel:
    """The panel beside the 3D scene in one browser.

    Args:
        client: viser's connection to the browser.
        commander: sends commands to the server; None without a server, which hides the controls for commands.
        methods: names of the tracking methods that the Setup form offers.
        known: memory of the view, shared by all browsers.
        operates: whether the browser may control the session; if not, no command is sent, and the controls for commands
            are hidden.
        refusals: the view's refused requests, which operators see among the notices.
        aim: is called with the `Aim` that the user chooses, from viser's callbacks.
        feed: requests camera images.
        timeline: the stored moments.
        playhead: position of this browser on the timeline.

    Attributes:
        cameras: folder with the camera images and the learning of marker colours.
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
        aim: Callable[[Aim], None],
        feed: CameraFeed,
        timeline: Timeline,
        playhead: Playhead,
    ) -> None:
        self._client, self._commander, self._aim = client, commander, aim
        self._known, self._colours = known, known.colours
        self._operates, self._refusals = operates, refusals
        self._timeline, self._playhead = timeline, playhead
        self._status: SessionStatus | None = None
        self._shown: tuple[object, ...] | None = None
        self._chosen: str | None = None
        self._shown_perspective = ""
        self._stage_panels: dict[str, PartPanel | None] = {}
        self._part_panels: dict[str, PartPanel | None] = {}
        gui = client.gui
        self._watchdog = Watchdog(gui)
        self._headline = gui.add_html(readout.status_html(None) if commander else readout.run_html("", None, 0, 0, 0))
        served = commander is not None
        gui.add_html(readout.watching_html(), visible=served and not operates)
        self._study = gui.add_html("", visible=False)
        self._progress = gui.add_progress_bar(0.0, visible=False, animated=True, color="blue")
        self._start = self._button("Start", "start", viser.Icon.PLAYER_PLAY, "teal")
        self._stop = self._button("Stop", "stop", viser.Icon.PLAYER_STOP, "gray")
        self._recalibrate = self._button("Recalibrate", "recalibrate", viser.Icon.REFRESH, "gray")
        self._timeline_panel = TimelinePanel(gui, timeline, playhead)
        self._stage_order = gui.add_html("", visible=False).order
        with gui.add_folder("Sensors", visible=served) as sensors:
            self._sensors = gui.add_html(readout.sensors_html(None, known.colours))
        self.cameras = CameraPanel(gui, feed, self._tell, learns=operates)
        self._boards = BoardPlace(
            lambda expanded: BoardPanel(
                gui, known.colours, self._send, self._say_no, order=sensors.order + 0.5, expanded=expanded
            )
        )
        self._part_order = gui.add_html("", visible=False).order
        self._add_recording_folder(gui, visible=served, operates=operates)
        self._add_camera_folder(gui)
        self._setup = SetupPanel(gui, methods, self._send_setup, self._refuse, visible=served and operates)
        with gui.add_folder("Notices", visible=served) as self._notices_folder:
            self._notices = gui.add_html(readout.notices_html(None))

    @property
    def trails(self) -> TrailChoice:
        """Trails of people's motion that the user has chosen."""
        return TrailChoice(TrailOf(self._trails.value), float(self._trail_seconds.value))

    @property
    def fields(self) -> bool:
        """Whether this browser shows the sensors' fields of view."""
        return bool(self._fields.value)

    @property
    def picture(self) -> str:
        """Name of the camera whose image fills the view; empty if no image does."""
        return "" if self._picture.value == NO_PICTURE else str(self._picture.value)

    @property
    def perspective(self) -> str:
        """The perspective that the user has chosen, else the default: a sensor's name, or `FREE`.

        The default is `FREE` if the scene's parts define the pose of the world, and else `default_perspective`.
        """
        if self._chosen is not None:
            return self._chosen
        if self._known.ground.space is not None:
            return FREE
        return default_perspective(self._status, self._colours.sensors)

    def show(self, news: PanelNews) -> None:
        """Update all controls and readouts; call it in every update. Unchanged content is not sent again."""
        status, moment = news.status, news.moment
        self._watchdog.beat(news.now_s)
        self.cameras.show(news.now_s)
        self._timeline_panel.show(news.now_s)
        self._show_pictures(news.pictures)
        can = allowed(status) if self._operates else Allowed()
        refused = self._refusals.lines if self._operates else ()
        self._setup.show(status, enabled=can.setup)
        self._boards.show(status, news.board if self._operates else None)
        self._show_perspectives(status)
        live = self._playhead.number is None
        shown = (status, self._known.troubles.lines, refused, None if live and self._commander else moment, live)
        changed = self._shown is None or any(a is not b for a, b in zip(shown, self._shown, strict=True))
        self._show_parts(news, changed=changed, can_name=can.name and live)
        if not changed:
            return
        self._shown = shown
        if status is not None and (name := take_name(self._name.value, self._status, status)) != self._name.value:
            set_value(self._name, name)
        self._status = status
        self._headline.content = self._headline_html(status, moment)
        self._study.content = readout.study_html(None if status is None else status.study)
        self._study.visible = bool(self._study.content)
        percent = progress_percent(status)
        self._progress.visible = percent is not None
        set_value(self._progress, percent or 0.0)
        self._start.disabled, self._stop.disabled = not can.start, not can.stop
        self._recalibrate.disabled = not can.recalibrate
        self._record.disabled, self._record_stop.disabled = not can.record, not can.record_stop
        self._name.disabled = not can.record
        self._recording.content = readout.recording_html(status.recording if status else None)
        troubles = self._known.troubles.lines
        self._notices_folder.visible = self._commander is not None or bool(troubles)
        self._notices.content = readout.notices_html(status, troubles, refused)
        places = {place.sensor: place for place in moment.scene.sensors} if moment.scene else {}
        self._sensors.content = readout.sensors_html(status, self._colours, places)

    def _headline_html(self, status: SessionStatus | None, moment: Moment) -> str:
        if self._commander is not None:
            return readout.status_html(status)
        timeline, playhead = self._timeline, self._playhead
        place = playhead.shown - timeline.first + 1
        return readout.run_html(playhead.state, moment.scene, moment.at_s, place, len(timeline))

    def _show_parts(self, news: PanelNews, *, changed: bool, can_name: bool) -> None:
        """Update the folders of the shown stage and of the part types."""
        status, moment = news.status, news.moment
        scene = moment.scene if status is not None or self._commander is None else None
        stage = moment.stage
        if stage.name not in self._stage_panels:
            self._stage_panels[stage.name] = self._made(f"stage {stage.name}", stage.panel, self._stage_order)
        names = part_names(status, scene)
        for name in names:
            if name not in self._part_panels:
                how = drawing_of(name, self._known.troubles)
                make = None if how is None else how.panel
                order = self._part_order + _BESIDE * len(self._part_panels)
                self._part_panels[name] = self._made(called(name), make, order)
                changed = True
        panels = [
            *((f"stage {name}", panel, name == stage.name, ()) for name, panel in self._stage_panels.items()),
            *(
                (called(name), panel, status is None or name in names, () if scene is None else scene.of(name))
                for name, panel in self._part_panels.items()
            ),
        ]
        for what, panel, visible, parts in panels:
            if panel is None:
                continue
            state = PanelState(
                scene, parts, moment.shown, visible, can_name, changed, news.now_s,
                lambda seconds: self._timeline.lately(self._playhead.shown, seconds),
            )  # fmt: skip
            self._known.troubles.attempt(f"panel of {what}", partial(panel.show, state), None)

    def _made(self, what: str, make: MakePanel | None, order: float) -> PartPanel | None:
        if make is None:
            return None
        sends = self._commander is not None and self._operates
        place = PanelPlace(self._client.gui, order, self._send if sends else None)
        return self._known.troubles.attempt(f"panel of {what}", lambda: make(place), None)

    def _button(self, label: str, verb: str, icon: Any, colour: Any) -> viser.GuiButtonHandle:
        served = self._commander is not None and self._operates
        button = self._client.gui.add_button(label, disabled=True, icon=icon, color=colour, visible=served)

        @button.on_click
        async def _(_: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            self._send(verb, {"name": self._name.value.strip()} if verb == "record" else {})

        return button

    def _add_camera_folder(self, gui: viser.GuiApi) -> None:
        with gui.add_folder("View"):
            self._perspective = gui.add_dropdown(
                "Perspective", (FREE,), hint="Camera frame of the stage; free: the world frame"
            )
            self._aims = gui.add_button_group("Look at", tuple(Aim))
            self._picture = gui.add_dropdown(
                "Picture", (NO_PICTURE,), visible=False, hint="Look at one camera's picture above the stage"
            )
            self._trails = gui.add_dropdown("Trails", tuple(TrailOf), hint="Paths of people's recent motion")
            self._trail_seconds = gui.add_slider(
                "Trail length, s", SHORTEST_TRAIL_S, LONGEST_S, 1, TrailChoice().seconds, hint="How many seconds back"
            )
            self._fields = gui.add_checkbox(
                "Fields of view", False, hint="The volume that each sensor sees, up to 4.5 m"
            )

        @self._perspective.on_update
        async def _(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                self._chosen = self._perspective.value
                self._aim(Aim.BOTH if self._chosen == FREE else Aim.EYES)

        @self._aims.on_click
        async def _(_: viser.GuiEvent[Any]) -> None:
            aim = Aim(self._aims.value)
            set_value(self._picture, NO_PICTURE)
            if aim is Aim.EYES and self.perspective == FREE:
                sensor = default_perspective(self._status, self._colours.sensors)
                if sensor == FREE:
                    notify(self._client, "Sensor's eyes", "There is no sensor yet; start a node first.", ok=False)
                    return
                self._chosen = sensor
            self._aim(aim)

    def _add_recording_folder(self, gui: viser.GuiApi, *, visible: bool, operates: bool) -> None:
        with gui.add_folder("Recording", visible=visible):
            hint = "The take's name; nothing is ever overwritten"
            self._name = gui.add_text("Take", FIRST_TAKE, hint=hint, visible=operates)
            self._record = self._button("Record", "record", viser.Icon.PLAYER_RECORD, "red")
            self._record_stop = self._button("Stop recording", "record-stop", viser.Icon.PLAYER_STOP, "gray")
            self._recording = gui.add_html(readout.recording_html(None))

    def _show_pictures(self, cameras: tuple[str, ...]) -> None:
        options = (NO_PICTURE, *cameras)
        if options != tuple(self._picture.options):
            chosen = self._picture.value
            self._picture.options = options
            set_value(self._picture, chosen if chosen in options else NO_PICTURE)
            self._picture.visible = bool(cameras)

    def _show_perspectives(self, status: SessionStatus | None) -> None:
        options = perspectives(status, self._colours.sensors)
        if options != self._perspective.options:
            self._perspective.options, self._shown_perspective = options, ""
        now = self.perspective
        # Only after a change: the browser's newest choice may not have arrived yet, and must not be undone.
        if now in options and now != self._shown_perspective:
            self._shown_perspective = now
            set_value(self._perspective, now)

    def _send(self, verb: str, arguments: dict[str, Any]) -> None:
        if self._commander is not None and self._operates:
            self._commander.send(verb, arguments, self._client)

    def _send_setup(self, arguments: dict[str, Any]) -> None:
        self._send("setup", arguments)

    def _tell(self, title: str, message: str, ok: bool) -> None:
        notify(self._client, title, message, ok=ok)

    def _refuse(self, message: str) -> None:
        self._say_no("Setup: not sent", message)

    def _say_no(self, title: str, message: str) -> None:
        self._tell(title, message, ok=False)
