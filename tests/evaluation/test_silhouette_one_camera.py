"""What one camera tells of a body: laws of its directions and errors along its axis, and the experiment on little."""

from __future__ import annotations

import json
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console
from typer.testing import CliRunner

from mocapella.cli.app import app
from mocapella.cli.evaluate_silhouettes import show_one_camera
from mocapella.errors import SettingsError
from mocapella.evaluation import silhouette_one_camera as experiment
from mocapella.evaluation.silhouette_experiments import followed
from mocapella.evaluation.silhouette_one_camera import AWAY_M, SCENES, WEIGHTS, errors_m, freedoms, median_freedoms
from mocapella.evaluation.silhouette_runs import filmed, with_penalty
from mocapella.evaluation.silhouettes import Movement
from mocapella.geometry.rigid import inverse
from mocapella.model.camera import CameraRig
from mocapella.model.twist_tree import TreePose
from mocapella.sources.simulate.silhouette_scene import silhouette_scene

pytestmark = pytest.mark.slow  # of kernels that are compiled for these tests alone

SMALL: Any = {"seed": 3, "size_px": (160, 120), "fps": 60.0}
SCENE = silhouette_scene("runner", **SMALL, cameras=4)
TRUTH = Movement(SCENE.mesh, SCENE.poses(), 60.0).first(6)
ONE = CameraRig(dict(list(SCENE.rig.cameras.items())[:1]))
OUTLINES = replace(with_penalty(0.0), usual_per_rad=0.0)


def moved(T: Any) -> Movement:
    return Movement(TRUTH.mesh, TreePose(T @ TRUTH.poses.T_world_model, TRUTH.poses.angles), 60.0)


@given(st.floats(-3, 3), st.floats(-3, 3))
def test_errors_along_the_axis_and_across_it_are_told_apart(along: float, across: float) -> None:
    (placed,) = ONE.cameras.values()
    T_world_camera, push = inverse(placed.T_camera_world), np.eye(4)
    push[:3, 3] = across, 0, along
    off = errors_m(moved(T_world_camera @ push @ placed.T_camera_world), TRUTH, ONE)
    assert off.shape == (6, len(TRUTH.landmarks), 3)
    np.testing.assert_allclose(off, np.broadcast_to([across, 0, along], off.shape), atol=1e-9)


@settings(max_examples=10)
@given(st.integers(0, len(SCENE) - 1), st.floats(0.01, 100))
def test_nothing_that_is_added_makes_a_direction_less_certain(k: int, weight: float) -> None:
    """Of sums of positive semidefinite matrices no eigenvalue is below the terms' (H. Weyl)."""
    pose = SCENE.pose(k)
    outlines, without, with_it = (
        freedoms(SCENE.mesh, pose, ONE, settings, 60.0)
        for settings in (OUTLINES, with_penalty(0.0), with_penalty(weight))
    )
    many = freedoms(SCENE.mesh, pose, SCENE.rig, OUTLINES, 60.0)
    for more, less in ((with_it, without), (without, outlines), (many, outlines)):
        assert (np.diff(more) <= 0).all()
        assert (more <= less * (1 + 1e-6)).all()
    assert with_it[0] < without[0]


def test_where_no_camera_sees_anything_nothing_but_the_penalty_holds_the_body() -> None:
    pose = SCENE.pose(0)
    away = TreePose(pose.T_world_model + np.outer([0, 100.0, 0, 0], [0, 0, 0, 1]), pose.angles)
    assert np.isinf(freedoms(SCENE.mesh, away, ONE, OUTLINES, 60.0)).all()
    assert np.isinf(freedoms(SCENE.mesh, away, ONE, with_penalty(0.0), 60.0)).sum() == 6  # the root
    assert np.isfinite(freedoms(SCENE.mesh, away, ONE, with_penalty(1.0), 60.0)).all()


def test_one_camera_leaves_directions_open_that_four_do_not_and_the_penalty_closes_them() -> None:
    one, four = (median_freedoms(TRUTH, rig, OUTLINES)[0] for rig in (ONE, SCENE.rig))
    assert one > 3 * four
    assert median_freedoms(TRUTH, ONE, with_penalty(1.0))[0] < 0.5 * median_freedoms(TRUTH, ONE, with_penalty(0.0))[0]


def test_the_experiment_is_a_command(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")

    def scene(name: str, *, seed: int, **more: Any) -> Any:
        return silhouette_scene(name, **(more | SMALL | {"seed": seed}))

    monkeypatch.setattr(experiment, "silhouette_scene", scene)
    line = ["lab", "evaluate", "silhouettes-one-camera", "--seeds", "5", "--seconds", "0.05"]
    files = ["--plot", str(tmp_path / "plot.svg"), "--json", str(tmp_path / "rows.json")]
    done = CliRunner().invoke(app, [*line, *files], env={"COLUMNS": "80"})
    assert done.exit_code == 0, (done.output, done.exception)
    rows = json.loads((tmp_path / "rows.json").read_text(encoding="utf-8"))["rows"]
    assert [(row["run"]["scene"], row["run"]["weight"]) for row in rows] == [
        (name, weight) for name in SCENES for weight in WEIGHTS
    ]
    for row in rows:
        assert 0 < row["depth_mm"] <= row["depth_p95_mm"]
        assert 0 < row["across_mm"] <= row["across_p95_mm"]
        assert 3 * row["away"] == pytest.approx(round(3 * row["away"]))  # of three frames
        assert row["outlines_of_many"] < row["outlines"]
        assert row["free"] <= row["outlines"]
    assert "<svg" in (tmp_path / "plot.svg").read_text(encoding="utf-8")
    assert all(f"{name} 5" in done.output for name in SCENES)
    assert "…" not in done.output  # nothing is cut off at 80 columns
    refused = CliRunner().invoke(app, [*line, "--bodies", "mine"])
    assert isinstance(refused.exception, SettingsError)
    assert "no 'mine'; there are own, measured" in str(refused.exception)


def test_a_body_that_is_elsewhere_is_away_and_the_table_has_room_for_it() -> None:
    aside = np.eye(4)
    aside[0, 3] = 1.2 * AWAY_M
    run, _ = followed(filmed(silhouette_scene("t-pose", **SMALL, cameras=1), 0.05), "own", "clean", None, 1.0)
    rows = [experiment._row(run, errors_m(found, TRUTH, ONE), 60.0, (0.0, 0.0, 0.0)) for found in (TRUTH, moved(aside))]
    assert [row.away for row in rows] == [0.0, 1.0]
    assert rows[1].depth_jitter == pytest.approx(0, abs=1e-6)
    out = StringIO()
    wide = msgspec.structs.replace(run, scene="knee-bend", seed=100)
    lost = [msgspec.structs.replace(row, run=wide, depth_p95_mm=12345.6, across_p95_mm=12345.6) for row in rows]
    show_one_camera(lost, Console(file=out, width=80))
    assert "12346" in out.getvalue()
    assert "…" not in out.getvalue()
    assert np.hypot(rows[1].depth_mm, rows[1].across_mm) == pytest.approx(1200 * AWAY_M)
