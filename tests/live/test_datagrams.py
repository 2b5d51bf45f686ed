"""``mocapella node datagrams`` as a whole process: programs that send, a bus, and somebody who sends far too much."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.programs import Program, free_port, wait_until
from typer.testing import CliRunner

from mocapella.cli.app import app
from mocapella.errors import AddressInUseError, NameTakenError, SettingsError
from mocapella.live.datagrams import run_datagrams
from mocapella.live.server import Server, ServerSettings
from mocapella.model.markers import MarkerFrame
from mocapella.sensing.colour_profile import save_profile
from mocapella.sources.datagram_settings import DatagramSettings
from mocapella.sources.simulate.hand_camera import pointed_at
from mocapella.sources.simulate.hand_scene import load_hand_scene
from mocapella.testing import FakeServer
from mocapella.wire.node import NodeLink

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "02_pi_camera.py"
PICTURES = 40


def free_udp_ports(count: int) -> list[int]:
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
    for one in sockets:
        one.bind(("127.0.0.1", 0))
    ports = [one.getsockname()[1] for one in sockets]
    for one in sockets:
        one.close()
    return ports


def test_two_programs_wait_for_the_start_and_become_two_cameras_while_a_third_floods(tmp_path: Path) -> None:
    server, scene = FakeServer(), load_hand_scene("demo", seed=3)
    shots = [scene.at("left", 0.2 + 0.02 * k) for k in range(5)]
    (tmp_path / "pictures").mkdir()
    for k in range(PICTURES):
        cv2.imwrite(str(tmp_path / "pictures" / f"{k:02}.png"), shots[k % 5].image)
    save_profile(tmp_path / "left.json", pointed_at(scene, "left"))
    seen = (str(tmp_path / "pictures"), str(tmp_path / "left.json"))
    left, right, *starts = free_udp_ports(4)
    report = tmp_path / "report.json"
    over = threading.Event()

    def flood() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while not over.is_set():
                for _ in range(300):
                    sender.sendto(b"1,1;2,2;3,3;4,4;5,5;6,6", ("127.0.0.1", left))
                over.wait(0.01)

    flooding = threading.Thread(target=flood)
    senders: list[subprocess.Popen[bytes]] = []
    words = ["node", "datagrams", "--camera", f"left={left}", "--camera", f"right={right}", "--connect", server.address]
    try:
        with server:
            for port, start in zip((left, right), starts, strict=True):
                what = (*seen, "127.0.0.1", str(port), str(PICTURES), str(start))
                with (tmp_path / f"{port}.txt").open("w") as said:
                    senders.append(subprocess.Popen([sys.executable, str(EXAMPLE), *what], stdout=said))
            ready = (lambda port=port: "--size" in (tmp_path / f"{port}.txt").read_text() for port in (left, right))
            for learnt in ready:  # else one ends long before the other begins, and the flood has its port
                wait_until("its colours are learnt", learnt, timeout=180.0)
            # There is no broadcast on the loopback: the node's start command reaches one, ours the other.
            with Program(
                tmp_path, "node", *words, "--set", f"start_to=127.0.0.1:{starts[0]}", "--json", str(report)
            ) as node:
                wait_until("the left one is heard", node.said("left: hears 127.0.0.1"), timeout=180.0)
                flooding.start()
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:

                    def started() -> bool:
                        other.sendto(b"start", ("127.0.0.1", starts[1]))
                        return node.said("right: hears 127.0.0.1")()

                    wait_until("the right one is heard", started, timeout=180.0)
                wait_until("others are noticed", node.said("left: others send to its port, too"))
                time.sleep(0.5)
                over.set()  # a program may take seconds to end, and after 2 s the port would be the flood's
                assert [sender.wait(60.0) for sender in senders] == [0, 0]
                assert node.end() == 0
    finally:
        over.set()
        if flooding.ident is not None:
            flooding.join()
        for sender in senders:
            sender.kill()
            sender.wait()
    done = json.loads(report.read_text())
    assert done["starts_sent"] >= 1
    for name in ("left", "right"):
        row, frames = done["cameras"][name], [frame for frame in server.frames if frame.sensor == name]
        assert all(isinstance(frame, MarkerFrame) for frame in frames)
        assert row["served"]
        assert row["refused"] == {}
        assert PICTURES // 2 < row["frames"] + row["superseded"] <= PICTURES  # in spite of the flood
        assert 0 < len(frames) <= row["frames"]
        assert (np.diff([frame.sequence for frame in frames]) > 0).all()
        assert (np.diff([frame.time_ns for frame in frames]) > 0).all()
        assert {frame.names for frame in frames} == {("red", "yellow", "green", "blue", "magenta", "cyan")}
        assert np.mean([frame.found for frame in frames]) > 0.9
        for frame in frames:
            off = [np.abs(frame.positions_px - shot.centres_px)[frame.found].max() for shot in shots]
            assert min(off) < 3.0
    said = (tmp_path / f"{left}.txt").read_text()
    assert "--markers red,yellow,green,blue,magenta,cyan --size 320x240" in said  # as `node datagrams` has it
    assert "milliseconds over" in said
    assert all(stage in said for stage in ("retrieval", "detection", "sending", "all"))
    # At most a turn's datagrams, and those of a buffer, in each of the port's turns: far fewer than were sent.
    assert 0 < done["cameras"]["left"]["other_senders"] <= 64 * 250 * (done["seconds"] + 1)
    assert done["cameras"]["right"]["other_senders"] == 0


def test_a_name_that_is_taken_ends_the_node(tmp_path: Path) -> None:
    address = f"tcp/127.0.0.1:{free_port()}"
    server = Server(ServerSettings(address))
    try:
        with NodeLink(address, "left") as first:
            wait_until("the first node has joined", first.join)
            settings = DatagramSettings((("left", 0), ("right", 0)), ("red",))
            with pytest.raises(NameTakenError, match="left"):
                run_datagrams(settings, address, threading.Event(), lambda text: None)
    finally:
        server.close()


def test_a_port_in_use_opens_no_node(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as first:
        first.bind(("127.0.0.1", 0))
        settings = DatagramSettings((("left", first.getsockname()[1]),), ("red",))
        with pytest.raises(AddressInUseError, match="in use by another program"):
            run_datagrams(settings, "tcp/127.0.0.1:1", threading.Event(), lambda text: None)


def test_without_a_server_it_says_so_and_still_reports(tmp_path: Path) -> None:
    (port,) = free_udp_ports(1)
    words = ["node", "datagrams", "--camera", f"left={port}", "--connect", f"tcp/127.0.0.1:{free_port()}"]
    with Program(tmp_path, "node", *words, "--json", "-") as node:
        wait_until("it listens", node.said(f"left: listening at 127.0.0.1:{port}"))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.sendto(b"1,2", ("127.0.0.1", port))
        wait_until("it says what is wrong", node.said("1 pairs; the markers are 6: red, yellow"))
        assert node.end(signal.SIGTERM) == 0
    assert "which no server at" in node.output
    assert '"number of markers": 1' in node.output


def test_its_seconds_are_those_between_its_begin_and_its_end() -> None:
    stop, began_s = threading.Event(), time.monotonic()
    stop.set()
    settings = DatagramSettings((("left", 0),), ("red",))
    report = run_datagrams(settings, f"tcp/127.0.0.1:{free_port()}", stop, lambda text: None)
    assert 0.0 <= report["seconds"] <= time.monotonic() - began_s + 0.001  # it is rounded


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--camera", "left"], "--camera 'left' cannot be used; write it as left=5001"),
        (["--camera", "left=٣"], "cannot be used; write it as left=5001"),
        (["--camera", "left=5001", "--size", "640"], "--size '640' cannot be used; write it as 640x480"),
        (["--camera", "left=5001", "--set", "start_to=nowhere"], "start_to 'nowhere' cannot be used; write it as"),
        (["--camera", "left=5001", "--camera", "right=5001"], "each at a port of its own"),
    ],
)
def test_options_that_cannot_be_used_say_how(words: list[str], why: str) -> None:
    done = CliRunner().invoke(app, ["node", "datagrams", *words])
    assert isinstance(done.exception, SettingsError)
    assert why in str(done.exception)
