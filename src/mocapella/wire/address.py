"""Addresses of a server: ``tls/HOST:PORT``, with an optional session name before it.

``tcp/HOST:PORT`` is read as the same, because earlier versions wrote it so; the bus speaks TLS in any case.
"""

from __future__ import annotations

import ipaddress
from typing import NamedTuple

from mocapella.errors import BusError

DEFAULT_ADDRESS = "tls/127.0.0.1:7447"


class Address(NamedTuple):
    """A parsed address.

    Attributes:
        session: name of the session before the ``@``; empty if the text has none.
        host: name or IP address; IPv6 in brackets.
        port: TCP port.
    """

    session: str
    host: str
    port: int

    @property
    def locator(self) -> str:
        """``tls/HOST:PORT``: the address as zenoh takes it."""
        return f"tls/{self.host}:{self.port}"

    @property
    def bare_host(self) -> str:
        """The host without brackets, as sockets take it."""
        return self.host.removeprefix("[").removesuffix("]")

    @property
    def local(self) -> bool:
        """Whether only this machine reaches the address, because its host is a loopback address."""
        return is_loopback(self.locator)

    def __str__(self) -> str:
        return f"{self.session}@{self.locator}" if self.session else self.locator


def parse_address(text: str) -> Address:
    """Parse ``[SESSION@]tls/HOST:PORT``.

    Raises:
        BusError: it has another form; shows a valid address.
    """
    before, _, locator = text.rpartition("@")
    protocol, _, rest = locator.partition("/")
    host, _, port = rest.rpartition(":")
    known = protocol in ("tcp", "tls") and host and port.isascii() and port.isdigit() and len(port) <= 5
    if not known or not 0 < int(port) < 65536:
        raise BusError(f"address {text[:120]!r} cannot be used; write it as {DEFAULT_ADDRESS}")
    return Address(before, host, int(port))


def is_loopback(address: str) -> bool:
    """Whether an address such as ``tls/127.0.0.1:7447`` is reachable from this machine only.

    Of host names, only ``localhost`` counts: any other, such as ``127.example.org``, may lead anywhere.
    """
    host = address.partition("/")[2].rpartition(":")[0]
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.removeprefix("[").removesuffix("]")).is_loopback
    except ValueError:
        return False
