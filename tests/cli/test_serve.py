"""What a session does about what happens around it."""

from __future__ import annotations

import inspect
import threading
from pathlib import Path
from typing import cast

import pytest
from programs import free_port
from typer.testing import CliRunner

from mocapella.calibration.rig import VERSION, Rig, RigSensor, load_rig, save_rig
from mocapella.cli.app import app
from mocapella.cli.serve import LiveSession, RigKeeper, serve, wait_while
from mocapella.errors import MocapellaError
from mocapella.live.launch import Children
from mocapella.live.server import Server, ServerSettings
from mocapella.recording.disk import GIB


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
    finally:
        server.close()


def test_a_recording_leaves_the_same_room_however_the_server_is_started() -> None:
    default = inspect.signature(serve).parameters["reserve_gib"].default
    assert default * GIB == ServerSettings("tcp/127.0.0.1:7447").reserve_bytes


class Placed:
    """A server that knows its rig after a while."""

    def __init__(self, *rigs: Rig | None) -> None:
        self.rigs = list(rigs)

    def rig(self) -> Rig | None:
        return self.rigs.pop(0)


def test_a_rig_is_saved_when_another_sensor_is_placed_and_at_the_end(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place = RigSensor([[float(i == k) for k in range(4)] for i in range(4)], 1.0, 1.0)
    two, three = (Rig(VERSION, True, dict.fromkeys(names, place), []) for names in (("a", "b"), ("a", "b", "c")))
    path = tmp_path / "hall.json"
    keeper = RigKeeper(cast(Server, Placed(None, two, two, three, two)), path)
    saved = []
    for _ in range(4):
        assert not keeper.watch()
        saved.append(sorted(load_rig(path).sensors) if path.exists() else [])
        path.unlink(missing_ok=True)
    assert saved == [[], ["a", "b"], [], ["a", "b", "c"]]
    keeper.save()
    assert load_rig(path) == two
    assert "rig saved to" in capsys.readouterr().err


def test_where_nobody_walked_nothing_is_saved_and_that_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "hall.json"
    RigKeeper(cast(Server, Placed(None)), path).save()
    assert not path.exists()
    assert "no two sensors have been placed" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--rig", "none.json"], "none.json: cannot be read"),
        (["--save-rig", "no-folder/hall.json"], "--save-rig no-folder/hall.json: cannot be written there"),
        (["--rig", "hall.json", "--method", "stand-still"], "'stand-still' uses no rig"),
        (["--method", "defalt"], "did you mean default?"),
        (["--set", "silent_after=2"], "did you mean silent_after_s?"),
        (["--set", "people.smoothnig=kalman"], "did you mean smoothing?"),
        (["--set", "people=1", "--set", "people.swap_m=1"], "people has a value already"),
        (["--interface", "192.0.2.1"], "choose another with --port"),
    ],
)
def test_what_cannot_be_used_ends_the_command_before_it_begins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("mocapella.tracker.make_ready", lambda *_: pytest.fail("compiled before it was refused"))
    save_rig("hall.json", Rig(VERSION, True, {}, []))
    result = CliRunner().invoke(app, ["serve", "--no-view", "--port", str(free_port()), *arguments])
    assert isinstance(result.exception, MocapellaError)
    assert said in str(result.exception)
