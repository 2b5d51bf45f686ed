"""Sockets that listen: a port is one program's, and free again as soon as that has ended."""

from __future__ import annotations

import os
import socket

import pytest

from mocapella.errors import AddressInUseError
from mocapella.sources.bound_socket import bound_socket

HERE = "127.0.0.1"
KINDS = [socket.SOCK_STREAM, socket.SOCK_DGRAM]


@pytest.mark.parametrize("kind", KINDS)
def test_two_programs_do_not_share_a_port(kind: socket.SocketKind) -> None:
    with bound_socket(HERE, 0, kind) as first:
        port = first.getsockname()[1]
        assert not first.getblocking()
        with pytest.raises(AddressInUseError, match=f"{HERE}:{port} is in use by another program"):
            bound_socket(HERE, port, kind)
    bound_socket(HERE, port, kind).close()


@pytest.mark.skipif(os.name != "posix", reason="other systems let go of the port by themselves")
def test_a_server_that_is_started_again_gets_its_port_though_it_has_just_closed_a_connection() -> None:
    """The system keeps such a connection's port for a minute."""
    with bound_socket(HERE, 0, socket.SOCK_STREAM) as listener:
        port = listener.getsockname()[1]
        with socket.create_connection((HERE, port), timeout=30.0) as client:
            listener.setblocking(True)
            listener.accept()[0].close()
            assert client.recv(1) == b""
    bound_socket(HERE, port, socket.SOCK_STREAM).close()
