"""``mocapella lab evaluate simulation``: its JSON, its tables, and bad input."""

from __future__ import annotations

from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console
from support.programs import run_here

from mocapella.cli.evaluate import _JOINTS, _WHO_AND_WHERE, show_simulation
from mocapella.evaluation.simulation import TARGETS, scene_summaries, summary

VERB = ("lab", "evaluate", "simulation")


def figures(**changed: float | None) -> dict[str, float | None]:
    return dict.fromkeys((*_JOINTS, *_WHO_AND_WHERE, "sensors"), 1.0) | changed


def test_a_person_reads_every_figure_every_target_and_what_is_not_known() -> None:
    runs = {"crossing": [figures()], "six": [figures(calibration_mm=None, fused_cm=12.345, sensors=4.0)]}
    targets = {name: {"over_scenes": kind, "limit": limit} for name, (kind, limit) in TARGETS.items()}
    out = StringIO()
    result = {"seeds": [0, 1], "targets": targets, "methods": {"default": summary(runs)}}
    show_simulation(result, Console(file=out, width=80))
    text = out.getvalue()
    assert "12.35" in text or "12.34" in text
    assert "seeds 0, 1" in text
    assert "…" not in text  # nothing is cut off at 80 columns
    assert all(name in text for name in TARGETS)
    assert "calibration_mm: – (six; ≤ 10) not met" in text
    assert "hota: 1.00 (crossing; ≥ 0.95) met" in text


def test_the_scenes_are_listed_and_what_is_unknown_is_refused(tmp_path: Path) -> None:
    listed = run_here(tmp_path, *VERB, "--scenes", "help")
    assert [line.split()[0] for line in listed.stdout.splitlines()] == list(scene_summaries())
    refused = run_here(tmp_path, *VERB, "--methods", "default", "--scenes", "crosing")
    assert refused.returncode == 1
    assert "crossing" in refused.stderr


@pytest.mark.parametrize(("option", "value"), [("--seeds", "one"), ("--methods", "defalt")])
def test_bad_options_are_refused_before_anything_is_done(tmp_path: Path, option: str, value: str) -> None:
    refused = run_here(tmp_path, *VERB, option, value)
    assert refused.returncode == 1
    assert option[2:-1] in refused.stderr
