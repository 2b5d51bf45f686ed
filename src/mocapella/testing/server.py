"""A fake server on the bus: for tests of sources, views, and programs that read results."""

from __future__ import annotations

import dataclasses
import socket
import threading
from collections.abc import Callable
from typing import Any

import msgspec

from mocapella import __version__
from mocapella.errors import WireError
from mocapella.model.scene import Scene
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.session import CommandReply, RecordingHealth, SensorHealth, SessionStatus, Setup
from mocapella.schema import decode_frame, encode_scene
from mocapella.wire.keys import NodeKey
from mocapella.wire.node import JoinReply
from mocapella.wire.server import ServerLink

Obey = Callable[[str, dict[str, Any]], CommandReply]


class FakeServer:
    """Server without tracker and recorder, directed by a test; a context manager that closes it at the end.

    It listens from its construction. Every node may join and send frames; readers receive the scenes and statuses that
    the test publishes; commands are recorded, and answered by ``obey``.

    Args:
        address: address to listen at, such as ``tls/127.0.0.1:40123``; a free port of the loopback if empty.
        obey: function that answers a command, given its verb and arguments, in a thread of the bus; by default every
            command succeeds.

    Attributes:
        address: address that nodes and readers connect to.
        frames: frames received so far, in order of arrival.
        commands: commands received so far, as (verb, arguments).
        problems: descriptions of messages that could not be read.

    Raises:
        AddressInUseError, BusError, KeyFileError: the server cannot listen.
    """

    def __init__(self, address: str = "", obey: Obey = lambda verb, arguments: CommandReply(True)) -> None:
        self.address = address or f"tls/127.0.0.1:{_free_port()}"
        self.frames: list[SensorFrame] = []
        self.commands: list[tuple[str, dict[str, Any]]] = []
        self.problems: list[str] = []
        self._obey, self._changed = obey, threading.Condition()
        self._link = ServerLink(self.address, on_nonsense=self.problems.append)
        self._link.serve(
            on_frame=self._take,
            on_truth=lambda *_: None,
            on_alive=lambda *_: None,
            on_command=self._command,
            on_join=_accept,
            on_leave=_accept,
        )

    def publish(self, scene: Scene) -> None:
        """Send a scene to the readers that are connected now; slow readers may miss it."""
        self._link.publish_scene(encode_scene(scene))

    def publish_status(self, status: SessionStatus) -> None:
        """Send a status, such as `session_status` makes, to the readers that are connected now."""
        self._link.publish_status(msgspec.json.encode(status))

    def wait_for(self, frames: int = 0, commands: int = 0, timeout_s: float = 30.0) -> None:
        """Wait until at least so many frames and commands have arrived since the server was made.

        Raises:
            AssertionError: fewer have arrived after ``timeout_s`` seconds; says how many.
        """
        with self._changed:
            if not self._changed.wait_for(
                lambda: len(self.frames) >= frames and len(self.commands) >= commands, timeout_s
            ):
                raise AssertionError(
                    f"{len(self.frames)} of {frames} frames and {len(self.commands)} of {commands} commands came "
                    f"within {timeout_s:g} s"
                )

    def close(self) -> None:
        """Stop listening, and disconnect nodes and readers."""
        self._link.close()

    def __enter__(self) -> FakeServer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _take(self, _node: NodeKey, data: bytes, _arrived_ns: int) -> None:
        try:
            frame = decode_frame(data)
        except WireError as error:
            self.problems.append(str(error))
            return
        with self._changed:
            self.frames.append(frame)
            self._changed.notify_all()

    def _command(self, verb: str, arguments: dict[str, Any], answer: Callable[[bytes], None]) -> None:
        answer(msgspec.json.encode(self._obey(verb, arguments)))
        with self._changed:
            self.commands.append((verb, arguments))
            self._changed.notify_all()


def _accept(_node: NodeKey, _arguments: dict[str, Any], answer: Callable[[bytes], None]) -> None:
    answer(msgspec.json.encode(JoinReply(True)))


def sensor_health(name: str, **changes: Any) -> SensorHealth:
    """Return the health of a connected sensor at 30 frames a second, for tests of status displays.

    Args:
        name: name of the sensor.
        changes: values of fields of `SensorHealth` that differ.
    """
    health = SensorHealth(
        name, node_id=7, connected=True, silent=False, local=False, bodies=2, rate_hz=30.0, latency=0.0021,
        frames=900, dropped=0, rejected=0, clock_offset=0.0123, clock_bound=0.0004, stored=0, lost=0, tilt=0.0,
        height=1.1,
    )  # fmt: skip
    return dataclasses.replace(health, **changes)


def session_status(**changes: Any) -> SessionStatus:
    """Return the status of a session that tracks two people with three sensors, for tests of status displays.

    Args:
        changes: values of fields of `SessionStatus` that differ.
    """
    status = SessionStatus(
        revision=3, running=True, phase="tracking", sensors_missing=0, frames_remaining=0, frames_wanted=120,
        reason="", counts={"people": 2}, scenes=900, scenes_hz=90.0, setup=Setup(sensors_expected=3),
        sensors=(
            sensor_health("front", local=True), sensor_health("left", latency=0.0034), sensor_health("right", dropped=2)
        ),
        recording=RecordingHealth(), notices=("front joined", "left joined", "right joined"), uptime=60.0,
        version=__version__,
    )  # fmt: skip
    return dataclasses.replace(status, **changes)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
