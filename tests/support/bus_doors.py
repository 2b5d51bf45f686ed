"""A server's end of the bus that keeps what reaches it, and programs that knock with any key."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import zenoh

from mocapella.live.launch import free_port
from mocapella.wire import keys
from mocapella.wire.delivery import FrameAnswer, FrameRequest
from mocapella.wire.door import KeyedAddress
from mocapella.wire.keys import NodeKey
from mocapella.wire.server import REQUEST_TIMEOUT_S, ServerLink
from mocapella.wire.session import open_client_at, open_node_at
from mocapella.wire.session_key import SessionKey


@dataclass
class OpenServer:
    """A `ServerLink` of a session.

    Attributes:
        address: with the session's name.
        link: of the server.
        key: of its session.
        frames: (sensor, bytes) that arrived live.
        commands: verbs that arrived.
        joined, left: nodes that asked so.
        notes: what it had to say.
    """

    address: str
    link: ServerLink
    key: SessionKey
    frames: list[tuple[str, bytes]] = field(default_factory=list)
    commands: list[str] = field(default_factory=list)
    joined: list[NodeKey] = field(default_factory=list)
    left: list[NodeKey] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def door(self, user: str, key: SessionKey | None = None) -> KeyedAddress:
        """The door as a user of this session, or of another one."""
        locator = self.address.rpartition("@")[2]
        return KeyedAddress(locator, (key or self.key).role_key(user, locator), "a test")

    def request(self, node: NodeKey, request: FrameRequest) -> tuple[list[bytes], list[FrameAnswer]]:
        """What answers to a request of the record path: frames, and the state of each node that says one."""
        frames: list[bytes] = []
        answers: list[FrameAnswer] = []
        ended = threading.Event()
        self.link.request_frames(node, request, lambda _, data, __: frames.append(data), answers.append, ended.set)
        assert ended.wait(REQUEST_TIMEOUT_S + 10.0)
        return frames, answers

    @contextmanager
    def program(self, user: str, *, peer: bool = False, key: SessionKey | None = None) -> Iterator[zenoh.Session]:
        """A program with the key of this user."""
        door = self.door(user, key)
        session = open_node_at(door) if peer else open_client_at(door)
        try:
            yield session
        finally:
            session.close()  # type: ignore[no-untyped-call]


@contextmanager
def open_server_of(key: SessionKey) -> Iterator[OpenServer]:
    """A server of this session at a free port, which answers every command with ``done``."""
    address = f"{key.session}@tls/127.0.0.1:{free_port()}"
    notes: list[str] = []
    link = ServerLink(address, on_nonsense=notes.append)
    server = OpenServer(address, link, key, notes=notes)
    link.serve(
        on_frame=lambda node, data, _: server.frames.append((node.sensor, data)),
        on_truth=lambda *_: None,
        on_alive=lambda *_: None,
        on_command=lambda verb, _, answer: (server.commands.append(verb), answer(b"done"))[1],
        on_join=lambda node, _, answer: (server.joined.append(node), answer(b"done"))[1],
        on_leave=lambda node, _, answer: (server.left.append(node), answer(b"done"))[1],
    )
    try:
        yield server
    finally:
        link.close()


def asks(session: zenoh.Session, key: str, timeout: float = 0.4, payload: bytes | None = None) -> list[bytes]:
    """The answers to a query."""
    replies = session.get(key, payload=payload, timeout=timeout)
    return [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]


def joins(session: zenoh.Session, node: NodeKey) -> bool:
    """Whether the server answers a node that joins: what was sent before has passed or was denied."""
    return asks(session, keys.of_node("join", node)) == [b"done"]
