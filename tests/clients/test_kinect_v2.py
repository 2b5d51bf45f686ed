"""The Kinect v2 client before a bridge of the test's: its messages, and what it does when the bridge misbehaves."""

from __future__ import annotations

import json
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.kinect_client import SOURCE, Built, Client, build, check_frame, frames_played
from support.programs import free_port, wait_until

from mocapella.model.observations import BodyFrame
from mocapella.schema import decode_frame, encode_frame
from mocapella.schema.delimited import DelimitedReader

ROOT = Path(__file__).resolve().parents[2]
PATIENCE_S = 60.0
WINDOW = 18000


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Built:
    return build(tmp_path_factory.mktemp("kinect"))


class Connection:
    """A connection of the client, as the bridge has it.

    Attributes:
        start: the client's request.
        frames: the messages that are frames.
        said: the other messages after the request.
    """

    def __init__(self, accepted: socket.socket) -> None:
        self.socket, self.reader = accepted, DelimitedReader()
        self.frames: list[bytes] = []
        self.said: list[dict[str, Any]] = []
        self.closed = False
        self.start: dict[str, Any] = {}
        self.until(lambda: bool(self.said))
        self.start = self.said.pop(0)

    def until(self, holds: Any) -> None:
        """Receive until it holds or the client closes."""
        while not holds() and not self.closed:
            piece = self.socket.recv(65536)
            self.closed = not piece
            for message in self.reader.feed(piece):
                if message[:1] == b"{":
                    self.said.append(json.loads(message))
                else:
                    self.frames.append(message)

    def answer(self, *lines: str) -> None:
        self.socket.sendall("".join(f"{line}\n" for line in lines).encode())

    @property
    def numbers(self) -> list[int]:
        return [decode_frame(data).sequence for data in self.frames]


class Listener:
    """The test's bridge: accepts connections one after the other."""

    def __init__(self, port: int = 0) -> None:
        self.socket = socket.create_server(("127.0.0.1", port))
        self.socket.settimeout(PATIENCE_S)
        self.address = f"127.0.0.1:{self.socket.getsockname()[1]}"

    @contextmanager
    def connection(self) -> Iterator[Connection]:
        accepted, _ = self.socket.accept()
        with accepted:
            accepted.settimeout(PATIENCE_S)
            yield Connection(accepted)


@pytest.fixture
def listener() -> Iterator[Listener]:
    made = Listener()
    with made.socket:
        yield made


def client(built: Built, folder: Path, bridge: str, *arguments: str, **settings: Any) -> Client:
    return Client(built, folder, "--bridge", bridge, "--start-bridge", "no", *arguments, **settings)


@pytest.mark.parametrize("name", ["frame_skeleton", "frame_everything", "frame_nobody"])
def test_its_encoder_writes_the_test_vectors_byte_for_byte(built: Built, name: str) -> None:
    written = subprocess.run(["mono", built.vectors, name], check=True, timeout=60, capture_output=True).stdout
    assert written == (ROOT / "tests" / "vectors" / f"{name}.bin").read_bytes()


def test_every_field_of_every_frame_is_sent(built: Built, tmp_path: Path, listener: Listener) -> None:
    with client(built, tmp_path, listener.address, "--frames", "40", hz=100) as program:
        with listener.connection() as heard:
            assert heard.start["say"] == "start"
            assert (heard.start["sensor"], heard.start["first"], heard.start["lost"]) == ("front", 0, 0)
            heard.answer(f"window {WINDOW}", "kept 0")
            heard.until(lambda: heard.said)
            assert heard.said == [{"say": "end"}]
            heard.answer("kept 40", "ended")
        assert program.process.wait(PATIENCE_S) == 0, program.output
    frames = [decode_frame(data) for data in heard.frames]
    assert [encode_frame(frame) for frame in frames] == heard.frames  # byte for byte as Python's encoder
    assert heard.numbers == list(range(40))
    sent = [frame.sent_ns for frame in frames]
    assert sent == sorted(sent)
    assert sent[-1] - sent[0] > 0
    assert sent[0] > 0
    for frame, played in zip(frames, frames_played(program.stub_log), strict=False):
        assert isinstance(frame, BodyFrame)
        assert (frame.sensor, frame.node_id) == ("front", heard.start["node_id"])
        check_frame(frame, played)
    assert {frame.bodies for frame in frames} == {2, 3}
    assert not list(program.spool.iterdir())


