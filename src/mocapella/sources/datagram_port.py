"""One camera's UDP port: choose its sender, and the datagram that becomes a frame.

UDP does not identify a sender, so the first sender with a readable datagram owns the port until it falls silent.
"""

from __future__ import annotations

import math
import socket
import time
from collections import Counter
from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np

from mocapella.conventions import NS_PER_S
from mocapella.model.markers import MarkerFrame, marker_frame
from mocapella.schema.marker_datagrams import DatagramError, MarkerDatagram, decode_marker_datagram
from mocapella.sources.datagram_settings import DatagramSettings, PortReport
from mocapella.sources.datagram_sockets import address_text, prepare, receive, socket_for

_MOST_READ: Final = 64
"""Largest number of datagrams read from a socket at a time."""
_MOST_DECODED: Final = 8
"""Largest number of waiting datagrams to decode, the newest first, until one is readable."""
_NEAR: Final = 1000
"""A sequence number farther than this from the last one means that the program has restarted."""
_CLOCK_WINDOW_NS: Final = 5 * NS_PER_S
_CLOCK_JUMP_NS: Final = NS_PER_S // 5
_OLDEST_NS: Final = NS_PER_S
"""Greatest plausible age of the kernel's arrival time; beyond it, the wall clock was set in between [ns]."""


class _Received(NamedTuple):
    """A datagram, its sender's address, and its arrival on the monotonic clock."""

    data: bytes
    source: Any
    at_ns: int


class DatagramPort:
    """One camera's port. It belongs to the first sender with a readable datagram, until that sender falls silent.

    Args:
        name: name of the camera.
        listener: bound, non-blocking UDP socket; the port owns and closes it.
        settings: the settings, for all cameras.
        say: receives messages about senders and refused datagrams.

    Attributes:
        name: as given.
        address: host and port of the listener.
        rests_until_ns: time on the monotonic clock before which the port is not read again.
        sender: address of the sender that the port belongs to; None if it belongs to none.
    """

    def __init__(
        self, name: str, listener: socket.socket, settings: DatagramSettings, say: Callable[[str], None]
    ) -> None:
        self.name, self._listener, self._settings, self._say = name, listener, settings, say
        self.address: tuple[str, int] = listener.getsockname()[:2]
        self.rests_until_ns = 0
        self.sender: Any = None
        self._own: socket.socket | None = None
        """The sender's own socket: datagrams of others go to the listener and cannot fill this one's buffer."""
        self._heard_ns = 0
        self._last_ns = 0
        self._sequence: int | None = None
        self._clock = SenderClock()
        self._counts: Counter[str] = Counter()
        self._refused: Counter[str] = Counter()
        self._overflowed: dict[socket.socket, int] = {}
        self._said: set[str] = set()
        self._last_problem = ""
        prepare(listener)

    @property
    def sockets(self) -> list[socket.socket]:
        """The sockets to wait for: the listener, and the present sender's own socket, if there is one."""
        return [self._listener] if self._own is None else [self._own, self._listener]

    @property
    def report(self) -> PortReport:
        """Counts of received and refused datagrams so far."""
        return PortReport(
            refused={str(problem): count for problem, count in self._refused.items()},
            overflowed=self._counts["overflowed"] + sum(self._overflowed.values()),
            sender="" if self.sender is None else address_text(self.sender),
            last_problem=self._last_problem,
            **{name: count for name, count in self._counts.items() if name != "overflowed"},
        )

    def close(self) -> None:
        """Close the sockets; the report stays."""
        self._let_go()
        self._listener.close()

    def release_silent_sender(self, now_ns: int) -> None:
        """Release a sender that has been silent for ``source_timeout`` seconds, so that another may take the port.

        Args:
            now_ns: the present time on the monotonic clock [ns].
        """
        if self.sender is None or now_ns - self._heard_ns <= self._settings.source_timeout * NS_PER_S:
            return
        self._say(f"{self.name}: nothing from {address_text(self.sender)} any more; waiting for any sender")
        self._let_go()

    def turn(self, now_ns: int) -> MarkerFrame | None:
        """Read the waiting datagrams without blocking, and decode the newest readable one into a frame.

        Older waiting datagrams are counted as superseded. None is returned if none is readable, or if the newest one's
        sequence number does not rise and is not that of a restarted program.

        Args:
            now_ns: the present time on the monotonic clock [ns].
        """
        self.rests_until_ns = now_ns + round(NS_PER_S / self._settings.max_rate_hz)
        waiting = sorted((one for each in self.sockets for one in self._read(each)), key=lambda one: one.at_ns)
        if self.sender is not None:
            own = [one for one in waiting if self._is_sender(one.source)]
            self._count_others(len(waiting) - len(own))
            waiting = own
        newest, datagram = self._newest_of(waiting)
        if newest is None or datagram is None:
            self._counts["superseded"] += len(waiting)
            return None
        if self.sender is None:
            self._belong_to(newest.source)
        older = sum(self._is_sender(one.source) for one in waiting)
        self._count_others(len(waiting) - older)
        self._counts["superseded"] += older
        if not self._in_order(datagram, older):
            return None
        self._heard_ns = now_ns
        return self._frame(datagram, newest.at_ns)

    def _newest_of(self, waiting: list[_Received]) -> tuple[_Received | None, MarkerDatagram | None]:
        """Decode the newest readable datagram; it and the unreadable newer ones are removed from the list."""
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
            self._last_problem = f"{address_text(one.source)}: {error}"
            self._say_once(error.problem, f"{self.name}: refused a datagram from {self._last_problem}")
            return None

    def _in_order(self, datagram: MarkerDatagram, skipped: int) -> bool:
        """Count repeated, late and missing sequence numbers; False for a repeated or late one."""
        last, now = self._sequence, datagram.sequence
        if last is not None and now is not None and -_NEAR <= now - last <= 0:
            self._counts["out_of_order" if now < last else "repeated"] += 1
            return False
        if last is not None and now is not None and 0 < now - last <= _NEAR:
            self._counts["missing"] += max(0, now - last - 1 - skipped)
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
        self.sender, self._sequence, self._clock = sender, None, SenderClock()
        self._own = None if self._settings.by_host else socket_for(self._listener, sender)
        self._counts["senders"] += 1
        self._said.clear()
        self._say(f"{self.name}: hears {address_text(sender)}")

    def _let_go(self) -> None:
        if self._own is not None:
            self._counts["overflowed"] += self._overflowed.pop(self._own, 0)
            self._own.close()
        self.sender = self._own = None

    def _count_others(self, count: int) -> None:
        if count:
            self._counts["other_senders"] += count
            text = f"{self.name}: others send to its port, too; it belongs to {address_text(self.sender)}"
            self._say_once(
                "other", f"{text} (a program that opens a socket for each datagram needs --set by_host=true)"
            )

    def _say_once(self, topic: str, text: str) -> None:
        if topic not in self._said:
            self._said.add(topic)
            self._say(text)

    def _read(self, from_socket: socket.socket) -> list[_Received]:
        found = []
        since_ns = time.monotonic_ns() - time.time_ns()  # the kernel stamps arrivals on the wall clock
        for _ in range(_MOST_READ):
            try:
                data, source, stamp_ns, dropped = receive(from_socket)
            except (BlockingIOError, InterruptedError):
                break
            except OSError:  # some systems report a closed port at the other end here
                continue
            now_ns = time.monotonic_ns()
            at_ns = now_ns if stamp_ns is None else stamp_ns + since_ns
            found.append(_Received(data, source, at_ns if now_ns - _OLDEST_NS < at_ns <= now_ns else now_ns))
            if dropped is not None:
                self._overflowed[from_socket] = dropped
        return found


