"""A plot that cannot be written is refused before any work, by each command that draws one."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest
from support.commands import commands_below, root
from typer.testing import CliRunner

from mocapella.cli.app import app
from mocapella.errors import SettingsError
from mocapella.evaluation.plots import check_plot

NEEDS = "matplotlib is not installed: uv sync --extra plots"


def test_each_command_that_plots_refuses_before_its_work(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    found = {path: one for path, one in commands_below(root()) if any("--plot" in o.opts for o in one.params)}
    assert len(found) >= 10
    for path, command in found.items():

        def begun(path: str = path, **_: Any) -> None:
            raise AssertionError(f"{path} has begun")

        monkeypatch.setattr(command, "callback", begun)
        needed = [word for each in command.params if each.required for word in (*each.opts, "7") if word[:1] in "-7"]
        with pytest.raises(SettingsError, match=NEEDS):
            command.main([*needed, "--plot", str(tmp_path / "x.png")], standalone_mode=False)


def test_the_method_silhouettes_refuses_before_its_work(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    words = ["track", "silhouettes", str(tmp_path / "none.mp4"), "--set", f"plot={tmp_path / 'x.png'}"]
    done = CliRunner().invoke(app, words)
    assert isinstance(done.exception, SettingsError)
    assert NEEDS in str(done.exception)


@pytest.mark.parametrize("name", ["none/x.png", "x.docx", "x"])
def test_a_file_that_cannot_be_drawn_is_refused(tmp_path: Path, name: str) -> None:
    pytest.importorskip("matplotlib")
    with pytest.raises(SettingsError, match=r"name a \.png or \.svg in a folder that exists"):
        check_plot(tmp_path / name)


def test_a_file_that_can_be_drawn_is_accepted_and_not_written(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    for name in ("x.png", "x.SVG"):
        check_plot(tmp_path / name)
    assert list(tmp_path.iterdir()) == []
