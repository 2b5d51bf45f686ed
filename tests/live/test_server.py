"""The server over real sockets: who is let in, what is refused, and what it says of itself."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from support.programs import free_port, wait_until

from mocapella.errors import AddressInUseError, BusError, NameTakenError, NoServerError, TakeExistsError
from mocapella.live.server import Server, ServerSettings
from mocapella.live.state_notices import CONDITION_AGAIN_S
from mocapella.model.observations import BodyFrame, body_frame
from mocapella.model.session import SensorHealth, Setup
from mocapella.model.topology import topology
from mocapella.recording.take_reader import read_take
from mocapella.wire import keys
from mocapella.wire.node import NodeLink
from mocapella.wire.reader import Newest, send_command
from mocapella.wire.server import ServerLink
from mocapella.wire.session import open_node, open_reader

SETUP = Setup("stand-still")
"""A method that loads nothing at its first frame: these tests count frames."""
POSITIONS = np.random.default_rng(0).normal(size=(2, 25, 3)).astype(np.float32)


@pytest.fixture
def address() -> str:
    return f"tcp/127.0.0.1:{free_port()}"


@pytest.fixture
def server(address: str, tmp_path: Path) -> Iterator[Server]:
    running = Server(ServerSettings(address, takes=tmp_path / "takes", setup=SETUP))
    yield running
    running.close()


@pytest.fixture
def reader(server: Server, address: str) -> Iterator[zenoh.Session]:
    session = open_reader(address)
    yield session
    session.close()


def frame(k: int = 0) -> BodyFrame:
    return body_frame("x", topology("kinect_v2"), time_ns=k * 33_000_000, positions=POSITIONS)


def sensor(server: Server, name: str) -> SensorHealth | None:
    return next((row for row in server.status().sensors if row.name == name), None)


def publish(link: NodeLink, count: int, begin: int = 0, every: float = 0.005) -> None:
    for k in range(begin, begin + count):
        link.publish(frame(k))
        time.sleep(every)


def until(what: str, links: Sequence[NodeLink], holds: Callable[[], bool]) -> None:
    """Publish frames until something holds: the live path is best effort, and may lose some on a busy machine."""

    def published() -> bool:
        for link in links:
            link.publish(frame(link.published))
        return holds()

    wait_until(what, published)


def test_a_port_in_use_is_named(server: Server, address: str) -> None:
    with pytest.raises(AddressInUseError, match=address.rpartition(":")[2]):
        Server(ServerSettings(address, setup=SETUP))


def test_nobody_at_the_address_is_said_and_does_not_hang(address: str) -> None:
    with pytest.raises(NoServerError, match="mocapella serve"):
        open_reader(address, timeout=0.3)


def test_a_node_that_starts_before_the_server_is_served(address: str, tmp_path: Path) -> None:
    with NodeLink(address, "front") as link:
        assert not link.join(0.2)
        running = Server(ServerSettings(address, setup=SETUP))
        try:
            wait_until("the node joins", lambda: link.join(0.5))
            publish(link, 5)
            wait_until("its frames arrive", lambda: (row := sensor(running, "front")) is not None and row.frames > 0)
        finally:
            running.close()


def test_a_second_node_under_a_name_is_refused_and_seen(server: Server, address: str) -> None:
    with NodeLink(address, "front") as first, NodeLink(address, "front") as second:
        wait_until("the first joins", first.join)
        with pytest.raises(NameTakenError, match="front"):
            second.join()
        publish(second, 20)  # were they taken, the first one's lower numbers would be refused
        until("frames of the first", [first], lambda: server.summary.frames_in >= 10)
        row = sensor(server, "front")
        assert row is not None
        assert row.node_id == first.node.node_id
        assert row.rejected == 0
        assert row.frames + row.dropped <= first.published
        assert any("second node under the name front was refused" in notice for notice in server.status().notices)


def test_two_servers_on_one_machine_never_see_each_others_sensors(server: Server, address: str) -> None:
    other_address = f"tcp/127.0.0.1:{free_port()}"
    other = Server(ServerSettings(other_address, setup=SETUP))
    try:
        with NodeLink(address, "here") as here, NodeLink(other_address, "there") as there:
            wait_until("both join", lambda: here.join() and there.join())
            both = server.summary, other.summary
            until("frames", [here, there], lambda: all(summary.frames_in >= 20 for summary in both))
            for seen, link in ((server, here), (other, there)):
                assert [(row.name, row.node_id) for row in seen.status().sensors] == [link.node]
                assert seen.summary.frames_in <= link.published
    finally:
        other.close()


def test_a_node_that_is_gone_is_said_to_be(server: Server, address: str) -> None:
    with NodeLink(address, "front") as link:
        wait_until("it joins", link.join)
        publish(link, 3)
    wait_until("its leaving", lambda: any('sensor "front" left the session' in n for n in server.status().notices))
    row = sensor(server, "front")
    assert row is not None
    assert not row.connected


def test_the_proposed_name_of_a_take_is_one_that_no_take_has(
    server: Server, reader: zenoh.Session, tmp_path: Path
) -> None:
    assert server.status().next_take == "take-1"
    (tmp_path / "takes").mkdir()
    (tmp_path / "takes" / "take-1.mcap").touch()
    (tmp_path / "takes" / "walk-8.mcap").touch()
    assert server.status().next_take == "take-2"
    assert send_command(reader, "record", {"name": "walk-7"}).ok
    assert server.status().next_take == "walk-9"


def test_clocks_are_compared_and_latency_is_known(server: Server, address: str) -> None:
    with NodeLink(address, "front") as link:
        wait_until("it joins", link.join)
        stop = threading.Event()

        def keep_on() -> None:
            k = 0
            while not stop.wait(0.01):
                link.publish(frame(k))
                k += 1

        thread = threading.Thread(target=keep_on)
        thread.start()
        try:
            wait_until("a latency", lambda: (row := sensor(server, "front")) is not None and row.latency is not None)
        finally:
            stop.set()
            thread.join()
        row = sensor(server, "front")
        assert row is not None
        assert row.clock_offset is not None
        assert row.clock_bound is not None
        assert abs(row.clock_offset) <= row.clock_bound  # one machine, one clock: the truth is 0
        assert row.local


def test_bytes_that_are_no_frame_are_counted_and_told(server: Server, address: str) -> None:
    session = open_node(address)
    node = keys.NodeKey("front", 7)
    try:
        reliable = zenoh.CongestionControl.BLOCK
        publisher = session.declare_publisher(keys.of_node("live", node), congestion_control=reliable)
        wait_until("a connection", lambda: _answers(session))
        for junk in (b"", b"\xff" * 40, b"\x08\x09", b"\x80\x04\x95pickle"):
            publisher.put(junk)
        session.put("mocapella/v1/live/<script>/0000000000000001", b"x")
        wait_until("the rejections", lambda: server.summary.rejected == 4)
        row = sensor(server, "front")
        assert row is not None
        assert row.rejected == 4
        assert row.problem
        assert server.summary.frames_in == 0
        assert all("<script>" not in r.name for r in server.status().sensors)
    finally:
        session.close()


def _answers(session: zenoh.Session) -> bool:
    return any(reply.ok for reply in session.liveliness().get(keys.SERVER_ALIVE, timeout=0.5))


def test_opposite_commands_are_served_in_order_and_everybody_sees_the_last(
    server: Server, reader: zenoh.Session, address: str
) -> None:
    other = open_reader(address)
    try:
        newest = [Newest(reader), Newest(other)]
        assert send_command(reader, "stop").ok
        refused = send_command(other, "stop")
        assert not refused.ok
        assert "start first" in refused.message
        assert send_command(other, "start").ok
        last = server.status().revision
        for view in newest:
            wait_until("the last status", lambda view=view: (s := view.status()) is not None and s.revision == last)
        assert server.status().running
    finally:
        other.close()


@pytest.mark.parametrize("begin", [True, False])
def test_no_client_can_start_tracking_before_the_server_is_ready(address: str, begin: bool) -> None:
    waiting = Server(ServerSettings(address, setup=SETUP, running=False, waiting_for="compiling the method"))
    try:
        reader = open_reader(address)
        try:
            refused = send_command(reader, "start")
            assert (refused.ok, refused.message) == (False, "getting ready: compiling the method")
            assert refused.status is not None
            assert (refused.status.getting_ready, refused.status.running) == (True, False)
            assert "start was refused: getting ready: compiling the method" in waiting.status().notices
            waiting.wait_for("compiling the method (1 of 2 kernels)")
            assert waiting.status().reason == "compiling the method (1 of 2 kernels)"
            waiting.ready(begin=begin)
            waiting.wait_for("compiling too late")
            assert "compiling" not in waiting.status().reason
            assert (waiting.status().getting_ready, waiting.status().running) == (False, begin)
            again = send_command(reader, "start")
            assert (again.ok, again.message) == ((False, "already running; stop first") if begin else (True, "started"))
        finally:
            reader.close()  # type: ignore[no-untyped-call]
    finally:
        waiting.close()


def test_drops_before_tracking_began_are_told_apart(address: str) -> None:
    waiting = Server(ServerSettings(address, setup=SETUP, running=False, waiting_for="compiling"))
    try:
        with NodeLink(address, "x") as link:
            publish(link, 5)
            wait_until("the frames", lambda: (row := sensor(waiting, "x")) is not None and row.frames > 0)
            before = sensor(waiting, "x")
            assert before is not None
            assert (before.frames_before, before.dropped_before) == (0, 0)
            wait_until("they are counted", lambda: waiting.summary.untracked > 0)
            assert waiting.summary.untracked == waiting.summary.frames_in
            waiting.ready(begin=True)
            after = sensor(waiting, "x")
            assert after is not None
            assert after.frames_before >= before.frames
    finally:
        waiting.close()


def test_names_that_two_give_are_served_in_order(server: Server, reader: zenoh.Session, address: str) -> None:
    other = open_reader(address)
    try:
        for session, name in ((reader, "Ada"), (other, "Grace"), (reader, "Edith")):
            reply = send_command(session, "name", {"person": 3, "name": name})
            assert reply.ok
            assert reply.message == f"person 3 is called {name}"
        refused = send_command(other, "name", {"person": 3, "name": "a\nb"})
        assert not refused.ok
        assert "on one line" in refused.message
        assert server._session.names == {3: "Edith"}
    finally:
        other.close()


def test_a_take_says_who_commanded_what(server: Server, reader: zenoh.Session, tmp_path: Path) -> None:
    """Replay does the same with it as without; a program that says nothing about itself is an operator all the same."""
    assert send_command(reader, "record", {"name": "asked"}, program="a script").ok
    assert send_command(reader, "name", {"person": 3, "name": "Ada"}, program="\x1b[2Ja \u202eview" + "x" * 200).ok
    rude = reader.get(keys.of_command("name"), payload=b'{"person": 4, "name": "Eve"}', timeout=30.0)
    assert [reply.ok is not None for reply in rude] == [True]
    assert any(notice.startswith("recording") and "(a script of " in notice for notice in server.status().notices)
    assert send_command(reader, "record-stop", program="a script", timeout=150.0).ok
    commands = [one.values for one in read_take(tmp_path / "takes" / "asked.mcap").commands()]
    named = [one for one in commands if one["verb"] == "name"]
    assert [one["arguments"]["name"] for one in named] == ["Ada", "Eve"]
    assert named[0]["by"].startswith("[2Ja viewxxx")
    assert len(named[0]["by"]) == 120
    assert "by" not in named[1]


def test_a_condition_is_told_of_when_it_comes_and_not_each_time(server: Server) -> None:
    said = "left: it was moved"
    for reason, now_s in ((said, 0.0), (f"{said}; right: silent", 1.0), ("", 2.0), (said, 3.0)):
        server._states.conditions(reason, now_s)
    assert server.status().notices == (said,)
    server._states.conditions(said, CONDITION_AGAIN_S)
    assert server.status().notices == (said, said)


def test_a_setup_is_carried_out_or_refused_with_its_reason(server: Server, reader: zenoh.Session) -> None:
    reply = send_command(reader, "setup", {"sensors_expected": 2, "participant": 7, "placement": "right-90"})
    assert reply.ok
    assert reply.status is not None
    assert reply.status.setup == Setup(sensors_expected=2, participant=7, placement="right-90")
    refused = send_command(reader, "setup", {"method": "magic"})
    assert not refused.ok
    assert "stand-still" in refused.message
    assert server.status().setup.participant == 7
    unknown = send_command(reader, "explode")
    assert not unknown.ok
    assert "recalibrate" in unknown.message


def test_scenes_are_published_for_others(server: Server, reader: zenoh.Session, address: str) -> None:
    newest = Newest(reader)
    with NodeLink(address, "front") as link:
        wait_until("it joins", link.join)
        publish(link, 10)
        scenes = []
        wait_until("a scene", lambda: (s := newest.scene()) is not None and scenes.append(s) is None)
        assert scenes[0].sensor == "front"
        assert scenes[0].node_id == link.node.node_id
        wait_until("the sensors' frames", lambda: "front" in newest.frames() or publish(link, 1, 10) is not None)


def test_a_take_has_every_frame_and_names_are_checked(
    server: Server, reader: zenoh.Session, address: str, tmp_path: Path
) -> None:
    with NodeLink(address, "front") as link:
        wait_until("it joins", link.join)
        publish(link, 10)
        for bad in ("../x", "", "a/b"):
            refused = send_command(reader, "record", {"name": bad})
            assert not refused.ok, bad
        assert "name" in send_command(reader, "record", {}).message
        assert "begin a take first" in send_command(reader, "record-stop").message
        assert send_command(reader, "record", {"name": "one"}).ok
        assert "already recording" in send_command(reader, "record", {"name": "two"}).message
        publish(link, 100, 10)
        ended = send_command(reader, "record-stop", timeout=30)
        assert ended.ok, ended.message
        taken = send_command(reader, "record", {"name": "one"})
        assert not taken.ok
        assert "one.mcap" in taken.message
    take = read_take(tmp_path / "takes" / "one.mcap")
    (frames,) = take.complete()
    assert take.clean
    assert frames.missing == ()
    assert frames.last == 109


def test_a_take_of_the_settings_has_begun_before_any_node_is_admitted(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, real, begun = tmp_path / "walk.mcap", ServerLink.serve, list[bool]()

    def serve(link: ServerLink, **callbacks: Any) -> None:
        begun.append(path.exists())
        real(link, **callbacks)

    monkeypatch.setattr(ServerLink, "serve", serve)
    running = Server(ServerSettings(address, setup=SETUP, record=path, reserve_bytes=0))
    assert running.status().recording.active
    running.close()
    assert begun == [True]
    assert read_take(path).clean


@pytest.mark.parametrize("fails", ["take", "bus"])
def test_a_server_that_cannot_be_made_leaves_nothing_behind(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails: str
) -> None:
    path, before = tmp_path / "walk.mcap", set(threading.enumerate())
    with monkeypatch.context() as patch:
        if fails == "take":
            path.write_bytes(b"mine")
        else:
            patch.setattr(ServerLink, "serve", lambda *_, **__: (_ for _ in ()).throw(BusError("no bus")))
        with pytest.raises((TakeExistsError, BusError)):
            Server(ServerSettings(address, setup=SETUP, record=path, reserve_bytes=0))
    ours = {"recorder", "record-path", "notices", "tracker", "housekeeping"}
    assert not [thread for thread in set(threading.enumerate()) - before if thread.name in ours]
    path.unlink()
    Server(ServerSettings(address, setup=SETUP, record=path, reserve_bytes=0)).close()  # port and name are free


def test_an_unwritable_place_is_refused_before_anything_starts(address: str, tmp_path: Path) -> None:
    (tmp_path / "takes").write_text("a file where the folder should be")
    running = Server(ServerSettings(address, takes=tmp_path / "takes", setup=SETUP))
    session = open_reader(address)
    try:
        (notice,) = running.status().notices  # before anybody has pressed Record
        assert f"takes cannot be recorded: {tmp_path / 'takes'} is no folder" in notice
        refused = send_command(session, "record", {"name": "one"})
        assert not refused.ok
        assert not running.status().recording.active
    finally:
        session.close()
        running.close()


def test_a_frame_that_the_tracker_cannot_use_is_counted_and_told(server: Server, address: str) -> None:
    with NodeLink(address, "front") as link:
        wait_until("it joins", link.join)

        def repeated() -> bool:
            link.publish(frame(1))  # the same capture time again and again
            return server.summary.rejected >= 2

        wait_until("the rejections", repeated)
        row = sensor(server, "front")
        assert row is not None
        assert row.rejected >= 2
        assert "repeats the time" in row.problem
        wait_until("a notice", lambda: any("repeats the time" in notice for notice in server.status().notices))
        until("all is well again", [link], lambda: (r := sensor(server, "front")) is not None and r.problem == "")


def test_a_new_take_begins_with_the_first_frame_that_is_tracked_after_it_was_asked_for(
    server: Server, reader: zenoh.Session, address: str, tmp_path: Path
) -> None:
    with NodeLink(address, "front") as link:
        wait_until("it joins", link.join)
        publish(link, 300, every=0.001)

        def last_is_tracked() -> bool:
            publish(link, 1, link.published, every=0.05)
            return server._registry.newest().get(link.node) == link.published - 1

        wait_until("the last one is tracked", last_is_tracked)
        begin = link.published
        assert send_command(reader, "record", {"name": "fresh"}).ok
        publish(link, 30, begin)
        assert send_command(reader, "record-stop", timeout=30).ok
    (frames,) = read_take(tmp_path / "takes" / "fresh.mcap").complete()
    assert (frames.first, frames.last) == (begin, begin + 29)
    assert frames.missing == ()


def test_what_a_halted_server_says_is_what_its_take_has_though_frames_go_on_coming(
    server: Server, address: str, tmp_path: Path
) -> None:
    stop = threading.Event()

    def go_on(link: NodeLink) -> None:
        k = 0
        while not stop.is_set():
            link.publish(frame(k))
            k += 1
            time.sleep(0.002)

    with NodeLink(address, "front") as link:
        wait_until("the node joins", link.join)
        server.record_to(tmp_path / "take.mcap")
        node = threading.Thread(target=go_on, args=(link,))
        node.start()
        try:
            wait_until("frames come", lambda: server.summary.frames_in > 50)
            server.halt()
            said = server.summary.frames_in, server.summary.scenes_out, server.status().scenes
            health = server.close()
        finally:
            stop.set()
            node.join()
    assert (server.summary.frames_in, server.summary.scenes_out, server.status().scenes) == said
    assert health.scenes == said[1]