class SenderClock:
    """Converts times of a sender's clock to this machine's clock, by the least delay of the last 5 to 10 s.

    With this window, clocks whose rates differ by 50 parts in a million cause an error of at most half a millisecond.
    """

    def __init__(self) -> None:
        self._began_ns: int | None = None
        self._least_ns = self._least_before_ns = math.inf

    def at(self, sent_ns: int, arrived_ns: int) -> tuple[int, bool]:
        """Convert a time of sending.

        Args:
            sent_ns: time of sending, on the sender's clock [ns].
            arrived_ns: time of arrival, on this machine's clock [ns].

        Returns:
            The time of sending on this machine's clock [ns], never after the arrival; and whether the sender's clock
            jumped, by more than 0.2 s. After a jump, as for the first datagram, the time of sending is the arrival.
        """
        delay_ns = arrived_ns - sent_ns
        least_ns = min(self._least_ns, self._least_before_ns)
        jumped = self._began_ns is not None and abs(delay_ns - least_ns) > _CLOCK_JUMP_NS
        if self._began_ns is None or jumped:
            self._began_ns, self._least_ns, self._least_before_ns = arrived_ns, delay_ns, math.inf
        elif arrived_ns - self._began_ns > _CLOCK_WINDOW_NS:
            self._began_ns, self._least_ns, self._least_before_ns = arrived_ns, delay_ns, self._least_ns
        self._least_ns = min(self._least_ns, delay_ns)
        return sent_ns + int(min(self._least_ns, self._least_before_ns)), jumped
