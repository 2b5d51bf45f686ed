"""The view's process: shows the newest scene, frames and status from the bus, up to thirty times a second.

It is a separate process, so that no browser and no drawing slows the tracker.
"""

from __future__ import annotations

import threading
import time
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

import zenoh

from mocapella.conventions import NS_PER_S
from mocapella.decoding import convert
from mocapella.errors import MocapellaError, NoServerError, NotAdmittedError
from mocapella.live.board_service import BoardService
from mocapella.live.live_check import LiveChecker
from mocapella.model.pace import Pace
from mocapella.model.scene import Scene
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.session import CommandReply, SessionStatus
from mocapella.sources.simulate.scenery import scenery_of
from mocapella.supervision import Boundary
from mocapella.tracker import METHODS, warm_up
from mocapella.viewer import Viewer
from mocapella.viewer.stages import Prop
from mocapella.wire.door import find_door
from mocapella.wire.questions import NodeAnswer, Question, ask_node
from mocapella.wire.reader import Newest, send_command
from mocapella.wire.roles import READERS
from mocapella.wire.session import open_reader

RATE_HZ = 30.0
READY_HZ = 2.0
"""Rate of drawing while the server gets ready, to leave the processor to the compilation [Hz].

It is not lower, or a busy page would take the view for lost (`mocapella.viewer.watchdog`)."""
CLOTH = "mocapella.sources.simulate.cloth:ClothBeforeHand"
ATTEMPT_S, LONGEST_ATTEMPT_S = 0.5, 4.0
"""Longest durations of the first attempt to reach the server and of any; each has twice the time of the last [s].

Ctrl-C waits for the end of an attempt. A busy machine may take longer than the first for the handshake of TLS."""
STALE_AFTER_S = 2.0
"""Age above which a scene or a status is no longer shown [s]; frames are hidden once their sensor is silent instead."""

T = TypeVar("T")


class Held(Generic[T]):
    """Holds the last received value for display until a newer one comes, or until it is too old to show (stale).

    Args:
        pace: measures the usual interval of the values; a value is stale once `Pace.silent` is true. If None, it is
            stale after `STALE_AFTER_S`.
    """

    def __init__(self, pace: Pace | None = None) -> None:
        self._pace = pace
        self._value: T | None = None
        self._since_s = 0.0

    def update(self, fresh: T | None, now_s: float) -> T | None:
        """Return the fresh value, or else the held one until it is stale, or else None.

        The age is the time since the call with the value, not since its capture.

        Args:
            fresh: the newest value; None if no new one has come.
            now_s: the present time on a monotonic clock [s].
        """
        if fresh is not None:
            self._value, self._since_s = fresh, now_s
            if self._pace is not None:
                self._pace.update(round(now_s * NS_PER_S))
        elif self._stale(now_s):
            self._value = None
        return self._value

    def _stale(self, now_s: float) -> bool:
        if self._pace is not None:
            return self._pace.silent(round(now_s * NS_PER_S))
        return now_s - self._since_s > STALE_AFTER_S


class ViewState:
    """Holds the newest scene, status, and frame of each sensor."""

    def __init__(self) -> None:
        self._scene: Held[Scene] = Held()
        self._status: Held[SessionStatus] = Held()
        self._frames: dict[str, Held[SensorFrame]] = {}
        self._getting_ready, self._updated_s = False, float("-inf")

    def due(self, now_s: float) -> bool:
        """Return whether to draw at ``now_s`` [s]: at every beat, but at `READY_HZ` while the server gets ready."""
        return not self._getting_ready or now_s - self._updated_s >= 1 / READY_HZ

    def update(
        self, scene: Scene | None, frames: dict[str, SensorFrame], status: SessionStatus | None, now_s: float
    ) -> tuple[Scene | None, dict[str, SensorFrame], SessionStatus | None]:
        """Add new values, if any; return those to draw.

        Args:
            scene: the newest scene; None if no new one has come.
            frames: new frames by sensor.
            status: the newest status; None if no new one has come.
            now_s: the present time on a monotonic clock [s].

        Returns:
            Scene, frames by sensor, and status, none of which is stale; no scene while the session is stopped.
        """
        for sensor in frames:
            self._frames.setdefault(sensor, Held(Pace()))
        held = {sensor: slot.update(frames.get(sensor), now_s) for sensor, slot in self._frames.items()}
        drawn = {sensor: frame for sensor, frame in held.items() if frame is not None}
        shown = self._status.update(status, now_s)
        self._getting_ready, self._updated_s = shown is not None and shown.getting_ready, now_s
        stopped = shown is not None and not shown.running
        newest = self._scene.update(scene, now_s)
        return None if stopped else newest, drawn, shown


def beats(rate_hz: float, stop: threading.Event) -> Iterator[float]:
    """Yield the monotonic time [s] at a steady rate until ``stop`` is set.

    After a delay, beats are skipped instead of caught up.

    Args:
        rate_hz: number of beats a second [Hz].
        stop: ends the iteration.
    """
    due_s = time.monotonic()
    while not stop.is_set():
        yield time.monotonic()
        due_s = max(due_s + 1 / rate_hz, time.monotonic() - 1 / rate_hz)
        stop.wait(max(0.0, due_s - time.monotonic()))


