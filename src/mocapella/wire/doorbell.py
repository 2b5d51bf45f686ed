"""The doorbell: tells a program with a wrong key why a server does not admit it, and reports the attempt at the server.

TLS refuses such a program without a reason to either side. So it sends one UDP datagram, a *ring*, to the server's port
number, and gets the name of the server's session. Nothing in it is authenticated; it is used for messages only.
"""

from __future__ import annotations

import platform
import re
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Final

import msgspec

from mocapella.decoding import decode_json
from mocapella.errors import InputError
from mocapella.wire.address import Address, parse_address
from mocapella.wire.door import KeyedAddress
from mocapella.wire.role_key import fingerprint
from mocapella.wire.session_key import SessionKey

_RING_BYTES: Final = 512
"""Exact size of a ring [bytes]; an answer is shorter, so that forged senders cannot amplify traffic."""
_MOST_NOTES: Final = 32
_EVERY_S: Final = 0.02
"""Shortest time between two answers [s]."""
_SILENT: Final = (
    "a program listens at {address}, but does not answer as a server of the session {session}: it is no server, stands "
    "still, is of an earlier version (then start it with this one), or its UDP port is closed"
)
_UNSAFE: Final = re.compile(r"[^A-Za-z0-9_.+-]")


class Ring(msgspec.Struct, frozen=True):
    """Datagram of a program that TLS does not admit, as JSON: it asks the server for the reason.

    Attributes:
        session, fingerprint, user: name and authority (`fingerprint`) of the session of the program's key; its user.
        sensor: name of the sensor, if the program is a node; else empty.
        machine: name of the program's machine.
    """

    session: str
    fingerprint: str
    user: str
    sensor: str = ""
    machine: str = ""


class RingAnswer(msgspec.Struct, frozen=True):
    """The server's answer to a ring, as JSON.

    Attributes:
        session, fingerprint: name and authority (`mocapella.wire.role_key.fingerprint`) of the server's session.
        known: whether the server's session has the user of the ring.
    """

    session: str
    fingerprint: str
    known: bool


class Doorbell:
    """Answers rings on a thread of its own until `close`. If the UDP port is in use, it reports that and answers none.

    Args:
        address: address of the server.
        key: key of the server's session.
        note: called with a message at the first ring of each program with a wrong or unknown key, on that thread.
        guard: function that calls its argument, a function that answers a ring, and catches unexpected errors.

    Attributes:
        refused: number of rings with a wrong or unknown key.
    """

    def __init__(
        self,
        address: Address,
        key: SessionKey,
        note: Callable[[str], None],
        guard: Callable[[Callable[[], object]], object],
    ) -> None:
        self.refused = 0
        self._note, self._guard, self._noted = note, guard, set[str]()
        self._session, self._users = key.session, frozenset(key.issued)
        self._fingerprint = fingerprint(key.authority.certificate)
        self._ended = threading.Event()
        self._socket = _bound(address)
        if self._socket is None:
            note(f"port {address.port} on UDP is in use; programs with a wrong key are refused, but not told why")
        self._thread = threading.Thread(target=self._run, name="doorbell", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop answering, and end the thread."""
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        if self._socket is None:
            return
        with self._socket as bell:
            while not self._ended.is_set():
                try:
                    data, sender = bell.recvfrom(_RING_BYTES + 1)
                except OSError:  # nothing came, or the last sender has left
                    continue
                self._guard(partial(self._ring, bell, data, sender))

    def _ring(self, bell: socket.socket, data: bytes, sender: tuple[str, int]) -> None:
        answer = self._answer(data, str(sender[0]))
        if answer:
            with suppress(OSError):  # the sender has left
                bell.sendto(answer, sender)
            self._ended.wait(_EVERY_S)

    def _answer(self, data: bytes, host: str) -> bytes:
        if len(data) != _RING_BYTES:
            return b""
        try:
            ring = decode_json(data, Ring)
        except InputError:
            return b""
        answer = RingAnswer(self._session, self._fingerprint, ring.user in self._users)
        if ring.fingerprint != self._fingerprint or not answer.known:
            self._refuse(ring, host)
        return msgspec.json.encode(answer)

    def _refuse(self, ring: Ring, host: str) -> None:
        self.refused += 1
        session, user, sensor, machine = (
            _UNSAFE.sub("?", text)[:64] for text in (ring.session, ring.user, ring.sensor, ring.machine or host)
        )
        who = f'the sensor "{sensor}"' if sensor else f"a program ({user})"
        text = f"{who} on {machine} was refused: its key is of the session {session}, not of this server's"
        if text not in self._noted and len(self._noted) < _MOST_NOTES:
            self._noted.add(text)
            self._note(text)


def why_not(door: KeyedAddress, sensor: str = "") -> str:
    """Return why the program at an address does not admit the key, with the remedy.

    The text is empty if a server admits it, or if no program listens there. ``sensor`` is the name of the node's
    sensor, if this program is a node; the server's message names it.
    """
    key, mine = door.key, fingerprint(door.key.authority)
    address = parse_address(door.locator)
    answer = _ring(address, Ring(key.session[:40], mine, key.user, sensor, platform.node()[:64]))
    if answer is None:
        return _SILENT.format(address=door.locator, session=key.session) if _listens(address) else ""
    if answer.fingerprint != mine:
        theirs = _UNSAFE.sub("?", answer.session)[:40]
        other = theirs != key.session
        says = f"is of the session {theirs}" if other else f"has another key of the session {theirs}"
        yours = (
            f"connect to {theirs}@{door.locator} if that session is yours" if other else "start it again if it is yours"
        )
        return (
            f"the server at {door.locator} {says} and does not admit the key of the session {key.session} "
            f"({door.origin}); invite this program there (mocapella session invite), or {yours}"
        )
    if not answer.known:
        return f"the server at {door.locator} was started before the key {key.user} was made; start it again"
    return ""


def _listens(address: Address) -> bool:
    try:
        with socket.create_connection((address.bare_host, address.port), timeout=0.5):
            return True
    except OSError:
        return False


def _ring(address: Address, ring: Ring) -> RingAnswer | None:
    data = msgspec.json.encode(ring)
    try:
        family, kind, protocol, _, target = socket.getaddrinfo(address.bare_host, address.port, type=socket.SOCK_DGRAM)[
            0
        ]
        with socket.socket(family, kind, protocol) as bell:
            bell.settimeout(0.5)
            bell.connect(target)
            bell.send(data.ljust(_RING_BYTES))
            return decode_json(bell.recv(_RING_BYTES), RingAnswer)
    except (OSError, InputError):
        return None


def _bound(address: Address) -> socket.socket | None:
    try:
        family, kind, protocol, _, target = socket.getaddrinfo(address.bare_host, address.port, type=socket.SOCK_DGRAM)[
            0
        ]
        bell = socket.socket(family, kind, protocol)
        bell.settimeout(0.1)
        bell.bind(target)
    except OSError:
        return None
    return bell
