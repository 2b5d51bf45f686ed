"""The doctor's report reaches whoever reads it, and knows browsers that Python cannot open."""

from __future__ import annotations

import shutil
import subprocess
import sys
import webbrowser
from collections import namedtuple
from pathlib import Path

import pytest
import typer
from support.programs import free_port

from mocapella.cli import kernel_folder
from mocapella.cli.doctor import doctor, examine
from mocapella.cli.kernel_folder import folder_finding, kernel_folder_finding
from mocapella.geometry.turn_kernels import turned

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


def test_the_packages_of_depth_cameras_are_named_with_what_brings_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether they are there, without importing them."""
    monkeypatch.syspath_prepend(str(tmp_path))
    for module in ("openni", "primesense", "freenect", "pylibfreenect2", "pyrealsense2", "pyorbbecsdk", "depthai"):
        monkeypatch.delitem(sys.modules, module, raising=False)
    found = look(tmp_path)
    assert found["depth camera openni:"] == ("note", "not installed: openni or primesense")
    assert found["depth camera orbbec:"] == ("note", "not installed: pyorbbecsdk")
    assert found["depth camera oak:"] == ("note", "not installed: depthai")
    advice = {finding.what: finding.advice for finding in examine(free_port(), free_port(), tmp_path)}
    assert "OpenNI2 itself" in advice["depth camera openni:"]
    assert "python3-freenect" in advice["depth camera freenect:"]
    (tmp_path / "primesense").mkdir()
    for name in ("primesense/__init__.py", "primesense/openni2.py", "pyrealsense2.py"):
        (tmp_path / name).write_text("raise RuntimeError('imported')\n" if "/__init__" not in name else "")
    found = look(tmp_path)
    assert found["depth camera openni:"] == ("ok", "primesense.openni2")
    assert found["depth camera realsense:"] == ("ok", "pyrealsense2")


def test_the_doctor_needs_no_package_of_cameras() -> None:
    code = "import sys; sys.modules['cv2'] = None; from mocapella.cli.doctor import examine; from pathlib import Path; "
    code += "print(*(finding.what for finding in examine(1024, 1025, Path())))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "depth camera orbbec:" in done.stdout


def test_a_folder_of_compiled_kernels_that_others_can_write_to_is_named(tmp_path: Path) -> None:
    folder = tmp_path / "cache"
    folder.mkdir(mode=0o700)
    assert folder_finding(folder).verdict == "ok"
    for open_, mode in ((folder, 0o777), (folder, 0o1777), (tmp_path, 0o777)):
        before = open_.stat().st_mode
        open_.chmod(mode)
        finding = folder_finding(folder)
        assert (finding.verdict, f"write to {open_}," in finding.found) == ("problem", True), oct(mode)
        assert f"chmod go-w {open_}" in finding.advice
        open_.chmod(before)
    tmp_path.chmod(0o1777)  # as /tmp: nobody can rename what is there
    assert folder_finding(folder).verdict == "ok"


def test_a_group_counts_if_it_has_another_member(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "cache"
    folder.mkdir()
    folder.chmod(0o770)
    for shared, verdict in ((False, "ok"), (True, "problem")):
        monkeypatch.setattr(kernel_folder, "_shared", lambda group, shared=shared: shared)
        assert folder_finding(folder).verdict == verdict


def test_the_doctor_looks_where_kernels_are_kept() -> None:
    finding = kernel_folder_finding()
    assert str(Path(turned.stats.cache_path)) in finding.found + finding.advice
