"""The bridge step by step, without its thread: what each message changes, and nothing before it."""

from __future__ import annotations

import json
import selectors
import socket
from collections.abc import Iterator
from contextlib import ExitStack

import msgspec
import pytest
from support.messages import plain_frame

from mocapella.model.observations import BodyFrame
from mocapella.schema import MAX_MESSAGE_BYTES, encode_frame
from mocapella.schema.delimited import DelimitedReader, delimited
from mocapella.sources.bridge import Bridge, _Connection
from mocapella.sources.bridge_messages import BridgeStart


class Noted:
    """A relay that notes what it is told, and says what a test lets it say."""

    def __init__(self) -> None:
        self.told: list[tuple[str, str | int]] = []
        self.stored = 0
        self.problem: str | None = None

    def start(self, start: BridgeStart) -> int:
        self.told.append(("start", start.sensor))
        return 50

    def frame(self, frame: BodyFrame) -> None:
        self.told.append(("frame", frame.sequence))

    def acknowledged(self, _sensor: str) -> int:
        return self.stored

    def end(self, sensor: str) -> None:
        self.told.append(("end", sensor))

    def ended(self, _sensor: str) -> str | None:
        return self.problem

    def gone(self, sensor: str) -> None:
        self.told.append(("gone", sensor))


class Stepped:
    """A bridge whose thread is the test's."""

    def __init__(self, opened: ExitStack) -> None:
        self.relay, self.heard, self.left = Noted(), list[int](), list[str]()
        self._opened = opened
        self._selector = opened.enter_context(selectors.DefaultSelector())
        self._bridge = Bridge(
            lambda _sensor, frame, _data: self.heard.append(frame.sequence), on_gone=self.left.append, relay=self.relay
        )

    def connect(self) -> Program:
        own, other = (self._opened.enter_context(one) for one in socket.socketpair())
        for one in (own, other):
            one.setblocking(False)
        connection = _Connection(other, "a program", DelimitedReader(MAX_MESSAGE_BYTES), 0.0)
        self._selector.register(other, selectors.EVENT_READ, connection)
        return Program(self._bridge, self._selector, connection, own)


class Program:
    """A connected program."""

    def __init__(
        self, bridge: Bridge, selector: selectors.BaseSelector, connection: _Connection, own: socket.socket
    ) -> None:
        self._bridge, self._selector, self._connection, self._own = bridge, selector, connection, own

    def send(self, message: bytes) -> None:
        self._own.sendall(delimited(message))
        self._bridge._read(self._connection, self._selector)

    def close(self) -> None:
        self._own.shutdown(socket.SHUT_WR)
        self._bridge._read(self._connection, self._selector)

    def hears(self) -> list[str]:
        """The lines that the bridge writes in its next round."""
        if self._connection.relayed is not None and self._connection.socket.fileno() >= 0:
            self._bridge._acknowledge(self._connection, self._selector)
        try:
            return self._own.recv(4096).decode().splitlines()
        except BlockingIOError:
            return []


@pytest.fixture
def stepped() -> Iterator[Stepped]:
    with ExitStack() as opened:
        yield Stepped(opened)


def frame(sequence: int, sensor: str = "front") -> bytes:
    return encode_frame(
        msgspec.structs.replace(plain_frame(), sensor=sensor, node_id=9, sequence=sequence, time_ns=sequence)
    )


def said(say: str, **fields: object) -> bytes:
    return json.dumps({"say": say, **fields}).encode()


START = said("start", sensor="front", node_id=9, first=0, lost=0, next=0, now_ns=5)


def test_a_program_hears_that_its_sensor_has_left_once_and_not_before_it_has(stepped: Stepped) -> None:
    program = stepped.connect()
    program.send(START)
    assert program.hears() + program.hears() == ["window 50", "kept 0"]
    stepped.relay.problem = ""  # the program has not asked to leave
    assert program.hears() == []
    stepped.relay.problem = None
    program.send(said("end"))
    assert program.hears() == []
    stepped.relay.problem = ""
    assert program.hears() == ["ended"]
    assert program.hears() == []


def test_each_number_is_acknowledged_once_and_none_below_it(stepped: Stepped) -> None:
    program = stepped.connect()
    program.send(START)
    program.hears()
    program.hears()
    heard = []
    for stepped.relay.stored in (0, 1, 1, 4, 3, 4, 5):
        heard += program.hears()
    assert heard == ["kept 1", "kept 4", "kept 5"]
    program.send(said("here"))
    assert program.hears() == ["kept 5"]


def test_a_sensor_whose_frames_are_not_stored_has_not_ended_until_it_asks_to(stepped: Stepped) -> None:
    program = stepped.connect()
    program.send(START)
    program.hears()
    program.hears()
    stepped.relay.problem = "3 frames are not stored"
    assert program.hears() == []
    program.send(said("end"))
    assert program.hears() == ["3 frames are not stored"]
    assert stepped.relay.told[-1] == ("gone", "front")


def test_a_relayed_sensors_frames_and_end_are_the_relays_and_its_name_is_free_afterwards(stepped: Stepped) -> None:
    for _ in range(2):
        stepped.relay.told.clear()
        program = stepped.connect()
        program.send(START)
        program.send(frame(0))
        program.send(frame(1))
        program.close()
        assert stepped.relay.told == [("start", "front"), ("frame", 0), ("frame", 1), ("gone", "front")]
    assert (stepped.heard, stepped.left) == ([], [])


def test_of_a_program_that_asks_for_no_acknowledgements_the_relay_hears_nothing(stepped: Stepped) -> None:
    for _ in range(2):
        program = stepped.connect()
        program.send(frame(0))
        program.send(frame(0, "side"))
        program.send(frame(1))
        program.close()
    assert stepped.relay.told == []
    assert stepped.heard == [0, 0, 1] * 2
    assert stepped.left == ["front", "side"] * 2
