"""A thread that dies ends the process, with the take closed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import threading
from contextlib import ExitStack, suppress
from functools import reduce
from pathlib import Path

import numpy as np
import psutil
import pytest
from support.programs import Program, free_port, wait_until

from mocapella.errors import MocapellaError, UnstoredFramesError
from mocapella.live.node import Membership
from mocapella.live.record_path import RecordPath
from mocapella.live.server import Server, ServerSettings
from mocapella.live.signals import stop_on_signals
from mocapella.live.thread_deaths import StopEvent, end_with_any_thread
from mocapella.model.observations import body_frame
from mocapella.model.session import Setup
from mocapella.model.topology import topology
from mocapella.recording.spool import DiskSpool
from mocapella.recording.take_reader import read_take
from mocapella.wire.delivery import FrameRequest
from mocapella.wire.node import NodeLink

POSITIONS = np.ones((1, 25, 3), np.float32)


def publish(link: NodeLink) -> bool:
    link.publish(body_frame("", topology("kinect_v2"), time_ns=link.published + 1, positions=POSITIONS))
    return True


def die(error: BaseException, name: str = "camera") -> None:
    """End a thread of this process by an error."""

    def run() -> None:
        raise error

    thread = threading.Thread(target=run, name=name)
    thread.start()
    thread.join()


def test_the_death_of_a_thread_stops_the_program_and_names_it() -> None:
    stop, exited = StopEvent(), threading.Event()
    before = threading.excepthook

    def block() -> None:
        with end_with_any_thread(stop, exit_now=exited.set, within_s=0.0):
            die(MemoryError("no room"))
            assert stop.wait(30.0)
            assert stop.died.is_set()
            assert exited.wait(30.0)  # although this block goes on

    with pytest.raises(MocapellaError, match="the thread camera died: MemoryError: no room"):
        block()
    assert threading.excepthook is before


def test_a_thread_that_ends_is_no_death() -> None:
    stop, exited = StopEvent(), threading.Event()
    with end_with_any_thread(stop, exit_now=exited.set, within_s=0.0):
        die(SystemExit())
        assert not stop.is_set()
    assert not exited.is_set()


def test_commands_that_run_for_long_end_with_any_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    exited = threading.Event()
    monkeypatch.setattr("mocapella.live.thread_deaths.exit_process", exited.set)

    def command() -> None:
        with stop_on_signals() as stop:
            die(MemoryError(), "questions")
            assert stop.is_set()

    with pytest.raises(MocapellaError, match="the thread questions died"):
        command()
    assert exited.wait(30.0)


def test_a_terminal_that_is_closed_ends_the_program_in_order() -> None:
    hang_up = getattr(signal, "SIGHUP", None)
    if hang_up is None:
        pytest.skip("this system has no terminals that hang up")
    before = signal.signal(hang_up, signal.SIG_DFL)  # the tests may run under nohup
    try:
        with stop_on_signals() as stop:
            signal.raise_signal(hang_up)
            assert stop.wait(30.0)
            assert not stop.died.is_set()
        signal.signal(hang_up, signal.SIG_IGN)  # as nohup does
        with stop_on_signals() as stop:
            signal.raise_signal(hang_up)
            assert not stop.is_set()
    finally:
        signal.signal(hang_up, before)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_background_job_of_a_shell_can_be_ended(number: signal.Signals) -> None:
    before = signal.signal(number, signal.SIG_IGN)  # as a shell does to its background jobs
    try:
        with stop_on_signals() as stop:
            signal.raise_signal(number)
            assert stop.wait(30.0)
        assert signal.getsignal(number) is signal.SIG_IGN
    finally:
        signal.signal(number, before)


SIGNALLED = """
import signal
from mocapella.live.signals import stop_on_signals
with stop_on_signals() as stop:
    with stop._cond:  # as within stop.wait() and stop.set()
        for _ in range(2):
            signal.raise_signal(signal.SIGTERM)
    assert stop.wait(30.0)
