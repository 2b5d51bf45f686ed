"""What a session does about what happens around it."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import cast

import pytest
from support.marker_motion import pair
from support.programs import free_port
from typer.testing import CliRunner

from mocapella.calibration.sensor_layout import VERSION, LayoutSensor, SensorLayout, load_layout, save_layout
from mocapella.cli.app import app
from mocapella.cli.live_session import LiveSession, wait_while
from mocapella.cli.serve import LayoutKeeper, ServeKeys, load_layout_option, nodes_hint
from mocapella.errors import MocapellaError
from mocapella.live.launch import Children
from mocapella.live.server import Server, ServerSettings
from mocapella.model.camera_rig_file import encode_camera_rig, save_camera_rig
from mocapella.recording.disk import GIB
from mocapella.tracker.method_files import settings_of_files


def test_a_view_that_ends_by_itself_is_told_of_once_and_ends_nothing_else(capsys: pytest.CaptureFixture[str]) -> None:
    server = Server(ServerSettings(f"tcp/127.0.0.1:{free_port()}"))
    told: list[str] = []
    looks = 0

    def looked_often() -> bool:
        nonlocal looks
        looks += 1
        told.append(capsys.readouterr().err)
        return "".join(told) != "" and looks > 3

    try:
        with Children() as view, Children() as nodes:
            view.start(["--version"])
            wait_while(LiveSession(server, view, nodes, threading.Event()), 60.0, until=looked_often)
        assert "".join(told).count("the live view has ended") == 1
        assert not server.failed.is_set()
        assert server.status().health.ended == ("view",)
    finally:
        server.close()


def test_a_recording_leaves_the_same_room_however_the_server_is_started() -> None:
    default = ServeKeys().reserve_gib
    assert default * GIB == ServerSettings("tcp/127.0.0.1:7447").reserve_bytes


def test_the_nodes_of_a_method_are_named_if_they_are_few() -> None:
    words = "start a node for each sensor, in a terminal of its own: mocapella node keypoints --help"
    assert nodes_hint("webcams") == nodes_hint("one-webcam") == words
    assert nodes_hint("default") == ""  # many kinds of sensors


class Placed:
    """A server that knows its layout after a while."""

    def __init__(self, *layouts: SensorLayout | None) -> None:
        self.layouts = list(layouts)

    def layout(self) -> SensorLayout | None:
        return self.layouts.pop(0)


def test_a_layout_is_saved_when_another_sensor_is_placed_and_at_the_end(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place = LayoutSensor([[float(i == k) for k in range(4)] for i in range(4)], 1.0, 1.0)
    two, three = (
        SensorLayout(VERSION, True, dict.fromkeys(names, place), []) for names in (("a", "b"), ("a", "b", "c"))
    )
    path = tmp_path / "hall.json"
    keeper = LayoutKeeper(cast(Server, Placed(None, two, two, three, two)), path)
    saved = []
    for _ in range(4):
        assert not keeper.watch()
        saved.append(sorted(load_layout(path).sensors) if path.exists() else [])
        path.unlink(missing_ok=True)
    assert saved == [[], ["a", "b"], [], ["a", "b", "c"]]
    keeper.save()
    assert load_layout(path) == two
    assert "sensor layout saved to" in capsys.readouterr().err


def test_where_nobody_walked_nothing_is_saved_and_that_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "hall.json"
    LayoutKeeper(cast(Server, Placed(None)), path).save()
    assert not path.exists()
    assert "no two sensors have been placed" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--set", "layout=none.json"], "none.json: cannot be read"),
        (["--set", "layout=note.txt"], "note.txt: is no sensor layout"),
        (["--set", "layout=rig.toml"], "rig.toml: is a camera rig; use --rig"),
        (["--set", "layout=rig.json", "--method", "arms"], "rig.json: is a camera rig; use --rig"),
        (["--set", "layout=other.toml"], "other.toml: is a camera rig; use --rig"),
        (["--set", "layout=hall.json", "--method", "stand-still"], "'stand-still' keeps no sensor layout"),
        (["--set", "save_layout=no-folder/hall.json"], "save_layout no-folder/hall.json: cannot be written there"),
        (["--set", "save_layout=hall.json", "--method", "hands"], "the method hands finds no sensor layout"),
        (["--rig", "none.toml"], "none.toml: is not there"),
        (["--rig", "note.txt"], "note.txt: is no TOML"),
        (["--rig", "hall.json"], "hall.json: is a sensor layout; use --set layout=FILE"),
        (["--rig", "hall.toml", "--method", "arms"], "hall.toml: is a sensor layout; use --set layout=FILE"),
        (["--rig", "old.json", "--method", "hands"], "old.json: is a sensor layout; use --set layout=FILE"),
        (
            ["--rig", "rig.toml", "--method", "stand-still"],
            "the method stand-still wants no such file; methods that do: arms, default, hands, one-webcam, "
            "silhouettes, webcams",
        ),
        (["--rig", "rig.toml"], "settings of silhouettes"),
        (["--method", "defalt"], "did you mean default?"),
        (["--set", "silent_after=2"], "did you mean silent_after_s?"),
        (["--set", "people.smoothnig=kalman"], "did you mean smoothing?"),
        (["--set", "people=1", "--set", "people.swap_m=1"], "people has a value already"),
        (["--host", "192.0.2.1"], "choose another with --port"),
    ],
)
def test_what_cannot_be_used_ends_the_command_before_it_begins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("mocapella.tracker.warm_up", lambda *_: pytest.fail("compiled before it was refused"))
    for name in ("hall.json", "hall.toml"):
        save_layout(name, SensorLayout(VERSION, True, {}, []))
    save_layout("old.json", SensorLayout(VERSION + 1, True, {}, []))
    for name in ("rig.toml", "rig.json"):
        save_camera_rig(name, pair())
    Path("other.toml").write_text("[cameras.1]\n")
    Path("note.txt").write_text("a note")
    result = CliRunner().invoke(app, ["serve", "--no-view", "--port", str(free_port()), *arguments])
    assert isinstance(result.exception, MocapellaError)
    assert said in str(result.exception)


def test_no_suffix_decides_whether_a_file_is_a_layout_or_a_camera_rig(tmp_path: Path) -> None:
    layout, cameras = SensorLayout(VERSION, True, {}, []), pair()
    save_layout(tmp_path / "hall.toml", layout)
    save_camera_rig(tmp_path / "rig.json", cameras)
    assert load_layout_option(tmp_path / "hall.toml") == layout
    for method in ("arms", "hands"):
        told = settings_of_files(method, {"rig": tmp_path / "rig.json", "hand": None, "alignment": []})
        assert told == {"rig": encode_camera_rig(cameras)}
