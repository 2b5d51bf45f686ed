"""The bridge with real sockets: what is right comes through, what is wrong ends only its own connection."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import msgspec
import numpy as np
import pytest
from support.messages import plain_frame

from mocapella.errors import AddressInUseError, BusError, MocapellaError, NameTakenError, SettingsError, WireError
from mocapella.model.observations import BodyFrame
from mocapella.schema import encode_frame
from mocapella.schema.delimited import delimited
from mocapella.sources.bridge import Bridge, BridgeSettings
from mocapella.sources.bridge_messages import BridgeEnd, BridgeHere, BridgeStart, read_message

PATIENCE_S = 20.0
"""How long a test waits for what must come; nothing waits this long when all is well."""


class Heard:
    """What the bridge passed on, and a way to wait for it."""

    def __init__(self) -> None:
        self.frames: list[tuple[str, BodyFrame, bytes]] = []
        self.gone: list[str] = []
        self._changed = threading.Condition()

    def on_frame(self, sensor: str, frame: BodyFrame, data: bytes) -> None:
        with self._changed:
            self.frames.append((sensor, frame, data))
            self._changed.notify_all()

    def on_gone(self, sensor: str) -> None:
        with self._changed:
            self.gone.append(sensor)
            self._changed.notify_all()

    def wait(self, condition: Callable[[], bool]) -> None:
        with self._changed:
            assert self._changed.wait_for(condition, PATIENCE_S)

    def sequences(self, sensor: str) -> list[int]:
        return [frame.sequence for name, frame, _ in self.frames if name == sensor]


@contextmanager
def bridge(heard: Heard, **changed: float) -> Iterator[Bridge]:
    settings = BridgeSettings(**{"port": 0, **changed})  # type: ignore[arg-type]
    with Bridge(heard.on_frame, settings, heard.on_gone) as running:
        yield running


@contextmanager
def connected(running: Bridge) -> Iterator[socket.socket]:
    with socket.create_connection(running.address, timeout=PATIENCE_S) as client:
        yield client


def answer(client: socket.socket) -> str:
    """What the bridge says before it closes the connection."""
    said = b""
    while piece := client.recv(4096):
        said += piece
    return said.decode()


def packet(sensor: str = "front", sequence: int = 0, *, node_id: int = 9, time_ns: int | None = None) -> bytes:
    frame = msgspec.structs.replace(
        plain_frame(),
        sensor=sensor,
        sequence=sequence,
        node_id=node_id,
        time_ns=sequence if time_ns is None else time_ns,
    )
    return delimited(encode_frame(frame))


def test_a_frame_comes_through_as_it_was_sent() -> None:
    heard = Heard()
    with bridge(heard) as running, connected(running) as client:
        client.sendall(packet())
        heard.wait(lambda: len(heard.frames) == 1)
    sensor, frame, data = heard.frames[0]
    assert sensor == frame.sensor == "front"
    assert delimited(data) == packet()
    np.testing.assert_array_equal(frame.positions, plain_frame().positions)
    assert running.report.frames == 1


def test_pieces_of_any_size_are_put_together() -> None:
    heard, stream = Heard(), b"".join(packet(sequence=i) for i in range(3))
    with bridge(heard) as running, connected(running) as client:
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for at in range(0, len(stream), 7):
            client.sendall(stream[at : at + 7])
        heard.wait(lambda: len(heard.frames) == 3)
    assert heard.sequences("front") == [0, 1, 2]


def test_two_sensors_at_once_and_one_that_leaves() -> None:
    heard = Heard()
    with bridge(heard) as running, connected(running) as front, connected(running) as left:
        for i in range(5):
            front.sendall(packet("front", i))
            left.sendall(packet("left", i))
        heard.wait(lambda: len(heard.frames) == 10)
        left.close()
        heard.wait(lambda: heard.gone == ["left"])
        front.sendall(packet("front", 5))
        heard.wait(lambda: len(heard.frames) == 11)
    assert heard.sequences("front") == [0, 1, 2, 3, 4, 5]
    assert heard.sequences("left") == [0, 1, 2, 3, 4]
    assert heard.gone == ["left", "front"]
    assert running.report.connections == 0


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        (b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n" * 4, "no BodyFrame message"),
        (b"\xff" * 100, "no length before the message"),
        (delimited(b""), "does not say its schema version"),
        (b"\x81\x80\x80\x08", "16777217 bytes is announced; at most 16777216"),
        (packet("no such/name"), "sensor name 'no such/name'"),
        (packet(node_id=0), "BodyFrame.node_id is 0; take a random number"),
        (packet(sequence=3) + packet(sequence=3), "BodyFrame.sequence is 3 after 3"),
        (packet(sequence=3) + packet(sequence=2), "BodyFrame.sequence is 2 after 3"),
        (packet(sequence=3, time_ns=9) + packet(sequence=4, time_ns=8), "BodyFrame.time_ns is 8 after 9"),
        (packet(sequence=3, time_ns=9) + packet(sequence=4, time_ns=9), "BodyFrame.time_ns is 9 after 9"),
    ],
)
def test_what_is_wrong_ends_its_own_connection_and_says_why(wrong: bytes, why: str) -> None:
    heard = Heard()
    with bridge(heard) as running, connected(running) as good, connected(running) as bad:
        good.sendall(packet("other", 0))
        bad.sendall(wrong)
        assert why in answer(bad)
        good.sendall(packet("other", 1))
        heard.wait(lambda: heard.sequences("other") == [0, 1])
        assert running.report.refused == 1
        assert why in running.report.last_problem


def test_a_program_that_starts_again_counts_anew() -> None:
    heard = Heard()
    with bridge(heard) as running, connected(running) as client:
        client.sendall(packet(sequence=7, node_id=1) + packet(sequence=0, node_id=2))
        heard.wait(lambda: heard.sequences("front") == [7, 0])


def test_a_sensor_that_is_served_already_is_refused_until_it_is_free() -> None:
    heard = Heard()
    with bridge(heard) as running:
        with connected(running) as first, connected(running) as second:
            first.sendall(packet())
            heard.wait(lambda: len(heard.frames) == 1)
            second.sendall(packet())
            assert "sensor front is served by 127.0.0.1:" in answer(second)
        heard.wait(lambda: heard.gone == ["front"])
        with connected(running) as third:
            third.sendall(packet())
            heard.wait(lambda: len(heard.frames) == 2)


def test_the_receiver_may_refuse_a_frame() -> None:
    def refuse(*_: object) -> None:
        raise NameTakenError("another node serves front")

    gone: list[str] = []
    with Bridge(refuse, BridgeSettings(port=0), gone.append) as running, connected(running) as client:
        client.sendall(packet())
        assert answer(client) == "another node serves front\n"
    assert gone == ["front"]
    assert (running.report.frames, running.report.refused) == (0, 1)


def test_an_unexpected_error_ends_its_own_connection_and_is_counted() -> None:
    heard, said = Heard(), list[str]()

    def on_frame(sensor: str, frame: BodyFrame, data: bytes) -> None:
        if sensor == "bad":
            raise ZeroDivisionError("planted")
        heard.on_frame(sensor, frame, data)

    with Bridge(on_frame, BridgeSettings(port=0), heard.on_gone, said.append) as running:
        with connected(running) as good, connected(running) as bad:
            bad.sendall(packet("bad"))
            assert answer(bad) == "an unexpected error of the bridge\n"
            good.sendall(packet("good"))
            heard.wait(lambda: heard.sequences("good") == [0])
        assert running.report.errors == 1
    assert said == ["unexpected error (message): ZeroDivisionError: planted"]


def test_a_message_that_never_ends_is_given_up() -> None:
    heard = Heard()
    with bridge(heard, message_timeout=0.2) as running, connected(running) as slow, connected(running) as good:
        slow.sendall(packet()[:100])
        assert answer(slow) == "a message was not complete after 0.2 s\n"
        good.sendall(packet())
        heard.wait(lambda: len(heard.frames) == 1)
        assert running.report.timed_out == 1


def test_whoever_says_nothing_is_given_up() -> None:
    with bridge(Heard(), idle_timeout=0.2) as running, connected(running) as client:
        assert answer(client) == "no message for 0.2 s\n"


def test_one_connection_too_many_is_turned_away() -> None:
    heard = Heard()
    with bridge(heard, max_connections=1) as running, connected(running) as first:
        first.sendall(packet())
        heard.wait(lambda: len(heard.frames) == 1)
        with connected(running) as second:
            assert answer(second) == "there are 1 connections already\n"
        first.sendall(packet(sequence=1))
        heard.wait(lambda: len(heard.frames) == 2)


def test_a_connection_that_brings_ever_more_sensors_is_ended() -> None:
    heard = Heard()
    with bridge(heard, max_sensors=2) as running, connected(running) as client:
        for sensor, sequence in (("a", 0), ("b", 0), ("a", 1), ("c", 0)):
            client.sendall(packet(sensor, sequence))
        assert answer(client) == "a connection serves at most 2 sensors; open one for each\n"
        heard.wait(lambda: sorted(heard.gone) == ["a", "b"])
        assert [name for name, _, _ in heard.frames] == ["a", "b", "a"]


def test_stopping_closes_every_connection_and_frees_the_port() -> None:
    heard = Heard()
    running = Bridge(heard.on_frame, BridgeSettings(port=0))
    running.start()
    with connected(running) as client:
        client.sendall(packet())
        heard.wait(lambda: len(heard.frames) == 1)
        host, port = running.address
        running.stop()
        running.stop()
        assert client.recv(1) == b""
    with Bridge(heard.on_frame, BridgeSettings(host, port)) as again:
        assert again.address == (host, port)


def test_a_port_in_use_is_named() -> None:
    with bridge(Heard()) as running:
        host, port = running.address
        with pytest.raises(AddressInUseError, match=f"{host}:{port} is in use by another program"):
            Bridge(Heard().on_frame, BridgeSettings(port=port)).start()


@pytest.mark.parametrize("host", ["x" * 70, "192.0.2.1"])
def test_an_address_of_no_interface_here_is_named(host: str) -> None:
    with pytest.raises(BusError, match=f"cannot listen at {host}:0"):
        Bridge(Heard().on_frame, BridgeSettings(host, 0)).start()


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("port", -1),
        ("port", 65536),
        ("max_connections", 0),
        ("max_sensors", 0),
        ("max_message_bytes", 0),
        ("max_message_bytes", 2**25),
    ],
)
def test_settings_out_of_range_are_refused(field: str, value: int) -> None:
    with pytest.raises(SettingsError, match=f"{field} is {value}; it must be"):
        BridgeSettings(**{field: value})  # type: ignore[arg-type]


@pytest.mark.parametrize("field", ["message_timeout", "idle_timeout"])
def test_no_patience_at_all_is_refused(field: str) -> None:
    with pytest.raises(SettingsError, match=f"{field} is 0.0; it must be above 0 s"):
        BridgeSettings(**{field: 0.0})  # type: ignore[arg-type]


class Kept:
    """In place of the part that serves sensors with acknowledgements: everything is kept, and a test says how far."""

    def __init__(self) -> None:
        self.starts: list[BridgeStart] = []
        self.frames: list[int] = []
        self.ends: list[str] = []
        self.left: list[str] = []
        self.stored = 0
        self.problem: str | None = None
        self.refusal: MocapellaError | None = None
        self.changed = threading.Event()

    def start(self, start: BridgeStart) -> int:
        if start.sensor == "closing":
            raise WireError("is being closed; connect again in a second")
        self.starts.append(start)
        return 50

    def frame(self, frame: BodyFrame) -> None:
        self.frames.append(frame.sequence)
        self.changed.set()

    def acknowledged(self, sensor: str) -> int:
        if self.refusal is not None:
            raise self.refusal
        return self.stored

    def end(self, sensor: str) -> None:
        self.ends.append(sensor)

    def ended(self, sensor: str) -> str | None:
        return self.problem

    def gone(self, sensor: str) -> None:
        self.left.append(sensor)
        self.changed.set()


@contextmanager
def relaying(kept: Kept) -> Iterator[Bridge]:
    heard = Heard()
    with Bridge(heard.on_frame, BridgeSettings(port=0), heard.on_gone, relay=kept) as running:
        yield running


def said(**fields: object) -> bytes:
    return delimited(json.dumps(fields).encode())


def begin(sensor: str = "front", **changed: object) -> bytes:
    fields = {"node_id": 9, "first": 0, "lost": 0, "next": 0, "now_ns": 5}
    return said(say="start", sensor=sensor, **{**fields, **changed})


def lines(client: socket.socket, count: int) -> list[str]:
    """Read so many lines of the bridge."""
    heard = b""
    while heard.count(b"\n") < count:
        piece = client.recv(1)
        assert piece, heard
        heard += piece
    return heard.decode().splitlines()


def test_a_program_that_asks_hears_how_far_its_frames_are_stored_and_when_it_has_left() -> None:
    kept = Kept()
    with relaying(kept) as running, connected(running) as client:
        client.sendall(begin(first=3, lost=2, next=7))
        assert lines(client, 2) == ["window 50", "kept 0"]
        client.sendall(packet(sequence=3) + packet(sequence=4))
        kept.stored = 4
        assert lines(client, 1) == ["kept 4"]
        client.sendall(said(say="here"))
        assert lines(client, 1) == ["kept 4"]
        client.sendall(said(say="end"))
        kept.stored, kept.problem = 5, ""
        assert lines(client, 2) == ["kept 5", "ended"]
        client.settimeout(0.3)
        with pytest.raises(TimeoutError):  # it is said once
            client.recv(1)
        client.close()
        kept.changed.clear()
        assert kept.left or kept.changed.wait(PATIENCE_S)
        assert running.report.frames == 2
    assert kept.starts == [BridgeStart("front", 9, 3, 2, 7, 5)]
    assert (kept.frames, kept.ends, kept.left) == ([3, 4], ["front"], ["front"])


def test_frames_that_no_server_has_stored_at_the_end_are_said() -> None:
    kept = Kept()
    kept.problem = "front: 3 frames are not stored by the server"
    with relaying(kept) as running, connected(running) as client:
        client.sendall(begin() + said(say="end"))
        assert answer(client).endswith("front: 3 frames are not stored by the server\n")


def test_a_name_that_is_refused_is_said_without_a_frame() -> None:
    kept = Kept()
    with relaying(kept) as running, connected(running) as client:
        client.sendall(begin())
        assert lines(client, 2) == ["window 50", "kept 0"]
        kept.refusal = NameTakenError("another node serves front")
        assert answer(client) == "another node serves front\n"


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        (begin("closing"), "is being closed; connect again"),
        (begin("other"), "sensor other is served by 127.0.0.1:"),
        (begin() + begin(), "sensor front is served by 127.0.0.1:"),
        (begin() + begin("side"), "start comes once in a connection, before any frame"),
        (packet() + begin("side"), "start comes once in a connection, before any frame"),
        (said(say="end"), "the first message about acknowledgements is start"),
        (begin() + packet("side"), "a frame of side/0000000000000009 came after the start of front/0000000000000009"),
        (begin() + packet(node_id=8), "a frame of front/0000000000000008 came after the start of"),
        (begin() + said(say="end") + packet(), "a frame came after the message end"),
        (begin(lost=1), "start has first 0, lost 1 and next 0; lost is at most first, and next at least"),
        (begin(first=2), "start has first 2, lost 0 and next 0"),
        (begin("no such/name"), "sensor name 'no such/name' cannot be used"),
        (begin(node_id=0), "`$.node_id`"),
        (said(say="stop"), "Invalid value 'stop' - at `$.say`"),
        (delimited(b"{"), "is no message about acknowledgements"),
    ],
)
def test_what_is_wrong_about_acknowledgements_ends_its_own_connection(wrong: bytes, why: str) -> None:
    kept = Kept()
    with relaying(kept) as running, connected(running) as good, connected(running) as bad:
        good.sendall(begin("other"))
        assert lines(good, 1) == ["window 50"]
        bad.sendall(wrong)
        assert why in answer(bad)
        good.sendall(packet("other", 1))
        assert kept.changed.wait(PATIENCE_S)
        assert running.report.refused == 1


def test_a_bridge_that_acknowledges_nothing_says_so() -> None:
    with bridge(Heard()) as running, connected(running) as client:
        client.sendall(begin())
        assert answer(client) == "this bridge acknowledges no frames\n"


def test_the_other_messages_are_read_as_what_they_are() -> None:
    assert read_message(b'{"say": "end"}') == BridgeEnd()
    assert read_message(b'{"say": "here"}') == BridgeHere()
