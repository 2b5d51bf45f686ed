"""The plot of what one camera tells of a body."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.rigged_meshes import worm

from mocapella.evaluation import silhouette_one_camera as experiment
from mocapella.evaluation.silhouette_one_camera import OneCameraShown, plot_one_camera
from mocapella.evaluation.silhouette_runs import Film
from mocapella.evaluation.silhouettes import Movement
from mocapella.model.camera import Camera, CameraRig, PlacedCamera
from mocapella.model.twist_tree import TreePose

FRAMES, FPS = 13, 24.0
LENS = np.array([100.0, 100.0, 79.5, 59.5, 0, 0, 0, 0, 0])
RIG = CameraRig({"front": PlacedCamera(Camera("front", (160, 120), LENS), np.eye(4), np.zeros((6, 6)))})


def still(off_m: float) -> Movement:
    T = np.eye(4)
    T[:3, 3] = off_m
    mesh = worm()
    return Movement(mesh, TreePose(np.tile(T, (FRAMES, 1, 1)), np.zeros((FRAMES, len(mesh.joint_names)))), FPS)


def test_errors_are_plotted_over_seconds(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    saved: list[Any] = []
    monkeypatch.setattr(experiment, "save_figure", lambda drawing, path: saved.append(drawing))
    film = Film(SimpleNamespace(name="still", seed=3, rig=RIG), [], still(0.0))  # type: ignore[arg-type]
    free = {name: np.ones(3) for name in ("many", "one", "and the resting pose", "and the penalty")}
    plot_one_camera([OneCameraShown(film, {1.0: still(0.1)}, free)], tmp_path / "plot.svg")
    (drawing,) = saved
    over_time = [axes for axes in drawing.axes if axes.get_xlabel() == "time [s]"]
    assert len(over_time) == 2
    for axes in over_time:
        (line,) = axes.lines
        np.testing.assert_allclose(np.diff(line.get_xdata()), 1 / FPS)
        assert axes.get_xlim() == pytest.approx((0.0, (FRAMES - 1) / FPS))
