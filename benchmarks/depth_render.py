"""`python -m benchmarks depth_render`: what a rendered depth image of an arm costs, and whether fingers keep apart."""

from __future__ import annotations

import statistics
import time
from typing import Final

import numpy as np

from benchmarks.harness import Row, at_most, measured
from mocapella.model.hand import TIPS
from mocapella.sources.simulate.arm_mesh import ArmMesh, ArmMeshPose
from mocapella.sources.simulate.arm_motion import worst_overlap
from mocapella.sources.simulate.depth_scene import depth_scene_names, depth_sensor_names, load_depth_scene

_SEEDS: Final = (0, 1, 2, 3, 100, 101, 102, 103)


def run(*, quick: bool = False) -> list[Row]:
    """Rows of time by sensor, and over all scenes of overlaps and of what the truth says of fingertips."""
    rows: list[Row] = []
    seeds = _SEEDS[:2] if quick else _SEEDS
    for sensor in depth_sensor_names():
        taken = []
        for seed in seeds:
            scene = load_depth_scene("open-close", seed=seed, sensor=sensor)
            scene.at(0.0)
            for at_s in np.linspace(0.0, scene.period_s, 4 if quick else 20):
                start = time.perf_counter()
                scene.at(float(at_s))
                taken.append(1e3 * (time.perf_counter() - start))
        rows.append(measured(f"open-close, {sensor}, an image", statistics.median(taken), "ms", goal=at_most(15)))
    load = []
    for name in depth_scene_names():
        overlap, tips, seen, occluded = 0.0, 0, 0, 0
        for seed in seeds:
            start = time.perf_counter()
            scene = load_depth_scene(name, seed=seed, sensor="exact")
            load.append(time.perf_counter() - start)
            for at_s in np.linspace(0.0, scene.period_s, 100):
                pairs: list[tuple[ArmMesh, ArmMeshPose]] = list(
                    zip(scene.meshes, scene.poses(float(at_s)), strict=True)
                )
                overlap = max([overlap, *(worst_overlap(mesh, pose.angles) for mesh, pose in pairs)])
            for at_s in np.linspace(0.0, scene.period_s, 4 if quick else 20):
                for arm in scene.at(float(at_s)).arms:
                    tips, seen = tips + 5, seen + int(arm.seen[list(TIPS)].sum())
                    occluded += int(arm.self_occluded.sum())
        rows.append(measured(f"{name}, worst overlap of fingers", 1e3 * overlap, "mm", goal=at_most(2)))
        rows.append(measured(f"{name}, fingertips that are seen", 100 * seen / tips, "%"))
        rows.append(measured(f"{name}, and self-occluded", 100 * occluded / tips, "%"))
    rows.append(measured("to load a scene, median", statistics.median(load), "s"))
    return rows
