"""A camera's node in a process of its own: what it sends, and what it answers over real sockets."""

from __future__ import annotations

import itertools
import json
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
import zenoh
from support.programs import Program, free_port, wait_until
from typer.testing import CliRunner

from mocapella.cli.app import app
from mocapella.errors import MocapellaError, SettingsError
from mocapella.live.marker_node import MarkerNodeSummary, run_marker_node
from mocapella.live.stage_times import StageTimes
from mocapella.model.board import parse_board
from mocapella.model.camera import Camera
from mocapella.model.markers import MarkerFrame, marker_frame
from mocapella.schema import decode_frame
from mocapella.sensing.boards import board_png
from mocapella.sensing.colour_profile import load_profile, save_profile
from mocapella.sources.acquisition import Acquisition
from mocapella.sources.picture_source import Picture, SourceState
from mocapella.sources.simulate.hand_camera import pointed_at
from mocapella.sources.simulate.hand_scene import load_hand_scene
from mocapella.supervision import Boundary
from mocapella.testing import FakeCamera
from mocapella.wire import keys
from mocapella.wire.keys import NodeKey
from mocapella.wire.questions import (
    AskBoard,
    AskControls,
    AskLearn,
    AskMask,
    AskPicture,
    AskReport,
    AskSave,
    Clicks,
    NodeAnswer,
    ask_node,
    read_answer,
)  # fmt: skip
from mocapella.wire.session import open_reader, open_server

BOARD = 'kind = "charuco"\ncolumns = 5\nrows = 4\nsquare_m = 0.03\nmarker_ratio = 0.75\ndictionary = "DICT_4X4_50"\n'


class Bus:
    """What a node sends, and a way to ask it, through a server's socket."""

    def __init__(self) -> None:
        self.port = free_port()
        self.address = f"tcp/127.0.0.1:{self.port}"
        self.server = open_server(self.address)
        self.frames: list[MarkerFrame] = []
        self._subscriber = self.server.declare_subscriber(keys.ALL_LIVE, self._take)
        self.reader: zenoh.Session = open_reader(self.address)

    def _take(self, sample: zenoh.Sample) -> None:
        frame = decode_frame(sample.payload.to_bytes())
        assert isinstance(frame, MarkerFrame)
        self.frames.append(frame)

    def ask(self, question: Any) -> NodeAnswer:
        """Its answer; as often as it says that it was asked too often."""
        return self._patiently(lambda: ask_node(self.reader, "left", question, timeout=30.0))

    def ask_raw(self, data: bytes) -> NodeAnswer:
        return self._patiently(lambda: self._ask_raw(data))

    def _patiently(self, ask: Callable[[], NodeAnswer]) -> NodeAnswer:
        while "ask again in a second" in (answer := ask()).message:
            time.sleep(0.2)
        return answer

    def _ask_raw(self, data: bytes) -> NodeAnswer:
        replies = [r.ok.payload.to_bytes() for r in self.reader.get(keys.asking("left"), payload=data, timeout=30.0)]
        assert len(replies) == 1
        return read_answer(replies[0])

    def close(self) -> None:
        self.reader.close()
        self.server.close()


@pytest.fixture(scope="module")
def bus() -> Iterator[Bus]:
    made = Bus()
    yield made
    made.close()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, bus: Bus) -> Path:
    """Pictures of a hand that the node shows again and again."""
    path = tmp_path_factory.mktemp("node")
    scene = load_hand_scene("demo", seed=3)
    (path / "pictures").mkdir()
    for k in range(6):
        image = scene.at("left", 0.2 + 0.02 * k).image
        cv2.imwrite(str(path / "pictures" / f"{k}.png"), image)
    return path


@pytest.fixture(scope="module")
def node(folder: Path, bus: Bus) -> Iterator[Program]:
    """It has no colours yet."""
    arguments = (
        "pictures",
        "--set",
        "loop=true",
        "--fps",
        "25",
        "--name",
        "left",
        "--profile",
        "left.json",
        "--epoch",
        "0",
    )
    epoch = (*arguments[:-1], str(time.time()))
    with Program(folder, "left", "node", "markers", *epoch, "--connect", bus.address, "--set", "report=0.5") as program:
        wait_until("frames come", lambda: program.said("pictures of")() and len(bus.frames) > 5, timeout=120.0)
        yield program
        assert program.end() == 0, program.output
        assert "frames published" in program.output