def test_frames_without_a_body_are_sent(built: Built, tmp_path: Path, listener: Listener) -> None:
    with client(built, tmp_path, listener.address, "--frames", "3", empty=1), listener.connection() as heard:
        heard.answer(f"window {WINDOW}")
        heard.until(lambda: heard.said)
    assert [decode_frame(data).bodies for data in heard.frames] == [0, 0, 0]


def test_joints_that_are_no_numbers_and_times_that_repeat_or_go_back(
    built: Built, tmp_path: Path, listener: Listener
) -> None:
    with client(built, tmp_path, listener.address, "--frames", "8", bad=3) as program:
        with listener.connection() as heard:
            heard.answer(f"window {WINDOW}")
            heard.until(lambda: heard.said)
            heard.answer("kept 8", "ended")
        assert program.process.wait(PATIENCE_S) == 0, program.output
    frames = [decode_frame(data) for data in heard.frames]
    assert heard.numbers == list(range(8))
    assert all(earlier.time_ns < later.time_ns for earlier, later in pairwise(frames))
    assert (frames[3].states[:, 0] == 0).all()
    assert np.isnan(frames[3].positions[:, 0]).all()
    assert "repeated 1; 2 joints were no numbers" in program.output


def test_frames_are_kept_until_a_bridge_is_there_and_sent_again_after_its_end(built: Built, tmp_path: Path) -> None:
    port = free_port()
    with client(built, tmp_path, f"127.0.0.1:{port}", "--frames", "90") as program:
        wait_until("it keeps frames", lambda: program.played >= 10 and "no bridge at 127.0.0.1" in program.output)
        listener = Listener(port)
        with listener.socket:
            with listener.connection() as first:
                assert (first.start["first"], first.start["lost"]) == (0, 0)
                first.answer(f"window {WINDOW}", "kept 0")
                first.until(lambda: len(first.frames) >= 20)
                first.answer("kept 7")
                first.until(lambda: len(first.frames) >= 25)
            with listener.connection() as second:
                assert second.start["node_id"] == first.start["node_id"]
                assert (second.start["first"], second.start["lost"]) == (7, 0)
                second.answer(f"window {WINDOW}")
                second.until(lambda: second.said)
                second.answer("kept 90", "ended")
            assert program.process.wait(PATIENCE_S) == 0, program.output
    assert first.numbers[:25] == list(range(25))
    assert second.numbers == list(range(7, 90))


def test_the_window_is_kept_to(built: Built, tmp_path: Path, listener: Listener) -> None:
    with client(built, tmp_path, listener.address, "--frames", "60", hz=300) as program:
        with listener.connection() as heard:
            heard.answer("window 5", "kept 0")
            wait_until("all are made", lambda: program.played >= 60)
            heard.until(lambda: len(heard.frames) >= 5)
            heard.socket.settimeout(0.5)
            with pytest.raises(TimeoutError):
                heard.until(lambda: len(heard.frames) > 5)
            heard.socket.settimeout(PATIENCE_S)
            for number in range(5, 65, 5):
                heard.answer(f"kept {min(number, 60)}")
                heard.until(lambda upto=number: len(heard.frames) >= min(upto + 5, 60))  # type: ignore[misc]
            heard.until(lambda: heard.said)
            heard.answer("ended")
        assert program.process.wait(PATIENCE_S) == 0, program.output
    assert heard.numbers == list(range(60))


