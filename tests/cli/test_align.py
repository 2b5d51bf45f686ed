"""``mocapella calibrate space``: from a take to a file for the tracker; messages about unusable takes."""

from __future__ import annotations

import inspect
import json
import threading
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from support.moved_wand import DELAY_S, HZ, ON_BODY, T_WORLD_VR, moved, wand
from support.programs import Program, free_port, wait_until
from typer.testing import CliRunner

from mocapella.cli.align import align
from mocapella.cli.app import app
from mocapella.errors import CalibrationError, InputError, MocapellaError, SettingsError
from mocapella.geometry.rigid import inverse
from mocapella.geometry.twists import log_motion
from mocapella.live.align_guide import AlignGuideSettings
from mocapella.model.session import Setup
from mocapella.model.space import load_space
from mocapella.recording.take import TakeInfo
from mocapella.recording.take_writer import TakeWriter
from mocapella.schema import encode_frame, encode_scene
from mocapella.wire.node import NodeLink
from mocapella.wire.server import ServerLink

assert align  # registers the verb


def recorded(path: Path, *, seconds: float = 6.0, turned: float = 0.7, spaces: tuple[str, ...] = ("vr",)) -> Path:
    """Of the wand's place, of a marker on it, and of poses that nobody could use then."""
    setup = Setup("hands", sensors_expected=2, participant=1, placement="", scenario="")
    writer = TakeWriter.create(path, info=TakeInfo(setup=setup, started_unix_ns=0, started_ns=0), reserve_bytes=0)
    for scene, frame in moved(seconds, partial(wand, turned=turned), spaces=spaces):
        if frame is not None:
            writer.write_frame(
                encode_frame(frame), sensor=frame.sensor, node_id=7, sequence=frame.sequence, log_ns=scene.at_ns
            )
        writer.write_scene(encode_scene(scene), scene.at_ns)
    writer.close()
    return path


def run(*words: object) -> Any:
    return CliRunner().invoke(app, ["calibrate", "space", *map(str, words)])


@pytest.mark.slow
@pytest.mark.parametrize("what", [("--object", "wand"), ("--marker", "cyan")])
def test_a_take_becomes_a_file(tmp_path: Path, what: tuple[str, str]) -> None:
    take, out, report = recorded(tmp_path / "move.mcap"), tmp_path / "vr.toml", tmp_path / "vr.json"
    result = run(take, "--body", "LHR-1", *what, "--out", out, "--json", report)
    assert result.exit_code == 0, result.output
    found = load_space(out)
    assert found.space == "vr"
    off = found.T_world_space @ inverse(T_WORLD_VR)
    assert np.linalg.norm(log_motion(off)[3:]) < 2e-3
    assert found.clock_s == pytest.approx(DELAY_S, abs=1e-3)
    said = json.loads(report.read_text())
    np.testing.assert_allclose(said["lever_m"], ON_BODY[:3, 3], atol=2e-3)


@pytest.mark.parametrize(
    ("words", "kind", "said"),
    [
        (("--body", "LHR-1"), SettingsError, "either --marker or --object"),
        (("--body", "LHR-1", "--object", "a", "--marker", "b"), SettingsError, "either --marker or --object"),
        (("--body", "LHR-1", "--object", "wnd"), SettingsError, "the take has wand"),
        (("--body", "LHR-1", "--marker", "red"), SettingsError, "the take has cyan"),
        (("--body", "LHR-2", "--object", "wand"), InputError, "LHR-1"),
        (("--body", "LHR-1", "--object", "wand", "--space", "stage"), InputError, "no such space"),
    ],
)
def test_what_the_take_does_not_have_is_named(
    tmp_path: Path, words: tuple[str, ...], kind: type[MocapellaError], said: str
) -> None:
    result = run(recorded(tmp_path / "move.mcap", seconds=0.2), *words, "--out", tmp_path / "vr.toml")
    assert isinstance(result.exception, kind)
    assert said in str(result.exception)
    assert not (tmp_path / "vr.toml").exists()


