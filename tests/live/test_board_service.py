"""A calibration by commands: nodes that are asked, what they answer, and what becomes of it; no bus, no picture."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.filmed_boards import BOARD, SIZE, film
from support.programs import wait_until

from mocapella.calibration.board_run import BoardRun
from mocapella.errors import BusError, NotNowError, SettingsError
from mocapella.live import board_cameras
from mocapella.live.board_cameras import EXPLAIN_EVERY, NodeCameras, node_names, urgent
from mocapella.live.board_service import BoardService, method_of_rig
from mocapella.model.board import encode_board, parse_board
from mocapella.model.camera_rig_file import decode_camera_rig, load_camera_rig
from mocapella.model.session import CommandReply, RecordingHealth, SensorHealth, SessionStatus, Setup
from mocapella.wire.questions import NodeAnswer

VALUES = {"kind": "charuco", "columns": 6, "rows": 5, "square_m": 0.06}


def sensor(name: str, **changes: Any) -> SensorHealth:
    row: dict[str, Any] = {
        "name": name, "node_id": 1, "connected": True, "silent": False, "local": True, "bodies": 0, "rate_hz": 30.0,
        "latency": None, "frames": 1, "dropped": 0, "rejected": 0, "clock_offset": None, "clock_bound": None,
        "stored": 0, "lost": 0, "tilt": 0.0, "height": 0.0, "pictures": True, "capture_offset": 100.0,
        "sends": "markers",
    }  # fmt: skip
    return SensorHealth(**(row | changes))


KINECT = sensor("kinect", pictures=False, sends="skeletons")
"""Of the session, and not of the rig: no method that wants a rig takes what it sends."""


def status(*sensors: SensorHealth, setup: Setup | None = None) -> SessionStatus:
    setup = setup or Setup()
    return SessionStatus(0, True, "waiting for sensors", 0, 0, 0, "", 0, 0.0, setup, sensors, RecordingHealth(),
                         (), 0.0, "")  # fmt: skip


class Nodes:
    """Two nodes that see a filmed board; each asked picture is the next one."""

    def __init__(self) -> None:
        self.views = {(v.camera, v.frame): v for v in film(instants=14, noise_px=0.2).views}
        self.asked: dict[str, int] = {"c0": 0, "c1": 0}
        self.gone: set[str] = set()
        self.blind: set[str] = set()
        self.questions: list[dict[str, Any]] = []
        self.gate = threading.Event()
        self.gate.set()

    def ask(self, camera: str, question: dict[str, Any], _timeout_s: float) -> NodeAnswer:
        self.gate.wait(30.0)
        self.questions.append(question)
        if camera in self.gone:
            raise BusError(f"{camera}: nobody answered")
        k, self.asked[camera] = self.asked[camera], self.asked[camera] + 1
        seen = self.views.get((camera, k % 14))
        time_ns = 500_000_000 * (k + 1)
        if seen is None or camera in self.blind:
            corners: dict[str, Any] = {"ids": [], "corners_px": [], "edge_px": None}
            said = "there is one of 9 × 6 squares" if question["explain"] else "the board is not seen"
            return NodeAnswer(True, said, time_ns=time_ns, size_px=SIZE, corners=corners)
        corners = {"ids": seen.ids.tolist(), "corners_px": seen.corners_px.tolist(), "edge_px": None}
        return NodeAnswer(True, time_ns=time_ns, size_px=SIZE, corners=corners)


class Harness:
    """A harness, what it sent to the server, and what the server says."""

    def __init__(self, folder: Path, nodes: Nodes) -> None:
        self.sent: list[tuple[str, dict[str, Any]]] = []
        self.reply = CommandReply(True, "tracking hands with c0, c1")
        self.made_ready: list[str] = []
        self.service = BoardService(nodes.ask, self._send, folder, warm_up=self._make_ready)
        self.service.update(status(sensor("c0"), sensor("c1"), KINECT))

    def _send(self, verb: str, arguments: dict[str, Any]) -> CommandReply:
        self.sent.append((verb, arguments))
        return self.reply

    def _make_ready(self, method: str) -> None:
        assert f"compiling the method {method}" in self.service.progress.busy
        self.made_ready.append(method)

    def do(self, verb: str, **arguments: Any) -> CommandReply:
        return self.service.command(verb, arguments)

    def until(self, phase: str, holds: Callable[[], bool] = lambda: True) -> None:
        wait_until(phase, lambda: self.service.progress.phase == phase and holds())


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(board_cameras, "INTERVAL_S", 0.002)


@pytest.fixture
def nodes() -> Nodes:
    return Nodes()


@pytest.fixture
def harness(tmp_path: Path, nodes: Nodes) -> Iterator[Harness]:
    made = Harness(tmp_path, nodes)
    yield made
    nodes.gate.set()
    made.service.close()


def test_from_start_to_a_rig_that_is_saved_and_used(harness: Harness, nodes: Nodes, tmp_path: Path) -> None:
    assert harness.service.progress.phase == "idle"
    started = harness.do("calibrate", board=VALUES)
    assert (started.ok, started.message) == (True, "show the board to c0, c1")
    assert not harness.do("calibrate", board=VALUES).ok
    assert not harness.do("save-rig", name="rig.toml").ok
    harness.until("filming", lambda: harness.service.progress.shared >= 13)
    filming = harness.service.progress
    assert filming.board == "ChArUco board (DICT_4X4_1000), 6 × 5 squares of 60 mm, markers of 45 mm"
    assert [camera.name for camera in filming.cameras] == ["c0", "c1"]
    assert all(camera.views >= 13 and camera.size_px == SIZE for camera in filming.cameras)
    assert sum(map(sum, filming.cameras[0].fields)) > 100
    assert {question["ask"] for question in nodes.questions} == {"board"}
    assert parse_board(nodes.questions[0]["board"]) == BOARD
    assert harness.do("finish-calibration").ok
    harness.until("done")
    quality = harness.service.progress.quality
    assert quality is not None
    assert [row[0] for row in quality.rows] == ["c0", "c1"]
    assert "c0 – c1 0." in quality.tape
    assert any("simultaneous images: 0.0 ms apart" in text for text in quality.sentences)
    (tmp_path / "rig.toml").write_text("somebody's")
    refused = harness.do("save-rig", name="rig")
    assert "rig.toml exists, and files are never overwritten; use rig-2.toml" in refused.message
    harness.reply = CommandReply(False, "no server answered")
    assert harness.do("use-this-rig", name="mine").message == "no server answered"
    assert (harness.service.progress.saved, harness.service.progress.used, harness.service.progress.busy) == (
        True,
        False,
        "",
    )
    harness.reply = CommandReply(True, "tracking hands with c0, c1")
    assert "mine.toml" in harness.do("use-this-rig", name="mine").message
    assert harness.service.progress.used
    assert harness.made_ready == ["hands"] * 2
    verb, arguments = harness.sent[-1]
    assert verb == "use-rig"
    assert arguments["method"] == "hands"
    told, saved = decode_camera_rig(arguments["rig"]), load_camera_rig(tmp_path / "mine.toml")
    assert list(told.cameras) == list(saved.cameras) == ["c0", "c1"]
    assert (tmp_path / "rig.toml").read_text() == "somebody's"


def test_too_few_views_are_said_and_filming_goes_on(harness: Harness, nodes: Nodes) -> None:
    nodes.blind |= {"c0", "c1"}
    harness.do("calibrate", board=VALUES)
    harness.do("finish-calibration")
    harness.until("filming", lambda: "no camera has seen the board" in harness.service.progress.problem)
    nodes.blind.clear()
    harness.until("filming", lambda: harness.service.progress.shared >= 12)
    harness.do("finish-calibration")
    harness.until("done")
    assert harness.service.progress.problem == ""


def test_a_camera_that_never_sees_it_says_what_it_sees_and_one_that_goes_is_named(
    harness: Harness, nodes: Nodes
) -> None:
    nodes.blind.add("c0")
    harness.do("calibrate", board=VALUES)
    harness.until("filming", lambda: "camera c0: there is one of 9 × 6 squares" in harness.service.progress.hints)
    explained = sum(question["explain"] for question in nodes.questions)
    assert 1 <= explained <= len(nodes.questions) / EXPLAIN_EVERY + 1
    nodes.gone.add("c1")
    gone = "camera c1 does not answer: check that its node (mocapella node markers) runs"
    harness.until("filming", lambda: gone in harness.service.progress.hints)
    harness.do("finish-calibration")
    harness.until("filming", lambda: "camera c0 has not seen the board" in harness.service.progress.problem)


def test_a_cancelled_run_is_forgotten_and_another_begins(harness: Harness, tmp_path: Path) -> None:
    (tmp_path / "boards").mkdir()
    (tmp_path / "boards" / "b.toml").write_text(encode_board(BOARD))
    assert harness.do("calibrate", file="boards/b.toml").ok
    assert harness.do("cancel-calibration").ok
    harness.until("idle")
    assert not harness.do("finish-calibration").ok
    assert not harness.do("cancel-calibration").ok
    assert harness.do("calibrate", file="boards/b.toml").ok


@pytest.mark.parametrize(
    ("verb", "arguments", "says"),
    [
        ("calibrate", {"board": VALUES | {"columns": 2}}, "columns is 2; it must be 3 to 100 squares"),
        ("calibrate", {"board": VALUES | {"colums": 6}}, "unknown key 'colums'"),
        ("calibrate", {"file": "../../etc/passwd"}, "is no file below"),
        ("calibrate", {"file": " "}, "the board's file"),
        ("calibrate", {"file": "none.toml"}, "cannot be read"),
        ("use-this-rig", {"name": "x"}, "there is no rig yet"),
    ],
)
def test_what_cannot_be_done_says_what_can(harness: Harness, verb: str, arguments: dict[str, Any], says: str) -> None:
    reply = harness.do(verb, **arguments)
    assert not reply.ok
    assert says in reply.message
    assert harness.service.progress.phase == "idle"


@pytest.mark.parametrize("name", ["", "../rig", "a/b.toml", ".hidden", "x" * 200, "a\nb"])
def test_a_rig_is_saved_in_the_folder_only(harness: Harness, tmp_path: Path, name: str) -> None:
    harness.do("calibrate", board=VALUES)
    harness.until("filming", lambda: harness.service.progress.shared >= 10)
    harness.do("finish-calibration")
    harness.until("done")
    assert "write the name of a file, such as rig.toml" in harness.do("save-rig", name=name).message
    assert list(tmp_path.rglob("*")) == []


def test_without_a_camera_nothing_begins_and_other_verbs_go_to_the_server(harness: Harness) -> None:
    harness.service.update(status(sensor("kinect", pictures=False), sensor("c0", connected=False)))
    assert "start one: mocapella node markers" in harness.do("calibrate", board=VALUES).message
    harness.do("start")
    assert harness.sent == [("start", {})]


def test_times_are_brought_to_the_servers_clock_and_without_it_nothing_is_believed(nodes: Nodes) -> None:
    rows = [sensor("c0", capture_offset=7.5), sensor("c1", capture_offset=None)]
    looks = NodeCameras(lambda name, question, s: nodes.ask(name, msgspec.to_builtins(question), s), lambda: rows,
                      ["c0", "c1"], BOARD)  # fmt: skip
    seen = looks.look()
    looks.close()
    assert seen["c0"].at_s == pytest.approx(0.5 + 7.5, abs=1e-9)
    assert seen["c0"].view is not None
    assert seen["c1"].view is None
    assert "the server does not know its clock yet" in seen["c1"].problem


@given(
    st.one_of(
        st.none(),
        st.fixed_dictionaries({"ids": st.lists(st.integers(), max_size=3)}),
        st.fixed_dictionaries(
            {
                "ids": st.one_of(st.none(), st.lists(st.integers(0, 9), max_size=3)),
                "corners_px": st.lists(st.lists(st.floats(), max_size=3), max_size=3),
            }
        ),
    )
)
def test_whatever_a_node_answers_is_a_view_or_a_problem(corners: dict[str, Any] | None) -> None:
    answer = NodeAnswer(True, time_ns=1, size_px=SIZE, corners=corners)
    looks = NodeCameras(lambda *_: answer, lambda: [sensor("c0")], ["c0"], BOARD)
    found = looks.look()["c0"]
    looks.close()
    if found.view is not None:
        assert corners is not None
        assert found.view.ids.tolist() == sorted(set(corners["ids"]))
        assert found.view.corners_px.tolist() == [list(point) for point in corners["corners_px"]]
        assert found.view.ids.max() < BOARD.corners
        assert np.isfinite(found.view.corners_px).all()
    else:
        assert found.problem or corners == {"ids": [], "corners_px": []}


@pytest.mark.parametrize(("axis", "least", "most"), [(0, -1.0, SIZE[0]), (1, -1.0, SIZE[1])])
def test_corners_from_a_pixel_before_the_picture_to_its_size_are_believed_and_none_beside(
    axis: int, least: float, most: float
) -> None:
    for value, believed in ((least, True), (most, True), (np.nextafter(least, -9), False), (most + 0.01, False)):
        corner = [5.0, 5.0]
        corner[axis] = float(value)
        answer = NodeAnswer(True, time_ns=1, size_px=SIZE, corners={"ids": [3], "corners_px": [corner]})
        looks = NodeCameras(lambda *_, answer=answer: answer, lambda: [sensor("c0")], ["c0"], BOARD)
        found = looks.look()["c0"]
        looks.close()
        assert (found.view is not None) == believed
        assert bool(found.problem) != believed


def test_what_keeps_a_camera_from_seeing_comes_before_what_is_missing(nodes: Nodes) -> None:
    nodes.gone.add("c1")
    looks = NodeCameras(lambda name, question, s: nodes.ask(name, msgspec.to_builtins(question), s),
                      lambda: [sensor("c0"), sensor("c1")], ["c0", "c1"], BOARD)  # fmt: skip
    run = BoardRun(BOARD, ["c0", "c1"])
    run.add(looks.look())
    looks.close()
    assert "c1 does not answer" in urgent(run)[0]
    assert not any("c1 has not seen the board" in text for text in urgent(run))


def test_nodes_are_named_as_they_are() -> None:
    rows = [sensor("c0"), sensor("kinect", pictures=False), sensor("old", connected=False)]
    assert node_names(["node:c0"], "node:", rows) == ["c0"]
    for text, says in (("node:kinect", "is no camera"), ("node:old", "is not there"), ("node:x", "cameras .*: c0")):
        with pytest.raises(SettingsError, match=says):
            node_names([text], "node:", rows)
    with pytest.raises(SettingsError, match="none; start one: mocapella node markers"):
        node_names(["node:c0"], "node:", [])


@pytest.mark.parametrize(
    ("sends", "method"),
    [
        (["markers"], "hands"),
        (["images"], "silhouettes"),
        (["images", "images"], "silhouettes"),
        (["markers", "?"], "hands"),
    ],
)
def test_a_rig_is_for_the_method_that_wants_one_and_takes_what_its_cameras_send(sends: list[str], method: str) -> None:
    assert method_of_rig(sends) == method


@pytest.mark.parametrize("sends", [["skeletons"], ["depth"], ["unknown"], []])
def test_cameras_of_which_no_method_wants_a_rig_are_named(sends: list[str]) -> None:
    with pytest.raises(NotNowError, match=sends[0] if sends else "nothing"):
        method_of_rig(sends)


def test_it_is_known_whether_the_session_tracks_with_a_rig(harness: Harness) -> None:
    assert not harness.service.progress.has_rig
    for method, has_rig in (("hands", True), ("default", False), ("silhouettes", True), ("not installed", False)):
        harness.service.update(status(sensor("c0"), setup=Setup(method=method)))
        assert harness.service.progress.has_rig is has_rig
        same = harness.service.progress
        harness.service.update(status(sensor("c0"), setup=Setup(method=method)))
        assert harness.service.progress is same  # browsers see that nothing is new
