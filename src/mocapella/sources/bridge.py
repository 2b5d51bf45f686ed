"""A TCP server for sensor programs without zenoh: C, C++, C# and any language with protobuf and sockets.

A program connects and writes length-delimited `BodyFrame` messages (`docs/wire.md`). Every message is validated. The
first invalid one ends the connection, with one line of text sent back that states the reason; other connections are not
affected. A program that asks for acknowledgements (`mocapella.sources.bridge_messages`) learns which frames it need not
keep.
"""

from __future__ import annotations

import contextlib
import logging
import selectors
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

from mocapella.errors import MocapellaError, WireError
from mocapella.model.observations import BodyFrame
from mocapella.model.sensor_frame import SensorFrame
from mocapella.schema import MAX_MESSAGE_BYTES
from mocapella.schema.delimited import DelimitedReader
from mocapella.settings import check
from mocapella.sources.bound_socket import bound_socket
from mocapella.sources.bridge_messages import BridgeEnd, BridgeStart, Relay, read_message
from mocapella.supervision import Boundary, printable

OnFrame = Callable[[str, BodyFrame, bytes], None]
"""Called with the sensor's name, the frame, and the message's bytes."""
OnGone = Callable[[str], None]
"""Called with the name of each sensor of a connection that ended."""

_PIECE = 64 * 1024
"""Bytes read at a time, so that a fast writer does not block the others."""
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class BridgeSettings:
    """Address and limits of the bridge.

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    host: str = "127.0.0.1"
    """Name or address of this machine to listen at; the default accepts only programs on this machine."""
    port: int = 7450
    """TCP port; 0 takes any free one."""
    max_connections: int = 32
    """Largest number of connections at a time; further ones are refused."""
    max_sensors: int = 16
    """Largest number of sensors per connection. Each becomes a node of its own, and opening one delays the others."""
    max_message_bytes: int = MAX_MESSAGE_BYTES
    """Largest message; a larger one ends the connection."""
    message_timeout: float = 5.0
    """Longest time from a message's first byte to its last [s]."""
    idle_timeout: float = 60.0
    """Longest time between messages before a connection is closed [s]."""

    def __post_init__(self) -> None:
        check(0 <= self.port <= 65535, "port", self.port, "from 0 to 65535")
        check(self.max_connections >= 1, "max_connections", self.max_connections, "1 or more")
        check(self.max_sensors >= 1, "max_sensors", self.max_sensors, "1 or more")
        most = MAX_MESSAGE_BYTES
        check(1 <= self.max_message_bytes <= most, "max_message_bytes", self.max_message_bytes, f"from 1 to {most}")
        check(self.message_timeout > 0, "message_timeout", self.message_timeout, "above 0 s")
        check(self.idle_timeout > 0, "idle_timeout", self.idle_timeout, "above 0 s")


@dataclass(frozen=True)
class BridgeReport:
    """Counts of frames and connections.

    Attributes:
        frames: number of frames passed on.
        refused: number of connections that were refused, or ended because of an invalid message.
        timed_out: number of connections that were ended because they were too slow or silent.
        connections: number of connections that are open now.
        last_problem: reason for the last refusal or timeout; empty if none.
        errors: number of unexpected errors.
    """

    frames: int = 0
    refused: int = 0
    timed_out: int = 0
    connections: int = 0
    last_problem: str = ""
    errors: int = 0


@dataclass(eq=False)
class _Connection:
    """One connected program."""

    socket: socket.socket
    peer: str
    reader: DelimitedReader
    last_message_s: float
    begun_s: float | None = None
    """When the incomplete message began to arrive."""
    newest: dict[str, BodyFrame] = field(default_factory=dict)
    """The last frame of each of this connection's sensors."""
    relayed: BridgeStart | None = None
    """The sensor whose frames are acknowledged, if the program has asked for it."""
    ending: bool = False
    """Whether the program has said that it sends no further frame."""
    left: bool = False
    """Whether the program was told that its sensor has left."""
    told: int = -1
    """The last acknowledgement that was written."""
    unsent: bytes = b""
    """Rest of a line that the program has not read yet."""


