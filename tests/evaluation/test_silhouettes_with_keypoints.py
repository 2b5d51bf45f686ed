"""Figures of silhouettes with keypoints and without, and the simulated keypoints."""

from __future__ import annotations

import io

import numpy as np
import pytest
from rich.console import Console

from mocapella.cli.evaluate_keypoints import show_keypoints
from mocapella.evaluation import silhouettes_with_keypoints as compared
from mocapella.evaluation.keypoints_of_scenes import drawn_keypoints
from mocapella.evaluation.silhouette_seated import SeatedRun
from mocapella.kinematics.silhouette_fit import eye, seen_at
from mocapella.sources.simulate.silhouette_scene import silhouette_scene

MARKS = ("left knee", "left ankle", "left wrist")


def test_figures_are_of_runs_with_keypoints_and_without(monkeypatch: pytest.MonkeyPatch) -> None:
    def follow(name: str, seed: int, seconds: float, *, keypoints: bool) -> SeatedRun:
        errors = np.full((4, 3), 0.01 * seed if keypoints else 0.2)
        return SeatedRun(MARKS, errors, np.full((4, 3), keypoints), np.ones((4, 3)), 0.9, 0)

    monkeypatch.setattr(compared, "follow_seated", follow)
    found = compared.evaluate(["dark"], [1, 3])
    given, none = found["scenes"]["dark"]["with keypoints"], found["scenes"]["dark"]["without keypoints"]
    assert (given["knee"]["median_mm"], given["knee"]["worst_mm"]) == pytest.approx((20.0, 30.0))
    assert (none["ankle"]["median_mm"], none["ankle"]["unsupported_percent"]) == pytest.approx((200.0, 100.0))
    assert given["overlap_percent"] == pytest.approx(90.0)
    text = io.StringIO()
    show_keypoints(found, Console(file=text, width=160))
    assert "without keypoints" in text.getvalue()
    assert "recordings" not in text.getvalue()


def test_simulated_keypoints_are_near_the_landmarks_and_the_same_again() -> None:
    scene = silhouette_scene("knee-bend", seed=3, cameras=3, size_px=(160, 120), fps=60.0)
    once, again = drawn_keypoints(scene, 0, 5), drawn_keypoints(scene, 0, 5)
    knee = list(scene.mesh.landmarks).index("left knee")
    for one, same, placed in zip(once, again, scene.rig.cameras.values(), strict=True):
        np.testing.assert_array_equal(one.positions_px, same.positions_px)
        assert (one.time_ns, one.size_px) == (5, (160, 120))
        truth = seen_at(scene.landmarks(0), eye(placed))[knee]
        seen = one.positions_px[0, one.topology.index("LKnee")]
        assert np.isnan(seen).any() or np.linalg.norm(seen - truth) < 60
        assert np.isnan(one.positions_px[0, one.topology.index("Neck")]).all()
