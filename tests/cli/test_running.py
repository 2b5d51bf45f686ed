"""Commands that run for a while, in real time: what they say, and what they leave."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

from programs import free_port, result, run


def test_a_take_that_was_cut_off_says_what_is_left(study_logs: Path, tmp_path: Path) -> None:
    made = result(tmp_path, "demo", "--headless", "--seconds", "9", "--record", "whole", "--scene", "stand")
    assert made["frames_in"] > 0
    again = run(tmp_path, "replay", "whole")
    assert f"all {made['frames_out']} results identical to the live run" in again.stderr
    whole = (tmp_path / "whole.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) * 2 // 3])
    (row,) = result(tmp_path, "replay", "cut.mcap")
    assert not row["clean"]
    assert row["problems"]
    assert row["frames_out"] > 0
    taken = run(tmp_path, "demo", "--headless", "--seconds", "1", "--record", "whole.mcap")
    assert taken.returncode == 1
    assert (tmp_path / "whole.mcap").read_bytes() == whole


def test_the_demos_summary_is_what_a_script_can_check(tmp_path: Path) -> None:
    summary = result(tmp_path, "demo", "--headless", "--seconds", "18")
    assert {row["name"] for row in summary["sensors"]} == {"front", "left", "right"}
    assert summary["frames_in"] == summary["frames_out"] > 0
    assert summary["most_people"] == 2
    assert set(summary["latency_ms"]) == {"p50", "p90", "p99", "max"}
    phases = [change["phase"] for change in summary["state_changes"]]
    assert phases[:3] == ["waiting for sensors", "calibrating", "tracking"]
    assert isinstance(summary["drops"], int)


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
