"""Connect other trackers to the bus: OSC datagrams and OpenVR devices, each as a node."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from mocapella.errors import AddressInUseError, BusError
from mocapella.live.node import Membership
from mocapella.sources.openvr_poses import OpenVrPoses
from mocapella.sources.osc import MOST_BYTES, OscPoses, as_json
from mocapella.supervision import Boundary
from mocapella.wire.node import NodeLink


def run_osc(
    link: NodeLink, address: tuple[str, int], space: str, stop: threading.Event, say: Callable[[str], None]
) -> dict[str, Any]:
    """Publish the poses of OSC datagrams until ``stop`` is set; return counts in the form of ``--json``.

    Args:
        link: the sensor's end of the bus; stays open.
        address: host and UDP port to listen at; port 0 takes a free one.
        space: name of the other tracker's coordinate system, which its frames carry.
        stop: ends the run.
        say: receives messages about the run.

    Raises:
        AddressInUseError: the address cannot be bound: another program listens on the port, or this machine does not
            have the address.
        BusError: the host cannot be resolved.
        NameTakenError: another node serves a sensor of this name.
    """
    host = address[0]
    with _bound(*address) as listener:
        membership = Membership(link, stop, say)
        source = OscPoses(link.node.sensor, space)
        errors = Boundary(say)

        def pass_on(data: bytes) -> None:
            frame = source.update(data, time.monotonic_ns())
            if frame is not None:
                link.publish(frame)

        say(f"{link.node.sensor}: listening for OSC at {host}:{listener.getsockname()[1]} (Ctrl-C ends)")
        try:
            while not stop.is_set():
                try:
                    data = listener.recv(MOST_BYTES)
                except TimeoutError:
                    continue
                except OSError:  # Windows reports an earlier undelivered datagram here
                    continue
                errors.run("datagram", partial(pass_on, data))
        finally:
            stop.set()
            membership.close()
    return {"sensor": link.node.sensor, "published": link.published, **as_json(source.report)}


def run_openvr(
    link: NodeLink, source: OpenVrPoses, hz: float, stop: threading.Event, say: Callable[[str], None]
) -> dict[str, Any]:
    """Publish OpenVR's poses at a fixed rate until ``stop`` is set; return counts in the form of ``--json``.

    Args:
        link: the sensor's end of the bus; stays open.
        source: the connected devices; stays open.
        hz: frame rate [Hz].
        stop: ends the run.
        say: receives messages about the run.

    Raises:
        NameTakenError: another node serves a sensor of this name.
    """
    membership = Membership(link, stop, say)
    errors = Boundary(say)
    due = time.monotonic()
    try:
        while not stop.wait(max(0.0, due - time.monotonic())):
            due = max(due + 1.0 / hz, time.monotonic())
            errors.run("poses", lambda: link.publish(source.poll(time.monotonic_ns())))
    finally:
        stop.set()
        membership.close()
    return {"sensor": link.node.sensor, "published": link.published, "invalid": source.invalid}


def _bound(host: str, port: int) -> socket.socket:
    where = f"{host}:{port}"
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM, flags=socket.AI_PASSIVE)[0]
        listener = socket.socket(family, socket.SOCK_DGRAM)
    except (OSError, UnicodeError) as error:
        raise BusError(f"cannot listen at {where}: {error}; try 127.0.0.1:9000") from error
    try:
        listener.bind(address)
    except OSError as error:
        listener.close()
        raise AddressInUseError(f"{where} cannot be listened at ({error}); take another port") from error
    listener.settimeout(0.1)
    return listener
