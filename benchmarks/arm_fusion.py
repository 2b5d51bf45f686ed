"""Two depth cameras beside each of them alone, on rendered scenes; and how long the fusion takes for a frame.

The detectors are simulated (`mocapella.sources.simulate.seen_arms`), so that only the fusion is measured: 4 mm of noise
in each coordinate of visible points, and a lasting error of 20 mm in hidden ones.
"""

from __future__ import annotations

import statistics
import time
from typing import Final

import numpy as np

from benchmarks.harness import Row, measured
from mocapella.evaluation.two_cameras import CAMERAS, FUSED, two_camera_scores
from mocapella.sources.simulate.depth_scene import load_depth_scene
from mocapella.sources.simulate.seen_arms import SimulatedArms
from mocapella.tracker.arms import ArmsTracker

SCENES: Final = ("fist", "rotation", "fast")
SEEDS: Final = (100, 101)
FIGURES: Final = {
    "tip_median_mm": "fingertips, median",
    "tip_p95_mm": "fingertips, p95",
    "tips_of_one_camera_median_mm": "points that the other camera sees alone, median",
    "palm_median_mm": "palm, median",
}


def run(quick: bool = False) -> list[Row]:
    rows = []
    for name in SCENES[: 1 if quick else None]:
        for seed in SEEDS[: 1 if quick else None]:
            scene = load_depth_scene(name, seed=seed, sensor="exact")
            looks = SimulatedArms(seed=1).look, SimulatedArms(seed=2).look
            told = two_camera_scores(scene, looks, seconds=1.0 if quick else 6.0)
            for figure, words in FIGURES.items():
                alone = ", ".join(f"{camera} {told[camera][figure]:.1f}" for camera in CAMERAS)
                text = f"{name} {seed}: {words} (alone: {alone})"
                rows.append(measured(text, told[FUSED][figure], "mm"))
    for name in () if quick else ("rotation", "fast"):
        scene = load_depth_scene(name, seed=100, sensor="exact")
        looks = SimulatedArms(seed=1).look, SimulatedArms(seed=2).look
        place = two_camera_scores(scene, looks, seconds=8.0, rig=False)["place"]
        rows.append(measured(f"{name}: a camera placed by the arm, known after", place["known_after_s"], "s"))
        rows.append(measured(f"{name}: position", place["position_error_mm"], "mm"))
        rows.append(measured(f"{name}: rotation", place["rotation_error_deg"], "°"))
    rows.append(measured("one step of the tracker, two cameras", _step_s(), "ms"))
    return rows


def _step_s() -> float:
    """Median time of a frame [ms]."""
    took: list[float] = []

    class Timed(ArmsTracker):
        def update(self, arrival):  # type: ignore[no-untyped-def]
            begin = time.perf_counter()
            scene = super().update(arrival)
            took.append(time.perf_counter() - begin)
            return scene

    scene = load_depth_scene("fast", seed=100, sensor="exact")
    looks = SimulatedArms(seed=1).look, SimulatedArms(seed=2).look
    two_camera_scores(scene, looks, seconds=1.0, make=Timed)
    return 1e3 * statistics.median(took[10:]) if len(took) > 10 else float(np.nan)
