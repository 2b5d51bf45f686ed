"""Commands that run for a while, in real time: what they say, and what they leave."""

from __future__ import annotations

import gzip
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from support.programs import free_port, result, run, run_here


@dataclass(frozen=True)
class Recorded:
    """A demo that was recorded, and what it said at its end."""

    folder: Path
    summary: dict[str, Any]


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    folder = tmp_path_factory.mktemp("demo")
    return Recorded(
        folder,
        result(folder, "demo", "--no-view", "--seconds", "14", "--record", "./whole", "--port", str(free_port())),
    )


@pytest.mark.slow
def test_the_demos_summary_is_what_a_script_can_check(demo: Recorded) -> None:
    summary = demo.summary
    assert {row["name"] for row in summary["sensors"]} == {"front", "left", "right"}
    assert summary["frames_in"] == summary["frames_out"] > 0
    assert summary["most_people"] == 2
    assert set(summary["latency_ms"]) == {"p50", "p90", "p99", "max"}
    phases = [change["phase"] for change in summary["state_changes"]]
    assert phases[:3] == ["waiting for sensors", "calibrating", "tracking"]
    assert isinstance(summary["drops"], int)


@pytest.mark.slow
def test_a_take_replays_as_it_was_and_is_never_recorded_over(demo: Recorded) -> None:
    whole = (demo.folder / "whole.mcap").read_bytes()
    again = run(demo.folder, "replay", "whole")
    assert f"all {demo.summary['frames_out']} results identical to the live run" in again.stderr
    taken = run(
        demo.folder, "demo", "--no-view", "--seconds", "1", "--record", "./whole.mcap", "--port", str(free_port())
    )
    assert taken.returncode == 1
    assert (demo.folder / "whole.mcap").read_bytes() == whole


@pytest.mark.slow
def test_a_take_that_was_cut_off_says_what_is_left(demo: Recorded, tmp_path: Path) -> None:
    whole = (demo.folder / "whole.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 3])
    done = run_here(tmp_path, "replay", "cut.mcap", "--json", "-")
    assert done.returncode == 3
    (row,) = json.loads(done.stdout)
    assert not row["clean"]
    assert row["problems"]
    assert 0 < row["frames_out"] < demo.summary["frames_out"]


@pytest.mark.slow
def test_replaying_live_goes_through_nodes_and_bus(study_logs: Path, tmp_path: Path) -> None:
    short = tmp_path / "short.csv"
    source = study_logs / "Study_7_Kinect_2_Time_3_11_06_PM.csv.gz"
    short.write_text("\n".join(gzip.decompress(source.read_bytes()).decode().splitlines()[:301]))
    done = run(tmp_path, "replay", "short.csv", "--live", "--no-view", "--port", str(free_port()), "--json", "-")
    assert done.returncode == 0, done.stderr
    (row,) = json.loads(done.stdout)
    assert {sensor["name"] for sensor in row["sensors"]} == {"front", "side"}
    assert row["frames_in"] > 0
    assert f"sensors: 2, frames in: {row['frames_in']}, " in done.stderr


@pytest.mark.slow
def test_the_demo_of_hands_finds_one_and_its_take_replays_as_it_was(tmp_path: Path) -> None:
    summary = result(
        tmp_path, "demo", "hands", "--no-view", "--seconds", "6", "--record", "./hand", "--port", str(free_port())
    )
    assert {row["name"] for row in summary["sensors"]} == {"left", "right"}
    assert summary["frames_in"] == summary["frames_out"] > 0
    assert summary["most_hands"] == 1
    assert "tracking" in [change["phase"] for change in summary["state_changes"]]
    again = run_here(tmp_path, "replay", "hand")
    assert f"all {summary['frames_out']} results identical to the live run" in again.stderr


@pytest.mark.slow
def test_the_demo_of_an_arm_finds_it_and_its_take_replays_as_it_was(tmp_path: Path) -> None:
    summary = result(
        tmp_path, "demo", "arm", "--no-view", "--seconds", "15", "--record", "./arm", "--port", str(free_port())
    )
    assert [row["name"] for row in summary["sensors"]] == ["arm"]
    assert summary["frames_in"] == summary["frames_out"] > 0
    assert summary["most_arms"] >= 1
    quality = summary["arm_quality"]
    assert quality["seen_s"] > 1
    assert set(quality["misdetections"]) == {"jumped", "appeared", "vanished", "swapped", "lost"}
    again = run(tmp_path, "replay", "arm")
    assert f"all {summary['frames_out']} results identical to the live run" in again.stderr
