"""What a session survives: a server that stands still, nodes that come, go and are killed, a full name, Ctrl-C."""

from __future__ import annotations

import json
import os
import re
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import psutil
import pytest
from support.programs import Program, free_port, result, result_here, run, run_here, wait_until

from mocapella.errors import NoServerError
from mocapella.model.session import SensorHealth, SessionStatus
from mocapella.recording.take_reader import read_take
from mocapella.wire.reader import send_command
from mocapella.wire.session import open_reader


class Served:
    """A server in a process of its own, and a way to ask it how it is."""

    def __init__(self, folder: Path, *options: str, port: int | None = None, name: str = "server") -> None:
        self.port = port or free_port()
        self.address = f"tcp/127.0.0.1:{self.port}"
        self.program = Program(
            folder,
            name,
            "serve",
            "--port",
            str(self.port),
            "--set",
            "reserve_gib=0.001",
            "--json",
            "server.json",
            *options,
        )
        wait_until("the server listens", self.program.said("waiting for sensors at"))
        self.session = open_reader(self.address)

    def status(self) -> SessionStatus:
        status = send_command(self.session, "status").status
        assert status is not None
        return status

    def sensor(self, name: str) -> SensorHealth | None:
        return next((row for row in self.status().sensors if row.name == name), None)

    def close(self) -> None:
        self.session.close()
        self.program.__exit__(None, None, None)


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Served]:
    server = Served(tmp_path, "--no-view")
    yield server
    server.close()


@pytest.fixture(scope="module")
def one_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """Of several tests, each of which has sensors of its own names."""
    server = Served(tmp_path_factory.mktemp("server"), "--no-view")
    yield server
    server.close()


def simulate(folder: Path, address: str, sensor: str, *options: str, name: str | None = None) -> Program:
    return Program(
        folder,
        name or f"node-{sensor}",
        "node",
        "simulate",
        "--scene",
        "stand",
        "--sensor",
        sensor,
        "--connect",
        address,
        "--epoch",
        "1000000000",
        *options,
    )


def seen(served: Served, name: str, frames: int = 1) -> bool:
    row = served.sensor(name)
    return row is not None and row.frames >= frames and not row.silent


@pytest.mark.slow
def test_a_silent_node_is_noticed_and_so_is_its_return(one_server: Served, tmp_path: Path) -> None:
    with simulate(tmp_path, one_server.address, "1", "--name", "quiet") as node:
        wait_until("frames", lambda: seen(one_server, "quiet", 10))
        os.kill(node.process.pid, signal.SIGSTOP)
        # Within 3 s is held in tests/live/test_sensor_registry.py, where time is an argument.
        wait_until("the silence is noticed", lambda: (row := one_server.sensor("quiet")) is not None and row.silent)
        os.kill(node.process.pid, signal.SIGCONT)
        wait_until("the return", lambda: (row := one_server.sensor("quiet")) is not None and not row.silent)
        wait_until("a notice", lambda: any('"quiet" is back' in notice for notice in one_server.status().notices))
        assert node.end() == 0


def test_a_killed_node_leaves_the_others_alone_and_a_new_one_takes_its_name(one_server: Served, tmp_path: Path) -> None:
    with (
        simulate(tmp_path, one_server.address, "1", "--name", "front") as front,
        simulate(tmp_path, one_server.address, "2", "--name", "side") as side,
    ):
        wait_until("both", lambda: seen(one_server, "front") and seen(one_server, "side"))
        first = one_server.sensor("front")
        front.process.kill()
        wait_until("it is gone", lambda: (row := one_server.sensor("front")) is not None and not row.connected)
        count = one_server.sensor("side")
        assert count is not None
        wait_until("the other goes on", lambda: seen(one_server, "side", count.frames + 30))
        with simulate(tmp_path, one_server.address, "1", "--name", "front", name="again") as again:
            wait_until("the new node is served", lambda: (r := one_server.sensor("front")) is not None and r.connected)
            row = one_server.sensor("front")
            assert row is not None
            assert first is not None
            assert row.node_id != first.node_id
            assert again.end() == 0
        assert side.end() == 0


def test_a_second_node_under_a_name_ends_with_the_reason(one_server: Served, tmp_path: Path) -> None:
    with simulate(tmp_path, one_server.address, "1", "--name", "door") as first:
        wait_until("the first", lambda: seen(one_server, "door"))
        with simulate(tmp_path, one_server.address, "2", "--name", "door", name="second") as second:
            assert second.process.wait(60.0) == 1
            assert "another node serves the sensor door" in second.output
        assert first.process.poll() is None


