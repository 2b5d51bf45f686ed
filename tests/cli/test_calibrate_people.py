"""``mocapella calibrate people`` and ``mocapella lab evaluate rig-from-people``."""

from __future__ import annotations

import json
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from support.keypoint_people import filmed, ring, walking
from support.programs import run_here
from support.webcam_clips import DATA

from mocapella.cli.calibrate_people import as_result
from mocapella.cli.evaluate_rig_from_people import show_rig_errors
from mocapella.evaluation.rig_from_people import RigErrorRow
from mocapella.library import people_calibration
from mocapella.model.camera_rig_file import load_camera_rig, save_camera_rig

CLIP = DATA / "pose2sim_single_person"


def write_openpose(folder: Path, seconds: float = 8.0) -> None:
    """Write the keypoints of four simulated cameras as OpenPose's JSON, and the true rig."""
    rig = ring(4, 3)
    save_camera_rig(folder / "true.toml", rig)
    frames = filmed(rig, walking(25, [(-0.8, 0.0), (0.8, 0.3)], [1.75, 1.65], 3), seconds, seed=3, hz=15)
    count = dict.fromkeys(rig.cameras, 0)
    for frame in frames:
        here = folder / "pose" / f"{frame.sensor}_json"
        here.mkdir(parents=True, exist_ok=True)
        rows = np.concatenate([np.nan_to_num(frame.positions_px), frame.confidences[..., None]], axis=-1)
        people = [{"pose_keypoints_2d": row.ravel().tolist()} for row in rows]
        (here / f"frame_{count[frame.sensor]:06d}.json").write_text(json.dumps({"people": people}))
        count[frame.sensor] += 1


@pytest.mark.slow
def test_cameras_are_calibrated_from_files_and_the_rig_is_written(tmp_path: Path) -> None:
    write_openpose(tmp_path)
    words = ["calibrate", "people", "pose", "--size", "1280x720", "--fps", "15", "--out", "rig.toml"]
    keys = ["--set", "order=HALPE_26", "--set", "instants=30", "--distance", "cam1:cam3:7.1", "--json", "found.json"]
    done = run_here(tmp_path, *words, *keys)
    assert done.returncode == 0, done.stderr
    assert "residual" in done.stdout
    assert "by the distance of cam1 and cam3" in done.stdout
    found = load_camera_rig(tmp_path / "rig.toml")
    assert list(found.cameras) == ["cam1", "cam2", "cam3", "cam4"]
    centres = [-p.T_camera_world[:3, :3].T @ p.T_camera_world[:3, 3] for p in found.cameras.values()]
    assert np.linalg.norm(centres[0] - centres[2]) == pytest.approx(7.1, abs=1e-6)
    values = json.loads((tmp_path / "found.json").read_text())
    assert values["cameras"]["cam2"]["keypoints"] > 100
    assert values["guessed"] is False


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--distance", "left:2.4"], "write it like left:right:2.4, in metres"),
        (["--distance", "left:right:far"], "write it like left:right:2.4, in metres"),
        (["--set", "camera_height=1.8"], "write it like left:1.8, in metres"),
        (["--height", "175"], "from 0.5 to 2.5 m"),
        (["--height", "1.75", "--distance", "a:b:2"], "state one"),
        ([], "give it with --size"),
    ],
)
def test_a_wrong_line_is_answered_with_what_would_have_worked(tmp_path: Path, words: list[str], said: str) -> None:
    folder = tmp_path / "pose" / "cam1_json"
    folder.mkdir(parents=True)
    (folder / "f_0.json").write_text(json.dumps({"people": [{"pose_keypoints_2d": [1.0, 2.0, 0.9] * 25}]}))
    done = run_here(tmp_path, "calibrate", "people", "pose", "--fps", "30", "--out", "rig.toml", *words)
    assert done.returncode == 1
    assert said in done.stderr.replace("\n", " ")
    assert not (tmp_path / "rig.toml").exists()


@pytest.mark.slow
@pytest.mark.skipif(not CLIP.is_dir(), reason="the recording is not there")
def test_a_real_clip_of_a_person_in_one_place_is_calibrated_and_called_uncertain() -> None:
    rig = CLIP / "calibration" / "Calib_qualisys.toml"
    true = load_camera_rig(rig)
    lenses = {name: placed.camera for name, placed in true.cameras.items()}
    frames = people_calibration.detected_frames(people_calibration.read_detections([CLIP / "pose"]), true, None, 60.0)
    from mocapella.calibration.keypoint_tracks import collect_tracks
    from mocapella.calibration.people_rig import place_rig
    from mocapella.calibration.rig_from_people import RigFromPeopleSettings, solve_people
    from mocapella.evaluation.rig_from_people import pose_errors

    found = place_rig(solve_people(collect_tracks(frames), lenses, RigFromPeopleSettings(every_s=0.05)))
    _, direction = pose_errors(found.rig, true)
    assert np.degrees(direction.max()) < 3.0
    assert not found.good
    assert as_result(found)["good"] is False


def test_the_errors_of_rigs_are_a_table_of_what_was_known_of_the_lenses() -> None:
    numbers = (16.9, 0.25, 0.0, 3.5, 1.01, 0.32, 34.0, 22.0, 0.6)
    known = [(True, False), (False, False), (False, True)]
    rows = [RigErrorRow("two-walk", 0, *lenses, *numbers, good=True) for lenses in known]
    out = StringIO()
    show_rig_errors(rows, Console(file=out, width=80))
    lines = [line.split() for line in out.getvalue().splitlines() if line.startswith("two-walk")]
    assert [line[2] for line in lines] == ["given", "found", "alike"]
    assert lines[0][3:] == ["16.9", "0.25", "0.0", "3.5", "1.010", "0.32", "34/22", "0.6", "yes"]