class Bridge:
    """TCP server that runs from `start` to `stop` in its own thread. A context manager that starts and stops it.

    All callbacks are called by that thread, one at a time. A sensor belongs to the first connection that sends its
    frames, until that one ends; another connection that sends them is ended.

    Args:
        on_frame: receives each valid frame. It may refuse a frame by raising a `MocapellaError`, such as
            `NameTakenError`, which ends the connection with the error's message. An unexpected error ends the
            connection, too, and is given to ``say``.
        settings: address and limits.
        on_gone: called for each sensor of a connection that ended.
        say: receives unexpected errors.
        relay: serves the sensors of programs that ask for acknowledgements; None refuses such programs.
    """

    def __init__(
        self,
        on_frame: OnFrame,
        settings: BridgeSettings | None = None,
        on_gone: OnGone | None = None,
        say: Callable[[str], None] = lambda text: None,
        relay: Relay | None = None,
    ) -> None:
        self._settings = settings or BridgeSettings()
        self._on_frame, self._on_gone, self._relay = on_frame, on_gone, relay
        self._connections: set[_Connection] = set()
        self._owners: dict[str, _Connection] = {}
        self._report = BridgeReport()
        self._errors = Boundary(say)
        self._listener: socket.socket | None = None
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def address(self) -> tuple[str, int]:
        """Host and port of the listening socket; before `start`, as in the settings."""
        if self._listener is None:
            return self._settings.host, self._settings.port
        host, port = self._listener.getsockname()[:2]
        return host, port

    @property
    def report(self) -> BridgeReport:
        """Counts of frames, connections and errors so far."""
        return replace(self._report, errors=sum(self._errors.counts.values()))

    def start(self) -> None:
        """Begin to listen; possible again after `stop`. The counts go on.

        Raises:
            AddressInUseError: another program listens there.
            BusError: the address does not belong to this machine, or may not be used.
        """
        self._listener = bound_socket(self._settings.host, self._settings.port, socket.SOCK_STREAM)
        self._stopping.clear()
        self._thread = threading.Thread(target=self._run, args=(self._listener,), name="bridge", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Close every connection and wait for the thread; may be called twice."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def __enter__(self) -> Bridge:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _run(self, listener: socket.socket) -> None:
        with selectors.DefaultSelector() as selector, listener:
            selector.register(listener, selectors.EVENT_READ)
            try:
                while not self._stopping.is_set():
                    for key, _ in selector.select(timeout=0.1):
                        if key.data is None:
                            self._errors.run("connection", partial(self._accept, listener, selector))
                        elif self._errors.run("message", partial(self._read, key.data, selector)):
                            problem = "an unexpected error of the bridge"
                            self._errors.run("refusal", partial(self._refuse, key.data, selector, problem))
                    self._errors.run("timeout", partial(self._end_the_slow, selector))
                    for connection in [one for one in self._connections if one.relayed is not None]:
                        self._errors.run("acknowledgement", partial(self._acknowledge, connection, selector))
            finally:
                for connection in list(self._connections):
                    self._close(connection, selector)
                self._listener = None

    def _accept(self, listener: socket.socket, selector: selectors.BaseSelector) -> None:
        try:
            accepted, address = listener.accept()
        except OSError as error:  # closed before it was accepted, or no file handle left
            _LOG.warning("bridge: a connection could not be accepted: %s", error)
            return
        accepted.setblocking(False)
        reader = DelimitedReader(self._settings.max_message_bytes)
        connection = _Connection(accepted, f"{address[0]}:{address[1]}", reader, time.monotonic())
        self._connections.add(connection)
        selector.register(accepted, selectors.EVENT_READ, connection)
        self._count(connections=len(self._connections))
        if len(self._connections) > self._settings.max_connections:
            self._refuse(connection, selector, f"there are {self._settings.max_connections} connections already")

    def _read(self, connection: _Connection, selector: selectors.BaseSelector) -> None:
        try:
            piece = connection.socket.recv(_PIECE)
        except BlockingIOError:
            return
        except OSError as error:
            _LOG.info("bridge: %s: %s", connection.peer, error)
            piece = b""
        if not piece:
            self._close(connection, selector)
            return
        try:
            for message in connection.reader.feed(piece):
                self._take(connection, message)
        except MocapellaError as error:
            self._refuse(connection, selector, str(error))
            return
        if connection.reader.pending == 0:
            connection.begun_s = None
        elif connection.begun_s is None:
            connection.begun_s = time.monotonic()

    def _take(self, connection: _Connection, message: bytes) -> None:
        received = read_message(message)
        if connection.relayed is not None or not isinstance(received, SensorFrame):
            self._take_relayed(connection, received)
            connection.last_message_s, connection.begun_s = time.monotonic(), None
            return
        frame: BodyFrame = received  # type: ignore[assignment]  # the fields of every type are enough
        owner = self._owners.get(frame.sensor, connection)
        if owner is not connection:
            raise WireError(f"sensor {frame.sensor} is served by {owner.peer} already; choose another name")
        if frame.sensor not in connection.newest and len(connection.newest) == self._settings.max_sensors:
            raise WireError(f"a connection serves at most {self._settings.max_sensors} sensors; open one for each")
        _check_order(frame, connection.newest.get(frame.sensor))
        self._owners[frame.sensor] = connection
        connection.newest[frame.sensor] = frame
        self._on_frame(frame.sensor, frame, message)
        connection.last_message_s, connection.begun_s = time.monotonic(), None
        self._count(frames=self._report.frames + 1)

    def _take_relayed(self, connection: _Connection, received: object) -> None:
        """Take a message of a connection with acknowledgements."""
        if self._relay is None:
            raise WireError("this bridge acknowledges no frames")
        if isinstance(received, BridgeStart):
            self._begin_relay(connection, self._relay, received)
        elif connection.relayed is None:
            raise WireError("the first message about acknowledgements is start, before any frame")
        elif isinstance(received, BridgeEnd):
            connection.ending = True
            self._relay.end(connection.relayed.sensor)
        elif isinstance(received, SensorFrame):
            _check_relayed(received, connection)
            self._relay.frame(received)  # type: ignore[arg-type]  # as above
            self._count(frames=self._report.frames + 1)
        else:
            connection.told = -1  # it is there, and wants to hear that the bridge is, too

    def _begin_relay(self, connection: _Connection, relay: Relay, start: BridgeStart) -> None:
        owner = self._owners.get(start.sensor)
        if owner is not None:
            raise WireError(f"sensor {start.sensor} is served by {owner.peer} already; choose another name")
        if connection.newest or connection.relayed is not None:
            raise WireError("start comes once in a connection, before any frame")
        window = relay.start(start)
        connection.relayed = start
        self._owners[start.sensor] = connection
        connection.unsent += f"window {window}\n".encode()

    def _acknowledge(self, connection: _Connection, selector: selectors.BaseSelector) -> None:
        """Write how far the frames of a connection are acknowledged, or that its sensor has left."""
        assert connection.relayed is not None
        assert self._relay is not None
        sensor = connection.relayed.sensor
        try:
            problem = self._relay.ended(sensor)
            number = self._relay.acknowledged(sensor)
        except MocapellaError as error:
            self._refuse(connection, selector, str(error))
            return
        if connection.ending and problem:
            self._refuse(connection, selector, problem)
            return
        if number > connection.told and not connection.unsent:
            connection.unsent, connection.told = f"kept {number}\n".encode(), number
        if connection.ending and problem == "" and not connection.left:
            connection.unsent, connection.left = connection.unsent + b"ended\n", True
        with contextlib.suppress(OSError):  # it reads nothing now, or is gone, which the next read notices
            connection.unsent = connection.unsent[connection.socket.send(connection.unsent) :]

    def _end_the_slow(self, selector: selectors.BaseSelector) -> None:
        now, limits = time.monotonic(), self._settings
        for connection in list(self._connections):
            if connection.begun_s is not None and now - connection.begun_s > limits.message_timeout:
                problem = f"a message was not complete after {limits.message_timeout:g} s"
            elif now - connection.last_message_s > limits.idle_timeout:
                problem = f"no message for {limits.idle_timeout:g} s"
            else:
                continue
            self._count(timed_out=self._report.timed_out + 1)
            self._end(connection, selector, problem)

    def _refuse(self, connection: _Connection, selector: selectors.BaseSelector, problem: str) -> None:
        self._count(refused=self._report.refused + 1)
        self._end(connection, selector, problem)

    def _end(self, connection: _Connection, selector: selectors.BaseSelector, problem: str) -> None:
        """Log the problem, send it to the program if possible, and close."""
        problem = printable(problem)
        _LOG.warning("bridge: %s: %s", connection.peer, problem)
        self._count(last_problem=f"{connection.peer}: {problem}")
        with contextlib.suppress(OSError):
            connection.socket.send(f"{problem}\n".encode())
        self._close(connection, selector)

    def _close(self, connection: _Connection, selector: selectors.BaseSelector) -> None:
        selector.unregister(connection.socket)
        connection.socket.close()
        self._connections.discard(connection)
        self._count(connections=len(self._connections))
        if connection.relayed is not None and self._relay is not None:
            del self._owners[connection.relayed.sensor]
            self._relay.gone(connection.relayed.sensor)
        for sensor in connection.newest:
            del self._owners[sensor]
            if self._on_gone is not None:
                self._on_gone(sensor)

    def _count(self, **changed: int | str) -> None:
        self._report = replace(self._report, **changed)  # type: ignore[arg-type]  # counts are int, the problem is str


def _check_relayed(frame: SensorFrame, connection: _Connection) -> None:
    """Refuse a frame of another sensor or run than the connection's, or after its end.

    Raises:
        WireError: names the field, or the end.
    """
    assert connection.relayed is not None
    start = connection.relayed
    if connection.ending:
        raise WireError("a frame came after the message end")
    if (frame.sensor, frame.node_id) != (start.sensor, start.node_id):
        raise WireError(
            f"a frame of {frame.sensor}/{frame.node_id:016x} came after the start of "
            f"{start.sensor}/{start.node_id:016x}; open a connection for each"
        )


def _check_order(frame: BodyFrame, last: BodyFrame | None) -> None:
    """Refuse a frame that the server would silently drop as a repetition.

    Raises:
        WireError: the node id is 0; or it is the last frame's, and sequence number or time does not rise.
    """
    if frame.node_id == 0:
        raise WireError("BodyFrame.node_id is 0; take a random number at each start of the program")
    if last is None or frame.node_id != last.node_id:
        return
    if frame.sequence <= last.sequence:
        raise WireError(f"BodyFrame.sequence is {frame.sequence} after {last.sequence}; count the frames 0, 1, 2, …")
    if frame.time_ns <= last.time_ns:
        raise WireError(f"BodyFrame.time_ns is {frame.time_ns} after {last.time_ns}; it rises from frame to frame")
