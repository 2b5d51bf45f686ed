"""Connect cameras that send markers as datagrams to the bus: each port is one camera with one node."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import asdict
from typing import Any, Final

from mocapella.errors import UnstoredFramesError
from mocapella.live.bridging import ServedSensor
from mocapella.sources.datagram_settings import DatagramSettings
from mocapella.sources.marker_datagrams import MarkerDatagrams
from mocapella.supervision import Boundary

_POLL_S: Final = 0.1


def run_datagrams(
    settings: DatagramSettings, connect: str, stop: threading.Event, say: Callable[[str], None]
) -> dict[str, Any]:
    """Serve a camera for each port until ``stop`` is set; return counts in the form of ``--json``, by camera.

    Args:
        settings: cameras with their ports, and the names of the markers.
        connect: address of the server.
        stop: ends the run.
        say: receives messages about the run.

    Raises:
        AddressInUseError: a port is in use.
        BusError: this machine does not have the address.
        NameTakenError: another node serves a camera of one of the names.
        UnstoredFramesError: frames of an open take are not stored.
    """
    began_s, busy_s = time.monotonic(), time.process_time()
    with MarkerDatagrams(settings, say) as source:
        serving = {name: ServedSensor(connect, name, say) for name in source.addresses}
        try:
            for name, (host, port) in source.addresses.items():
                say(f"{name}: listening at {host}:{port} for {', '.join(settings.markers)} (Ctrl-C ends)")
            errors = Boundary(say)

            def pass_on() -> None:
                for frame in source.poll(_POLL_S):
                    serving[frame.sensor].publish(frame)

            while not stop.is_set():
                errors.run("datagram", pass_on)
                for sensor in serving.values():
                    sensor.raise_refusal()
        finally:
            for sensor in serving.values():
                sensor.close()
        unstored = [sensor.unstored for sensor in serving.values() if sensor.unstored]
        for name, report in source.report.items():
            served, address = serving[name].membership.served.is_set(), serving[name].link.address
            say(f"{name}: {_in_words(report.frames, sum(report.refused.values()))}" + _nowhere(served, address))
        if unstored:
            raise UnstoredFramesError(unstored[-1])
        return {
            "cameras": {
                name: {"port": source.addresses[name][1], "served": serving[name].membership.served.is_set()}
                | asdict(report)
                for name, report in source.report.items()
            },
            "starts_sent": source.starts_sent,
            "seconds": round(time.monotonic() - began_s, 3),
            "processor_seconds": round(time.process_time() - busy_s, 3),
            "errors": errors.counts,
        }


def _in_words(frames: int, refused: int) -> str:
    return f"{frames} frames" + (f", {refused} datagrams refused" if refused else "")


def _nowhere(served: bool, address: str) -> str:
    return "" if served else f", which no server at {address} received"