def decoded(answer: NodeAnswer) -> Any:
    assert answer.ok, answer.message
    return cv2.imdecode(np.frombuffer(answer.image, np.uint8), cv2.IMREAD_COLOR)


def test_a_node_without_colours_sends_empty_frames_and_says_what_to_do(node: Program, bus: Bus) -> None:
    assert bus.frames[-1].names == ()
    assert bus.frames[-1].size_px == (320, 240)
    refused = bus.ask(AskMask())
    assert (refused.ok, "no colours are learnt yet" in refused.message) == (False, True)
    assert not bus.ask(AskSave()).ok
    assert "no colours are learnt yet" in str(bus.ask(AskReport()).report)


def test_colours_are_learnt_by_pointing_at_a_picture_used_at_once_and_saved(
    node: Program, bus: Bus, folder: Path
) -> None:
    shown = bus.ask(AskPicture(format="png"))
    image, scene = decoded(shown), load_hand_scene("demo", seed=3)
    files = [cv2.imread(str(folder / "pictures" / f"{k}.png")) for k in range(6)]
    which = next(k for k, file in enumerate(files) if np.array_equal(file, image))
    shot = scene.at("left", 0.2 + 0.02 * which)
    points = {n: (float(x), float(y)) for n, (x, y) in zip(scene.names, shot.centres_px, strict=True)}
    before = len(bus.frames)
    learnt = bus.ask(AskLearn([Clicks(shown.time_ns, points)]))
    assert learnt.ok, learnt.message
    assert learnt.names == list(scene.names)
    assert learnt.separability is not None
    assert set(learnt.separability["kept"]) == set(scene.names)
    wait_until("frames with the new colours come", lambda: bus.frames[-1].names == scene.names)
    assert len(bus.frames) > before  # frames came on while it learnt
    newest = bus.frames[-1]
    assert newest.found.all()
    near = min(np.abs(newest.positions_px - scene.at("left", 0.2 + 0.02 * k).centres_px).max() for k in range(6))
    assert near < 3.0
    assert not (folder / "left.json").exists()
    assert bus.ask(AskSave()).ok
    saved = load_profile(folder / "left.json")
    assert (saved.camera, saved.names, saved.size_px) == ("left", scene.names, (320, 240))
    masked = bus.ask(AskMask())
    assert masked.positions_px is not None
    mask = decoded(masked)
    assert mask.shape == (240, 320, 3)
    x, y = masked.positions_px[0] or (np.nan, np.nan)
    assert mask[round(y) - 2, round(x) - 2].max() > 200  # painted, where the rest is dark
    assert np.median(mask) < 100


def test_pointing_that_cannot_be_learnt_from_is_refused_and_changes_nothing(node: Program, bus: Bus) -> None:
    shown, before = bus.ask(AskPicture()), bus.frames[-1].names
    for points, says in (
        ({"skin": (160.0, 120.0)}, "no marker was pointed at"),
        ({"red": (999.0, 5.0)}, "lies outside the image"),
        ({"x" * 81: (160.0, 120.0)}, "1 to 80 characters"),
        ({"": (160.0, 120.0)}, "1 to 80 characters"),
        ({"red": (1e308, -1e308)}, "lies outside the image"),
    ):
        refused = bus.ask(AskLearn([Clicks(shown.time_ns, points)]))
        assert not refused.ok
        assert says in refused.message
    assert bus.frames[-1].names == before


def test_pictures_come_in_the_size_that_is_asked_for(node: Program, bus: Bus) -> None:
    small = bus.ask(AskPicture(scale=0.5))
    assert decoded(small).shape == (120, 160, 3)
    assert (small.size_px, small.format) == ((320, 240), "jpeg")
    assert small.time_ns > 0
    controls = bus.ask(AskControls()).controls
    assert controls is not None
    assert controls["asked_fps"] == 25.0
    assert controls["automatic"] == []


