"""A server among unexpected errors, floods, slow disks and slow readers: it counts, says, and goes on."""

from __future__ import annotations

import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import zenoh
from support.programs import free_port, wait_until

from mocapella.live.recordings import open_recording
from mocapella.live.replay import replay
from mocapella.live.server import Server, ServerSettings
from mocapella.live.session import Session
from mocapella.model.limits import MOST_COMMANDS_OF_A_CLIENT, MOST_UNPROVEN
from mocapella.model.observations import Arrival, BodyFrame, body_frame
from mocapella.model.scene import Scene
from mocapella.model.session import Descriptors, SensorHealth, Setup
from mocapella.model.topology import topology
from mocapella.recording.take_reader import read_take
from mocapella.recording.take_writer import TakeWriter
from mocapella.wire import keys
from mocapella.wire.node import NodeLink
from mocapella.wire.reader import Newest, send_command
from mocapella.wire.session import open_node, open_reader

POSITIONS = np.random.default_rng(0).normal(size=(1, 25, 3)).astype(np.float32)


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
def front(server: Server, address: str) -> Iterator[NodeLink]:
    """A node of ours, which has joined."""
    with NodeLink(address, "front") as link:
        wait_until("it joins", link.join)
        yield link


def frame(k: int) -> BodyFrame:
    return body_frame("", topology("kinect_v2"), time_ns=k * 33_000_000, positions=POSITIONS)


def until(what: str, link: NodeLink, holds: Callable[[], bool]) -> None:
    """Publish frames until something holds; the live path may lose some of them on a busy machine."""

    def published() -> bool:
        link.publish(frame(link.published + 1))
        return holds()

    wait_until(what, published)


def row(server: Server, name: str = "front") -> SensorHealth:
    return next(one for one in server.status().sensors if one.name == name)


class Planted:
    """In place of a function: fails a number of times, and then does what the function does."""

    def __init__(self, function: Callable[..., Any], error: Exception, times: int) -> None:
        self.function, self.error, self.left = function, error, times

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        if self.left:
            self.left -= 1
            raise self.error
        return self.function(*arguments, **named)


def test_an_error_of_the_tracker_costs_its_frames_only(
    server: Server, front: NodeLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server._session, "step", Planted(server._session.step, ZeroDivisionError("planted"), 3))
    until("frames are tracked again", front, lambda: server.summary.scenes_out >= 5)
    status = server.status()
    assert sum(status.health.errors.values()) == 3
    assert next(iter(status.health.errors)).startswith("frame: ZeroDivisionError")
    assert row(server).rejected == 3
    assert "unexpected error (frame): ZeroDivisionError: planted" in status.notices
    assert any("3 unexpected errors" in problem for problem in status.health.problems())
    assert not server.failed.is_set()
    server.halt()
    assert sum(server.summary.errors.values()) == 3


def test_an_error_of_a_command_is_answered_and_the_next_is_carried_out(
    server: Server, reader: zenoh.Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server._session, "carry_out", Planted(server._session.carry_out, OverflowError("planted"), 1))
    reply = send_command(reader, "stop")
    assert (reply.ok, reply.message) == (False, "unexpected error (command): OverflowError: planted")
    assert send_command(reader, "stop").ok


@pytest.mark.parametrize(
    ("what", "part"),
    [
        ("_notices.beat", "housekeeping"),
        ("_link.probe_clock", "clock probe"),
        ("_registry.standing", "message of the bus"),
        ("_registry.set_connected", "token of the bus"),
        ("_commands.put", "command of the bus"),
        ("_commands.take", "turn of the tracker"),
    ],
)
def test_no_loop_and_no_callback_ends_of_an_error(
    server: Server, reader: zenoh.Session, monkeypatch: pytest.MonkeyPatch, what: str, part: str
) -> None:
    owner, name = getattr(server, what.partition(".")[0]), what.partition(".")[2]
    monkeypatch.setattr(owner, name, Planted(getattr(owner, name), KeyError("planted"), 1))
    reader.get(keys.of_command("status"), lambda reply: None)
    with NodeLink(server._settings.listen, "front") as link:
        until("the error", link, lambda: sum(server.status().health.errors.values()) == 1)
        assert next(iter(server.status().health.errors)).startswith(f"{part}: KeyError")
        wait_until("the node joins", link.join)
        until("frames are tracked", link, lambda: server.summary.scenes_out >= 2)
    assert send_command(reader, "status").ok
    newest = Newest(reader)
    wait_until("statuses go on", lambda: newest.status() is not None)
    assert not server.failed.is_set()