def test_a_take_that_will_not_do_says_why(tmp_path: Path) -> None:
    def refused(take: Path) -> BaseException:
        result = run(take, "--body", "LHR-1", "--object", "wand", "--out", tmp_path / "vr.toml")
        assert result.exception is not None
        return result.exception

    still = refused(recorded(tmp_path / "still.mcap", turned=0.0))
    assert isinstance(still, CalibrationError)
    assert "too little rotation" in str(still)
    assert "several spaces" in str(refused(recorded(tmp_path / "two.mcap", seconds=0.2, spaces=("vr", "stage"))))
    assert "no poses of another tracker" in str(refused(recorded(tmp_path / "none.mcap", seconds=0.2, spaces=())))


def test_seconds_are_of_the_live_way(tmp_path: Path) -> None:
    result = run("take.mcap", "--body", "LHR-1", "--object", "wand", "--seconds", 5, "--out", tmp_path / "vr.toml")
    assert isinstance(result.exception, SettingsError)
    assert "--seconds is for the live way" in str(result.exception)
    (option,) = [one for one in inspect.signature(align).parameters.values() if one.name == "seconds"]
    assert f"only; {AlignGuideSettings().seconds:g} s by default" in str(option.annotation)


def test_where_nothing_can_be_written_it_says_so_before_it_begins(tmp_path: Path) -> None:
    result = run("--body", "LHR-1", "--object", "wand", "--out", tmp_path / "none" / "vr.toml")
    assert isinstance(result.exception, SettingsError)
    assert "there is no folder" in str(result.exception)


@pytest.mark.slow
def test_live_it_leads_somebody_who_moves_it(tmp_path: Path) -> None:
    """A process that says what is missing; on the bus, scenes and a node's poses of somebody who moves the wand."""
    address, out, report = f"tcp/127.0.0.1:{free_port()}", tmp_path / "vr.toml", tmp_path / "vr.json"
    server, over = ServerLink(address, on_nonsense=lambda text: None), threading.Event()
    words = ["--body", "LHR-1", "--object", "wand", "--out", str(out), "--connect", address, "--seconds", "40"]
    try:
        with (
            Program(tmp_path, "align", "calibrate", "space", *words, "--json", str(report)) as program,
            NodeLink(address, "vr") as node,
        ):
            moving = threading.Thread(target=move, args=(server, node, over))
            moving.start()
            try:
                wait_until("it is aligned", lambda: program.process.poll() is not None)
            finally:
                over.set()
                moving.join()
            assert program.process.poll() == 0, program.output
            assert "move it through all of the space" in program.output
            assert "too few shared instants" in program.output
    finally:
        server.close()
    found = load_space(out)
    assert np.linalg.norm(log_motion(found.T_world_space @ inverse(T_WORLD_VR))[3:]) < 2e-3
    assert found.clock_s == pytest.approx(DELAY_S, abs=1e-3)
    assert json.loads(report.read_text())["space"] == "vr"


def test_ctrl_c_ends_it_and_writes_nothing(tmp_path: Path) -> None:
    address, out = f"tcp/127.0.0.1:{free_port()}", tmp_path / "vr.toml"
    server = ServerLink(address, on_nonsense=lambda text: None)
    words = ["--body", "LHR-1", "--object", "wand", "--out", str(out), "--connect", address]
    try:
        with Program(tmp_path, "align", "calibrate", "space", *words) as program:
            wait_until("it waits", program.said("waiting for scenes"))
            assert program.end() == 130
            assert "nothing was written" in program.output
    finally:
        server.close()
    assert not out.exists()


def move(server: ServerLink, node: NodeLink, over: threading.Event) -> None:
    """Publish it all, about in real time, for ever."""
    for scene, frame in moved(600):
        if frame is not None:
            sent = node.publish(frame)
            scene = msgspec.structs.replace(scene, node_id=sent.node_id, sequence=sent.sequence)  # noqa: PLW2901
        server.publish_scene(encode_scene(scene))
        if over.wait(0.5 / HZ):
            return
