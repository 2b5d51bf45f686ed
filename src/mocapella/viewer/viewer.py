"""The live view: a web page with both stages and all controls, for any number of browsers."""

from __future__ import annotations

import contextlib
import errno
import io
import socket
import time
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
import viser

from mocapella.errors import AddressInUseError, BusError, SettingsError
from mocapella.model.board_progress import BoardProgress
from mocapella.model.observations import Frame
from mocapella.model.scene import Scene
from mocapella.model.session import SessionStatus, Setup
from mocapella.viewer.arms import ArmsShown
from mocapella.viewer.browser import Browser, Known
from mocapella.viewer.camera_feed import Ask, CameraAnswer, CameraFeed
from mocapella.viewer.commands import Command, Commander
from mocapella.viewer.panel import WIDTH_PX
from mocapella.viewer.stages import SensorsStage, TrackingDrawing, tracking_drawing

_TOP, _BOTTOM = np.array([30.0, 41.0, 60.0]), np.array([9.0, 12.0, 19.0])
"""The ground's colours, from the top of the picture to its bottom."""


@contextlib.contextmanager
def _unprinted() -> Iterator[None]:
    """viser prints a banner and a farewell; standard output is for results."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield


@contextlib.contextmanager
def _tolerated() -> Iterator[None]:
    """viser 1.1 sets an `asyncio.Event` from this thread; that fails where its own waits for it in that instant.

    The message is queued by then, and the next call draws what this one did not come to.
    """
    try:
        yield
    except RuntimeError as error:
        if str(error) != "deque mutated during iteration":
            raise


class _Server(viser.ViserServer):
    def request_share_url(self, verbose: bool = True) -> str | None:
        """No: what a sensor sees of people does not leave through a public tunnel because of a message from a page."""
        return None


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
        command: Command,
        methods: Sequence[str] = (Setup.method,),
        ask: Ask | None = None,
    ) -> None:
        _check_free(host, port)
        with _unprinted():
            self._server = _Server(host=host, port=port, label="Mocapella", verbose=False)
        if port not in (0, self._server.get_port()):
            self._server.stop()
            raise _in_use(host, port)
        self._methods = tuple(methods)
        self._commander = Commander(command)
        self._feed = CameraFeed(ask or _nobody)
        self._asks = ask is not None
        self._known = Known()
        self._browsers: dict[int, Browser] = {}
        self._dress()
        self._sensors = SensorsStage(self._server.scene, self._known.colours, self._known.fields)

    @property
    def url(self) -> str:
        """Where a browser finds the view."""
        host = self._server.get_host()
        return f"http://{f'[{host}]' if ':' in host else host}:{self._server.get_port()}"

    def show(
        self,
        scene: Scene | None,
        frames: Mapping[str, Frame],
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
        self._feed.beat([row.name for row in rows if row.markers and row.connected], time.monotonic())
        with _tolerated(), self._server.atomic():
            self._sensors.draw(frames, self._known.floors)
        for browser in self._browsers.values():
            with _tolerated():
                browser.show(draw, scene, status, board, arms)

    def close(self) -> None:
        """Serve no more."""
        self._commander.close()
        self._feed.close()
        with _unprinted():
            self._server.stop()

    def _welcome(self) -> None:
        clients = self._server.get_clients()
        self._browsers = {number: browser for number, browser in self._browsers.items() if number in clients}
        for number, client in clients.items():
            if number not in self._browsers:
                self._browsers[number] = Browser(client, self._commander, self._methods, self._known, self._feed)

    def _dress(self) -> None:
        gui, scene = self._server.gui, self._server.scene
        gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False, brand_color=(56, 132, 255))
        gui.main_panel.dock_right()
        gui.main_panel.set_width(WIDTH_PX)
        scene.set_up_direction("+y")
        scene.configure_environment_map("studio", environment_intensity=0.3)
        shade = np.linspace(_TOP, _BOTTOM, 256)[:, None, :].repeat(8, axis=1)
        scene.set_background_image(shade.round().astype(np.uint8), format="png")


def _nobody(camera: str, question: dict[str, Any], timeout_s: float) -> CameraAnswer:
    raise BusError(f"{camera}: this view has no way to ask cameras")


def _check_free(host: str, port: int) -> None:
    """Before the web server tries: it would silently take the next port instead."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
            probe.listen()
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise _in_use(host, port) from error
        raise SettingsError(
            f"the view cannot listen at {host}:{port} ({error.strerror or error}); take 127.0.0.1 and a port over 1023"
        ) from error


def _in_use(host: str, port: int) -> AddressInUseError:
    return AddressInUseError(
        f"the view's port {port} on {host} is in use; stop what listens there, or take another port"
    )
