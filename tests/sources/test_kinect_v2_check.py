"""What `mocapella doctor` says of the SDK of a Kinect v2."""

from __future__ import annotations

from pathlib import Path

import pytest

from mocapella.sources.device_checks import KINECT_SDK, kinect_v2


def test_it_is_named_with_its_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(KINECT_SDK, str(tmp_path))
    (tmp_path / "Assemblies").mkdir()
    (tmp_path / "Assemblies" / "Microsoft.Kinect.dll").touch()
    [finding] = kinect_v2()
    assert (finding.verdict, finding.found.endswith("Microsoft.Kinect.dll"), finding.advice) == ("ok", True, "")


def test_a_part_that_is_missing_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(KINECT_SDK, str(tmp_path))
    [finding] = kinect_v2()
    assert finding.found.endswith("Microsoft.Kinect.dll is missing")
    assert "install the Kinect for Windows SDK 2.0 again" in finding.advice


def test_without_it_the_steps_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(KINECT_SDK, raising=False)
    [finding] = kinect_v2()
    assert (finding.verdict, finding.found) == ("note", "not installed")
    assert "docs/sensors.md" in finding.advice


def test_the_script_that_builds_the_client_reads_the_same_variable() -> None:
    script = Path(__file__).resolve().parents[2] / "clients" / "kinect_v2" / "build.cmd"
    assert f"%{KINECT_SDK}%Assemblies\\Microsoft.Kinect.dll" in script.read_text(encoding="ascii")
