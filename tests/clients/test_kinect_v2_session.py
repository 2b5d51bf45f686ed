"""The Kinect v2 client with bridge and server as whole processes, and what the take has after faults."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.kinect_client import Built, Client, build, check_frame, frames_played
from support.programs import Program, free_port, wait_until

from mocapella.model.observations import BodyFrame
from mocapella.recording.take_reader import Take, read_take
from mocapella.wire.reader import send_command
from mocapella.wire.session import open_reader


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Built:
    return build(tmp_path_factory.mktemp("kinect"))


class Session:
    """A server that records, a bridge and a client; each can be killed and started again."""

    def __init__(self, built: Built, folder: Path) -> None:
        self.built, self.folder = built, folder
        self.ports = free_port(), free_port()
        self.running: list[Program | Client] = []

    def server(self, name: str = "server") -> Program:
        words = ("--no-view", "--method", "stand-still", "--sensors", "1", "--record", "./take.mcap")
        server = Program(
            self.folder, name, "serve", "--port", str(self.ports[0]), *words, "--json", f"{name}.json",
            "--set", "reserve_gib=0.001",
        )  # fmt: skip
        self.running.append(server)
        wait_until("the server listens", server.said("waiting for sensors at"), timeout=120.0)
        return server

    def bridge(self, name: str = "bridge") -> Program:
        listen, connect = f"127.0.0.1:{self.ports[1]}", f"tcp/127.0.0.1:{self.ports[0]}"
        bridge = Program(self.folder, name, "node", "bridge", "--listen", listen, "--connect", connect)
        self.running.append(bridge)
        wait_until("the bridge listens", bridge.said("bridge: listening"))
        return bridge

    def client(self, *arguments: str, name: str = "client", start: str = "no", **played: int) -> Client:
        words = ("--bridge", f"127.0.0.1:{self.ports[1]}", "--start-bridge", start, *arguments)
        client = Client(self.built, self.folder, *words, name=name, **played)
        self.running.append(client)
        return client

    def stored(self) -> int:
        """Number of frames of the take that are on the server's disk."""
        reader = open_reader(f"tcp/127.0.0.1:{self.ports[0]}")
        try:
            status = send_command(reader, "status").status
        finally:
            reader.close()
        assert status is not None
        return sum(sensor.stored for sensor in status.sensors)

    def close(self) -> None:
        for program in self.running:
            program.__exit__(None, None, None)


@pytest.fixture
def session(built: Built, tmp_path: Path) -> Iterator[Session]:
    made = Session(built, tmp_path)
    yield made
    made.close()


def check_take(take: Take, *runs: Client) -> None:
    """Check that a take has every frame that the runs have sent, once, in order, and in every field as it was."""
    assert take.clean, take.problems
    nodes = take.complete()
    assert [(node.lost, node.missing) for node in nodes] == [(0, ())] * len(runs)
    stored: dict[int, list[BodyFrame]] = {}
    for item in take.frames("front"):
        assert isinstance(item.frame, BodyFrame)
        stored.setdefault(item.frame.node_id, []).append(item.frame)
    assert len(stored) == len(runs)
    for run, frames in zip(runs, stored.values(), strict=True):
        frames.sort(key=lambda frame: frame.sequence)
        assert [frame.sequence for frame in frames] == list(range(len(frames)))
        for frame, played in zip(frames, frames_played(run.stub_log), strict=False):
            assert frame.sent_ns > 0
            check_frame(frame, played)


@pytest.mark.slow
def test_every_field_of_every_frame_is_in_the_take_and_the_client_starts_the_bridge(session: Session) -> None:
    script = session.folder / "mocapella"
    script.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m mocapella "$@"\n')
    script.chmod(0o755)
    server = session.server()
    connect = f"tcp/127.0.0.1:{session.ports[0]}"
    words = ("--mocapella", str(script), "--connect", connect, "--frames", "60")
    client = session.client(*words, start="yes")
    assert client.process.wait(120.0) == 0, client.output
    assert f"front: serving {connect.replace('tcp', 'tls')}" in client.output
    assert server.end() == 0, server.output
    take = read_take(session.folder / "take.mcap")
    check_take(take, client)
    assert take.frame_count == 60
    assert not list(client.spool.iterdir())


