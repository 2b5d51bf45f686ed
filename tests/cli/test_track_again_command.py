"""``mocapella replay --record``: what a user sees of tracking a recording again."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.programs import run_here
from support.take_making import small_take

from mocapella.live.recorded import track_again
from mocapella.live.recordings import open_recording
from mocapella.recording.take_reader import read_take


def test_a_take_is_tracked_again_into_a_new_one_that_names_its_origin(tmp_path: Path) -> None:
    before = small_take(tmp_path / "a.mcap").read_bytes()
    words = ["replay", "a", "--method", "stand-still", "--set", "frames=5", "--placement", "parallel"]
    done = run_here(tmp_path, *words, "--record", "b", "--json", "out.json")
    assert done.returncode == 0, done.stderr
    assert "24 results of 24 frames in takes/b.mcap\n" in done.stderr
    (row,) = json.loads((tmp_path / "out.json").read_text())
    assert row["recording"]["path"] == "takes/b.mcap"
    assert (row["recording"]["frames"], row["recording"]["scenes"]) == (24, 24)
    assert "recorded_scenes" not in row
    assert (tmp_path / "a.mcap").read_bytes() == before
    replayed = run_here(tmp_path, "replay", "b")
    assert replayed.returncode == 0, replayed.stderr
    assert "all 24 results identical to the live run" in replayed.stderr
    told = run_here(tmp_path, "take", "info", "b", "--json", "info.json")
    assert "tracked again from a.mcap (SHA-256 " in told.stderr
    assert "): method stand-still; frames 5; placement parallel\n" in told.stderr
    origin = json.loads((tmp_path / "info.json").read_text())["origin"]
    assert origin["changes"] == {"method": "stand-still", "settings": {"frames": 5}, "placement": "parallel"}
    assert len(origin["sha256"]) == 64
    told = run_here(tmp_path, "take", "info", "a", "--json", "info.json")
    assert "tracked again" not in told.stderr
    assert json.loads((tmp_path / "info.json").read_text())["origin"] is None


def test_without_a_name_it_only_counts_and_a_name_in_use_is_refused(tmp_path: Path) -> None:
    small_take(tmp_path / "a.mcap")
    done = run_here(tmp_path, "replay", "a", "--set", "frames=5")
    assert done.returncode == 0, done.stderr
    assert "a: nothing was written; --record NAME writes a take\n" in done.stderr
    refused = run_here(tmp_path, "replay", "a", "--record", "./a")
    assert refused.returncode == 1
    assert "a.mcap: it exists, and nothing is overwritten" in refused.stderr
    refused = run_here(tmp_path, "replay", "a", "--method", "hands", "--record", "b")
    assert refused.returncode == 1
    assert "a.mcap: cannot be tracked: it sends skeletons, which the method hands does not use" in refused.stderr
    refused = run_here(tmp_path, "replay", "a", "--rig", "gone.toml", "--record", "b")
    assert refused.returncode == 1
    assert "gone.toml" in refused.stderr
    assert sorted(path.name for path in tmp_path.rglob("*.mcap")) == ["a.mcap"]


def test_ctrl_c_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small_take(tmp_path / "a.mcap")

    def interrupted(*arguments: object) -> object:
        def press(run: int, scene: object) -> None:
            raise KeyboardInterrupt

        recording = open_recording(tmp_path / "a.mcap")
        return track_again(recording, recording.runs_to_track(), press, tmp_path / "takes" / "b.mcap")

    monkeypatch.setattr("mocapella.live.recorded.track_again", interrupted)
    done = run_here(tmp_path, "replay", "a", "--record", "b")
    assert done.returncode == 130
    assert "stopped before the end" in done.stderr
    assert list((tmp_path / "takes").iterdir()) == []


def test_a_damaged_take_gives_a_new_one_of_what_can_be_read_and_the_status_says_so(tmp_path: Path) -> None:
    data = small_take(tmp_path / "a.mcap", 40).read_bytes()
    (tmp_path / "a.mcap").write_bytes(data[: len(data) * 2 // 3])
    done = run_here(tmp_path, "replay", "a", "--record", "b")
    assert done.returncode == 3
    assert "a: a.mcap: ends early" in done.stderr
    new = read_take(tmp_path / "takes" / "b.mcap")
    assert new.clean
    assert 20 < new.frame_count == new.scene_count < 80


@pytest.mark.slow
def test_a_study_log_becomes_a_take_with_its_labels(study_logs: Path, tmp_path: Path) -> None:
    log = study_logs / "Study_7_Kinect_2_Time_3_11_06_PM.csv.gz"
    done = run_here(tmp_path, "replay", str(log), "--method", "stand-still", "--record", "b")
    assert done.returncode == 0, done.stderr
    setup = read_take(tmp_path / "takes" / "b.mcap").info.setup
    assert (setup.participant, setup.placement) == (7, "right-90")
    assert setup.scenario == ""  # it changes within the log
    assert "identical to the live run" in run_here(tmp_path, "replay", "b").stderr