"""


def test_a_signal_while_the_event_is_locked_ends_the_program() -> None:
    subprocess.run([sys.executable, "-c", SIGNALLED], timeout=60.0, check=True)


def test_signals_leave_no_thread_and_no_file_behind() -> None:
    before = threading.active_count(), psutil.Process().num_fds()
    with stop_on_signals():
        signal.raise_signal(signal.SIGTERM)
    assert (threading.active_count(), psutil.Process().num_fds()) == before


def no_room(*_: object, **__: object) -> None:
    raise MemoryError("planted")


@pytest.mark.parametrize(
    ("what", "name"),
    [
        ("_recording.recorder._writer.flush", "recorder"),
        ("_recording._record_path._ask", "record-path"),
        ("_notices._say", "notices"),
        ("_link.probe_clock", "clocks"),
        ("status", "housekeeping"),
        ("_session.step", "tracker"),
        ("_registry.standing", "message of the bus"),
        ("_recording._record_path._answered", "answer of a node"),
    ],
)
def test_whichever_thread_dies_the_take_is_closed_at_once(
    what: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without waiting for missing frames: the process exits soon after."""
    monkeypatch.setattr("mocapella.live.record_path.GIVE_UP_S", 3600.0)
    monkeypatch.setattr(RecordPath, "_whole", lambda path: False)
    stop, exited, address = StopEvent(), threading.Event(), f"tcp/127.0.0.1:{free_port()}"

    def session() -> None:
        with end_with_any_thread(stop, exit_now=exited.set, within_s=0.0):
            settings = ServerSettings(address, setup=Setup("stand-still"), reserve_bytes=0)
            server = Server(settings, failed=stop.died)
            with suppress(UnstoredFramesError), NodeLink(address, "front") as link:
                wait_until("the node joins", link.join)
                server.record_to(tmp_path / "a.mcap")
                wait_until("a frame is stored", lambda: publish(link) and server.status().recording.frames > 0)
                *path, last = what.split(".")
                monkeypatch.setattr(reduce(getattr, path, server), last, no_room)

                def died() -> bool:
                    server._notices.add("something to say")
                    return publish(link) and stop.is_set()

                wait_until("the death", died)
                closing = threading.Thread(target=server.close, daemon=True)
                closing.start()
                closing.join(60.0)
                assert not closing.is_alive()
                link.farewell_s = 0.0

    with pytest.raises(MocapellaError, match=f"the thread {name} died: MemoryError: planted"):
        session()
    assert exited.wait(60.0)
    take = read_take(tmp_path / "a.mcap")
    assert [problem for problem in take.problems if "unknown after frame" not in problem] == []
    (node,) = take.complete()
    assert node.end_known or take.problems  # it is marked if nobody knows the last frame; the node may have said it
    assert list(take.scenes())


def test_a_node_whose_thread_has_died_does_not_wait_for_its_server(tmp_path: Path) -> None:
    stop, address = StopEvent(), f"tcp/127.0.0.1:{free_port()}"
    link = NodeLink(address, "front", spool=lambda node: DiskSpool(tmp_path, *node))
    link.farewell_s = 3600.0
    publish(link)
    link.outbox.update(FrameRequest("a" * 32, 0), 0)  # a take that lacks the frame, whose server is away
    membership = Membership(link, stop, lambda text: None)
    stop.died.set()
    stop.set()
    membership.close()
    with pytest.raises(UnstoredFramesError, match="1 frames are not stored by the server; they are in"):
        link.close()


PLANTED = """
    from mocapella.live.server import Server
    step, count = Server._step, 0
    def planted(self, message):
        global count
        count += 1
        if count == 20:
            raise MemoryError("planted")
        if count == 10:
            raise ZeroDivisionError("planted, and caught")
        return step(self, message)
    Server._step = planted
    from mocapella.live import thread_deaths
    thread_deaths.exit_process = lambda: None  # this machine may be too busy for two seconds
    from mocapella.cli import main
    main()
"""
"""A server whose tracker dies; that it exits in time all the same is held by the test of the block above."""


def test_a_server_whose_tracker_dies_closes_its_take_and_goes_on_with_it_when_it_is_started_again(
    tmp_path: Path,
) -> None:
    port = free_port()
    words = f"serve --no-view --port {port} --method stand-still --record {tmp_path / 'a'} --set reserve_gib=0".split()
    server = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(PLANTED), *words],
        stderr=subprocess.PIPE, text=True, env={**os.environ, "MOCAPELLA_LOGS": str(tmp_path / "logs")},
    )  # fmt: skip
    with ExitStack() as links:
        link = links.enter_context(NodeLink(f"tcp/127.0.0.1:{port}", "front"))
        try:
            wait_until("the node joins", link.join, 60.0)
            wait_until("the server ends", lambda: publish(link) and server.poll() is not None, 60.0)
            _, said = server.communicate()
        finally:
            server.kill()
        died = read_take(tmp_path / "a.mcap")
        with Program(tmp_path, "again", *words) as again:
            wait_until("the node joins", link.join)
            publish(link)
            link.farewell_s = 60.0  # until all is stored
            links.close()
            assert again.end() == 0, again.output
    assert server.returncode == 1
    assert "unexpected error (frame): ZeroDivisionError: planted, and caught" in said
    assert "the thread tracker died: MemoryError: planted" in said
    assert [problem for problem in died.problems if "unknown after frame" not in problem] == []  # it is closed
    assert died.scene_count == 18  # of the frames before, without the one whose error was caught
    take = read_take(tmp_path / "a.mcap")
    assert (take.clean, take.problems, len(take.interruptions)) == (True, (), 1)
    (node,) = take.complete()
    assert (node.stored, node.lost) == (link.published, 0)
    (log,) = (tmp_path / "logs").iterdir()
    assert "ZeroDivisionError" in log.read_text()