@pytest.mark.parametrize("rig", ["x = " + "1" * 5000, "x = " + "[" * 5000, "\ud800" * 10])
def test_a_rig_that_is_none_is_refused(server: Server, reader: zenoh.Session, rig: str) -> None:
    assert not send_command(reader, "use-rig", {"rig": rig}).ok
    assert send_command(reader, "status").ok


def test_numbers_that_no_take_can_store_are_refused_at_the_door(server: Server, reader: zenoh.Session) -> None:
    for arguments in ({"participant": 2**40}, {"sensors_expected": 65}):
        refused = send_command(reader, "setup", arguments)
        assert (refused.ok, "it must be from" in refused.message) == (False, True)
    refused = send_command(reader, "setup", {"participant": 10**30, "sensors_expected": 10**25})
    assert (refused.ok, refused.message) == (False, "the arguments are no JSON object")
    assert send_command(reader, "record", {"name": "a"}).ok
    assert send_command(reader, "record-stop", timeout=60.0).ok


def test_a_take_that_cannot_begin_leaves_no_thread_and_no_file(
    server: Server, reader: zenoh.Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server._session, "memory", Planted(server._session.memory, OverflowError("planted"), 1))
    assert not send_command(reader, "record", {"name": "a"}).ok
    assert "recorder" not in {thread.name for thread in threading.enumerate()}
    assert list((tmp_path / "takes").iterdir()) == []
    assert send_command(reader, "record", {"name": "a"}).ok


def test_arguments_of_any_length_are_not_read(server: Server, reader: zenoh.Session) -> None:
    (reply,) = reader.get(keys.of_command("setup"), payload=b" " * 2_000_000 + b"{}", timeout=60.0)
    assert reply.err is not None
    assert b"too long" in reply.err.payload.to_bytes()


def test_keys_that_no_node_has_are_counted_and_named(server: Server, address: str) -> None:
    stranger = open_node(address)
    wait_until("its connection", lambda: bool(list(stranger.liveliness().get(keys.SERVER_ALIVE, timeout=0.5))))
    for k in range(100):
        key = f"mocapella/v1/live/<script>/{k}"
        stranger.put(key, b"x", congestion_control=zenoh.CongestionControl.BLOCK)
    what = "messages with an invalid key or invalid arguments"
    wait_until("all are counted", lambda: server.status().health.turned_away.get(what) == 100)
    stranger.close()
    assert len(server.status().notices) <= 8
    assert server.status().sensors == ()