def test_corners_of_a_board_are_told_of_the_newest_picture(node: Program, bus: Bus) -> None:
    there = bus.ask(AskBoard(BOARD))
    assert there.ok
    assert there.corners == {"ids": [], "corners_px": [], "edge_px": None}
    assert "nor any other board" in bus.ask(AskBoard(BOARD, explain=True)).message
    assert "field kind: is missing" in bus.ask(AskBoard("columns = 5")).message


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "no question"),
        (b"\xff\x00", "no question"),
        (b"{}", "missing required field `ask`"),
        (b'{"ask":"format disk"}', "Invalid value 'format disk'"),
        (b'{"ask":"picture","colour":1}', "unknown field `colour`"),
        (b'{"ask":"picture","scale":1e9}', "must be from 0.05 to 2"),
        (b'{"ask":"picture","scale":"x"}', "Expected `float`"),
        (b'{"ask":"learn","clicks":[]}', "click on every marker"),
        (b'{"ask":"learn","clicks":[{"time_ns":5,"points":{"red":[1,1]}}]}', "no image of that time is kept"),
        (b'{"ask":"board","board":"' + b"x" * 70_000 + b'"}', "at most 65536 are read"),
        (b"[" * 60_000, "no question"),
        (b'{"ask":"learn","clicks":[{"time_ns":1e999,"points":{}}]}', "no question"),
    ],
)
def test_nonsense_is_answered_with_what_would_have_worked(node: Program, bus: Bus, data: bytes, says: str) -> None:
    answer = bus.ask_raw(data)
    assert not answer.ok
    assert says in answer.message


