"""Sensors of programs that keep their frames, on a real bus: identity, what is published, and what is acknowledged."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import pytest
from support.messages import plain_frame
from support.programs import free_port, wait_until

from mocapella.errors import NameTakenError, WireError
from mocapella.live import relaying
from mocapella.live.relaying import RelayedSensor, Relays
from mocapella.model.frame_types import HISTORY_FRAMES
from mocapella.model.observations import BodyFrame
from mocapella.sources.bridge_messages import BridgeStart
from mocapella.testing import FakeServer
from mocapella.wire.delivery import FrameRequest
from mocapella.wire.node import NodeLink

HOUR_NS = 3600 * 10**9


def start(first: int = 0, lost: int = 0, following: int = 0, now_ns: int = HOUR_NS, node_id: int = 9) -> BridgeStart:
    return BridgeStart("front", node_id, first, lost, following, now_ns)


def frame(sequence: int, sent_ns: int = HOUR_NS, node_id: int = 9) -> BodyFrame:
    return msgspec.structs.replace(
        plain_frame(), sensor="front", sequence=sequence, node_id=node_id, time_ns=sequence, sent_ns=sent_ns
    )


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # of the spool


@pytest.fixture
def server() -> Iterator[FakeServer]:
    with FakeServer() as made:
        yield made


@pytest.fixture
def serve() -> Iterator[Callable[..., RelayedSensor]]:
    made: list[RelayedSensor] = []

    def begin(address: str, request: BridgeStart) -> RelayedSensor:
        made.append(RelayedSensor(address, request, lambda text: None))
        return made[-1]

    yield begin
    for sensor in made:
        sensor.gone()
        sensor.hurry()
        sensor.wait()


def nowhere() -> str:
    return f"tcp/127.0.0.1:{free_port()}"


Serve = Callable[[str, BridgeStart], RelayedSensor]


def test_frames_have_the_programs_id_and_numbers_and_old_ones_are_not_published(
    server: FakeServer, serve: Serve
) -> None:
    sensor = serve(server.address, start(first=5, following=7))
    wait_until("the server serves it", sensor._membership.served.is_set)
    for k in range(5, 8):
        sensor.frame(frame(k))
    sensor.frame(frame(8, HOUR_NS - 2 * 10**9))  # of two seconds ago
    sensor.frame(frame(9, 0))  # sent at an unknown time
    server.wait_for(frames=2)
    assert [(f.sequence, f.node_id) for f in server.frames] == [(7, 9), (9, 9)]
    kept = sensor._link.outbox
    assert (kept.oldest, kept.next) == (5, 10)
    now_ns = time.monotonic_ns()
    assert all(0 < f.sent_ns <= now_ns for f in server.frames)


def test_a_frame_out_of_order_is_refused(serve: Serve) -> None:
    sensor = serve(nowhere(), start(first=5, following=5))
    with pytest.raises(WireError, match="sequence is 6, and 5 is next; connect again after a loss"):
        sensor.frame(frame(6))
    sensor.frame(frame(5))
    with pytest.raises(WireError, match="sequence is 5, and 6 is next"):
        sensor.frame(frame(5))


def test_without_a_server_nothing_is_acknowledged(serve: Serve, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(relaying, "CALM_S", 0.0)
    sensor = serve(nowhere(), start(first=5, following=5))
    sensor.frame(frame(5))
    assert sensor.acknowledged() == 5


def test_what_a_take_has_stored_is_acknowledged_and_never_taken_back(serve: Serve) -> None:
    sensor = serve(nowhere(), start())
    for k in range(4):
        sensor.frame(frame(k))
    outbox = sensor._link.outbox
    outbox.update(FrameRequest("one", 3), 0)
    outbox.update(FrameRequest("two", 2), 0)
    assert sensor.acknowledged() == 2
    outbox.update(FrameRequest("two", 9), 0)  # more than was sent to this bridge
    assert sensor.acknowledged() == 3
    outbox.update(FrameRequest("one", 9), 0)
    assert sensor.acknowledged() == 4
    outbox.update(FrameRequest("three", 0), 0)
    assert sensor.acknowledged() == 4


def test_a_server_that_asks_for_no_frames_needs_none_that_are_older_than_a_while(
    server: FakeServer, serve: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_ns = [0]
    sensor = RelayedSensor(server.address, start(), lambda text: None, clock_ns=lambda: now_ns[0])
    try:
        sensor._shift_ns = -HOUR_NS
        wait_until("the server serves it", sensor._membership.served.is_set)
        for k in range(3):
            sensor.frame(frame(k, HOUR_NS + k * 10**9))

        def heard(now_s: float, last_s: float) -> int:
            now_ns[0] = round(now_s * 1e9)
            sensor._link.heard_s = last_s
            return sensor.acknowledged()

        monkeypatch.setattr(sensor._link, "_tell", lambda *_: None)  # the test says when the server was heard
        assert heard(20, 19) == 0  # from now on
        assert heard(29, 28) == 0
        assert heard(30, 25) == 0  # not heard for a while: begins anew
        assert heard(31, 30.5) == 0
        assert heard(42, 41) == 3
        sensor.frame(frame(3, HOUR_NS + 40 * 10**9))
        assert heard(43, 42) == 3
        assert heard(51, 50) == 4
    finally:
        sensor.gone()
        sensor.hurry()
        sensor.wait()


def test_at_the_end_everything_is_acknowledged_that_no_take_needs(server: FakeServer, serve: Serve) -> None:
    sensor = serve(server.address, start())
    wait_until("the server serves it", sensor._membership.served.is_set)
    sensor.frame(frame(0))
    assert (sensor.acknowledged(), sensor.closed, sensor.problem) == (0, False, None)
    sensor.end()
    sensor.wait()
    assert (sensor.acknowledged(), sensor.closed, sensor.problem) == (1, True, "")


def test_without_a_server_at_the_end_the_program_keeps_its_frames(tmp_path: Path, serve: Serve) -> None:
    sensor = serve(nowhere(), start())
    sensor.frame(frame(0))
    sensor.end()
    sensor.wait()
    assert "has heard the end of front; keep its frames" in (sensor.problem or "")
    assert (sensor.acknowledged(), sensor.unstored) == (0, "")
    assert not (tmp_path / "spool").exists()


def test_frames_of_an_open_take_that_are_not_stored_at_the_end_are_named_and_in_a_file(
    tmp_path: Path, serve: Serve
) -> None:
    sensor = serve(nowhere(), start())
    sensor.frame(frame(0))
    sensor._link.outbox.update(FrameRequest("take", 0), 0)
    sensor._link.farewell_s = 0.1
    sensor.end()
    sensor.wait()
    assert "front: 1 frames are not stored by the server; they are in spool" in (sensor.problem or "")
    assert sensor.acknowledged() == 0
    assert len(list((tmp_path / "spool").iterdir())) == 1


def test_a_program_that_vanishes_leaves_no_file_because_it_has_the_frames(tmp_path: Path, serve: Serve) -> None:
    sensor = serve(nowhere(), start())
    sensor.frame(frame(0))
    sensor._link.outbox.update(FrameRequest("take", 0), 0)
    sensor.gone()
    assert not sensor.closed  # a server may come and ask
    sensor.hurry()
    sensor.wait()
    assert (sensor.closed, sensor.problem) == (True, None)
    assert not (tmp_path / "spool").exists()


def test_a_name_that_a_server_refuses_is_an_error_of_frames_and_of_acknowledgements(serve: Serve) -> None:
    sensor = serve(nowhere(), start())
    sensor._membership.refusal = NameTakenError("another node serves front")
    with pytest.raises(NameTakenError):
        sensor.frame(frame(0))
    with pytest.raises(NameTakenError):
        sensor.acknowledged()


def test_a_sensor_begins_again_once_its_last_connection_is_closed() -> None:
    said: list[str] = []
    relays = Relays(nowhere(), said.append)
    assert relays.start(start()) == HISTORY_FRAMES
    relays.frame(frame(0))
    assert (relays.acknowledged("front"), relays.ended("front")) == (0, None)
    relays._sensors["front"]._link.outbox.update(FrameRequest("take", 0), 0)
    relays.gone("front")
    with pytest.raises(WireError, match="the last connection of sensor front is being closed; connect again"):
        relays.start(start())
    relays._sensors["front"].wait()
    relays.start(start(first=4, lost=3, following=4))
    assert "front: its program has lost 3 frames before frame 4" in said
    relays.end("front")
    relays._sensors["front"].wait()
    assert "has heard the end of front" in (relays.ended("front") or "")
    assert relays.close() == []


def test_frames_that_are_not_stored_are_told_at_the_end_of_the_bridge() -> None:
    relays = Relays(nowhere(), lambda text: None)
    for k in range(2):
        relays.start(start(node_id=k + 1))
        relays.frame(frame(0, node_id=k + 1))
        sensor = relays._sensors["front"]
        sensor._link.outbox.update(FrameRequest(f"take-{k}", 0), 0)
        sensor._link.farewell_s = 0.1
        relays.end("front")
        sensor.wait()
    assert [problem.split(";")[0] for problem in relays.close()] == ["front: 1 frames are not stored by the server"] * 2


def test_a_link_that_is_detached_says_no_farewell_and_keeps_nothing() -> None:
    with NodeLink(nowhere(), "front") as link:
        link.outbox.add(b"", 0)
        link.outbox.update(FrameRequest("take", 0), 0)
        link.detach()
        link.close()
    assert link.outbox.holds == {}
