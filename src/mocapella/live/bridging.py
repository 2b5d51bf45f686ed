"""Connect foreign programs to the bus: each connection at the bridge is one sensor with one node."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict
from typing import Any

from mocapella.errors import UnstoredFramesError
from mocapella.live.node import Membership
from mocapella.live.node_disk import open_link
from mocapella.live.relaying import Relays
from mocapella.model.observations import BodyFrame
from mocapella.model.sensor_frame import SensorFrame
from mocapella.sources.bridge import Bridge, BridgeSettings


class ServedSensor:
    """A sensor's link to the bus, and its membership, which claims the sensor's name, for programs without a node.

    Args:
        connect: address of the server.
        sensor: name of the sensor.
        say: receives messages about the link.

    Attributes:
        link: publishes the frames.
        membership: claims the name, on a thread of its own.
        ended: set by `close`, or when a server refuses the name.
        unstored: message about frames of an open take that the server has not stored at `close`; else empty.

    Raises:
        BusError, KeyFileError: as `mocapella.wire.node.NodeLink`.
    """

    def __init__(self, connect: str, sensor: str, say: Callable[[str], None]) -> None:
        self.ended = threading.Event()
        self._stack = ExitStack()
        self._say = say
        self.link = self._stack.enter_context(open_link(connect, sensor, say=say))
        self.unstored = ""
        self.membership = Membership(self.link, self.ended, say)

    def publish(self, frame: SensorFrame) -> None:
        """Publish a frame; raise `NameTakenError` once a server has refused the name."""
        self.raise_refusal()
        self.link.publish(frame)

    def raise_refusal(self) -> None:
        """Raise `NameTakenError` if a server has refused the name."""
        if self.membership.refusal is not None:
            raise self.membership.refusal

    def close(self) -> None:
        """Leave the bus, and release the sensor's name, once all frames of an open take are stored.

        If the server stores none for about 10 s, those that it lacks are reported in ``unstored`` and by ``say``.
        """
        self.ended.set()
        self.membership.wait()
        try:
            self._stack.close()
        except UnstoredFramesError as error:
            self.unstored = str(error)
            self._say(self.unstored)


def run_bridge(
    settings: BridgeSettings, connect: str, stop: threading.Event, say: Callable[[str], None]
) -> dict[str, Any]:
    """Serve every sensor of a program connected to the bridge until ``stop`` is set; return the bridge's report.

    Args:
        settings: where the bridge listens, and its limits.
        connect: address of the server.
        stop: ends the run.
        say: receives messages about the run.

    Raises:
        AddressInUseError: the bridge's port is in use.
        BusError: the bridge cannot listen at its address for another reason.
        UnstoredFramesError: frames of an open take are not stored.
    """
    serving: dict[str, ServedSensor] = {}
    unstored: list[str] = []

    def on_frame(sensor: str, frame: BodyFrame, _data: bytes) -> None:
        if sensor not in serving:
            serving[sensor] = ServedSensor(connect, sensor, say)
        serving[sensor].publish(frame)

    def on_disconnect(sensor: str) -> None:
        left = serving.pop(sensor, None)
        if left is not None:
            nowhere = "" if left.membership.served.is_set() else f", which no server at {left.link.address} received"
            say(f"{sensor}: its program left after {left.link.published} frames{nowhere}")
            left.close()
            unstored.extend(filter(None, [left.unstored]))

    relays = Relays(connect, say)
    bridge = Bridge(on_frame, settings, on_disconnect, say, relays)
    bridge.start()
    host, port = bridge.address
    say(f"bridge: listening at {host}:{port} for length-delimited BodyFrames (Ctrl-C ends)")
    try:
        stop.wait()
    finally:
        bridge.stop()
        for sensor in list(serving):
            on_disconnect(sensor)
        unstored.extend(relays.close())
    if unstored:
        raise UnstoredFramesError(unstored[-1])
    return asdict(bridge.report)