def test_what_a_killed_client_has_not_delivered_is_sent_first_by_the_next(
    built: Built, tmp_path: Path, listener: Listener
) -> None:
    with client(built, tmp_path, listener.address, name="killed") as killed, listener.connection() as first:
        first.answer(f"window {WINDOW}")
        first.until(lambda: len(first.frames) >= 15)
        first.answer("kept 9")
        wait_until("more are made", lambda: killed.played >= 30)
        killed.kill()
        first.until(lambda: False)
    with client(built, tmp_path, listener.address, "--frames", "12") as program:
        with listener.connection() as left:
            assert left.start["node_id"] == first.start["node_id"]
            assert left.start["lost"] == 0
            left.answer(f"window {WINDOW}")
            left.until(lambda: left.said)
            last = left.numbers[-1]
            left.answer(f"kept {last + 1}", "ended")
        with listener.connection() as fresh:
            assert fresh.start["node_id"] != first.start["node_id"]
            fresh.answer(f"window {WINDOW}")
            fresh.until(lambda: fresh.said)
            fresh.answer("kept 12", "ended")
        assert program.process.wait(PATIENCE_S) == 0, program.output
    assert left.numbers == list(range(left.start["first"], last + 1))
    assert last >= 29  # played and numbered by the killed one
    assert fresh.numbers == list(range(12))
    assert left.frames[15:20] == first.frames[left.start["first"] + 15 : left.start["first"] + 20]
    assert "frames of the earlier run are stored" in program.output


def test_a_full_spool_loses_the_oldest_frames_and_says_so(built: Built, tmp_path: Path) -> None:
    port = free_port()
    frames = 700  # more than fit
    arguments = ("--frames", str(frames), "--spool-mib", "1")
    with client(built, tmp_path, f"127.0.0.1:{port}", *arguments, hz=1000) as program:
        wait_until("all are made", lambda: program.played >= frames)
        wait_until("it says so", lambda: "the spool is full" in program.output)
        listener = Listener(port)
        with listener.socket, listener.connection() as heard:
            lost = heard.start["lost"]
            assert heard.start["first"] == lost > 0
            heard.answer(f"window {WINDOW}")
            heard.until(lambda: heard.said)
            heard.answer(f"kept {frames}", "ended")
        assert program.process.wait(PATIENCE_S) == 1, program.output
    assert heard.numbers == list(range(lost, frames))
    assert f"{lost} frames before frame {lost} are lost, and reported as lost" in program.output
    assert f"{frames} frames, {lost} of them lost" in program.output


@pytest.mark.slow
def test_the_frames_of_earlier_runs_count_for_the_limit_and_are_lost_first(built: Built, tmp_path: Path) -> None:
    port, arguments = free_port(), ("--spool-mib", "1", "--frames", "300")
    for name in ("first", "second"):
        with client(built, tmp_path, f"127.0.0.1:{port}", *arguments, name=name, hz=1000) as program:
            wait_until("all are made", lambda program=program: program.played >= 300)  # type: ignore[misc]
            wait_until("all are kept", lambda program=program: "no bridge" in program.output)  # type: ignore[misc]
    assert "the spool is full" in program.output
    assert 500_000 < sum(path.stat().st_size for path in program.spool.glob("*/*.frames")) <= 2**20
    listener = Listener(port)
    with listener.socket, client(built, tmp_path, listener.address, "--frames", "5") as third:
        for lost, numbers in ((True, 300), (False, 300), (False, 5)):
            with listener.connection() as heard:
                assert (heard.start["lost"] > 0) is lost
                heard.answer(f"window {WINDOW}")
                heard.until(lambda heard=heard: heard.said)  # type: ignore[misc]
                heard.answer(f"kept {numbers}", "ended")
            assert heard.numbers == list(range(heard.start["first"], numbers))
        assert third.process.wait(PATIENCE_S) == 0, third.output


def test_a_second_client_of_the_sensor_leaves_the_first_ones_frames_alone(built: Built, tmp_path: Path) -> None:
    nowhere = f"127.0.0.1:{free_port()}"
    with client(built, tmp_path, nowhere, name="first") as first:
        wait_until("the first keeps frames", lambda: first.played >= 5)
        with client(built, tmp_path, nowhere, name="second") as second:
            wait_until("the second keeps frames", lambda: second.played >= 5)
            assert "earlier run" not in second.output


