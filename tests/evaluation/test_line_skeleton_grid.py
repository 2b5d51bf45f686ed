"""The table of grids: what it counts, on drawn arms of which the truth is known."""

from __future__ import annotations

import json
import sys
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cv2")

from support.drawn_arms import CAMERA, arm
from typer.testing import CliRunner

from mocapella.cli import evaluate as _evaluate  # noqa: F401 - registers the verb
from mocapella.cli import view as _view  # noqa: F401 - and another: an app of one verb has no verbs
from mocapella.cli.app import app
from mocapella.errors import EvaluationError, SettingsError
from mocapella.evaluation import line_skeleton_grid
from mocapella.evaluation.line_skeleton_grid import GRIDS_PX, NEAR_M, GridRow, grid_table, plot_grid, rendered_frames
from mocapella.sensing.line_skeleton import LineSkeletonSettings

ROWS = (GridRow(1, 3, 3, 20.0, 25.0, 30.0, 9.0, 1.0), GridRow(10, 3, 3, 12.0, 14.0, 35.0, 20.0, 0.8))


def test_each_grid_has_a_row_of_all_frames() -> None:
    scenes = [arm(), arm(rotation_degrees=180)]
    nothing = np.zeros_like(scenes[0].depth), scenes[0].truth, 2.0
    frames = [*((scene.depth, scene.truth, float(at)) for at, scene in enumerate(scenes)), nothing]
    ticks = count()
    rows = grid_table(frames, CAMERA, lambda: 0.002 * next(ticks))
    assert tuple(row.grid_px for row in rows) == GRIDS_PX
    for row in rows:
        assert (row.frames, row.arms) == (3, 2)
        assert row.median_ms == pytest.approx(2.0)
        assert row.p95_ms == pytest.approx(2.0)
        assert row.tips_found == pytest.approx(1 / 3)  # those of the first; of the turned arm none is in its place
        assert row.tips_mm < 15
        assert row.arm_mm > 30


def test_a_truth_that_is_not_known_is_not_missed() -> None:
    scene = arm()
    truth = scene.truth.copy()
    truth[[4, 8]] = np.nan
    (row,) = grid_table([(scene.depth, truth, 0.0)], CAMERA, lambda: 0.0, grids_px=(4,))
    assert row.tips_found == 1.0
    (none,) = grid_table([(scene.depth, np.full_like(truth, np.nan), 0.0)], CAMERA, lambda: 0.0, grids_px=(4,))
    assert np.isnan([none.tips_found, none.tips_mm, none.arm_mm]).all()


def test_a_tip_is_found_up_to_five_centimetres_off() -> None:
    off = np.r_[np.zeros(3), NEAR_M, np.nextafter(NEAR_M, 1), np.inf, np.nan, np.nan]
    row = line_skeleton_grid._row(1, [0.25], [off])
    assert (row.tips_found, row.tips_mm, row.arms) == (pytest.approx(1 / 3), 1000 * NEAR_M, 1)


def test_settings_reach_the_detector() -> None:
    scene = arm()
    settings = LineSkeletonSettings(least_area_px=1e6)
    (row,) = grid_table([(scene.depth, scene.truth, 0.0)], CAMERA, lambda: 0.0, grids_px=(2,), settings=settings)
    assert (row.arms, row.tips_found) == (0, 0.0)


def test_without_frames_there_is_no_table() -> None:
    with pytest.raises(EvaluationError, match="no frame"):
        grid_table([], CAMERA, lambda: 0.0)


@pytest.mark.slow
def test_it_is_drawn(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    plot_grid(ROWS, tmp_path / "grid.svg")
    assert "<svg" in (tmp_path / "grid.svg").read_text(encoding="utf-8")
    with pytest.raises(SettingsError, match=r"name a \.png or \.svg"):
        plot_grid(ROWS, tmp_path / "nowhere" / "grid.png")


def test_without_matplotlib_it_says_so(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(SettingsError, match="matplotlib is not installed: uv sync --extra plots"):
        plot_grid(ROWS, tmp_path / "grid.png")


def test_frames_are_evenly_over_the_periods_of_scenes_of_right_hands_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their depths are in metres."""

    def scene(name: str, *, seed: int, sensor: str) -> Any:
        hands = {"right": ["right"], "left": ["left"], "both": ["right", "left"]}[name]
        truth = np.zeros((23, 3))
        return SimpleNamespace(
            meshes=[SimpleNamespace(handedness=hand) for hand in hands],
            period_s=1.0 + seed if name == "right" else 99.0,
            sensor=SimpleNamespace(size_px=(64, 48)),
            lens=np.array([48.0, 48.0, 31.5, 23.5, 0, 0, 0, 0, 0]),
            at=lambda at_s: SimpleNamespace(
                depth=np.full((48, 64), 1400, np.uint16), unit_m=0.0005, arms=[SimpleNamespace(points=truth)], at_s=at_s
            ),
        )

    monkeypatch.setattr(line_skeleton_grid, "load_depth_scene", scene)
    _, frames = rendered_frames(("left", "right", "both"), (1, 3), images=2)
    found = list(frames)
    assert [at_s for _, _, at_s in found] == [0.5, 1.5, 1.0, 3.0]
    np.testing.assert_allclose([depth for depth, _, _ in found], 0.7, rtol=1e-6)


@pytest.mark.slow
def test_rendered_frames_are_those_of_right_arms() -> None:
    camera, frames = rendered_frames(("still", "fist"), (100, 102), "exact", images=1)
    found = list(frames)
    assert camera.size_px == (640, 480)
    assert 0 < len(found) < 4  # some of the four are left ones
    for depth, truth, _ in found:
        assert depth.dtype == np.float32
        assert depth.shape == (480, 640)
        assert truth.shape == (23, 3)
    with pytest.raises(EvaluationError, match="no right arm in still with seeds 102"):
        rendered_frames(("still",), (102,))
    with pytest.raises(SettingsError, match="unknown scene 'stil'"):
        rendered_frames(("stil",))


@pytest.mark.slow
def test_the_experiment_is_a_command(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    words = ["--scenes", "still", "--seeds", "101", "--depth-sensor", "exact", "--plot", str(tmp_path / "grid.svg")]
    done = CliRunner().invoke(
        app,
        ["lab", "evaluate", "line-skeleton-grid", *words, "--json", str(tmp_path / "grid.json")],
        env={"COLUMNS": "120"},
    )
    assert done.exit_code == 0, (done.output, done.exception)
    rows = json.loads((tmp_path / "grid.json").read_text(encoding="utf-8"))["rows"]
    assert [row["grid_px"] for row in rows] == [1, 2, 4, 5, 8, 10]
    assert all(row["frames"] == row["arms"] == 6 for row in rows)
    assert all(row["median_ms"] > 0 for row in rows)
    assert rows[2]["tips_found"] >= 0.5
    assert rows[2]["tips_mm"] < 30
    assert "<svg" in (tmp_path / "grid.svg").read_text(encoding="utf-8")
    assert "line-skeleton, 6 images of rendered right arms" in done.output