@pytest.mark.slow
def test_nothing_is_missing_from_a_take_whose_bridge_was_killed_and_ended(session: Session) -> None:
    server, bridge = session.server(), session.bridge()
    client = session.client("--frames", "360")
    for k in range(2):
        wait_until("frames are stored", lambda k=k: session.stored() >= 60 + 90 * k)  # type: ignore[misc]
        if k == 0:
            bridge.process.kill()
            bridge.process.wait()
        else:
            assert bridge.end() == 0, bridge.output
        made = client.played
        wait_until("more are made", lambda made=made: client.played >= made + 30)  # type: ignore[misc]
        bridge = session.bridge(f"bridge-{k}")
    assert client.process.wait(120.0) == 0, client.output
    assert bridge.end() == 0, bridge.output
    assert server.end() == 0, server.output
    take = read_take(session.folder / "take.mcap")
    check_take(take, client)
    assert take.frame_count == 360
    assert "connecting again" in client.output


@pytest.mark.slow
def test_nothing_is_missing_from_a_take_whose_server_and_bridge_were_killed_together(session: Session) -> None:
    server, bridge = session.server(), session.bridge()
    client = session.client("--frames", "300")
    wait_until("frames are stored", lambda: session.stored() >= 60)
    for program in (server, bridge):
        program.process.kill()
        program.process.wait()
    made = client.played
    bridge = session.bridge("bridge-again")
    wait_until("more are made", lambda: client.played >= made + 60)
    server = session.server("server-again")
    assert client.process.wait(120.0) == 0, client.output
    assert bridge.end() == 0, bridge.output
    assert server.end() == 0, server.output
    take = read_take(session.folder / "take.mcap")
    check_take(take, client)
    assert take.frame_count == 300


@pytest.mark.slow
def test_nothing_is_missing_from_a_take_whose_client_was_killed_without_a_bridge(session: Session) -> None:
    server, bridge = session.server(), session.bridge()
    killed = session.client(name="killed")
    wait_until("frames are stored", lambda: session.stored() >= 40)
    bridge.process.kill()
    bridge.process.wait()
    made = killed.played
    wait_until("more are made", lambda: killed.played >= made + 30)
    killed.kill()
    bridge = session.bridge("bridge-again")
    client = session.client("--frames", "40")
    assert client.process.wait(120.0) == 0, client.output
    assert bridge.end() == 0, bridge.output
    assert server.end() == 0, server.output
    take = read_take(session.folder / "take.mcap")
    check_take(take, killed, client)
    assert take.frame_count >= made + 30 + 40 - 1


@pytest.mark.slow
def test_frames_that_a_full_spool_has_lost_are_counted_in_the_take(session: Session) -> None:
    server = session.server()
    client = session.client("--frames", "700", "--spool-mib", "1", hz=400)
    wait_until("all are made, and some lost", lambda: client.played >= 700 and "spool is full" in client.output)
    bridge = session.bridge()
    assert client.process.wait(120.0) == 1, client.output
    assert bridge.end() == 0, bridge.output
    assert server.end() == 0, server.output
    (node,) = read_take(session.folder / "take.mcap").complete()
    assert node.stored + node.lost == 700
    assert node.lost > 0
    assert f"700 frames, {node.lost} of them lost" in client.output


@pytest.mark.slow
def test_a_name_that_is_taken_is_said_and_the_frames_wait_until_it_is_free(session: Session) -> None:
    server, bridge = session.server(), session.bridge()
    connect = f"tcp/127.0.0.1:{session.ports[0]}"
    with Program(
        session.folder, "other", "node", "simulate", "--scene", "stand", "--name", "front", "--connect", connect
    ) as other:
        wait_until("the other has the name", lambda: session.stored() >= 10)
        client = session.client("--frames", "90")
        wait_until("it says so", lambda: "another node serves the sensor front" in client.output)
        assert other.end() == 0
    assert client.process.wait(120.0) == 0, client.output
    assert bridge.end() == 0, bridge.output
    assert server.end() == 0, server.output
    nodes = read_take(session.folder / "take.mcap").complete()
    assert [node.lost for node in nodes] == [0, 0]
    assert 90 in [node.stored for node in nodes]
    assert json.loads((session.folder / "server.json").read_text())["recording"]["lost"] == 0
