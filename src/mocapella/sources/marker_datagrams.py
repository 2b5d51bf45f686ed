"""Markers from other programs (such as a Raspberry Pi's), each sending a camera's markers to a UDP port as text.

UDP guarantees neither sender, time nor order, and any program can send to a port. So a port belongs to the first sender
with a readable datagram, until that sender falls silent. Of several waiting datagrams the newest is used. A port is
read at a limited rate, a limited number of datagrams at a time. All others are counted by reason.
`mocapella.schema.marker_datagrams` decodes the text.
"""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from typing import Any

from mocapella.conventions import NS_PER_S
from mocapella.errors import BusError
from mocapella.model.markers import MarkerFrame
from mocapella.sources.bound_socket import bound_socket
from mocapella.sources.datagram_port import DatagramPort
from mocapella.sources.datagram_settings import DatagramSettings, PortReport
from mocapella.sources.datagram_sockets import address_text, readable


class MarkerDatagrams:
    """Receiver of marker datagrams, from `start` to `stop`. It needs no thread: `poll` waits and returns the frames.

    A context manager that starts and stops it. It cannot be started again.

    Args:
        settings: cameras and ports.
        say: receives messages about senders and problems, each kind once per camera and sender.
        clock: the monotonic clock [ns].
    """

    def __init__(
        self,
        settings: DatagramSettings,
        say: Callable[[str], None] = lambda text: None,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._settings, self._say, self._clock = settings, say, clock
        self._ports: list[DatagramPort] = []
        self._starter: _Starter | None = None

    def start(self) -> None:
        """Begin to listen.

        Raises:
            AddressInUseError: another program listens at one of the ports.
            BusError: the address does not belong to this machine, or the start command's address is invalid.
        """
        s = self._settings
        try:
            for name, port in s.cameras:
                self._ports.append(DatagramPort(name, bound_socket(s.host, port, socket.SOCK_DGRAM), s, self._say))
            if s.start_to is not None:
                self._starter = _Starter(s, self._say)
        except BusError:
            self.stop()
            raise

    def stop(self) -> None:
        """Close the ports; may be called twice. The report stays."""
        for port in self._ports:
            port.close()
        if self._starter is not None:
            self._starter.close()

    def __enter__(self) -> MarkerDatagrams:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def addresses(self) -> dict[str, tuple[str, int]]:
        """Host and port of each camera, after `start`; empty before."""
        return {port.name: port.address for port in self._ports}

    @property
    def report(self) -> dict[str, PortReport]:
        """The counts of each camera so far; empty before `start`."""
        return {port.name: port.report for port in self._ports}

    @property
    def starts_sent(self) -> int:
        """Number of start commands sent."""
        return 0 if self._starter is None else self._starter.sent

    def poll(self, timeout: float = 0.0) -> list[MarkerFrame]:
        """Return the frames that have arrived; wait for one at most ``timeout`` seconds.

        Returns:
            At most one frame per camera, the newest, in no fixed order; empty if none has arrived. A frame's
            ``time_ns`` is on the monotonic clock: the settings' ``delay`` before the arrival, or before the program's
            own time (see `SenderClock`). Node and sequence number are 0; the publisher sets them.
        """
        until_ns = self._clock() + round(timeout * NS_PER_S)
        while True:
            now_ns = self._clock()
            for port in self._ports:
                port.release_silent_sender(now_ns)
            if self._starter is not None and any(port.sender is None for port in self._ports):
                self._starter.update(now_ns)
            resting = [port.rests_until_ns for port in self._ports if port.rests_until_ns > now_ns]
            waking = {one: port for port in self._ports if port.rests_until_ns <= now_ns for one in port.sockets}
            wait_ns = max(0, min([until_ns, *resting]) - now_ns)
            ready = readable(list(waking), wait_ns / NS_PER_S)
            found = [port.turn(self._clock()) for port in dict.fromkeys(waking[one] for one in ready)]
            frames = [frame for frame in found if frame is not None]
            if frames or self._clock() >= until_ns:
                return frames


class _Starter:
    """Sender of the start command, for programs that wait for it."""

    def __init__(self, settings: DatagramSettings, say: Callable[[str], None]) -> None:
        assert settings.start_to is not None
        self._settings, self._say, self._due_ns = settings, say, 0
        self.sent = 0
        host, port = settings.start_to
        try:
            family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
            self._socket = socket.socket(family, socket.SOCK_DGRAM)
        except (OSError, UnicodeError) as error:
            problem = f"cannot send the start command to {host}:{port}: {error}"
            raise BusError(f"{problem}; try the network's broadcast address, such as 192.168.1.255:5000") from error
        self._address: Any = address
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        self._problem = ""

    def update(self, now_ns: int) -> None:
        """Send the command if it is due."""
        if now_ns < self._due_ns:
            return
        self._due_ns = now_ns + round(self._settings.start_every * NS_PER_S)
        try:
            self._socket.sendto(self._settings.start_text.encode("ascii"), self._address)
            self.sent += 1
        except OSError as error:
            if str(error) != self._problem:
                self._say(
                    f"the start command could not be sent to {address_text(self._address)}: {error}; trying again"
                )
            self._problem = str(error)

    def close(self) -> None:
        self._socket.close()
