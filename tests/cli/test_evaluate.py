"""``mocapella lab evaluate kinectmultitrack``: its JSON, its table, and bad input."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.evaluation_sessions import log_of
from support.programs import result, result_here, run_here

from mocapella.cli.evaluate import failures
from mocapella.recording.study_log import write_study_log

VERB = ("lab", "evaluate", "kinectmultitrack")
FIGURES = {"dx_cm", "dy_cm", "dz_cm", "dd_cm", "torso_dd_cm"}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "logs").mkdir()
    for hour in (1, 2):
        write_study_log(tmp_path / "logs" / f"Study_7_Kinect_2_Time_{hour}.csv.gz", log_of(seed=hour).rows())
    return tmp_path


def test_the_json_has_every_figure_by_method_task_and_placement(folder: Path) -> None:
    scored = result(folder, *VERB, "logs", "--methods", "stand-still", "--participants", "7")
    assert (scored["participants"], scored["files"]) == ([7], 2)
    method = scored["methods"]["stand-still"]
    for task in ("stationary", "steps", "walk"):
        row = method["tasks"][task]["90"]
        assert FIGURES | {"raw_labels", "participants", "pairs", "finite_joints", "problem"} <= set(row)
        assert set(row["raw_labels"]) == FIGURES
        assert all(set(row[name]) == {"mean", "std", "worst_participant"} for name in FIGURES)
        assert (row["participants"], row["pairs"], row["finite_joints"]) == (1, 160, 4000)
        # 1 cm of noise in each coordinate of both views
        assert row["dd_cm"]["mean"] == pytest.approx(np.sqrt(16 / np.pi), abs=0.1)
    assert set(method["yaw_deg"]["90"]) == {"mean", "sd", "sessions"}
    assert method["fused"]["90"]["sessions"] == method["fused"]["all"]["sessions"] == 2
    assert method["interactions"]["identity_switches"] == 0
    assert "as they were logged" in method["scored"]
    assert set(scored["front_sensor_alone"]["fused"]["all"]) == set(method["fused"]["all"])


def test_interactions_have_switches_and_both_people(study_logs: Path, tmp_path: Path) -> None:
    scored = result_here(tmp_path, *VERB, str(study_logs), "--participants", "22")
    interactions = scored["methods"]["stand-still"]["interactions"]
    assert interactions["identity_switches"] == interactions["missed"] == 0
    (file,) = interactions["files"].values()
    assert set(file["people"]) == {"0", "1"}
    assert set(file["people"]["0"]) == {"median_cm", "mean_cm", "p95_cm"}


def test_a_person_reads_a_table_and_a_program_only_json(folder: Path) -> None:
    shown = run_here(folder, *VERB, "logs", "--json", "out.json")
    assert shown.returncode == 0, shown.stderr
    assert "walk" in shown.stdout
    assert "bone length variation" in shown.stdout
    written = json.loads((folder / "out.json").read_text())
    piped = json.loads(run_here(folder, *VERB, "logs", "--json", "-").stdout)
    assert piped == written


def test_a_row_that_fails_is_said() -> None:
    rows = {"walk": {"90": {"problem": "3 pairs"}, "45": {"problem": ""}}}
    assert failures({"methods": {"m": {"tasks": rows}}}) == ["m: walk 90 fails: 3 pairs"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere"], ["nowhere", "no such folder"]),
        (["."], ["has no study logs", "Study_P_Kinect_C_"]),
        (["logs", "--methods", "stand-stil"], ["unknown tracking method", "did you mean stand-still"]),
        (["logs", "--methods", "default:people.smoothing=kalmann"], ["smoothing", "did you mean kalman"]),
        (["logs", "--methods", "default:smoothing"], ["smoothing", "NAME=VALUE"]),
        (["logs", "--methods", ","], ["no method to score", "stand-still"]),
        (["logs", "--participants", "8"], ["has no participant 8", "it has 7"]),
        (["logs", "--participants", "seven"], ["--participants 'seven'", "0,1,20"]),
        (["logs", "--json", "nowhere/out.json"], ["nowhere/out.json"]),
    ],
)
def test_bad_input_is_one_line_that_says_what_would_work(arguments: list[str], words: list[str], folder: Path) -> None:
    done = run_here(folder, *VERB, *arguments)
    assert done.returncode == 1
    message = done.stderr.strip().splitlines()[-1]
    assert message.startswith("mocapella: ")
    assert all(word in message for word in words), message


def test_a_log_that_cannot_be_read_is_named(folder: Path) -> None:
    (folder / "logs" / "Study_9_Kinect_1_Time_3.csv").write_text("what, is, this\n1, 2, 3\n")
    done = run_here(folder, *VERB, "logs")
    assert done.returncode == 1
    assert "Study_9_Kinect_1_Time_3.csv" in done.stderr
