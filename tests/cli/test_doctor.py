"""The doctor's report reaches whoever reads it, and knows browsers that Python cannot open."""

from __future__ import annotations

import shutil
import webbrowser
from collections import namedtuple
from pathlib import Path

import pytest
import typer
from programs import free_port

from mocapella.cli.doctor import doctor, examine

Usage = namedtuple("Usage", "total used free")


def look(takes: Path) -> dict[str, tuple[str, str]]:
    findings = examine(free_port(), free_port(), takes)
    return {finding.what: (finding.verdict, finding.found) for finding in findings}


def test_a_problem_is_on_standard_output_and_an_exit_status(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: Usage(10**12, 10**12, 10**6))
    with pytest.raises(typer.Exit) as ended:
        doctor(free_port(), free_port(), tmp_path, None)
    assert ended.value.exit_code == 1
    said = capsys.readouterr()
    assert "to be mended: disk for takes" in said.out
    assert said.err == ""


def test_the_table_makes_room_for_json_on_standard_output(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    doctor(free_port(), free_port(), tmp_path, "-")
    said = capsys.readouterr()
    assert said.out.startswith("[")
    assert "core packages" in said.err


@pytest.mark.parametrize("name", ["chromium", "google-chrome", "firefox"])
def test_a_browser_is_found_by_its_name_where_python_cannot_open_it(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none() -> None:
        raise webbrowser.Error

    monkeypatch.setattr(webbrowser, "get", none)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert look(tmp_path)["browser"] == ("note", "none found")
    browser = tmp_path / name
    browser.touch(0o755)
    verdict, found = look(tmp_path)["browser"]
    assert verdict == "note"
    assert found.startswith(str(browser))
    monkeypatch.setattr(webbrowser, "get", object)
    assert look(tmp_path)["browser"] == ("ok", str(browser))
