"""The live view: a web page with both stages and all controls, for any number of browsers."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

from mocapella.errors import BusError
from mocapella.model.board_progress import BoardProgress
from mocapella.model.scene import Scene
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.session import SessionStatus, Setup
from mocapella.viewer.arms import ArmsShown
from mocapella.viewer.browser import Browser, Known
from mocapella.viewer.camera_feed import Ask, CameraAnswer, CameraFeed
from mocapella.viewer.commands import Commander, SendCommand
from mocapella.viewer.page import open_page, tolerated, unprinted
from mocapella.viewer.panel import WIDTH_PX
from mocapella.viewer.stages import SensorsStage, TrackingDrawing, tracking_drawing


class Viewer:
    """Serves the view on one address. Its methods belong to one loop; commands run on a thread of their own.

    Args:
        host: the interface to serve on, and no other.
        port: its port; 0 takes a free one.
        command: carries out a verb with its arguments; may block.
        methods: what the Setup form offers as the tracker's methods.
        ask: asks a camera's node; may block. Without it no picture of a camera is shown.

    Raises:
        AddressInUseError: somebody else listens there.
        SettingsError: an address that this machine cannot listen at.
    """

    def __init__(
        self,
        host: str,
        port: int,
        *,
        command: SendCommand,
        methods: Sequence[str] = (Setup.method,),
        ask: Ask | None = None,
    ) -> None:
        self._server = open_page(host, port, WIDTH_PX)
        self._methods = tuple(methods)
        self._commander = Commander(command)
        self._feed = CameraFeed(ask or _nobody)
        self._asks = ask is not None
        self._known = Known()
        self._browsers: dict[int, Browser] = {}
        self._sensors = SensorsStage(self._server.scene, self._known.colours, self._known.fields)

    @property
    def url(self) -> str:
        """Where a browser finds the view."""
        return self._server.url

    def show(
        self,
        scene: Scene | None,
        frames: Mapping[str, SensorFrame],
        status: SessionStatus | None,
        board: BoardProgress | None = None,
        arms: ArmsShown | None = None,
    ) -> None:
        """Show the newest of everything in every browser; next to nothing is done while there is none.

        Call it steadily, at up to 30 Hz, also when nothing is new: that is when browsers that came are served.

        Args:
            scene: the tracker's newest result, None before the first.
            frames: each sensor's newest frame, by its name.
            status: the session's newest, None while no server answers.
            board: how a calibration of cameras goes; None where the commands of one (``calibrate`` …) are unknown.
            arms: what belongs to the scene's arms; None where there are none.
        """
        self._welcome()
        self._known.learn(scene, frames, status)
        if not self._browsers:
            return

        @cache
        def draw(perspective: str) -> TrackingDrawing:
            return tracking_drawing(scene, perspective, self._known.seen, self._known.floors, arms)

        rows = status.sensors if status is not None and self._asks else ()
        self._feed.beat([row.name for row in rows if row.pictures and row.connected], time.monotonic())
        with tolerated(), self._server.atomic():
            self._sensors.draw(frames, self._known.floors)
        for browser in self._browsers.values():
            with tolerated():
                browser.show(draw, scene, status, board, arms)

    def close(self) -> None:
        """Serve no more."""
        self._commander.close()
        self._feed.close()
        with unprinted():
            self._server.stop()

    def _welcome(self) -> None:
        clients = self._server.get_clients()
        self._browsers = {number: browser for number, browser in self._browsers.items() if number in clients}
        for number, client in clients.items():
            if number not in self._browsers:
                self._browsers[number] = Browser(client, self._commander, self._methods, self._known, self._feed)


def _nobody(camera: str, question: dict[str, Any], timeout_s: float) -> CameraAnswer:
    raise BusError(f"{camera}: this view has no way to ask cameras")
