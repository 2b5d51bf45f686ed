"""Cameras that are programs of their own, such as a Raspberry Pi's, each sending its markers to a UDP port as text.

UDP tells neither who sends, nor when, nor in which order, and its ports take whatever anybody sends. So a port belongs
to its first sender whose datagrams can be read, until that one is silent; of several datagrams that wait, the newest is
taken; and each port is looked at no more often than its rate, reading no more than so many each time. What is not
taken is counted by reason. `mocapella.schema.marker_datagrams` reads the text.
"""

from __future__ import annotations

import contextlib
import math
import select
import socket
import struct
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import numpy as np

from mocapella.conventions import NS_PER_S
from mocapella.errors import BusError
from mocapella.model.markers import MarkerFrame, marker_frame
from mocapella.model.observations import check_sensor_name
from mocapella.schema.marker_datagrams import (
    MAX_DATAGRAM_BYTES,
    MAX_MARKERS,
    DatagramError,
    MarkerDatagram,
    decode_marker_datagram,
)
from mocapella.settings import check
from mocapella.sources.bound_socket import bound_socket

_MOST_READ: Final = 64
"""Datagrams of a socket at a time."""
_MOST_DECODED: Final = 8
"""Of these, from the newest on, until one can be read."""
_BUFFER_BYTES: Final = 16 * 1024
"""Of the system for a socket: some forty datagrams, so that what waits is read at once and is not old."""
_NEAR: Final = 1000
"""A sequence number so far behind or before the last is of another start of the program."""
_CLOCK_WINDOW_NS: Final = 5 * NS_PER_S
_CLOCK_JUMP_NS: Final = NS_PER_S // 5
_OLDEST_NS: Final = NS_PER_S
"""A kernel's time of arrival that is older was told while somebody set the clock."""
# Of asm-generic/socket.h; Python names neither.
_SO_TIMESTAMPNS: Final = 35
_SO_RXQ_OVFL: Final = 40
_TIMESPEC: Final = struct.Struct("@ll")
_LINUX: Final = sys.platform == "linux"


@dataclass(frozen=True)
class DatagramSettings:
    """Which cameras send where, and what is believed.

    Attributes:
        cameras: name and UDP port of each; port 0 takes any free one.
        markers: names, in the order of a datagram's pairs.
        size_px: (width, height) of the pictures.
        host: address of this machine to listen at; 0.0.0.0 listens at all.
        sd_px: standard deviation of a coordinate; 0 where it is not known.
        delay: from the middle of a picture's exposure to its datagram's arrival [s].
        zero_is_lost: whether ``0,0`` is a marker that is not seen.
        max_rate_hz: a port is looked at no more often, and no more frames come from it.
        by_host: a sender is a machine, whatever port it sends from: of programs that open a socket for each datagram.
        source_timeout: after so long without a datagram from its sender a port takes another one [s].
        start_to: address and port of the start command; None sends none.
        start_text: what it says.
        start_every: how often it is repeated while a camera is silent [s].
    """

    cameras: tuple[tuple[str, int], ...]
    markers: tuple[str, ...]
    size_px: tuple[int, int] = (640, 480)
    host: str = "127.0.0.1"
    sd_px: float = 0.0
    delay: float = 0.0
    zero_is_lost: bool = False
    max_rate_hz: float = 250.0
    by_host: bool = False
    source_timeout: float = 2.0
    start_to: tuple[str, int] | None = None
    start_text: str = "start"
    start_every: float = 1.0

    def __post_init__(self) -> None:
        names, ports = [name for name, _ in self.cameras], [port for _, port in self.cameras if port]
        check(1 <= len(names) == len(set(names)) <= 32, "cameras", names, "1 to 32, each with a name of its own")
        check(len(ports) == len(set(ports)), "cameras", ports, "each at a port of its own")
        for name, port in self.cameras:
            check_sensor_name(name)
            check(0 <= port <= 65535, f"port of {name}", port, "from 0 to 65535")
        n = len(self.markers)
        check(1 <= n <= MAX_MARKERS, "markers", n, f"1 to {MAX_MARKERS} names")
        told = len(set(self.markers)) == n and all(0 < len(name) <= 80 for name in self.markers)
        check(told, "markers", self.markers, "names of 1 to 80 characters, each once")
        check(all(0 < side <= 16_384 for side in self.size_px), "size_px", self.size_px, "1 to 16384 pixels each")
        check(0 <= self.sd_px <= 100, "sd_px", self.sd_px, "from 0 to 100 px")
        check(0 <= self.delay <= 1, "delay", self.delay, "from 0 to 1 s")
        check(1 <= self.max_rate_hz <= 1000, "max_rate_hz", self.max_rate_hz, "from 1 to 1000 Hz")
        check(0 < self.source_timeout <= 3600, "source_timeout", self.source_timeout, "above 0 and at most 3600 s")
        check(0.05 <= self.start_every <= 3600, "start_every", self.start_every, "from 0.05 to 3600 s")
        fits = self.start_text.isascii() and 0 < len(self.start_text) <= MAX_DATAGRAM_BYTES
        check(fits, "start_text", self.start_text, f"1 to {MAX_DATAGRAM_BYTES} ASCII characters")
        if self.start_to is not None:
            check(0 < self.start_to[1] <= 65535, "port of start_to", self.start_to[1], "from 1 to 65535")