def test_too_many_questions_are_refused_and_frames_flow_on(node: Program, bus: Bus) -> None:
    before, answers = len(bus.frames), list[NodeAnswer]()

    def pester() -> None:
        answers.extend(ask_node(bus.reader, "left", AskMask(scale=2.0), timeout=30.0) for _ in range(30))

    threads = [threading.Thread(target=pester) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    refused = [answer.message for answer in answers if not answer.ok]
    assert len(answers) == 90
    assert refused
    assert all("ask again" in message for message in refused)
    wait_until("frames come on", lambda: len(bus.frames) > before + 10)


def test_a_board_is_found_and_a_film_that_ends_ends_the_node(tmp_path: Path, bus: Bus) -> None:
    """A still picture of a board at three times a second: no colours, a board, and an end of its own at Ctrl-C."""
    drawn = cv2.imdecode(np.frombuffer(board_png(parse_board(BOARD), 72), np.uint8), cv2.IMREAD_COLOR)
    cv2.imwrite(str(tmp_path / "board.png"), drawn)
    arguments = ("node", "markers", "board.png", "--set", "loop=true", "--name", "boards", "--connect", bus.address)
    with Program(tmp_path, "boards", *arguments, "--epoch", str(time.time()), "--json", "out.json") as program:
        wait_until("it sends", lambda: program.said("pictures of")() and bus.frames[-1].sensor == "boards", 120.0)
        found = ask_node(bus.reader, "boards", AskBoard(BOARD), timeout=30.0)
        assert found.corners is not None
        assert found.corners["ids"] == list(range(12))
        assert np.array(found.corners["corners_px"]).shape == (12, 2)
        assert program.end() == 0
    summary = json.loads((tmp_path / "out.json").read_text())
    assert summary["published"] > 0
    assert summary["report"]["markers"] == {}


def test_what_cannot_be_served_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    scene = load_hand_scene("demo", seed=3)
    save_profile(tmp_path / "left.json", pointed_at(scene, "left"))
    cv2.imwrite(str(tmp_path / "large.png"), np.zeros((480, 640, 3), np.uint8))
    for arguments, says in (
        (
            ("large.png", "--profile", "left.json"),
            "left.json: field size_px: '320 × 240': large.png gives pictures of 640",
        ),
        (
            ("large.png", "--profile", "left.json", "--name", "right"),
            "left.json: field camera: 'left': the colours are",
        ),
        (("large.png",), "no colours yet"),
        (("nothing.mp4", "--name", "x"), "nothing.mp4: is not there"),
        (("rendered:demo/middle",), "unknown camera 'middle'"),
        (("rendered:demo",), "write it as rendered:demo/left"),
        (("camera:first", "--name", "x"), "camera:0"),
        (("large.png", "--name", "x", "--size", "big"), "640x480"),
        (("large.png", "--name", "x", "--set", "timing=9"), "the setting timing needs colours"),
    ):
        done = CliRunner().invoke(app, ["node", "markers", *arguments])
        assert isinstance(done.exception, MocapellaError), done.output
        assert says in str(done.exception)


class OneMarker:
    """Processing that sees one marker at the image's origin."""

    names = ("red",)

    def look(self, picture: Picture) -> MarkerFrame:
        return marker_frame("left", self.names, time_ns=picture.time_ns, size_px=(64, 48), positions_px=[[0, 0]])

    def in_time(self, took_s: float, age_s: float, drop_after_s: float) -> bool:
        return True

    def words(self) -> str:
        return ""

    def warnings(self, now_s: float) -> Iterator[str]:
        return iter(())

    def report(self) -> dict[str, Any]:
        return {}


class StoppingLink:
    """A node's link without a bus, which stops the node at the third frame."""

    node, address, put_off = NodeKey("left", 1), "tcp/127.0.0.1:1", ""

    def __init__(self) -> None:
        self.errors, self.stop, self.published = Boundary(), threading.Event(), 0
        self.heard_s = time.monotonic()

    def join(self, timeout: float = 1.0) -> bool:
        return True

    def server_is_there(self) -> bool:
        return True

    def answer(self, ask: Any) -> None:
        pass

    def publish(self, frame: MarkerFrame) -> None:
        self.published += 1
        if self.published == 3:
            self.stop.set()


def run_here(times: StageTimes | None, camera: Camera | None = None) -> MarkerNodeSummary:
    """Run a node with a clock that goes on by a second with each look at it."""
    link, work, service = StoppingLink(), OneMarker(), SimpleNamespace(ask=None)
    seconds, spent_s = itertools.count(), itertools.count(100)
    with Acquisition(FakeCamera(SourceState((64, 48), None))) as acquisition:
        return run_marker_node(
            link, acquisition, work, service, stop=link.stop, times=times, camera=camera,  # type: ignore[arg-type]
            clock=lambda: float(next(seconds)), processor_clock=lambda: 0.25 * next(spent_s),
        )  # fmt: skip


def test_a_node_measures_times_only_if_it_is_asked_to() -> None:
    done = run_here(None)
    assert (done.published, done.report, done.stages, done.jitter) == (3, {"errors": {}}, None, None)
    assert done.processor_ms is None


@pytest.mark.parametrize("calibrated", [False, True])
def test_each_stage_takes_its_own_time_and_all_take_the_sum(calibrated: bool) -> None:
    camera = Camera("left", (64, 48), np.array([50.0, 50, 31.5, 23.5, 0, 0, 0, 0, 0])) if calibrated else None
    done = run_here(StageTimes(3, 1), camera)
    assert done.stages is not None
    taken_s = {"retrieval": 0, "detection": 1, "sending": 1} | ({"rectification": 1} if calibrated else {})
    assert {name: row["mean_ms"] for name, row in done.stages.items()} == {
        name: 1000 * seconds for name, seconds in (taken_s | {"all": sum(taken_s.values())}).items()
    }
    assert {row["frames"] for row in done.stages.values()} == {3}
    assert done.jitter == {"red": {"x_px": 0, "y_px": 0, "seen": 3}}
    assert done.processor_ms == 250.0


@pytest.mark.slow
def test_times_of_the_stages_are_measured_without_a_server(tmp_path: Path) -> None:
    words = ["node", "markers", "rendered:demo/left", "--set", "timing=12", "--tags", "APRILTAG_36h11:7"]
    words += ["--set", "prerender=4", "--fps", "60"]
    words += ["--json", str(tmp_path / "t.json"), "--connect", f"tcp/127.0.0.1:{free_port()}"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    summary = json.loads((tmp_path / "t.json").read_text())
    assert set(summary["stages"]) == {"retrieval", "detection", "sending", "all"}
    assert all(row["frames"] == 12 and row["median_ms"] <= row["p99_ms"] <= row["max_ms"]
               for row in summary["stages"].values())  # fmt: skip
    assert set(summary["jitter"]) == {"red", "yellow", "green", "blue", "magenta", "cyan"}
    assert "detection" in done.stdout
    assert summary["processor_ms"] > 0
    assert "of one core" in " ".join(done.stdout.split())
    assert summary["report"]["asked_fps"] == 60.0
    assert summary["report"]["tags"]["images"] >= 12


@pytest.mark.parametrize("tags", ["7", "APRILTAG_36h11:seven", "4X4_50:50", "4X4_50:1,1"])
def test_tags_that_cannot_be_looked_for_are_refused(tags: str) -> None:
    done = CliRunner().invoke(app, ["node", "markers", "rendered:demo/left", "--tags", tags])
    assert done.exit_code != 0
    assert isinstance(done.exception, SettingsError)
