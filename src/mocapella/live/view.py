"""The view's process: the newest of everything from the bus to the screen, thirty times a second.

It is a process of its own, so that no browser and no drawing can ever slow the tracker.
"""

from __future__ import annotations

import threading
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Generic, TypeVar

import msgspec
import zenoh

from mocapella.errors import NoServerError
from mocapella.live.board_service import BoardService
from mocapella.model.scene import Scene
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.session import CommandReply, SessionStatus
from mocapella.tracker import METHODS, warm_up
from mocapella.viewer import Viewer
from mocapella.wire.questions import NodeAnswer, Question, ask_node
from mocapella.wire.reader import Newest, send_command
from mocapella.wire.session import check_address, open_reader

RATE_HZ = 30.0
CLOTH = "mocapella.sources.simulate.cloth:ClothBeforeHand"
ATTEMPT_S = 0.5
"""How long one attempt to reach the server takes at most: Ctrl-C waits for its end."""
STALE_AFTER_S = 2.0
"""What is older than this is not shown as if it were now."""

T = TypeVar("T")


class Held(Generic[T]):
    """A value that stays until a newer one comes, or until it is stale."""

    def __init__(self) -> None:
        self._value: T | None = None
        self._since_s = 0.0

    def update(self, fresh: T | None, now_s: float) -> T | None:
        """The fresh value, or else the held one while it is not stale."""
        if fresh is not None:
            self._value, self._since_s = fresh, now_s
        elif now_s - self._since_s > STALE_AFTER_S:
            self._value = None
        return self._value


class ViewState:
    """What is shown now: the newest scene, status, and frame of each sensor."""

    def __init__(self) -> None:
        self._scene: Held[Scene] = Held()
        self._status: Held[SessionStatus] = Held()
        self._frames: dict[str, Held[SensorFrame]] = {}

    def update(
        self, scene: Scene | None, frames: dict[str, SensorFrame], status: SessionStatus | None, now_s: float
    ) -> tuple[Scene | None, dict[str, SensorFrame], SessionStatus | None]:
        """Take in what is new; returns what is to be drawn."""
        for sensor in frames:
            self._frames.setdefault(sensor, Held())
        held = {sensor: slot.update(frames.get(sensor), now_s) for sensor, slot in self._frames.items()}
        drawn = {sensor: frame for sensor, frame in held.items() if frame is not None}
        shown = self._status.update(status, now_s)
        stopped = shown is not None and not shown.running
        newest = self._scene.update(scene, now_s)
        return None if stopped else newest, drawn, shown


def beats(rate_hz: float, stop: threading.Event) -> Iterator[float]:
    """Instants [s] at a steady rate until ``stop`` is set; after a delay it goes on, and does not catch up."""
    due_s = time.monotonic()
    while not stop.is_set():
        yield time.monotonic()
        due_s = max(due_s + 1 / rate_hz, time.monotonic() - 1 / rate_hz)
        stop.wait(max(0.0, due_s - time.monotonic()))


class Link:
    """The way to the server, which is tried on a thread of its own until it is there; afterwards the bus keeps it.

    Args:
        connect: the server's address.
        on_waiting: is called once, on that thread, where nobody answers at first.

    Raises:
        BusError: an address that cannot be used.
    """

    def __init__(self, connect: str, on_waiting: Callable[[str], None]) -> None:
        self._connect, self._on_waiting = check_address(connect), on_waiting
        self._closed = threading.Event()
        self._session: zenoh.Session | None = None
        self._newest: Newest | None = None
        self._thread = threading.Thread(target=self._reach, name="reach server")
        self._thread.start()

    def newest(self) -> tuple[Scene | None, dict[str, SensorFrame], SessionStatus | None]:
        """What has come since the last call; nothing while no server was reached."""
        newest = self._newest
        return (None, {}, None) if newest is None else (newest.scene(), newest.frames(), newest.status())

    def command(self, verb: str, arguments: dict[str, Any]) -> CommandReply:
        """Send a command; the reply says where nobody answers."""
        if self._session is None:
            return CommandReply(False, f"no server at {self._connect}; start one with: mocapella serve")
        try:
            return send_command(self._session, verb, arguments, timeout=150.0 if verb == "record-stop" else 10.0)
        except NoServerError as error:
            return CommandReply(False, str(error))

    def ask(self, camera: str, question: dict[str, Any], timeout_s: float) -> NodeAnswer:
        """Ask a camera's node, and wait for its answer.

        Raises:
            BusError: nobody answers.
            WireError: what comes is no answer.
        """
        if self._session is None:
            raise NoServerError(f"no server at {self._connect}; start one with: mocapella serve")
        return ask_node(self._session, camera, msgspec.convert(question, Question), timeout_s)

    def close(self) -> None:
        """Leave the bus, or give up trying."""
        self._closed.set()
        self._thread.join()
        if self._session is not None:
            self._session.close()  # type: ignore[no-untyped-call]

    def _reach(self) -> None:
        told = False
        while self._session is None and not self._closed.is_set():
            try:
                self._session = open_reader(self._connect, timeout=ATTEMPT_S)
            except NoServerError:
                if not told:
                    self._on_waiting(self._connect)
                told = True
        if self._session is not None:
            self._newest = Newest(self._session)


def run_view(
    connect: str,
    host: str,
    port: int,
    stop: threading.Event,
    *,
    cloth: bool = False,
    on_ready: Callable[[str], None] = lambda url: None,
    on_waiting: Callable[[str], None] = lambda address: None,
) -> None:
    """Show the session at ``connect`` on ``http://host:port`` until ``stop`` is set, whenever a server is there.

    ``cloth``: one hangs before the first hand that is tracked.
    ``on_ready`` is called with the page's URL, ``on_waiting`` with the address where no server answers yet.

    Raises:
        AddressInUseError: the port is in use.
        BusError: an address that cannot be used.
    """
    # What is shown to a browser in the instant in which it leaves is nobody's concern; viser would warn of it.
    warnings.filterwarnings("ignore", "Queued a .* on a closed connection", UserWarning)
    link = Link(connect, on_waiting)
    boards = BoardService(link.ask, link.command, Path.cwd(), warm_up=warm_up)
    try:
        stages = {name: method.stages for name, method in METHODS.items()}
        props = {"cloth": CLOTH} if cloth else {}
        viewer = Viewer(host, port, command=boards.command, methods=stages, props=props, ask=link.ask)
        try:
            on_ready(viewer.url)
            picture = ViewState()
            for now_s in beats(RATE_HZ, stop):
                scene, frames, status = picture.update(*link.newest(), now_s)
                boards.learn(status)
                viewer.show(scene, frames, status, boards.progress)
        finally:
            viewer.close()
    finally:
        boards.close()
        link.close()