class Link:
    """Connection to the server. A thread tries until the server answers; afterwards, the bus reconnects by itself.

    Args:
        connect: the server's address.
        on_waiting: called once, on that thread, with the reason if no server admits this program at first.

    Raises:
        BusError: the address is invalid, or there is no key for it.
    """

    def __init__(self, connect: str, on_waiting: Callable[[str], None]) -> None:
        self._address = find_door(connect, READERS).locator  # what cannot be used is refused here
        self._connect, self._on_waiting = connect, on_waiting
        self._closed = threading.Event()
        self._session: zenoh.Session | None = None
        self._newest: Newest | None = None
        self._thread = threading.Thread(target=self._reach, name="reach server")
        self._thread.start()

    def newest(self) -> tuple[Scene | None, dict[str, SensorFrame], SessionStatus | None]:
        """Return the newest scene, frames by sensor, and status that have arrived since the last call.

        Scene and status are None, and the frames are empty, if nothing new has come or no server is reached yet.
        """
        newest = self._newest
        return (None, {}, None) if newest is None else (newest.scene(), newest.frames(), newest.status())

    def command(self, verb: str, arguments: dict[str, Any]) -> CommandReply:
        """Send a command and wait for the reply, at most 10 s (150 s for ``record-stop``).

        If no server answers, or its reply cannot be read, the result has ``ok`` False and the reason.
        """
        if self._session is None:
            return CommandReply(False, f"no server at {self._address}; start one with: mocapella serve")
        try:
            timeout = 150.0 if verb == "record-stop" else 10.0
            return send_command(self._session, verb, arguments, timeout, program="the view")
        except MocapellaError as error:
            return CommandReply(False, str(error))

    def ask(self, camera: str, question: dict[str, Any], timeout_s: float) -> NodeAnswer:
        """Query a camera's node, and return its answer.

        Args:
            camera: name of the camera.
            question: fields of a query of `mocapella.wire.questions`.
            timeout_s: longest wait for the answer [s].

        Raises:
            InputError: the question is not one of `mocapella.wire.questions`.
            BusError: no node answers, or no server is reached yet.
            WireError: the answer is invalid.
        """
        if self._session is None:
            raise NoServerError(f"no server at {self._address}; start one with: mocapella serve")
        return ask_node(self._session, camera, convert(question, Question, what="question"), timeout_s)

    def close(self) -> None:
        """Leave the bus, or give up trying."""
        self._closed.set()
        self._thread.join()
        if self._session is not None:
            self._session.close()  # type: ignore[no-untyped-call]

    def _reach(self) -> None:
        notified, attempt_s = False, ATTEMPT_S
        while self._session is None and not self._closed.is_set():
            try:
                self._session = open_reader(self._connect, timeout=attempt_s)
            except MocapellaError as error:
                if not notified:
                    nobody = f"no server at {self._address} yet: start one with `mocapella serve`"
                    absent = isinstance(error, NoServerError) and not isinstance(error, NotAdmittedError)
                    self._on_waiting(nobody if absent else str(error))
                notified, attempt_s = True, min(2 * attempt_s, LONGEST_ATTEMPT_S)
                self._closed.wait(ATTEMPT_S)
        if self._session is not None:
            self._newest = Newest(self._session)


def run_view(
    connect: str,
    host: str,
    port: int,
    stop: threading.Event,
    *,
    cloth: bool = False,
    scenery: str | None = None,
    on_ready: Callable[[str, str], None] = lambda url, watch_url: None,
    on_page: Callable[[], None] = lambda: None,
    on_study: Callable[[str, str], None] = lambda url, participant_url: None,
    on_waiting: Callable[[str], None] = lambda reason: None,
) -> None:
    """Show a server's session as a web page until ``stop`` is set.

    Args:
        connect: address of the server.
        host, port: address and TCP port at which the page is served.
        stop: ends the view.
        cloth: whether a simulated cloth hangs before the first tracked hand.
        scenery: name of a simulated scene whose obstacles are drawn; None for none.
        on_ready: called with the page's URLs for operators and for watchers.
        on_page: called once, when the first browser draws the view.
        on_study: called once, when the session runs a study, with the URLs of the researcher's page and of the
            participant's screen.
        on_waiting: called once with the reason if no server admits this program at first.

    Raises:
        AddressInUseError: the port is in use.
        BusError: an address is invalid, or there is no key for it.
    """
    # viser warns if a message is queued for a browser that is just disconnecting.
    warnings.filterwarnings("ignore", "Queued a .* on a closed connection", UserWarning)
    link = Link(connect, on_waiting)
    boards = BoardService(link.ask, link.command, Path.cwd(), warm_up=warm_up)
    try:
        stages = {name: method.stages for name, method in METHODS.items()}
        props: dict[str, Prop] = {"cloth": CLOTH} if cloth else {}
        if scenery is not None:
            props["scenery"] = partial(scenery_of, scenery)
        viewer = Viewer(host, port, command=boards.command, methods=stages, props=props, ask=link.ask)
        try:
            on_ready(viewer.url, viewer.watch_url)
            picture = ViewState()
            errors = Boundary()  # the log has them, and a line in the terminal
            drawn = study_told = False
            checker = LiveChecker()

            def draw(now_s: float) -> None:
                if not picture.due(now_s):
                    return
                scene, frames, status = picture.update(*link.newest(), now_s)
                nonlocal study_told
                boards.update(status)
                if status is not None and status.study is not None and not study_told:
                    study_told = True
                    on_study(viewer.study_url("study"), viewer.study_url("participant"))
                check = checker.update(scene, status, now_s)
                viewer.show(scene, frames, status, boards.progress, check=check)

            for now_s in beats(RATE_HZ, stop):
                errors.run("drawing", partial(draw, now_s))
                if not drawn and viewer.pages:
                    drawn = True
                    on_page()
        finally:
            viewer.close()
    finally:
        boards.close()
        link.close()
