"""mocapella lab depth lines: depth images in, lines of bodies out."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from mocapella.cli import depth as _depth  # noqa: F401 - its group of verbs
from mocapella.cli import depth_lines as _lines  # noqa: F401 - registers the verb
from mocapella.cli.app import app
from mocapella.errors import InputError, SettingsError
from mocapella.geometry.lens import project
from mocapella.sources.simulate.room_depth import room_depth_scene


def lines(*arguments: str) -> Any:
    return CliRunner().invoke(app, ["lab", "depth", "lines", *arguments])


def result(*arguments: str) -> dict[str, Any]:
    done = lines(*arguments, "--json", "out.json")
    assert done.exit_code == 0, (done.output, done.exception)
    (recording,) = json.loads(Path("out.json").read_text(encoding="utf-8"))["recordings"]
    return dict(recording)


@pytest.mark.slow
def test_a_rendered_room_needs_no_camera(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    recording = result("rendered:room-stand/1/exact", "--fps", "0.1", "--stages", "looked")
    assert recording["size_px"] == [640, 480]
    assert len(recording["frames"]) == 2
    for frame in recording["frames"]:
        (body,) = frame["bodies"]
        assert frame["reason"] == ""
        assert frame["floor"] == pytest.approx([0, -1, 0, 1], abs=0.03)
        assert 2.4 < body["distance_m"] < 3.0
        assert len(body["lines"]) >= 8
        for end in body["ends"]:
            np.testing.assert_allclose(project(np.array(end["m"]), np.array(recording["lens"])), end["px"], atol=0.1)
    names = sorted(path.name for path in (tmp_path / "looked" / "00001-1").iterdir())
    assert names[-2:] == ["07-thinning.png", "08-lines.png"]


def test_files_and_what_is_wrong_with_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "frames"
    folder.mkdir()
    depth = room_depth_scene("stand", seed=1, sensor="kinect").at(1.0).depth
    for name, image in (("1", depth), ("2", np.zeros_like(depth)), ("3", depth)):
        (folder / f"{name}.png").write_bytes(cv2.imencode(".png", image)[1].tobytes())
    (folder / "3.png").write_bytes((folder / "3.png").read_bytes()[:-30])
    said = ["--intrinsics", "580,319.5,239.5", "--unit", "0.001"]
    first, second, third = result("frames", *said)["frames"]
    assert (len(first["bodies"]), first["reason"]) == (1, "")
    assert (second["bodies"], second["reason"]) == ([], "nothing was measured in the whole image")
    assert "cut off" in third["reason"]
    assert result("frames/1.png", *said, "--keep-floor")["frames"][0]["floor"] is None
    wrong = (
        (["frames"], "give --intrinsics F,CX,CY and --unit METRES", InputError),
        (["frames", *said[:2], "--unit", "0.1"], "--unit 0.001", InputError),
        (["frames", *said, "--far", "0.5"], "near_m", SettingsError),
        (["frames", *said, "--fps", "0"], "--fps", SettingsError),
        (["openni:0"], "mocapella node arm openni:0", SettingsError),
    )
    for arguments, named, kind in wrong:
        done = lines(*arguments)
        assert isinstance(done.exception, kind)
        assert named in str(done.exception)
