"""The least jitter of linear filters: laws of the optimum, and the experiment on little."""

from __future__ import annotations

import json
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console
from support.rigged_meshes import worm
from typer.testing import CliRunner

from mocapella.cli.app import app
from mocapella.cli.evaluate_jitter import show_jitter_limit
from mocapella.errors import EvaluationError, SettingsError
from mocapella.evaluation import jitter_limit as experiment
from mocapella.evaluation.jitter_limit import JitterLimitRow, constrained_filter, least_jitter, run_jitter_limit
from mocapella.evaluation.silhouettes import Movement, rms_acceleration
from mocapella.model.twist_tree import TreePose
from mocapella.sources.simulate.silhouette_scene import silhouette_scene

FPS, FRAMES = 60.0, 150
MESH = worm()


def moved(places: Any) -> Movement:
    """A body that does not bend, at these places (frames, 3)."""
    T = np.tile(np.eye(4), (len(places), 1, 1))
    T[:, :3, 3] = places
    return Movement(MESH, TreePose(T, np.zeros((len(places), len(MESH.joint_names)))), FPS)


def swinging(seed: int, noise_m: float, frames: int = FRAMES) -> tuple[Movement, Movement, float]:
    """A motion of 1 Hz with noise, the true one, and the jitter of the noise."""
    rng, at = np.random.default_rng(seed), np.arange(frames)[:, None] / FPS
    true = 0.3 * np.sin(2 * np.pi * at + rng.uniform(0, 6, 3))
    noise = rng.normal(0, noise_m, true.shape)
    return moved(true + noise), moved(true), rms_acceleration(noise[:, None], FPS)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6))
def test_whoever_knows_or_may_do_more_has_less_jitter(seed: int) -> None:
    found, true, raw = swinging(seed, 0.003)
    # The first frames have no past, so that the raw jitter is of others, too.
    no_lag, lagging, smoothed = (
        least_jitter(found, true, ahead=ahead, no_lag=no_lag) for ahead, no_lag in ((0, True), (0, False), (16, False))
    )
    assert 0 < no_lag < 1.15 * raw
    assert lagging <= no_lag * (1 + 1e-6)
    assert least_jitter(found, true, taps=8) >= 0.85 * lagging
    assert smoothed < lagging


def test_without_noise_there_is_no_jitter() -> None:
    found, true, _ = swinging(1, 0.0)
    for ahead, no_lag in ((0, True), (0, False), (16, False)):
        assert least_jitter(found, true, ahead=ahead, no_lag=no_lag) < 1e-4


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.booleans())
def test_no_other_filter_that_keeps_the_conditions_is_better(seed: int, no_lag: bool) -> None:
    rng = np.random.default_rng(seed)
    at = np.arange(9) - 6
    A, b = rng.normal(size=(60, 9)), rng.normal(size=60)
    h = constrained_filter(A, b, at, no_lag=no_lag)
    assert h.sum() == pytest.approx(1.0)
    if no_lag:
        assert h @ at == pytest.approx(0.0, abs=1e-9)
    conditions = np.stack([np.ones(9), at])[: 1 + no_lag]
    free = np.linalg.svd(conditions)[2][1 + no_lag :]
    other = h + free.T @ rng.normal(0, 0.1, len(free))
    assert np.sum((A @ h - b) ** 2) <= np.sum((A @ other - b) ** 2)


def test_white_noise_of_who_stands_still_is_lowered_as_theory_says() -> None:
    """A free filter of n frames, Σ h = 1, that makes Σ (second difference)² least; the noise is white."""
    rng = np.random.default_rng(0)
    still, noise = np.zeros((20_000, 3)), rng.normal(0, 0.01, (20_000, 3))
    taps = 6
    D = np.diff(np.eye(taps + 5), 2, axis=0)[:, 2:-2] * FPS**2
    ones = np.ones(taps + 1)
    inverse = np.linalg.inv(D.T @ D)
    theory = 0.01 * np.sqrt(3 / (ones @ inverse @ ones))
    assert least_jitter(moved(noise), moved(still), taps=taps) == pytest.approx(theory, rel=0.02)


def test_what_cannot_be_filtered_is_refused() -> None:
    found, true, _ = swinging(1, 0.001)
    with pytest.raises(EvaluationError, match="150 frames cannot be compared with 149"):
        least_jitter(found, true.first(149))
    with pytest.raises(EvaluationError, match="34 frames are too few for a filter of 17; 35 or more"):
        least_jitter(found.first(34), true.first(34))
    least_jitter(found.first(35), true.first(35))
    with pytest.raises(SettingsError, match="seeds"):
        run_jitter_limit([])


def test_the_table_has_room_at_80_columns() -> None:
    out = StringIO()
    show_jitter_limit(
        [JitterLimitRow("flick-flack", 12345, 1234.5, 1234.5, 1.0, 1.0, 1.0)], Console(file=out, width=80)
    )
    assert "…" not in out.getvalue()
    assert "100 %" in out.getvalue()


@pytest.mark.slow
def test_the_experiment_is_a_command(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def scene(name: str, *, seed: int) -> Any:
        return silhouette_scene(name, seed=seed, cameras=3, size_px=(160, 120), fps=60.0)

    monkeypatch.setattr(experiment, "silhouette_scene", scene)
    monkeypatch.setattr(experiment, "TAPS", 3)
    monkeypatch.setattr(experiment.least_jitter, "__kwdefaults__", {"ahead": 0, "no_lag": False, "taps": 3})
    rows = tmp_path / "rows.json"
    line = ["lab", "evaluate", "silhouettes-jitter-limit", "--seeds", "5", "--seconds", "0.4", "--json", str(rows)]
    done = CliRunner().invoke(app, line, env={"COLUMNS": "80"})
    assert done.exit_code == 0, (done.output, done.exception)
    (row,) = json.loads(rows.read_text(encoding="utf-8"))["rows"]
    assert row["with_it"] != row["without"]
    assert 0 < row["lagging"] <= row["no_lag"]
    assert row["smoothed"] > 0
    assert "runner 5" in done.output
