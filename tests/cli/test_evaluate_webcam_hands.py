"""``mocapella lab evaluate webcam-hands``: tables, JSON and bad input."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from rich.console import Console
from typer.testing import CliRunner

from mocapella.cli import import_commands
from mocapella.cli.app import app
from mocapella.cli.evaluate_webcam_hands import _CLIP, _WHERE, _WHO, show_webcam_hands
from mocapella.sources.simulate.hand_keypoints import hand_keypoint_scenes

import_commands()
VERB = ("lab", "evaluate", "webcam-hands")
FIGURES = _WHO | _WHERE


def test_help_lists_the_scenes_of_hands() -> None:
    done = CliRunner().invoke(app, [*VERB, "--scenes", "help"])
    assert done.exit_code == 0
    assert all(name in done.output for name in hand_keypoint_scenes())


def test_the_tables_have_every_figure_and_say_that_there_is_no_reference() -> None:
    result = {"seeds": [0, 1], "scenes": {"fist": {"mean": dict.fromkeys(FIGURES, 12.345) | {"alone_mm": None}}}}
    out = Console(record=True, width=80)
    show_webcam_hands(result | {"clip": dict.fromkeys(_CLIP, 7.0)}, out)
    text = out.export_text()
    assert text.count("12.35") == len(FIGURES) - 1
    assert text.count("7.00") == len(_CLIP)
    assert "without a reference" in text
    assert "…" not in text


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--scenes", "nowhere"], "unknown scene"),
        (["--seeds", "x"], "--seeds"),
        (["--scenes", "fist", "--set", "hands.nothing=1"], "nothing"),
    ],
)
def test_bad_input_of_hands_is_named(words: list[str], said: str) -> None:
    done = CliRunner().invoke(app, [*VERB, *words])
    assert done.exit_code != 0
    assert said in done.output + str(done.exception)


@pytest.mark.slow
def test_the_json_has_the_figures_of_each_seed(tmp_path: Path) -> None:
    out = tmp_path / "out.json"
    done = CliRunner().invoke(app, [*VERB, "--scenes", "fist", "--seeds", "0,1", "--json", str(out)])
    assert done.exit_code == 0
    result = json.loads(out.read_text(encoding="utf-8"))
    assert set(FIGURES) <= set(result["scenes"]["fist"]["mean"])
    assert len(result["scenes"]["fist"]["runs"]) == 2


@pytest.mark.slow
def test_a_folder_without_the_recording_is_named(tmp_path: Path) -> None:
    pytest.importorskip("mediapipe")
    done = CliRunner().invoke(app, [*VERB, "--scenes", "fist", "--data", str(tmp_path)])
    assert done.exit_code != 0
    assert "stereo_hand_webcams" in done.output + str(done.exception)
