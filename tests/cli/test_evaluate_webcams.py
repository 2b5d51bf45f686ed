"""``mocapella lab evaluate webcams`` and ``lab train keypoint-errors``: tables, JSON and bad input."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from rich.console import Console
from typer.testing import CliRunner

from mocapella.cli import import_commands
from mocapella.cli.app import app
from mocapella.cli.evaluate_webcams import _WHERE, _WHO, show_causes, show_films, show_webcams
from mocapella.evaluation.webcams import judged
from mocapella.sources.simulate.crowd import crowd_names

import_commands()
VERB = ("lab", "evaluate", "webcams")
FIGURES = _WHO | _WHERE


def test_help_lists_the_scenes() -> None:
    done = CliRunner().invoke(app, [*VERB, "--scenes", "help"])
    assert done.exit_code == 0
    assert all(name in done.output for name in crowd_names())


def test_the_table_has_every_figure_and_verdict() -> None:
    mean = dict.fromkeys(FIGURES, 12.345)
    person = {"present_percent": 100.0, "median_mm": 20.0, "p95_mm": 90.0, "ids": 1}
    clip = {"people": [person], "others_percent": 0.0, "measured_percent": 90.0}
    result = {"seeds": [0], "scenes": {"six-walk": {"mean": mean}}, "clips": {"pose2sim_single_person": clip}}
    result["targets"] = judged(result)
    out = Console(record=True, width=80)
    show_webcams(result, out)
    text = out.export_text()
    assert text.count("12.35") >= len(FIGURES)
    assert "…" not in text
    assert all(words.partition("\n")[0] in text for words in FIGURES.values())
    assert "six-walk: hota: 12.35 (≥ 0.95) met" in text
    assert "person 1: p95_mm: 90.00 (≤ 80) not met" in text


def test_the_tables_of_films_have_both_comparisons_and_the_lags() -> None:
    person = {"present_percent": 100.0, "median_mm": 44.5, "p95_mm": 90.0, "ids": 1}
    clip = {"people": [person], "others_percent": 0.0, "measured_percent": 87.0}
    out = Console(record=True, width=120)
    lags = {"reference_lag_frames": -1.01, "detector_lag_frames": 0.12}
    show_films("a-clip", {"as_is": clip, "aligned": clip, **lags}, out)
    text = out.export_text()
    assert text.count("44.50") == 2
    assert all(words in text for words in ("as numbered", "same image", "keypoints -1.01", "detector's 0.12 frames"))


def test_the_tables_of_causes_have_a_row_for_each_seed() -> None:
    run = {
        "pcp_percent": {"method": 91.25}, "actors_percent": [91.25, 92.25], "parts_percent": {"upper arms": 93.25},
        "found_percent": 94.25, "precision_percent": 95.25, "causes_percent": {"not tracked": 3.25},
        "parts_causes_percent": {"upper arms": {"sides": 4.25}, "head": {"sides": 5.25}},
        "actors_causes_percent": [{"sides": 6.25}],
    }  # fmt: skip
    fewer = run | {"actors_percent": [96.25]}
    out = Console(record=True, width=80)
    show_causes({"seeds": [0, 7], "causes": {"shelf": [run, fewer]}}, out)
    text = out.export_text()
    assert all(f"{value:.2f}" in text for value in (91.25, 92.25, 93.25, 94.25, 95.25, 96.25, 3.25, 4.25, 5.25, 6.25))
    assert text.count("shelf 7") == len(run) + 1  # a row for each part
    assert "shelf 7, upper arms" in text


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--scenes", "nowhere"], "unknown scene"),
        (["--causes", "--scenes", "nowhere"], "unknown scene"),
        (["--seeds", "x"], "--seeds"),
        (["--detector", "mediapipe"], "--data"),
        (["--data", ".", "--detector", "nothing"], "nothing"),
    ],
)
def test_bad_input_is_named(words: list[str], said: str) -> None:
    done = CliRunner().invoke(app, [*VERB, *words])
    assert done.exit_code != 0
    assert said in done.output + str(done.exception)


@pytest.mark.slow
def test_the_json_has_runs_and_targets(tmp_path: Path) -> None:
    out = tmp_path / "out.json"
    done = CliRunner().invoke(app, [*VERB, "--scenes", "turning/2", "--json", str(out)])
    assert done.exit_code == 0
    result = json.loads(out.read_text(encoding="utf-8"))
    assert set(result) == {"seeds", "scenes", "clips", "targets"}
    assert set(FIGURES) <= set(result["scenes"]["turning/2"]["mean"])


def test_errors_are_not_measured_without_recordings(tmp_path: Path) -> None:
    words = ["lab", "train", "keypoint-errors", str(tmp_path), "--out", str(tmp_path / "errors.json")]
    done = CliRunner().invoke(app, words)
    assert done.exit_code != 0
    assert "Calib_qualisys" in done.output + str(done.exception)
    assert not (tmp_path / "errors.json").exists()
