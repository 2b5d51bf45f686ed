"""The controls and readouts of one browser.

What they show comes from the session's status alone, never from what this browser asked for: so two browsers agree.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from enum import StrEnum
from typing import Any

import viser

from mocapella.model.board_progress import BoardProgress
from mocapella.model.scene import Scene
from mocapella.model.session import SessionStatus
from mocapella.viewer import readout
from mocapella.viewer.arm_panel import ArmPanel
from mocapella.viewer.arms import ArmsShown
from mocapella.viewer.board_panel import BoardPanel, BoardPlace
from mocapella.viewer.camera_feed import CameraFeed
from mocapella.viewer.camera_panel import CameraPanel
from mocapella.viewer.commands import Commander, notify
from mocapella.viewer.controls import (
    FIRST_TAKE,
    allowed,
    default_perspective,
    makes_people,
    perspectives,
    progress_percent,
    take_name,
)
from mocapella.viewer.palette import SensorColours
from mocapella.viewer.people_panel import PeoplePanel
from mocapella.viewer.perspective import FREE
from mocapella.viewer.setup_panel import SetupPanel
from mocapella.viewer.trails import LONGEST_S, TrailChoice, TrailOf
from mocapella.viewer.watchdog import Watchdog

WIDTH_PX = 340
SHORTEST_TRAIL_S = 2


class Aim(StrEnum):
    """What the camera can be put before."""

    BOTH = "Both"
    TRACKING = "Tracking"
    SENSORS = "Sensors"
    EYES = "Sensor's eyes"


class Panel:
    """All that a browser shows beside the 3D scene.

    Attributes:
        perspective: from where this browser shows the people; a sensor's name or `FREE`.
        cameras: their pictures, and how their colours are learnt.
    """

    def __init__(
        self,
        client: viser.ClientHandle,
        commander: Commander,
        methods: Sequence[str],
        colours: SensorColours,
        *,
        aim: Callable[[Aim], None],
        feed: CameraFeed,
    ) -> None:
        self._client, self._commander, self._colours, self._aim = client, commander, colours, aim
        self._status: SessionStatus | None = None
        self._begun = False
        self._chosen: str | None = None
        self._shown_perspective = ""
        self._take = ""
        gui = client.gui
        self._watchdog = Watchdog(gui)
        self._headline = gui.add_html(readout.status_html(None))
        self._progress = gui.add_progress_bar(0.0, visible=False, animated=True, color="blue")
        self._start = self._button("Start", "start", viser.Icon.PLAYER_PLAY, "teal")
        self._stop = self._button("Stop", "stop", viser.Icon.PLAYER_STOP, "gray")
        self._recalibrate = self._button("Recalibrate", "recalibrate", viser.Icon.REFRESH, "gray")
        self._arms = ArmPanel(gui)
        with gui.add_folder("Sensors") as sensors:
            self._sensors = gui.add_html(readout.sensors_html(None, colours))
        self.cameras = CameraPanel(gui, feed, self._tell)
        self._boards = BoardPlace(
            lambda expanded: BoardPanel(
                gui, colours, self._send_board, self._say_no, order=sensors.order + 0.5, expanded=expanded
            )
        )
        self._people = PeoplePanel(gui, self._send_name)
        self._add_recording_folder(gui)
        self._add_camera_folder(gui)
        self._setup = SetupPanel(gui, methods, self._send_setup, self._refuse)
        with gui.add_folder("Notices"):
            self._notices = gui.add_html(readout.notices_html(None))

    @property
    def trails(self) -> TrailChoice:
        """The trails that this browser shows."""
        return TrailChoice(TrailOf(self._trails.value), float(self._trail_seconds.value))

    @property
    def fields(self) -> bool:
        """Whether this browser shows what each sensor can see."""
        return bool(self._fields.value)

    @property
    def perspective(self) -> str:
        """From where this browser shows the people: what was chosen in it, else the default."""
        if self._chosen is not None:
            return self._chosen
        return default_perspective(self._status, self._colours.sensors)

    def show(
        self,
        status: SessionStatus | None,
        scene: Scene | None,
        board: BoardProgress | None = None,
        arms: ArmsShown | None = None,
    ) -> None:
        """Bring everything up to the status; costs next to nothing when it is the one already shown."""
        now_s = time.monotonic()
        self._watchdog.beat(now_s)
        self.cameras.show(now_s)
        self._arms.show(scene, arms, now_s)
        can = allowed(status)
        self._setup.show(status, enabled=can.setup)
        self._boards.show(status, board)
        self._show_perspectives(status)
        if self._begun and status is self._status:
            return
        self._begun = True
        if status is not None and (name := take_name(self._name.value, self._status, status)) != self._name.value:
            self._name.value = name
        self._status = status
        self._headline.content = readout.status_html(status)
        percent = progress_percent(status)
        self._progress.visible = percent is not None
        self._progress.value = percent or 0.0
        self._start.disabled, self._stop.disabled = not can.start, not can.stop
        self._recalibrate.disabled = not can.recalibrate
        self._record.disabled, self._record_stop.disabled = not can.record, not can.record_stop
        self._name.disabled = not can.record
        self._recording.content = readout.recording_html(status.recording if status else None)
        self._notices.content = readout.notices_html(status)
        places = {place.sensor: place for place in scene.sensors} if scene else {}
        self._sensors.content = readout.sensors_html(status, self._colours, places)
        people = scene.people if scene and status else ()
        self._people.show(people, enabled=can.name, visible=makes_people(status))

    def _button(self, label: str, verb: str, icon: Any, colour: Any) -> viser.GuiButtonHandle:
        button = self._client.gui.add_button(label, disabled=True, icon=icon, color=colour)

        @button.on_click
        async def _(_: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            arguments = {"name": self._name.value.strip()} if verb == "record" else {}
            self._commander.send(verb, arguments, self._client)

        return button

    def _add_camera_folder(self, gui: viser.GuiApi) -> None:
        with gui.add_folder("View"):
            self._perspective = gui.add_dropdown(
                "Perspective", (FREE,), hint="Whose eyes place the people; free: the tracker's own world"
            )
            self._aims = gui.add_button_group("Look at", tuple(Aim))
            self._trails = gui.add_dropdown("Trails", tuple(TrailOf), hint="Lines along which people have moved")
            self._trail_seconds = gui.add_slider(
                "Trail length, s", SHORTEST_TRAIL_S, LONGEST_S, 1, TrailChoice().seconds, hint="How many seconds back"
            )
            self._fields = gui.add_checkbox("Fields of view", False, hint="What each sensor can see, 4.5 m far")

        @self._perspective.on_update
        async def _(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                self._chosen = self._perspective.value
                self._aim(Aim.BOTH if self._chosen == FREE else Aim.EYES)

        @self._aims.on_click
        async def _(_: viser.GuiEvent[Any]) -> None:
            aim = Aim(self._aims.value)
            if aim is Aim.EYES and self.perspective == FREE:
                sensor = default_perspective(self._status, self._colours.sensors)
                if sensor == FREE:
                    notify(self._client, "Sensor's eyes", "There is no sensor yet; start a node first.", ok=False)
                    return
                self._chosen = sensor
            self._aim(aim)

    def _add_recording_folder(self, gui: viser.GuiApi) -> None:
        with gui.add_folder("Recording"):
            self._name = gui.add_text("Take", FIRST_TAKE, hint="The take's name; nothing is ever overwritten")
            self._record = self._button("Record", "record", viser.Icon.PLAYER_RECORD, "red")
            self._record_stop = self._button("Stop recording", "record-stop", viser.Icon.PLAYER_STOP, "gray")
            self._recording = gui.add_html(readout.recording_html(None))

    def _show_perspectives(self, status: SessionStatus | None) -> None:
        options = perspectives(status, self._colours.sensors)
        if options != self._perspective.options:
            self._perspective.options, self._shown_perspective = options, ""
        now = self.perspective
        # Only when it has changed: what was chosen in the browser just now is not here yet, and must not be undone.
        if now in options and now != self._shown_perspective:
            self._perspective.value = self._shown_perspective = now

    def _send_name(self, arguments: dict[str, Any]) -> None:
        self._commander.send("name", arguments, self._client)

    def _send_setup(self, arguments: dict[str, Any]) -> None:
        self._commander.send("setup", arguments, self._client)

    def _send_board(self, verb: str, arguments: dict[str, Any]) -> None:
        self._commander.send(verb, arguments, self._client)

    def _tell(self, title: str, message: str, ok: bool) -> None:
        notify(self._client, title, message, ok=ok)

    def _refuse(self, message: str) -> None:
        self._say_no("Setup: not sent", message)

    def _say_no(self, title: str, message: str) -> None:
        self._tell(title, message, ok=False)