@pytest.mark.slow
def test_a_loss_behind_frames_that_the_bridge_has_is_told_at_the_next_connection(
    built: Built, tmp_path: Path, listener: Listener
) -> None:
    arguments = ("--frames", "700", "--spool-mib", "1")
    with client(built, tmp_path, listener.address, *arguments, hz=1000) as program:
        with listener.connection() as first:
            first.answer("window 100")
            first.until(lambda: len(first.frames) >= 100)
            wait_until("the spool is full", lambda: "the spool is full" in program.output)
            wait_until("all are made", lambda: program.played >= 700)
            first.answer("kept 100")
            first.until(lambda: False)
            assert first.closed
        with listener.connection() as second:
            assert second.start["first"] - second.start["lost"] == 100
            assert second.start["lost"] > 0
            second.answer(f"window {WINDOW}")
            second.until(lambda: second.said)
            second.answer("kept 700", "ended")
        assert program.process.wait(PATIENCE_S) == 1, program.output
    assert first.numbers == list(range(100))
    assert second.numbers == list(range(second.start["first"], 700))


def test_a_refusal_is_said_and_it_tries_again(built: Built, tmp_path: Path, listener: Listener) -> None:
    with client(built, tmp_path, listener.address) as program:
        with listener.connection() as first:
            first.answer("another node serves the sensor front; give this one another with --name, or end that node")
        with listener.connection() as second:
            assert second.start == first.start | {key: second.start[key] for key in ("next", "now_ns")}
    assert "the bridge says: another node serves the sensor front" in program.output


@pytest.mark.slow
def test_without_a_bridge_it_says_at_the_end_where_the_frames_are(built: Built, tmp_path: Path) -> None:
    with client(built, tmp_path, f"127.0.0.1:{free_port()}") as program:
        wait_until("it has made frames", lambda: program.played >= 5)
        assert program.end() == 1
    assert "frames are not stored; they stay in" in program.output
    assert "the next start sends them" in program.output


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "the name of the sensor is missing"),
        (["no/name"], "sensor name no/name cannot be used"),
        (["front", "--frames"], "--frames wants a value"),
        (["front", "--frames", "x"], "--frames is x; it wants 1 to"),
        (["front", "--bridge", "7450"], "--bridge wants HOST:PORT"),
        (["front", "--start-bridge", "1"], "--start-bridge is 1; it wants yes or no"),
        (["front", "--colour", "red"], "there is no option --colour"),
    ],
)
def test_a_wrong_command_line_is_named(built: Built, words: list[str], said: str) -> None:
    done = subprocess.run(["mono", built.client, *words], check=False, timeout=60, capture_output=True, text=True)
    assert done.returncode == 2
    assert said in done.stderr
    assert "usage: kinect_v2 SENSOR" in done.stderr


def test_the_documentation_has_the_limits_of_the_program(built: Built) -> None:
    usage = subprocess.run(["mono", built.client], check=False, timeout=60, capture_output=True, text=True).stderr
    text = " ".join((ROOT / "docs" / "sensors.md").read_text(encoding="utf-8").split())
    assert "largest size of these (1024)" in usage
    assert "free disk space to leave (1024)" in usage
    assert "They have at most 1024 MiB (`--spool-mib`), and leave as much of the disk free (`--reserve-mib`)" in text
    for option in ("--connect", "--bridge", "--start-bridge", "--spool", "--spool-mib", "--reserve-mib"):
        assert f"  {option} " in usage
        assert option in text


def test_it_is_written_for_the_compiler_that_windows_has() -> None:
    script = (SOURCE / "build.cmd").read_bytes()
    assert script.count(b"\n") == script.count(b"\r\n")  # as cmd wants
    assert b"v4.0.30319\\csc.exe" in script
    assert b"-langversion:5" in (SOURCE / "Makefile").read_bytes()
