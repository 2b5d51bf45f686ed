"""Read results and send commands on the bus, as the view, `record`, and your programs do."""

from __future__ import annotations

import getpass
import json
import platform
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import zenoh

from mocapella.decoding import decode_json
from mocapella.errors import InputError, NoServerError, WireError
from mocapella.model.scene import Scene
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.session import CommandReply, SessionStatus
from mocapella.schema import decode_frame, decode_scene
from mocapella.supervision import Boundary
from mocapella.wire import keys


class Newest:
    """The newest message of each type, decoded on demand: a slow reader skips messages, and delays no other program.

    Messages are received from the constructor on, until the session is closed.

    Args:
        session: open session of a reader (`mocapella.wire.session.open_reader`); the caller closes it.

    Attributes:
        refused: number of unreadable messages.
        skipped: number of scenes that were replaced by newer ones before they were read.
        heard_s: monotonic time of the newest status; negative infinity before the first [s]. A server publishes five
            a second; if none comes, it hangs or the network is down, which nothing else shows.
    """

    def __init__(self, session: zenoh.Session) -> None:
        self.refused = self.skipped = 0
        self.heard_s = float("-inf")
        self._scene: bytes | None = None
        self._status: bytes | None = None
        self._frames: dict[str, bytes] = {}
        guard = Boundary().wrap
        self._subscribers = [
            session.declare_subscriber(keys.SCENE, guard("scene", self._take_scene)),
            session.declare_subscriber(keys.STATUS, guard("status", self._take_status)),
            session.declare_subscriber(keys.ALL_LIVE, guard("frame", self._take_frame)),
        ]

    def scene(self) -> Scene | None:
        """Return the newest scene once; None if there is no new one."""
        data, self._scene = self._scene, None
        return None if data is None else self._read(decode_scene, data)

    def status(self) -> SessionStatus | None:
        """Return the newest status once; None if there is no new one."""
        data, self._status = self._status, None
        return None if data is None else self._read(_decode_status, data)

    def frames(self) -> dict[str, SensorFrame]:
        """Return the newest frame of each sensor that has sent one since the last call."""
        fresh, self._frames = self._frames, {}
        read = {sensor: self._read(decode_frame, data) for sensor, data in fresh.items()}
        return {sensor: frame for sensor, frame in read.items() if frame is not None}

    def _take_scene(self, sample: zenoh.Sample) -> None:
        self.skipped += self._scene is not None
        self._scene = sample.payload.to_bytes()

    def _take_status(self, sample: zenoh.Sample) -> None:
        self._status, self.heard_s = sample.payload.to_bytes(), time.monotonic()

    def _take_frame(self, sample: zenoh.Sample) -> None:
        self._frames[str(sample.key_expr).split("/")[-2]] = sample.payload.to_bytes()

    def _read(self, decode: Callable[[bytes], Any], data: bytes) -> Any:
        try:
            return decode(data)
        except WireError:
            self.refused += 1
            return None


class Following:
    """All scenes and live frames in the order of arrival, for a reader that polls often and must not skip any.

    Messages are received from the constructor on, until the session is closed.

    Args:
        session: open session of a reader (`mocapella.wire.session.open_reader`); the caller closes it.
        most: number of messages that are kept between two calls of `take`.

    Attributes:
        refused: number of unreadable messages.
        lost: number of messages dropped because the reader polled too late; the oldest are dropped first.
    """

    def __init__(self, session: zenoh.Session, most: int = 4096) -> None:
        self.refused = self.lost = 0
        self._waiting: deque[tuple[Callable[[bytes], Scene | SensorFrame], bytes]] = deque(maxlen=most)
        self._lock = threading.Lock()
        guard = Boundary().wrap
        self._subscribers = [
            session.declare_subscriber(keys.SCENE, guard("scene", partial(self._put, decode_scene))),
            session.declare_subscriber(keys.ALL_LIVE, guard("frame", partial(self._put, decode_frame))),
        ]

    def take(self) -> list[Scene | SensorFrame]:
        """Return all readable messages since the last call; empty if there is none."""
        with self._lock:
            waiting = list(self._waiting)
            self._waiting.clear()
        read = []
        for decode, data in waiting:
            try:
                read.append(decode(data))
            except WireError:
                self.refused += 1
        return read

    def _put(self, decode: Callable[[bytes], Scene | SensorFrame], sample: zenoh.Sample) -> None:
        with self._lock:
            self.lost += len(self._waiting) == self._waiting.maxlen
            self._waiting.append((decode, sample.payload.to_bytes()))


def send_command(
    session: zenoh.Session,
    verb: str,
    arguments: Mapping[str, Any] | None = None,
    timeout: float = 10.0,
    *,
    program: str = "a program",
) -> CommandReply:
    """Send a command, and wait until it is carried out or refused.

    Args:
        session: open session of a reader (`mocapella.wire.session.open_reader`).
        verb: the command, such as ``recalibrate``.
        arguments: the command's arguments by name; None for none.
        timeout: longest wait for the reply [s].
        program: name of the sender; a take stores it with the names of the account and the machine.

    Returns:
        The server's reply; a refusal has ``ok`` False and the reason.

    Raises:
        NoServerError: no server answers within ``timeout`` seconds, or the key does not allow the command.
        InputError: the reply cannot be read.
    """
    payload = json.dumps(dict(arguments or {}))
    sender = f"{session.info.zid()!s:0>32} {program} of {_user()}@{platform.node()}"
    for reply in session.get(keys.of_command(verb), payload=payload, attachment=sender, timeout=timeout):
        answer = reply.ok if reply.ok is not None else reply.err
        if answer is not None:
            return decode_json(answer.payload.to_bytes(), CommandReply, what="reply of a server", file=verb)
    raise NoServerError(f"no server answered the command {verb} within {timeout:g} s; a reader's key commands nothing")


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):  # an account without a name
        return "?"


def _decode_status(data: bytes) -> SessionStatus:
    try:
        return decode_json(data, SessionStatus)
    except InputError as error:
        raise WireError(f"{len(data)} bytes that are no session status ({error})") from error
