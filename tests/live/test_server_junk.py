"""A server among programs that send nonsense: it goes on serving, and says what was wrong with whom."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import zenoh
from support.programs import free_port, wait_until

from mocapella.live.recordings import open_recording
from mocapella.live.server import Server, ServerSettings
from mocapella.live.session import Session
from mocapella.model.observations import body_frame
from mocapella.model.session import SensorHealth, Setup
from mocapella.model.topology import topology
from mocapella.recording.take_reader import read_take
from mocapella.schema import encode_frame
from mocapella.wire import keys
from mocapella.wire.node import NodeLink
from mocapella.wire.reader import Newest, send_command
from mocapella.wire.session import open_node, open_reader

POSITIONS = np.random.default_rng(0).normal(size=(1, 25, 3)).astype(np.float32)
NODE = keys.NodeKey("front", 7)
RELIABLE = zenoh.CongestionControl.BLOCK
"""A node's live path drops frames; these tests send each message once."""


@pytest.fixture
def address() -> str:
    return f"tcp/127.0.0.1:{free_port()}"


@pytest.fixture
def server(address: str, tmp_path: Path) -> Iterator[Server]:
    running = Server(ServerSettings(address, takes=tmp_path / "takes", reserve_bytes=0, setup=Setup("stand-still")))
    yield running
    running.close()


@pytest.fixture
def reader(server: Server, address: str) -> Iterator[zenoh.Session]:
    session = open_reader(address)
    yield session
    session.close()


@pytest.fixture
def stranger(server: Server, address: str) -> Iterator[zenoh.Session]:
    """A node of somebody else's making."""
    session = open_node(address)
    yield session
    session.close()


def row(server: Server) -> SensorHealth | None:
    return next(iter(server.status().sensors), None)


def speak(session: zenoh.Session, server: Server, node: keys.NodeKey = NODE) -> zenoh.LivelinessToken:
    """One frame and a token, as a node has them; the token lasts for as long as it is kept."""
    frame = body_frame(node.sensor, topology("kinect_v2"), time_ns=1, positions=POSITIONS, node_id=node.node_id)
    token = session.liveliness().declare_token(keys.of_node("alive/sensor", node))
    wait_until("it is there", lambda: (seat := row(server)) is not None and seat.connected)
    session.put(keys.of_node("live", node), encode_frame(frame), congestion_control=RELIABLE)
    wait_until("its frame", lambda: (seat := row(server)) is not None and seat.frames == 1)
    return token


@pytest.mark.parametrize("answer", [b"12.5", b"", b"9" * 5000, b"9" * 400])
def test_a_node_whose_clock_answers_nonsense_is_named_and_harms_nobody(
    server: Server, stranger: zenoh.Session, reader: zenoh.Session, answer: bytes
) -> None:
    key = keys.of_node("clock", NODE)
    clock = stranger.declare_queryable(key, lambda query: query.reply(key, answer))
    token = speak(stranger, server)
    wait_until("it is named", lambda: (seat := row(server)) is not None and "decimal text" in seat.problem)
    assert not server.failed.is_set()
    assert send_command(reader, "status").ok
    clock.undeclare()
    token.undeclare()


