"""A thread that dies ends the process, with the take closed."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
import threading
from pathlib import Path

import numpy as np
import pytest
from support.programs import free_port, wait_until

from mocapella.errors import MocapellaError
from mocapella.live.signals import stop_on_signals
from mocapella.live.thread_deaths import end_with_any_thread
from mocapella.model.observations import body_frame
from mocapella.model.topology import topology
from mocapella.recording.take_reader import read_take
from mocapella.wire.node import NodeLink

POSITIONS = np.ones((1, 25, 3), np.float32)


def die(error: BaseException, name: str = "camera") -> None:
    """End a thread of this process by an error."""

    def run() -> None:
        raise error

    thread = threading.Thread(target=run, name=name)
    thread.start()
    thread.join()


def test_the_death_of_a_thread_stops_the_program_and_names_it() -> None:
    stop, exited = threading.Event(), threading.Event()
    before = threading.excepthook

    def block() -> None:
        with end_with_any_thread(stop, exit_now=exited.set, within_s=0.0):
            die(MemoryError("no room"))
            assert stop.wait(30.0)
            assert exited.wait(30.0)  # although this block goes on

    with pytest.raises(MocapellaError, match="the thread camera died: MemoryError: no room"):
        block()
    assert threading.excepthook is before


def test_a_thread_that_ends_is_no_death() -> None:
    stop, exited = threading.Event(), threading.Event()
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
    from mocapella.cli import main
    main()
"""


def test_a_server_whose_tracker_dies_exits_with_its_take_closed(tmp_path: Path) -> None:
    port = free_port()
    words = f"serve --no-view --port {port} --method stand-still --record {tmp_path / 'a'} --set reserve_gib=0".split()
    server = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(PLANTED), *words],
        stderr=subprocess.PIPE, text=True, env={**os.environ, "MOCAPELLA_LOGS": str(tmp_path / "logs")},
    )  # fmt: skip
    try:
        with NodeLink(f"tcp/127.0.0.1:{port}", "front") as link:
            wait_until("the node joins", link.join, 60.0)

            def ended() -> bool:
                link.publish(body_frame("", topology("kinect_v2"), time_ns=link.published + 1, positions=POSITIONS))
                return server.poll() is not None

            wait_until("the server ends", ended, 60.0)
        _, said = server.communicate()
    finally:
        server.kill()
    assert server.returncode == 1
    assert "unexpected error (frame): ZeroDivisionError: planted, and caught" in said
    assert "the thread tracker died: MemoryError: planted" in said
    take = read_take(tmp_path / "a.mcap")
    assert [problem for problem in take.problems if "unknown after frame" not in problem] == []  # it is closed
    assert len(list(take.scenes())) == 18  # of the frames before, without the one whose error was caught
    (log,) = (tmp_path / "logs").iterdir()
    assert "ZeroDivisionError" in log.read_text()