@pytest.mark.slow
def test_a_server_that_stood_still_has_every_frame_afterwards(served: Served, tmp_path: Path) -> None:
    with simulate(tmp_path, served.address, "1", "--name", "front", "--seconds", "9", "--json", "front.json") as node:
        wait_until("frames", lambda: seen(served, "front"))
        assert send_command(served.session, "record", {"name": "still"}).ok
        time.sleep(1.0)
        os.kill(served.program.process.pid, signal.SIGSTOP)
        time.sleep(4.0)
        os.kill(served.program.process.pid, signal.SIGCONT)
        assert node.process.wait(60.0) == 0
        ended = send_command(served.session, "record-stop", timeout=60.0)
        assert ended.ok, ended.message
    take = read_take(tmp_path / "takes" / "still.mcap")
    (frames,) = take.complete()
    assert frames.missing == ()
    assert frames.last == json.loads((tmp_path / "front.json").read_text())["published"] - 1


@pytest.mark.slow
def test_no_end_of_a_node_that_the_server_has_not_heard_is_called_clean(tmp_path: Path) -> None:
    """One node is killed while the server stands still, one while it is gone; one ends then, and keeps its frames."""
    port = free_port()
    words = ["--no-view", "--record", "./take.mcap", "--set", f"takes={tmp_path}"]
    with ExitStack() as stack:
        first = Served(tmp_path, *words, port=port)
        stack.callback(first.close)
        nodes = {
            name: stack.enter_context(simulate(tmp_path, first.address, "1", "--name", name, "--set", "farewell=1"))
            for name in "abc"
        }
        wait_until("frames", lambda: all(seen(first, name, 15) for name in "abc"), timeout=60.0)
        os.kill(first.program.process.pid, signal.SIGSTOP)
        nodes["a"].process.kill()
        time.sleep(1.0)
        os.kill(first.program.process.pid, signal.SIGCONT)
        wait_until("it is gone", lambda: (row := first.sensor("a")) is not None and not row.connected, timeout=60.0)
        first.program.process.kill()
        first.program.process.wait()
        time.sleep(1.0)
        nodes["b"].process.kill()
        assert nodes["c"].end(signal.SIGTERM) == 1  # after a while, in which no server came
        last = Served(tmp_path, *words, port=port, name="again")
        stack.callback(last.close)
        last.session.close()
        assert last.program.end() == 0
    take = read_take(tmp_path / "take.mcap")
    assert not take.clean
    assert [frames.end_known for frames in take.complete()] == [False, False, False]
    assert sum("unknown after frame" in problem for problem in take.problems) == 3
    summary = json.loads((tmp_path / "server.json").read_text())
    assert sorted(end["sensor"] for end in summary["recording"]["unknown"]) == ["a", "b", "c"]
    (kept,) = (tmp_path / "spool").glob("c-*.mcap")
    assert str(kept.relative_to(tmp_path)) in nodes["c"].output
    done = run_here(tmp_path, "take", "merge", "take.mcap", *(str(path) for path in (tmp_path / "spool").iterdir()))
    assert done.returncode == 0, done.stderr
    frames = {frames.sensor: frames for frames in read_take(tmp_path / "take.mcap").complete()}
    assert {name: one.end_known for name, one in frames.items()} == {"a": False, "b": False, "c": True}
    (said,) = re.findall(r"c: (\d+) frames published", nodes["c"].output)
    assert (frames["c"].stored + frames["c"].first, frames["c"].lost) == (int(said), 0)


def test_ending_the_server_closes_the_take_and_exits_with_0(tmp_path: Path) -> None:
    """By Ctrl-C, and by SIGTERM: two servers at once, for a node takes a while to notice."""
    folders = {how: tmp_path / how.name for how in (signal.SIGINT, signal.SIGTERM)}
    with ExitStack() as programs:
        servers, nodes = {}, {}
        for how, folder in folders.items():
            folder.mkdir()
            servers[how] = served = Served(folder, "--no-view", "--record", "./take.mcap")
            programs.callback(served.close)
            nodes[how] = programs.enter_context(simulate(folder, served.address, "1", "--name", "front"))
        for how, served in servers.items():
            wait_until("frames", lambda served=served: seen(served, "front", 30))
            served.session.close()
            assert served.program.end(how) == 0
        for node in nodes.values():
            wait_until("the node notices", node.said("frames are kept for it"))
            assert node.end() == 0
    for folder in folders.values():
        take = read_take(folder / "take.mcap")
        assert take.clean
        assert take.frame_count > 0
        summary = json.loads((folder / "server.json").read_text())
        assert summary["recording"]["frames"] == take.frame_count