def test_a_step_of_the_wall_clock_is_in_status_and_take_and_changes_no_time(
    server: Server, front: NodeLink, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    server.record_to(tmp_path / "a.mcap")
    until("frames are tracked", front, lambda: server.summary.scenes_out >= 2)
    wall_ns = time.time_ns
    for step_s in (-7200, 30):
        monkeypatch.setattr(server._wall_clock, "_wall_ns", lambda: wall_ns() + step_s * 10**9)  # noqa: B023
        wait_until("the notice", lambda: sum("wall clock" in one for one in server.status().notices) > (step_s > 0))  # noqa: B023
        before = server.summary.scenes_out
        until("frames are tracked", front, lambda: server.summary.scenes_out > before + 3)  # noqa: B023
    wait_until("it is in a recorded status", lambda: server.status().recording.frames >= front.published)
    server._keep_house()
    assert server.close().lost == 0
    take = read_take(tmp_path / "a.mcap")
    times, statuses = zip(*take.statuses(), strict=True)
    assert sum("the wall clock of this machine stepped by" in one for one in statuses[-1]["notices"]) == 2
    assert list(times) == sorted(times)


@pytest.mark.parametrize("recording", [True, False])
def test_without_file_descriptors_what_runs_goes_on_and_a_new_take_is_refused(
    server: Server, reader: zenoh.Session, front: NodeLink, recording: bool
) -> None:
    resource = pytest.importorskip("resource")
    until("it is tracked", front, lambda: server.summary.frames_in > 3)
    if recording:
        assert send_command(reader, "record", {"name": "a"}).ok
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (3, limits[1]))
    try:
        refused = send_command(reader, "record", {"name": "b"})
        before = server.summary.frames_in, server.status().recording.frames
        until("frames are tracked", front, lambda: server.summary.frames_in > before[0] + 3)
        if recording:
            until("frames are stored", front, lambda: server.status().recording.frames > before[1] + 3)
        wait_until("it is counted", lambda: server.status().health.descriptors == Descriptors(3, 3))
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)
    assert not refused.ok
    assert ("already recording" if recording else "Too many open files") in refused.message
    assert send_command(reader, "record-stop" if recording else "record", {"name": "b"}, timeout=60.0).ok


