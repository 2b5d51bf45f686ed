"""UDP sockets with arrival times, drop counts, and a private socket for one sender (the last three on Linux only)."""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import sys
import time
from typing import Any, Final

from mocapella.conventions import NS_PER_S
from mocapella.schema.marker_datagrams import MAX_DATAGRAM_BYTES

_BUFFER_BYTES: Final = 16 * 1024
"""Receive buffer of a socket: about forty datagrams, so that waiting datagrams are read at once and are not old."""
# From asm-generic/socket.h; Python's socket module defines neither.
_SO_TIMESTAMPNS: Final = 35
_SO_RXQ_OVFL: Final = 40
_TIMESPEC: Final = struct.Struct("@ll")
_LINUX: Final = sys.platform == "linux"


def prepare(listener: socket.socket) -> None:
    """Set a socket's buffer size and, on Linux, enable arrival times and drop counts."""
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
    if _LINUX:
        for option in (_SO_TIMESTAMPNS, _SO_RXQ_OVFL):
            with contextlib.suppress(OSError):  # without them: time of reading, no drop count
                listener.setsockopt(socket.SOL_SOCKET, option, 1)


def socket_for(listener: socket.socket, sender: Any) -> socket.socket | None:
    """Open a second socket at the listener's port for this sender's datagrams only: others cannot fill its buffer.

    None is returned if that fails, or if the system is not Linux. The socket is non-blocking.

    Linux delivers a datagram to the socket that is connected to its sender, if one exists. The option by which two
    sockets share a port is on only during this call, so that no other program can share it.
    """
    if not _LINUX:
        return None
    own = socket.socket(listener.family, socket.SOCK_DGRAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        own.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        own.setblocking(False)
        prepare(own)
        own.bind(listener.getsockname())
        own.connect(sender)
    except OSError:
        own.close()
        return None
    finally:
        for each in (listener, own):
            with contextlib.suppress(OSError):
                each.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)
    return own


def readable(sockets: list[socket.socket], timeout: float) -> list[socket.socket]:
    """Wait until some of the sockets have a datagram, at most ``timeout`` seconds; return these sockets, or none."""
    if not sockets:  # select refuses an empty list on some systems
        time.sleep(timeout)
        return []
    return select.select(sockets, [], [], timeout)[0]


def receive(from_socket: socket.socket) -> tuple[bytes, Any, int | None, int | None]:
    """Receive a datagram.

    A datagram that is too long is cut off at ``MAX_DATAGRAM_BYTES`` + 1 bytes, so that it is recognised.

    Returns:
        The data, the sender's address, the time of arrival on the wall clock [ns], and the number of datagrams that the
        system has dropped since the socket was opened; the last two are None if the system does not report them.

    Raises:
        BlockingIOError: the socket is non-blocking and no datagram waits.
    """
    if not _LINUX:
        data, source = from_socket.recvfrom(MAX_DATAGRAM_BYTES + 1)
        return data, source, None, None
    space = socket.CMSG_SPACE(_TIMESPEC.size) + socket.CMSG_SPACE(4)
    data, ancillary, _, source = from_socket.recvmsg(MAX_DATAGRAM_BYTES + 1, space)
    at_ns = dropped = None
    for level, kind, value in ancillary:
        if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS and len(value) == _TIMESPEC.size:
            seconds, ns = _TIMESPEC.unpack(value)
            at_ns = seconds * NS_PER_S + ns
        elif level == socket.SOL_SOCKET and kind == _SO_RXQ_OVFL and len(value) == 4:
            (dropped,) = struct.unpack("@I", value)
    return data, source, at_ns, dropped


def address_text(address: Any) -> str:
    """Return host and port of a socket address, as text."""
    return f"{address[0]}:{address[1]}"
