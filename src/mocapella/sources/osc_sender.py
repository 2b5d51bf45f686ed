"""Send numbers as OSC messages over UDP, to programs for sound, light and stage.

OSC 1.0 (M. Wright, *The Open Sound Control 1.0 Specification*, 2002); `mocapella.sources.osc` decodes it.
"""

from __future__ import annotations

import socket
from types import TracebackType
from typing import Final

from mocapella.errors import SettingsError
from mocapella.schema.osc_messages import osc_message

_EXAMPLE: Final = "expected HOST:PORT, such as 127.0.0.1:9000"


class OscSender:
    """Sends messages to one receiver; a context manager that closes its socket at the end.

    UDP does not say whether a program receives them.

    Args:
        target: the receiver, as HOST:PORT.

    Raises:
        SettingsError: ``target`` is no HOST:PORT, its port is not from 1 to 65535, or its host is unknown.
    """

    def __init__(self, target: str) -> None:
        host, _, port = target.rpartition(":")
        if not host or not (len(port) <= 5 and port.isascii() and port.isdigit() and 0 < int(port) < 65536):
            raise SettingsError(f"OSC address {target!r}: {_EXAMPLE}")
        try:
            self._target = socket.gethostbyname(host), int(port)
        except (OSError, UnicodeError) as error:
            raise SettingsError(f"OSC address {target!r}: no such host ({error}); {_EXAMPLE}") from None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def send(self, address: str, *values: float) -> None:
        """Send one message; raise `SettingsError` if the network refuses the receiver."""
        self.send_datagram(osc_message(address, *(float(value) for value in values)))

    def send_datagram(self, data: bytes) -> None:
        """Send an encoded message or bundle; raise `SettingsError` if the network refuses the receiver."""
        try:
            self._socket.sendto(data, self._target)
        except OSError as error:
            raise SettingsError(f"OSC to {self._target[0]}:{self._target[1]}: {error.strerror}; {_EXAMPLE}") from None

    def __enter__(self) -> OscSender:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._socket.close()