def test_with_few_file_descriptors_new_sensors_are_refused_visibly_and_others_stay(
    server: Server, front: NodeLink, address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    until("it is tracked", front, lambda: server.summary.frames_in > 3)
    monkeypatch.setattr("mocapella.live.health.open_descriptors", lambda: Descriptors(91, 100))
    wait_until("it is counted", lambda: server.status().health.descriptors == Descriptors(91, 100))
    assert front.join(timeout=60.0)
    with NodeLink(address, "side") as side:
        wait_until("it is put off", lambda: not side.join() and "91 of 100 file descriptors" in side.why_not_admitted())
        status = server.status()
        assert any('sensor "side" was refused: the server has 91 of 100' in one for one in status.notices)
        assert any("91 of 100 file descriptors" in one for one in status.health.problems())
        monkeypatch.setattr("mocapella.live.health.open_descriptors", lambda: Descriptors(50, 100))
        wait_until("there is room again", side.join)
        assert side.why_not_admitted() == ""


def test_a_verb_reaches_neither_terminal_nor_status_raw(server: Server, reader: zenoh.Session) -> None:
    assert not send_command(reader, "\x1b]0;owned\x07\u202e\x9b31m", {}).ok
    notice = server.status().notices[-1]
    assert notice.isprintable()
    assert r"\x1b]0;owned\x07\u202e\x9b31m was refused" in notice


def test_junk_under_any_number_of_keys_costs_a_sensor_nothing(server: Server, front: NodeLink, address: str) -> None:
    until("it is tracked", front, lambda: server.summary.frames_in > 3)
    stranger = open_node(address)
    try:
        wait_until("a connection", lambda: stranger.info.peers_zid() != [])
        server._notices.close()  # its thread is not needed: what is said is in the status
        for k in range(2000):
            key = keys.of_node("live", keys.NodeKey(f"x{k}", k))
            stranger.put(key, b"junk", congestion_control=zenoh.CongestionControl.BLOCK)
        wait_until("the junk", lambda: _looked_at(server) + server._inbox.strangers_dropped == 2000)
        before = server.summary.frames_in
        until("the sensor is tracked", front, lambda: server.summary.frames_in > before + 3)
    finally:
        stranger.close()
    status = server.status()
    assert len(status.sensors) <= 1 + MOST_UNPROVEN
    assert status.health.turned_away["messages of unknown nodes"] > 0
    assert row(server).rejected == 0


def _looked_at(server: Server) -> int:
    return server.summary.rejected + len(server._inbox._strangers)


def test_one_program_cannot_keep_the_others_waiting(server: Server, reader: zenoh.Session, address: str) -> None:
    flooding, answers = open_reader(address), list[dict[str, Any]]()

    def got(reply: zenoh.Reply) -> None:
        assert reply.ok is not None
        answers.append(json.loads(reply.ok.payload.to_bytes()))

    try:
        with server._stepping:  # the tracker has something else to do
            for k in range(200):
                arguments = json.dumps({"person": k, "name": "a"})
                flooding.get(keys.of_command("name"), got, payload=arguments, attachment=b"flood", timeout=60.0)
            most = 200 - MOST_COMMANDS_OF_A_CLIENT
            wait_until("what is too much is refused", lambda: sum(not one["ok"] for one in answers) >= most - 1)
            other = threading.Thread(target=send_command, args=(reader, "stop"), kwargs={"timeout": 60.0})
            other.start()
            assert server.status().running
        other.join()
        assert not server.status().running
    finally:
        flooding.close()
    assert any("commands of this program wait already" in one["message"] for one in answers)
    assert server.status().health.turned_away["commands"] >= most - 1


def test_a_disk_that_does_not_answer_does_not_hold_up_the_tracker(
    server: Server, front: NodeLink, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hold, waits, flush = threading.Event(), threading.Event(), TakeWriter.flush

    def slow(writer: TakeWriter) -> None:
        waits.set()
        hold.wait(60.0)
        flush(writer)

    monkeypatch.setattr(TakeWriter, "flush", slow)
    server.record_to(tmp_path / "a.mcap")
    try:
        until("the disk is waited for", front, waits.is_set)
        before = server.summary.scenes_out
        until("frames are tracked meanwhile", front, lambda: server.summary.scenes_out >= before + 10)
        assert waits.is_set()
        assert not hold.is_set()
    finally:
        hold.set()
    health = server.close()
    assert not health.problem
    assert health.scenes == server.summary.scenes_out


class StalledProxy:
    """Passes a connection on until `stall`; from then on it reads nothing, like a program that is stopped."""

    def __init__(self, port: int) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        self.address = f"tcp/127.0.0.1:{self._listener.getsockname()[1]}"
        self._to, self._stalled, self._open = port, threading.Event(), list[socket.socket]()
        threading.Thread(target=self._accept, daemon=True).start()

    def stall(self) -> None:
        self._stalled.set()

    def close(self) -> None:
        for one in (self._listener, *self._open):
            one.close()

    def _accept(self) -> None:
        near, _ = self._listener.accept()
        far = socket.create_connection(("127.0.0.1", self._to))
        self._open += [near, far]
        for source, target in ((near, far), (far, near)):
            threading.Thread(target=self._pass_on, args=(source, target), daemon=True).start()

    def _pass_on(self, source: socket.socket, target: socket.socket) -> None:
        try:
            while not self._stalled.is_set() and (data := source.recv(65536)):
                target.sendall(data)
        except OSError:
            pass


def test_a_reader_that_stops_reading_delays_nobody(server: Server, front: NodeLink, address: str) -> None:
    """A publisher that waited for it would wait for ever: its connection stays open, and its buffers are full."""
    drop = zenoh.CongestionControl.DROP  # the bus would close a connection that blocks it, after five seconds
    assert [each.congestion_control for each in (server._link._scene, server._link._status)] == [drop, drop]
    proxy = StalledProxy(int(address.rpartition(":")[2]))
    stopped, other = open_reader(proxy.address), open_reader(address)
    try:
        slow, newest = Newest(stopped), Newest(other)
        until("it reads", front, lambda: slow.scene() is not None)
        proxy.stall()
        for _ in range(400):  # 20 MB, more than all buffers hold
            server._link.publish_scene(bytes(50_000))
        before = server.summary.scenes_out
        until("frames are tracked", front, lambda: server.summary.scenes_out >= before + 10)
        newest.scene()
        until("the other reader has scenes", front, lambda: newest.scene() is not None)
    finally:
        proxy.close()
        other.close()
        stopped.close()


def test_a_take_with_a_frame_that_could_not_be_tracked_replays_like_the_live_run(
    server: Server, front: NodeLink, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    step = Session.step

    def planted(session: Session, arrival: Arrival) -> Scene | None:
        scene = step(session, arrival)
        if arrival.frame.sequence % 7 == 3:
            raise ZeroDivisionError("planted, when the frame has changed the tracker already")
        return scene

    monkeypatch.setattr(Session, "step", planted)
    server.record_to(tmp_path / "a.mcap")
    until("errors", front, lambda: sum(server.status().health.errors.values()) >= 2)
    server.close()
    take = read_take(tmp_path / "a.mcap")
    assert all(scene.sequence % 7 != 3 for _, scene in take.scenes())
    replayed = open_recording(tmp_path / "a.mcap").replay(lambda scene: None)
    assert replayed.notes["differing_scenes"] == 0
    assert replayed.summary.scenes_out == len(list(take.scenes())) > 5
    assert replayed.summary.errors == {}


def test_the_interval_in_which_a_camera_was_moved_is_marked_in_take_and_summary(
    server: Server, front: NodeLink, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the first scene with the condition to the last: it ends when the camera is calibrated again."""
    step, moved = Session.step, "front: it was moved"

    def planted(session: Session, arrival: Arrival) -> Scene | None:
        scene = step(session, arrival)
        assert scene is not None
        if not 5 <= scene.sequence < 12:
            return scene
        return msgspec.structs.replace(scene, state=msgspec.structs.replace(scene.state, reason=moved))

    monkeypatch.setattr(Session, "step", planted)
    server.record_to(tmp_path / "a.mcap")
    until("scenes", front, lambda: server.summary.scenes_out >= 20)
    server.close()
    conditions = server.summary.as_json(server._session.state)["conditions"]
    (marked,) = [one for one in conditions if one["condition"] == moved]
    assert marked["results"] == 7
    assert 0 <= marked["first_s"] <= marked["last_s"]
    scenes = [scene for _, scene in read_take(tmp_path / "a.mcap").scenes()]
    assert [scene.sequence for scene in scenes if scene.state.reason == moved] == list(range(5, 12))


def test_frames_that_are_frozen_or_go_back_in_time_are_stored_and_flagged(
    server: Server, front: NodeLink, tmp_path: Path
) -> None:
    server.record_to(tmp_path / "a.mcap")
    until("it is tracked", front, lambda: server.summary.scenes_out > 3)
    newest = front.published
    for k in (newest, newest, newest - 3):  # again, again, and earlier
        front.publish(frame(k))
    wait_until("they are flagged", lambda: row(server).rejected == 3)
    for said in ("repeats the time of the frame before", "time goes backwards"):
        wait_until("it is told", lambda: any(said in one for one in server.status().notices))  # noqa: B023
    front.publish(frame(newest + 1))
    sent = front.published
    wait_until("all are on the disk", lambda: server.status().recording.frames == sent)
    assert server.close().lost == 0
    stored = [one.frame.sequence for one in read_take(tmp_path / "a.mcap").frames_in_sequence("front")]
    assert stored == list(range(sent))


def test_a_node_at_ten_times_its_rate_and_one_at_its_own_are_counted_apart(
    server: Server, front: NodeLink, address: str
) -> None:
    with NodeLink(address, "side") as fast:
        wait_until("it joins", fast.join)
        with server._stepping:  # the tracker has something else to do meanwhile
            for k in range(4):
                front.publish(frame(k + 1))
            until("it is throttled", fast, lambda: row(server, "side").behind >= 40)
        until("the slow one is tracked", front, lambda: row(server).frames >= 4)
        assert row(server).behind == 0
        assert row(server, "side").behind >= 40


def test_a_frame_whose_replay_fails_is_counted_and_the_replay_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    session = Session(Setup("stand-still"))
    monkeypatch.setattr(session, "step", Planted(session.step, ZeroDivisionError("planted"), 2))
    summary = replay(session, (Arrival(frame(k), k * 33_000_000) for k in range(5)))
    assert (summary.frames_in, summary.scenes_out, list(summary.errors.values())) == (5, 3, [2])