def test_nodes_that_never_answer_the_clock_do_not_hold_up_the_status(
    server: Server, stranger: zenoh.Session, reader: zenoh.Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, hold = threading.Event(), threading.Event()

    def never(*_: object, **__: object) -> list[object]:
        asked.set()
        hold.wait(60.0)
        return []

    monkeypatch.setattr(server._link, "probe_clock", never)
    token = speak(stranger, server)
    assert asked.wait(30.0)
    newest = Newest(reader)
    for _ in range(3):
        wait_until("another status, while the clock is waited for", lambda: newest.status() is not None)
    hold.set()
    token.undeclare()


@pytest.mark.parametrize("arguments", [b"[1]", b"{", b"\xff", b'{"a":"\xff"}', b'{"a":' * 50_000])
def test_arguments_that_are_no_object_are_answered(server: Server, reader: zenoh.Session, arguments: bytes) -> None:
    replies = list(reader.get(keys.of_command("setup"), payload=arguments, timeout=30.0))
    assert len(replies) == 1
    assert replies[0].err is not None
    assert b"no JSON object" in replies[0].err.payload.to_bytes()
    assert not server.failed.is_set()


@pytest.mark.parametrize("node_id", ["f" * 20, "-1", "1", "F" * 16, "*"])
def test_a_node_id_that_no_node_can_have_is_not_let_in(server: Server, stranger: zenoh.Session, node_id: str) -> None:
    wait_until("its connection", lambda: bool(list(stranger.liveliness().get(keys.SERVER_ALIVE, timeout=0.5))))
    (reply,) = stranger.get(f"mocapella/v1/join/front/{node_id}", timeout=30.0)
    assert reply.err is not None
    assert b"16 hex digits" in reply.err.payload.to_bytes()
    assert server.status().sensors == ()


def test_a_restore_is_for_takes_only(server: Server, reader: zenoh.Session) -> None:
    refused = send_command(reader, "restore", Session(server.status().setup).memory())
    assert not refused.ok
    assert "unknown command" in refused.message


def test_a_long_text_of_a_stranger_is_not_in_every_status(server: Server, reader: zenoh.Session) -> None:
    assert not send_command(reader, "setup", {"x" * 100_000: 1}).ok
    notices = server.status().notices
    assert any("was refused" in notice for notice in notices)
    assert max(map(len, notices)) <= 500


def test_a_number_that_comes_again_is_refused_and_told(server: Server, stranger: zenoh.Session) -> None:
    token = speak(stranger, server)
    again = body_frame("front", topology("kinect_v2"), time_ns=2, positions=POSITIONS, node_id=7, sequence=0)
    stranger.put(keys.of_node("live", NODE), encode_frame(again), congestion_control=RELIABLE)
    wait_until("it is refused", lambda: server.summary.rejected == 1)
    seat = row(server)
    assert seat is not None
    assert "sequence is 0 after 0" in seat.problem
    assert server.summary.frames_in == 1
    token.undeclare()


def test_a_take_begins_with_the_memory_of_its_first_step_whoever_begins_it(
    server: Server, address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is begun on this thread, as ``serve --record`` does, while frames stream in on the tracker's."""
    session, stop = server._session, threading.Event()
    memory = session.memory

    def slowly() -> dict[str, str]:
        remembered = memory()
        time.sleep(0.1)
        return remembered

    monkeypatch.setattr(session, "memory", slowly)
    with NodeLink(address, "front") as link:
        wait_until("it joins", link.join)

        def stream() -> None:
            k = 0
            while not stop.wait(0.005):
                link.publish(body_frame("front", topology("kinect_v2"), time_ns=k * 1_000_000, positions=POSITIONS))
                k += 1

        thread = threading.Thread(target=stream)
        thread.start()
        try:
            wait_until("frames", lambda: server.summary.frames_in > 0)
            server.record_to(tmp_path / "a.mcap")
            wait_until("scenes", lambda: server.status().recording.scenes > 3)
        finally:
            stop.set()
            thread.join()
        server._recording.finish()
    replayed = open_recording(tmp_path / "a.mcap").replay(lambda scene: None)
    assert replayed.summary.scenes_out > 3
    assert replayed.notes["differing_scenes"] == 0


def test_a_take_cannot_begin_after_the_last_one_was_closed(address: str, tmp_path: Path) -> None:
    """Otherwise its thread would keep the process for ever, and its file would have no end."""
    running = Server(ServerSettings(address, takes=tmp_path, reserve_bytes=0, setup=Setup("stand-still")))
    session = open_reader(address)
    try:
        stop = threading.Event()

        def press() -> None:
            k = 0
            while not stop.wait(0.001):
                for verb, arguments in (("record", {"name": f"take-{k}"}), ("record-stop", {})):
                    session.get(keys.of_command(verb), lambda reply: None, payload=json.dumps(arguments))
                k += 1

        thread = threading.Thread(target=press)
        thread.start()
        time.sleep(0.3)
        running.close()
        stop.set()
        thread.join()
    finally:
        session.close()
    assert not [thread.name for thread in threading.enumerate() if thread.name in ("recorder", "finish-take")]
    assert all(read_take(path).clean for path in tmp_path.glob("*.mcap"))
