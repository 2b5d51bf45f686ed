"""Bind a socket to an address of this machine, with readable errors."""

from __future__ import annotations

import errno
import os
import socket

from mocapella.errors import AddressInUseError, BusError


def bound_socket(host: str, port: int, kind: socket.SocketKind) -> socket.socket:
    """Return a non-blocking socket that is bound to an address; a stream socket also listens.

    Args:
        host: a name or address of this machine.
        port: from 0 to 65535; 0 takes any free one.
        kind: ``SOCK_STREAM`` or ``SOCK_DGRAM``.

    Raises:
        AddressInUseError: another program uses the port.
        BusError: the address does not belong to this machine, or may not be used.
    """
    where = f"{host}:{port}"
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=kind, flags=socket.AI_PASSIVE)[0]
        bound = socket.socket(family, kind)
    except (OSError, UnicodeError) as error:  # UnicodeError: an invalid host name
        raise BusError(f"cannot listen at {where}: {error}; try 127.0.0.1") from error
    try:
        # On other systems, and for datagrams, the option would let two programs share the port.
        if os.name == "posix" and kind == socket.SOCK_STREAM:
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.bind(address)
        if kind == socket.SOCK_STREAM:
            bound.listen()
    except OSError as error:
        bound.close()
        if error.errno == errno.EADDRINUSE:
            raise AddressInUseError(f"{where} is in use by another program; listen at another port") from error
        raise BusError(f"cannot listen at {where}: {error}; try 127.0.0.1") from error
    bound.setblocking(False)
    return bound
