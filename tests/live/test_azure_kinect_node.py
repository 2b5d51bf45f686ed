"""`mocapella node azure-kinect` with a stand-in for the vendor's libraries: over the bus, and to its end."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.k4a_stand_in import build, check_frame, read_log
from support.programs import Program, run_here, wait_until

from mocapella.model.observations import BodyFrame
from mocapella.testing import FakeServer

WORDS = ("node", "azure-kinect", "--name", "left")


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("k4a"))


@pytest.fixture(autouse=True)
def told(built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MOCAPELLA_K4A", str(built))
    monkeypatch.setenv("K4A_LOG", str(tmp_path / "log"))


def test_bodies_reach_a_server_until_ctrl_c(tmp_path: Path) -> None:
    with (
        FakeServer() as server,
        Program(tmp_path, "node", *WORDS, "--connect", server.address, "--json", "node.json") as node,
    ):
        server.wait_for(frames=20, timeout_s=90.0)
        assert node.end() == 0, node.output
    assert "left: azure-kinect 0 is camera 000000001000" in node.output
    for frame in server.frames:
        assert isinstance(frame, BodyFrame)
        assert frame.sensor == "left"
        check_frame(frame)
    row = json.loads((tmp_path / "node.json").read_text())
    assert (row["sensor"], row["serial"], row["errors"]) == ("left", "000000001000", {})
    assert row["published"] == row["frames"] >= len(server.frames)
    read_log(tmp_path / "log").check_released()


def test_ctrl_c_ends_it_while_the_tracker_is_loaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("K4A_LATE", "k4abt_tracker_create")  # never returns
    with Program(tmp_path, "node", *WORDS) as node:
        wait_until("the camera runs", lambda: "start" in read_log(tmp_path / "log").words)
        assert node.end() == 0, node.output
    assert "loading its body tracker" in node.output


def test_an_unplugged_camera_ends_it_with_the_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("K4A_FAIL", "k4a_device_get_capture:20")
    with FakeServer() as server:
        done = run_here(tmp_path, *WORDS, "--connect", server.address)
    assert done.returncode == 1
    last = done.stderr.strip().splitlines()[-1]
    assert "mocapella: azure-kinect 0: gives no images any more (unplugged?); plug it in again" in last
    read_log(tmp_path / "log").check_released()


def test_libraries_and_options_that_cannot_be_end_it_with_the_remedy(
    built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for options, words in (
        (["--fps", "20"], "--fps is 20.0; it must be 5, 15 or 30"),
        (["--set", "processing=cude"], "processing"),
        (["7", "--set", f"libraries={built}"], "azure-kinect 7: there is no such camera; 1 of them is here"),
    ):
        done = run_here(tmp_path, *WORDS, *options)
        assert (done.returncode, words in done.stderr) == (1, True), done.stderr
    monkeypatch.setattr("mocapella.sources.k4a_libraries._usual_folders", lambda: iter(()))
    monkeypatch.delenv("MOCAPELLA_K4A")
    done = run_here(tmp_path, *WORDS)
    assert (done.returncode, "libk4a and libk4abt are not installed: install" in done.stderr) == (1, True)
