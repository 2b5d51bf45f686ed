"""Open zenoh sessions that connect only to given addresses: no scouting, no gossip, no shared memory.

A *session* of Mocapella is a server with the programs that have its keys; a zenoh session is one program's connection.
Every connection is TLS, with certificates of one session on both sides (docs/decisions/0020-doors-of-the-bus.md).

A server only listens, so two servers on one machine never see each other's sensors. A node is a zenoh peer that keeps
trying to reach its one server. A reader of results is a zenoh client; the server forwards the nodes' messages to it
(measured: a peer forwards to clients, not to other peers).
"""

from __future__ import annotations

import json
from typing import Any

import zenoh

from mocapella.errors import AddressInUseError, BusError, NoServerError, NotAdmittedError
from mocapella.wire.address import DEFAULT_ADDRESS, parse_address
from mocapella.wire.door import KeyedAddress, client_tls, find_door, node_users, server_access, server_tls
from mocapella.wire.doorbell import why_not
from mocapella.wire.roles import READERS
from mocapella.wire.session_key import session_key, session_name

__all__ = ["DEFAULT_ADDRESS", "open_client_at", "open_node", "open_node_at", "open_reader", "open_server"]


def open_server(listen: str) -> zenoh.Session:
    """Open a server's zenoh session at ``listen``, ``[SESSION@]tls/HOST:PORT``.

    It admits programs that have a key of the session named there, or else of `session_name`'s.

    Raises:
        AddressInUseError: another program listens there.
        BusError: ``listen`` is no address, or it cannot listen there for another reason.
        KeyFileError: the session's key cannot be used.
        SettingsError: ``SESSION`` is no name of a session.
    """
    address = parse_address(listen)
    key = session_key(session_name(address.session))
    config = _config("peer", server_tls(key), listen=[address.locator])
    _set(config, "access_control", server_access(key))
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        if "in use" in str(error):
            raise AddressInUseError(
                f"port {address.port} of {listen} is in use by another program; stop it, or choose another with --port"
            ) from error
        raise BusError(f"cannot listen at {listen}: {_first_line(error)}") from error


def open_node(connect: str, sensor: str = "") -> zenoh.Session:
    """Open a node's zenoh session, which keeps trying to reach the server; return without waiting for it.

    Args:
        connect: ``[SESSION@]tls/HOST:PORT``, a pairing code, or the path of a file that contains a pairing code.
            Without ``SESSION@``, the key paired for the address is used, or else that of `session_name`'s session.
        sensor: name of the sensor that the node serves; empty needs the key of all sensors.

    Raises:
        BusError: ``connect`` is none of these, such as the path of a missing file.
        KeyFileError: there is no key for the server and the sensor, or the key is damaged; says how to get one.
        SettingsError: ``SESSION`` is no name of a session.
    """
    return open_node_at(find_door(connect, node_users(sensor)))


def open_node_at(door: KeyedAddress) -> zenoh.Session:
    """Open a node's zenoh session, given the server's address and a key; return without waiting for the server.

    The session is a peer that keeps trying this one server, and finds no others. `open_node` looks up the key.
    """
    config = _config("peer", client_tls(door.key), connect=[door.locator])
    retry = {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 1.5}
    _set(config, "connect/retry", retry)
    _set(config, "connect/timeout_ms", -1)
    _set(config, "connect/exit_on_failure", False)
    return _open(config, door)


def open_reader(connect: str, timeout: float = 3.0) -> zenoh.Session:
    """Open the zenoh session of a program that reads results and sends commands, as far as its key allows.

    ``connect`` is as in `open_node`; the key is the one with most rights that this user has for the server.

    Raises:
        NoServerError: no server answers at ``connect`` within ``timeout`` seconds.
        NotAdmittedError: the server there is of another session, or does not know the key.
        BusError: ``connect`` is no address.
        KeyFileError: there is no key for it, or the key is damaged.
        SettingsError: ``SESSION`` is no name of a session.
    """
    return open_client_at(find_door(connect, READERS), timeout)


def open_client_at(door: KeyedAddress, timeout: float = 3.0) -> zenoh.Session:
    """Open the zenoh session of `open_reader`, given the server's address and a key.

    Raises:
        NoServerError: no server answers within ``timeout`` seconds.
        NotAdmittedError: the server there is of another session, or does not know the key.
    """
    config = _config("client", client_tls(door.key), connect=[door.locator])
    _set(config, "connect/timeout_ms", int(timeout * 1000))
    _set(config, "connect/exit_on_failure", True)
    return _open(config, door)


def _open(config: zenoh.Config, door: KeyedAddress) -> zenoh.Session:
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        refusal = why_not(door)
        if refusal:
            raise NotAdmittedError(refusal) from error
        raise NoServerError(f"no server answers at {door.locator}; start a server there (mocapella serve)") from error


def _config(
    mode: str, tls: dict[str, Any], *, listen: list[str] | None = None, connect: list[str] | None = None
) -> zenoh.Config:
    config = zenoh.Config()
    _set(config, "mode", mode)
    _set(config, "listen/endpoints", listen or [])
    _set(config, "listen/timeout_ms", 0)
    _set(config, "listen/exit_on_failure", True)
    _set(config, "connect/endpoints", connect or [])
    _set(config, "scouting/multicast/enabled", False)
    _set(config, "scouting/gossip/enabled", False)
    _set(config, "transport/shared_memory/enabled", False)
    _set(config, "transport/link/tls", tls)
    _set(config, "timestamping/enabled", False)  # it is by wall clocks, and refuses messages of a clock that is ahead
    return config


def _set(config: zenoh.Config, key: str, value: Any) -> None:
    config.insert_json5(key, json.dumps(value))


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0].partition(" at /")[0]
