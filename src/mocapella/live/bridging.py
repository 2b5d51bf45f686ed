"""Connect foreign programs to the bus: each connection at the bridge is one sensor with one node."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from mocapella.live.node import Membership
from mocapella.model.observations import BodyFrame
from mocapella.model.sensor_frame import SensorFrame
from mocapella.sources.bridge import Bridge, BridgeSettings
from mocapella.wire.node import NodeLink


class ServedSensor:
    """A sensor's link to the bus, and its membership, which claims the sensor's name."""

    def __init__(self, connect: str, sensor: str, say: Callable[[str], None]) -> None:
        self.ended = threading.Event()
        self.link = NodeLink(connect, sensor)
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
        """Leave the bus; a refusal is not raised again."""
        self.ended.set()
        self.membership.wait()
        self.link.close()


def run_bridge(
    settings: BridgeSettings, connect: str, stop: threading.Event, say: Callable[[str], None]
) -> dict[str, Any]:
    """Serve every sensor of a program connected to the bridge until ``stop`` is set; return the bridge's report.

    Raises:
        AddressInUseError: the bridge's port is in use.
    """
    serving: dict[str, ServedSensor] = {}

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

    bridge = Bridge(on_frame, settings, on_disconnect)
    bridge.start()
    host, port = bridge.address
    say(f"bridge: listening at {host}:{port} for length-delimited BodyFrames (Ctrl-C ends)")
    try:
        stop.wait()
    finally:
        bridge.stop()
        for sensor in list(serving):
            on_disconnect(sensor)
    return asdict(bridge.report)
