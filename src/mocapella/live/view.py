"""The view's process: the newest of everything from the bus to the screen, thirty times a second.

It is a process of its own, so that no browser and no drawing can ever slow the tracker.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any, Generic, TypeVar

from mocapella.errors import NoServerError
from mocapella.model.observations import BodyFrame
from mocapella.model.scene import Scene
from mocapella.model.session import CommandReply, SessionStatus
from mocapella.tracker import METHODS
from mocapella.viewer import Viewer
from mocapella.wire.reader import Newest, send_command
from mocapella.wire.session import open_reader

RATE_HZ = 30.0
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


class Picture:
    """What is shown now: the newest scene, status, and frame of each sensor."""

    def __init__(self) -> None:
        self._scene: Held[Scene] = Held()
        self._status: Held[SessionStatus] = Held()
        self._frames: dict[str, Held[BodyFrame]] = {}

    def update(
        self, scene: Scene | None, frames: dict[str, BodyFrame], status: SessionStatus | None, now_s: float
    ) -> tuple[Scene | None, dict[str, BodyFrame], SessionStatus | None]:
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


def run_view(
    connect: str, host: str, port: int, stop: threading.Event, on_ready: Callable[[str], None] = lambda url: None
) -> None:
    """Show the session at ``connect`` on ``http://host:port`` until ``stop`` is set.

    Raises:
        NoServerError: nobody answers at ``connect``.
        AddressInUseError: the port is in use.
    """
    session = open_reader(connect, timeout=10.0)

    def command(verb: str, arguments: dict[str, Any]) -> CommandReply:
        try:
            return send_command(session, verb, arguments, timeout=150.0 if verb == "record-stop" else 10.0)
        except NoServerError as error:
            return CommandReply(False, str(error))

    newest, picture = Newest(session), Picture()
    try:
        viewer = Viewer(host, port, command=command, methods=tuple(METHODS))
        try:
            on_ready(viewer.url)
            for now_s in beats(RATE_HZ, stop):
                viewer.show(*picture.update(newest.scene(), newest.frames(), newest.status(), now_s))
        finally:
            viewer.close()
    finally:
        session.close()  # type: ignore[no-untyped-call]
