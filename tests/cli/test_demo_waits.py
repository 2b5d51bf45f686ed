"""A demo with a take or a duration compiles first, so that neither begins with minutes without results."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from support.programs import run_here
from typer.testing import CliRunner

from mocapella.cli import demo, live_session
from mocapella.cli.app import app


class StopHereError(Exception):
    """Ends the command where the session would begin."""


@pytest.mark.parametrize(("options", "waits"), [([], False), (["--seconds", "3"], True), (["--record", "walk"], True)])
def test_a_take_or_a_duration_waits_for_the_kernels(
    options: list[str], waits: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert demo.app is app
    asked: list[bool] = []

    def session(*_: Any, track_at_once: bool, **__: Any) -> None:
        asked.append(track_at_once)
        raise StopHereError

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(live_session, "live_session", session)
    result = CliRunner().invoke(app, ["demo", "--no-view", *options])
    assert isinstance(result.exception, StopHereError), result.output
    assert asked == [waits]


@pytest.mark.parametrize("what", ["webcam", "hands", "arm", "silhouettes"])
def test_a_demo_of_one_method_refuses_another(what: str) -> None:
    result = run_here(Path(), "demo", what, "--no-view", "--method", "stand-still")
    assert (result.returncode, "--method" in result.stderr) == (1, True), result.stderr
