"""Silhouettes beside a marker system: joint angles with the penalty on jitter and without.

B. Rosenhahn, T. Brox, D. Cremers, H.-P. Seidel, "Online Smoothing for Markerless Motion Capture", DAGM 2007, compare
with a marker system: a mean difference of 5.8°, and a standard deviation of 12° without smoothing, 5° with it. Here a
simulated runner in disturbed images is followed with both, and compared as `mocapella compare` does with the true
landmarks in a C3D, in its own space and on its own clock. Angles are those between neighbouring bones.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.harness import Row, measured
from mocapella.comparison.comparison import compared
from mocapella.evaluation.silhouette_experiments import EXPERIMENTS, corrupted, followed
from mocapella.evaluation.silhouette_runs import filmed
from mocapella.evaluation.silhouettes import Movement
from mocapella.exports.c3d_file import write_c3d
from mocapella.geometry.rigid import rigid
from mocapella.model.trajectories import Trajectories
from mocapella.recording.c3d_file import read_c3d
from mocapella.sources.simulate.silhouette_scene import silhouette_scene

SCENE: Final = "runner"
SEED: Final = 700
START_S: Final = 1.25
"""Time of the marker system's clock at the film's beginning [s]."""


def run(quick: bool = False) -> list[Row]:
    plan = EXPERIMENTS[SCENE]
    film = filmed(silhouette_scene(plan.scenes[0], seed=SEED, fps=plan.fps), 1.5 if quick else None)
    images, corruption = list(plan.images.items())[-1]
    rows = []
    for weight, words in ((0.0, "without penalty"), (1.0, "with penalty")):
        _, found = followed(film, "own", images, corrupted(corruption, SEED), weight)
        rows += rows_of(f"silhouettes, {images}, {words}", found, film.truth)
    return rows


def rows_of(name: str, found: Movement, truth: Movement) -> list[Row]:
    """Write the truth as C3D, read it, compare, and return the figures."""
    T = rigid(Rotation.from_rotvec([0.3, 2.0, -0.1]).as_matrix(), [1.0, -0.2, 3.0])
    with tempfile.TemporaryDirectory() as folder:
        write_c3d(trajectories(truth).moved(T), Path(folder) / "truth.c3d")
        reference = read_c3d(Path(folder) / "truth.c3d")
    later = Trajectories(**{**vars(reference), "times_s": reference.times_s + START_S})
    one = compared({"bodies": trajectories(found)}, {"points": later})
    all_angles = one.all_angles()
    assert all_angles is not None
    positions = one.all_positions()
    assert positions is not None
    offset_ms = 1e3 * (one.motion.shift_s - START_S)
    return [
        measured(f"{name}: angles, mean difference", float(np.degrees(all_angles.mean)), "°"),
        measured(f"{name}: angles, SD of the difference", float(np.degrees(all_angles.difference_sd[0])), "°"),
        measured(f"{name}: angles, bias", float(np.degrees(all_angles.bias[0])), "°"),
        measured(f"{name}: positions, RMSE", 1e3 * positions.rmse, "mm"),
        measured(f"{name}: time that is found too much", offset_ms, "ms"),
    ]


def trajectories(movement: Movement) -> Trajectories:
    """The landmarks of a movement as trajectories."""
    names = tuple(movement.landmarks)
    positions = np.stack([movement.landmarks[name] for name in names], axis=1)[:, None]
    shape, count = positions.shape[:3], len(movement)
    return Trajectories(
        "bodies", np.arange(count) / movement.fps, np.zeros(count, np.int64), ("runner",), names, positions,
        np.full(shape, 2, np.uint8), np.full(shape, 0.001, np.float32), rate_hz=movement.fps,
    )  # fmt: skip
