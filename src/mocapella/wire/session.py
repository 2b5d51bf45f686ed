"""Open zenoh sessions that connect only to given addresses: no scouting, no gossip, no shared memory.

A server only listens, so two servers on one machine never see each other's sensors. A node is a peer that tries to
reach its one server for ever; a reader of results is a client, to which the server forwards the nodes' messages
(measured: a peer forwards to clients, not to other peers).
"""

from __future__ import annotations

import ipaddress
import json
from typing import Any

import zenoh

from mocapella.errors import AddressInUseError, BusError, NoServerError

DEFAULT_ADDRESS = "tcp/127.0.0.1:7447"


def is_loopback(address: str) -> bool:
    """Whether an address such as ``tcp/127.0.0.1:7447`` is reachable from this machine only.

    Of host names, only ``localhost`` counts: any other, such as ``127.example.org``, may lead anywhere.
    """
    host = address.partition("/")[2].rpartition(":")[0]
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.removeprefix("[").removesuffix("]")).is_loopback
    except ValueError:
        return False


def check_address(address: str) -> str:
    """Return the address if it has the form ``tcp/HOST:PORT``.

    Raises:
        BusError: it has another form; shows a valid address.
    """
    protocol, _, rest = address.partition("/")
    host, _, port = rest.rpartition(":")
    if protocol not in ("tcp", "tls", "quic", "udp") or not host or not port.isdigit() or not 0 < int(port) < 65536:
        raise BusError(f"address {address!r} cannot be used; write it as {DEFAULT_ADDRESS}")
    return address


def open_server(listen: str) -> zenoh.Session:
    """Open a session that listens.

    Raises:
        AddressInUseError: another program listens there.
        BusError: it cannot listen there for another reason.
    """
    config = _config("peer", listen=[check_address(listen)])
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        if "in use" in str(error):
            port = listen.rpartition(":")[2]
            raise AddressInUseError(
                f"port {port} of {listen} is in use by another program; stop it, or choose another with --port"
            ) from error
        raise BusError(f"cannot listen at {listen}: {_first_line(error)}") from error


def open_node(connect: str) -> zenoh.Session:
    """Open a session that keeps trying the server at ``connect``; return without waiting for it."""
    config = _config("peer", connect=[check_address(connect)])
    retry = {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 1.5}
    _set(config, "connect/retry", retry)
    _set(config, "connect/timeout_ms", -1)
    _set(config, "connect/exit_on_failure", False)
    return _open(config, connect)


def open_reader(connect: str, timeout: float = 3.0) -> zenoh.Session:
    """Open a session of a program that reads results and sends commands.

    Raises:
        NoServerError: no server answers at ``connect`` within ``timeout`` seconds.
    """
    config = _config("client", connect=[check_address(connect)])
    _set(config, "connect/timeout_ms", int(timeout * 1000))
    _set(config, "connect/exit_on_failure", True)
    return _open(config, connect)


def _open(config: zenoh.Config, connect: str) -> zenoh.Session:
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise NoServerError(f"no server answers at {connect}; start a server there (mocapella serve)") from error


def _config(mode: str, *, listen: list[str] | None = None, connect: list[str] | None = None) -> zenoh.Config:
    config = zenoh.Config()
    _set(config, "mode", mode)
    _set(config, "listen/endpoints", listen or [])
    _set(config, "listen/timeout_ms", 0)
    _set(config, "listen/exit_on_failure", True)
    _set(config, "connect/endpoints", connect or [])
    _set(config, "scouting/multicast/enabled", False)
    _set(config, "scouting/gossip/enabled", False)
    _set(config, "transport/shared_memory/enabled", False)
    _set(config, "timestamping/enabled", True)
    return config


def _set(config: zenoh.Config, key: str, value: Any) -> None:
    config.insert_json5(key, json.dumps(value))


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0].partition(" at /")[0]