@dataclass(frozen=True)
class PortReport:
    """What came to one camera's port. Every datagram that was read is in one of the first six.

    Attributes:
        frames: passed on.
        refused: could not be read, by reason.
        superseded: not looked at, for a newer one waited.
        other_senders: from somebody else than the port's sender.
        out_of_order: older than the one before, by their sequence numbers.
        repeated: with the sequence number of the one before.
        missing: numbers that were left out, of programs that number.
        overflowed: dropped by this machine before they could be read, as far as it tells.
        clock_jumps: of the sender's clock, of programs that tell times.
        senders: how many the port has belonged to, one after the other.
        sender: to whom it belongs; empty where to nobody.
        last_problem: why the last was refused.
    """

    frames: int = 0
    refused: dict[str, int] = field(default_factory=dict)
    superseded: int = 0
    other_senders: int = 0
    out_of_order: int = 0
    repeated: int = 0
    missing: int = 0
    overflowed: int = 0
    clock_jumps: int = 0
    senders: int = 0
    sender: str = ""
    last_problem: str = ""


class _Received(NamedTuple):
    """A datagram, from whom, and when it arrived on the monotonic clock."""

    data: bytes
    source: Any
    at_ns: int


class MarkerDatagrams:
    """Listens from `start` to `stop`. Needs no thread: `poll` waits, and gives the frames that have come.

    Args:
        settings: which cameras.
        say: is told in words who sends and what is wrong, each kind once for each camera and sender.
        clock: monotonic, in ns.
    """

    def __init__(
        self,
        settings: DatagramSettings,
        say: Callable[[str], None] = lambda text: None,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._settings, self._say, self._clock = settings, say, clock
        self._ports: list[_Port] = []
        self._starter: _Starter | None = None

    def start(self) -> None:
        """Begin to listen.

        Raises:
            AddressInUseError: another program listens at one of the ports.
            BusError: the address is none of this machine, or the start command's is none.
        """
        s = self._settings
        try:
            for name, port in s.cameras:
                self._ports.append(_Port(name, bound_socket(s.host, port, socket.SOCK_DGRAM), s, self._say))
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
        """Host and port of each camera, after `start`."""
        return {port.name: port.address for port in self._ports}

    @property
    def report(self) -> dict[str, PortReport]:
        """What came for each camera so far."""
        return {port.name: port.report for port in self._ports}

    @property
    def starts_sent(self) -> int:
        """How often the start command was sent."""
        return 0 if self._starter is None else self._starter.sent

    def poll(self, timeout: float = 0.0) -> list[MarkerFrame]:
        """The frames that have come, in the order of the cameras; waits for one so many seconds at most.

        A frame's ``time_ns`` is on the monotonic clock; node and sequence number are left to who publishes it.
        """
        until_ns = self._clock() + round(timeout * NS_PER_S)
        while True:
            now_ns = self._clock()
            for port in self._ports:
                port.let_go_of_the_silent(now_ns)
            if self._starter is not None and any(port.sender is None for port in self._ports):
                self._starter.update(now_ns)
            resting = [port.rests_until_ns for port in self._ports if port.rests_until_ns > now_ns]
            waking = {one: port for port in self._ports if port.rests_until_ns <= now_ns for one in port.sockets}
            wait_ns = max(0, min([until_ns, *resting]) - now_ns)
            ready = _readable(list(waking), wait_ns / NS_PER_S)
            found = [port.turn(self._clock()) for port in dict.fromkeys(waking[one] for one in ready)]
            frames = [frame for frame in found if frame is not None]
            if frames or self._clock() >= until_ns:
                return frames


class _Port:
    """One camera's port, and whose it is."""

    def __init__(
        self, name: str, listener: socket.socket, settings: DatagramSettings, say: Callable[[str], None]
    ) -> None:
        self.name, self._listener, self._settings, self._say = name, listener, settings, say
        self.address: tuple[str, int] = listener.getsockname()[:2]
        self.rests_until_ns = 0
        self.sender: Any = None
        self._own: socket.socket | None = None
        """The sender's: what others send to the port goes to the listener, and cannot fill this one's buffer."""
        self._heard_ns = 0
        self._last_ns = 0
        self._sequence: int | None = None
        self._clock = _SenderClock()
        self._counts: Counter[str] = Counter()
        self._refused: Counter[str] = Counter()
        self._overflowed: dict[socket.socket, int] = {}
        self._said: set[str] = set()
        self._last_problem = ""
        _prepare(listener)

    @property
    def sockets(self) -> list[socket.socket]:
        return [self._listener] if self._own is None else [self._own, self._listener]

    @property
    def report(self) -> PortReport:
        return PortReport(
            refused={str(problem): count for problem, count in self._refused.items()},
            overflowed=self._counts["overflowed"] + sum(self._overflowed.values()),
            sender="" if self.sender is None else _told(self.sender),
            last_problem=self._last_problem,
            **{name: count for name, count in self._counts.items() if name != "overflowed"},
        )

    def close(self) -> None:
        self._let_go()
        self._listener.close()

    def let_go_of_the_silent(self, now_ns: int) -> None:
        """A sender that has been silent for too long, so that another may come."""
        if self.sender is None or now_ns - self._heard_ns <= self._settings.source_timeout * NS_PER_S:
            return
        self._say(f"{self.name}: nothing from {_told(self.sender)} any more; waiting for any sender")
        self._let_go()

    def turn(self, now_ns: int) -> MarkerFrame | None:
        """Read what waits, and make a frame of the newest that can be read."""
        self.rests_until_ns = now_ns + round(NS_PER_S / self._settings.max_rate_hz)
        waiting = sorted((one for each in self.sockets for one in self._read(each)), key=lambda one: one.at_ns)
        if self.sender is not None:
            own = [one for one in waiting if self._is_sender(one.source)]
            self._pass_over_strangers(len(waiting) - len(own))
            waiting = own
        newest, datagram = self._newest_of(waiting)
        if newest is None or datagram is None:
            self._counts["superseded"] += len(waiting)
            return None
        if self.sender is None:
            self._belong_to(newest.source)
        older = sum(self._is_sender(one.source) for one in waiting)
        self._pass_over_strangers(len(waiting) - older)
        self._counts["superseded"] += older
        if not self._in_order(datagram, older):
            return None
        self._heard_ns = now_ns
        return self._frame(datagram, newest.at_ns)

    def _newest_of(self, waiting: list[_Received]) -> tuple[_Received | None, MarkerDatagram | None]:
        """The newest that can be read; it and those that came later, which cannot, are taken from the list."""
        for _ in range(min(len(waiting), _MOST_DECODED)):
            newest = waiting.pop()
            datagram = self._decode(newest)
            if datagram is not None:
                return newest, datagram
        return None, None

    def _is_sender(self, source: Any) -> bool:
        return bool(source[0] == self.sender[0]) and (self._settings.by_host or bool(source == self.sender))

    def _decode(self, one: _Received) -> MarkerDatagram | None:
        s = self._settings
        try:
            return decode_marker_datagram(one.data, s.markers, s.size_px, zero_is_lost=s.zero_is_lost)
        except DatagramError as error:
            self._refused[error.problem] += 1
            self._last_problem = f"{_told(one.source)}: {error}"
            self._say_once(error.problem, f"{self.name}: refused a datagram from {self._last_problem}")
            return None

    def _in_order(self, datagram: MarkerDatagram, passed_over: int) -> bool:
        """Whether a numbered datagram comes after the last one; counts those that are missing."""
        last, now = self._sequence, datagram.sequence
        if last is not None and now is not None and -_NEAR <= now - last <= 0:
            self._counts["out_of_order" if now < last else "repeated"] += 1
            return False
        if last is not None and now is not None and 0 < now - last <= _NEAR:
            self._counts["missing"] += max(0, now - last - 1 - passed_over)
        self._sequence = now
        return True

    def _frame(self, datagram: MarkerDatagram, arrived_ns: int) -> MarkerFrame:
        s = self._settings
        at_ns = arrived_ns
        if datagram.time_us is not None:
            at_ns, jumped = self._clock.at(1000 * datagram.time_us, arrived_ns)
            self._counts["clock_jumps"] += jumped
        self._last_ns = max(at_ns - round(s.delay * NS_PER_S), self._last_ns + 1)
        self._counts["frames"] += 1
        return marker_frame(
            self.name,
            s.markers,
            time_ns=self._last_ns,
            size_px=s.size_px,
            positions_px=datagram.positions_px,
            sd_px=s.sd_px or np.nan,
        )

    def _belong_to(self, sender: Any) -> None:
        self.sender, self._sequence, self._clock = sender, None, _SenderClock()
        self._own = None if self._settings.by_host else _socket_for(self._listener, sender)
        self._counts["senders"] += 1
        self._said.clear()
        self._say(f"{self.name}: hears {_told(sender)}")

    def _let_go(self) -> None:
        if self._own is not None:
            self._counts["overflowed"] += self._overflowed.pop(self._own, 0)
            self._own.close()
        self.sender = self._own = None

    def _pass_over_strangers(self, count: int) -> None:
        if count:
            self._counts["other_senders"] += count
            text = f"{self.name}: others send to its port, too; it belongs to {_told(self.sender)}"
            self._say_once("other", f"{text} (a program that opens a socket for each datagram wants --by-host)")

    def _say_once(self, what: str, text: str) -> None:
        if what not in self._said:
            self._said.add(what)
            self._say(text)

    def _read(self, from_socket: socket.socket) -> list[_Received]:
        found = []
        since_ns = time.monotonic_ns() - time.time_ns()  # the kernel tells arrivals on the clock of the day
        for _ in range(_MOST_READ):
            try:
                data, source, told_ns, dropped = _receive(from_socket)
            except (BlockingIOError, InterruptedError):
                break
            except OSError:  # an answer to a port that is closed, on some systems
                continue
            now_ns = time.monotonic_ns()
            at_ns = now_ns if told_ns is None else told_ns + since_ns
            found.append(_Received(data, source, at_ns if now_ns - _OLDEST_NS < at_ns <= now_ns else now_ns))
            if dropped is not None:
                self._overflowed[from_socket] = dropped
        return found


class _SenderClock:
    """A sender's times on ours: the least delay of the last seconds is taken for the one that there always is.

    With a window of some seconds, crystals that differ by 50 parts in a million cost a quarter of a millisecond.
    """

    def __init__(self) -> None:
        self._began_ns: int | None = None
        self._least_ns = self._least_before_ns = math.inf

    def at(self, sent_ns: int, arrived_ns: int) -> tuple[int, bool]:
        """When it was sent, on our clock and never after it arrived; and whether the sender's clock was set anew."""
        delay_ns = arrived_ns - sent_ns
        least_ns = min(self._least_ns, self._least_before_ns)
        jumped = self._began_ns is not None and abs(delay_ns - least_ns) > _CLOCK_JUMP_NS
        if self._began_ns is None or jumped:
            self._began_ns, self._least_ns, self._least_before_ns = arrived_ns, delay_ns, math.inf
        elif arrived_ns - self._began_ns > _CLOCK_WINDOW_NS:
            self._began_ns, self._least_ns, self._least_before_ns = arrived_ns, delay_ns, self._least_ns
        self._least_ns = min(self._least_ns, delay_ns)
        return sent_ns + int(min(self._least_ns, self._least_before_ns)), jumped


class _Starter:
    """Tells programs that wait for it to begin."""

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
        """Send it if it is time."""
        if now_ns < self._due_ns:
            return
        self._due_ns = now_ns + round(self._settings.start_every * NS_PER_S)
        try:
            self._socket.sendto(self._settings.start_text.encode("ascii"), self._address)
            self.sent += 1
        except OSError as error:
            if str(error) != self._problem:
                self._say(f"the start command could not be sent to {_told(self._address)}: {error}; trying again")
            self._problem = str(error)

    def close(self) -> None:
        self._socket.close()


def _prepare(listener: socket.socket) -> None:
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
    if _LINUX:
        for option in (_SO_TIMESTAMPNS, _SO_RXQ_OVFL):
            with contextlib.suppress(OSError):  # without it the time of reading is taken, and drops are not counted
                listener.setsockopt(socket.SOL_SOCKET, option, 1)


def _socket_for(listener: socket.socket, sender: Any) -> socket.socket | None:
    """A second socket at the listener's port that only this sender's datagrams reach; None where there is none such.

    Linux hands a datagram to the socket that is connected to its sender, if there is one. The option that lets two
    sockets share the port is on for this moment only, so that no other program can share it.
    """
    if not _LINUX:
        return None
    own = socket.socket(listener.family, socket.SOCK_DGRAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        own.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        own.setblocking(False)
        _prepare(own)
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


def _readable(sockets: list[socket.socket], timeout: float) -> list[socket.socket]:
    if not sockets:  # which some systems' select refuses
        time.sleep(timeout)
        return []
    return select.select(sockets, [], [], timeout)[0]


def _receive(from_socket: socket.socket) -> tuple[bytes, Any, int | None, int | None]:
    """A datagram, its sender, when it arrived on the clock of the day [ns], and how many were dropped before it.

    One that is too long comes with one byte more than is read of any.
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


def _told(address: Any) -> str:
    return f"{address[0]}:{address[1]}"