@pytest.mark.slow
def test_a_take_recorded_by_command_begins_mid_session_and_replays_alike(served: Served, tmp_path: Path) -> None:
    with (
        simulate(tmp_path, served.address, "1", "--name", "front"),
        simulate(tmp_path, served.address, "2", "--name", "side"),
    ):
        wait_until("somebody is tracked", lambda: served.status().counts.get("people") == 1, timeout=60.0)
        made = result(tmp_path, "record", "mid", "--connect", served.address, "--seconds", "2")
        assert made["frames"] > 0
        assert made["lost"] == 0
    (row,) = result_here(tmp_path, "replay", made["path"])
    assert row["differing_scenes"] == 0
    assert row["frames_out"] > 0
    assert row["most_people"] == 1
    assert row["state_changes"][0]["phase"] != "waiting for sensors"  # as a new tracker would at first


@pytest.mark.slow
def test_takes_are_whole_and_nobody_flaps_when_something_stands_still_as_they_begin_and_end(
    served: Served, tmp_path: Path
) -> None:
    """As on a machine that has too much to do. Each take replays to what was tracked live."""
    with (
        simulate(tmp_path, served.address, "1", "--name", "front") as front,
        simulate(tmp_path, served.address, "2", "--name", "side") as side,
    ):
        wait_until("somebody is tracked", lambda: served.status().counts.get("people") == 1, timeout=60.0)
        said = served.program.output
        takes = []
        for k, paused in enumerate((front, side, served.program, front)):
            pid = paused.process.pid
            os.kill(pid, signal.SIGSTOP)
            resume = threading.Timer(0.2, os.kill, (pid, signal.SIGCONT))
            resume.start()
            begun = send_command(served.session, "record", {"name": f"paused-{k}"}, timeout=30.0)
            assert begun.ok, begun.message
            resume.join()
            time.sleep(1.0)
            os.kill(pid, signal.SIGSTOP)
            resume = threading.Timer(0.2, os.kill, (pid, signal.SIGCONT))
            resume.start()
            ended = send_command(served.session, "record-stop", timeout=60.0)
            resume.join()
            assert ended.ok, ended.message
            takes.append(tmp_path / "takes" / f"paused-{k}.mcap")
        notices = served.program.output.removeprefix(said)
        assert "sent nothing" not in notices
        assert "left" not in notices
        assert served.status().counts.get("people") == 1
    for row in result_here(tmp_path, "replay", *map(str, takes)):
        assert row["differing_scenes"] == 0
        assert row["frames_out"] > 30
        assert row["state_changes"][0]["phase"] != "waiting for sensors"
        assert row["most_people"] == 1


def test_no_server_is_an_error_and_not_a_hang(tmp_path: Path) -> None:
    done = run(tmp_path, "record", "x", "--connect", f"tcp/127.0.0.1:{free_port()}")
    assert done.returncode == 1
    assert "mocapella serve" in done.stderr
    assert "Traceback" not in done.stderr
    with pytest.raises(NoServerError):
        open_reader(f"tcp/127.0.0.1:{free_port()}", timeout=0.2)


@pytest.mark.slow
def test_a_port_in_use_is_named(one_server: Served, tmp_path: Path) -> None:
    done = run(tmp_path, "serve", "--port", str(one_server.port), "--no-view")
    assert done.returncode == 1
    assert str(one_server.port) in done.stderr
    assert "--port" in done.stderr
    view = run(tmp_path, "serve", "--port", str(free_port()), "--set", f"view_port={one_server.port}")
    assert view.returncode == 1
    assert "--view-port" in view.stderr


@pytest.mark.slow
def test_who_opens_another_interface_is_told_of_keys(tmp_path: Path) -> None:
    done = run(tmp_path, "serve", "--port", str(free_port()), "--no-view", "--host", "0.0.0.0", "--set", "seconds=0.5")
    assert done.returncode == 0
    assert "mocapella session invite sensor" in done.stderr
    closed = run(tmp_path, "serve", "--port", str(free_port()), "--no-view", "--set", "seconds=0.5")
    assert "invite" not in closed.stderr


@pytest.mark.slow
def test_what_a_killed_demo_has_started_ends_too(tmp_path: Path) -> None:
    with Program(
        tmp_path,
        "demo",
        "demo",
        "--no-browser",
        "--scene",
        "stand",
        "--port",
        str(free_port()),
        "--view-port",
        str(free_port()),
    ) as demo:
        wait_until("all are there", demo.said("simulating stand"), timeout=120.0)
        children = psutil.Process(demo.process.pid).children()
        assert len(children) == 4  # three sensors and the view
        demo.process.kill()
        demo.process.wait()
        gone, alive = psutil.wait_procs(children, timeout=30.0)
        assert not alive, [child.cmdline() for child in alive]
        assert len(gone) == 4
