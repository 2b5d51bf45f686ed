"""Measures time and accuracy of the detector `line-skeleton` over its grid: 1, 2, 4, 5, 8 and 10 pixels.

The grid is the stride of the pixels of the arm that the detector samples; a joint takes the depth of the nearest one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.errors import EvaluationError
from mocapella.evaluation.plots import new_figure, save_figure
from mocapella.model.arms import ARM_JOINTS
from mocapella.model.camera import Camera
from mocapella.model.observations import JointState
from mocapella.sensing.line_skeleton import LineSkeleton, LineSkeletonSettings
from mocapella.sources.simulate.depth_scene import load_depth_scene

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

GRIDS_PX: Final = (1, 2, 4, 5, 8, 10)
SCENES: Final = ("open-close", "counting", "each-finger-before-palm", "still")
SEEDS: Final = (100, 101, 102, 103)
"""Seeds of the table's scenes; only scenes with a right arm are used, because the detector expects one."""
IMAGES: Final = 6
"""Number of images of each scene, evenly over its period."""
NEAR_M: Final = 0.05
"""Largest error of a found fingertip [m]; a farther one is another part of the hand."""
_ARM: Final = 3
"""Number of the arm's joints, elbow, wrist and palm, which are the first of the eight."""


class GridRow(msgspec.Struct, frozen=True):
    """Results of one grid on all frames.

    Attributes:
        grid_px: stride of the detector's grid, see `LineSkeletonSettings` [px].
        frames: number of frames.
        arms: number of frames with a detected arm.
        median_ms, p95_ms: median and 95th percentile of the detector's time per frame [ms].
        arm_mm: median distance of elbow, wrist and palm from their true positions [mm]; NaN without any.
        tips_mm: median distance of the found fingertips from their true positions [mm]; NaN without any.
        tips_found: share of true fingertips that the detector measured within `NEAR_M` of their true positions.
    """

    grid_px: int
    frames: int
    arms: int
    median_ms: float
    p95_ms: float
    arm_mm: float
    tips_mm: float
    tips_found: float


def grid_table(
    frames: Iterable[tuple[Float32, Float64, float]],
    camera: Camera,
    clock: Callable[[], float],
    *,
    grids_px: Sequence[int] = GRIDS_PX,
    settings: LineSkeletonSettings | None = None,
) -> tuple[GridRow, ...]:
    """Run all grids on each frame in turn, so that variations of the machine's speed affect all alike.

    Args:
        frames: for each frame the depth (height, width) [m], the ground truth (23, 3) of
            `mocapella.model.arms.ARM_POINTS` in the camera frame [m], NaN if unknown, and the capture time [s].
        camera: camera of the frames.
        clock: function that measures the time, such as `time.perf_counter` [s].
        grids_px: strides of the grid, one for each row of the table [px].
        settings: settings of the detector, except the grid; None for the defaults.

    Raises:
        EvaluationError: there is no frame.
        SettingsError: a frame of another size than the camera's, or an impossible grid.
    """
    base = settings or LineSkeletonSettings()
    detectors = [LineSkeleton(camera, replace(base, grid_px=grid)) for grid in grids_px]
    took: list[list[float]] = [[] for _ in detectors]
    off: list[list[Float64]] = [[] for _ in detectors]
    warm = False
    for depth, truth, at_s in frames:
        if not warm:
            detectors[0].look(depth)  # warm-up: compile the kernels now
            warm = True
        for detector, seconds, distances in zip(detectors, took, off, strict=True):
            begin = clock()
            seen = detector.update(depth, at_s)
            seconds.append(clock() - begin)
            distances.append(
                _off(seen.arms[0].joints, seen.arms[0].joint_states, truth) if seen.arms else _nothing(truth)
            )
    if not warm:
        raise EvaluationError("no frame to look at; at least one is wanted")
    return tuple(_row(*columns) for columns in zip(grids_px, took, off, strict=True))


def rendered_frames(
    scenes: Sequence[str] = SCENES, seeds: Sequence[int] = SEEDS, sensor: str = "kinect", images: int = IMAGES
) -> tuple[Camera, Iterator[tuple[Float32, Float64, float]]]:
    """Return a depth camera, and frames of right arms for `grid_table` that are rendered on demand.

    Args:
        scenes, seeds, sensor: names of scenes, random seeds, and name of the sensor, as in
            `mocapella.sources.simulate.depth_scene.load_depth_scene`.
        images: number of images of each scene.

    Returns:
        The camera; and for each image the depth (height, width) [m], the ground truth (23, 3) [m] and the time [s].

    Raises:
        SettingsError: no such scene or sensor.
        EvaluationError: none of the scenes has a right arm.
    """
    made = [load_depth_scene(name, seed=seed, sensor=sensor) for name in scenes for seed in seeds]
    right = [scene for scene in made if all(mesh.handedness == "right" for mesh in scene.meshes)]
    if not right:
        raise EvaluationError(f"no right arm in {', '.join(scenes)} with seeds {', '.join(map(str, seeds))}; name more")

    def frames() -> Iterator[tuple[Float32, Float64, float]]:
        for scene in right:
            for k in range(images):
                shot = scene.at(scene.period_s * (k + 0.5) / images)
                yield shot.depth * np.float32(shot.unit_m), shot.arms[0].points, shot.at_s

    return Camera(sensor, right[0].sensor.size_px, right[0].lens), frames()


def plot_grid(rows: Sequence[GridRow], path: Path) -> None:
    """Plot time and accuracy over the grid.

    Raises:
        SettingsError: matplotlib is not installed, or the file cannot be written.
    """
    grids = [row.grid_px for row in rows]
    figure = new_figure(path, 7, 3.2)
    time, accuracy = figure.subplots(1, 2)
    time.plot(grids, [row.median_ms for row in rows], "o-", label="median")
    time.plot(grids, [row.p95_ms for row in rows], "o--", label="95 %")
    time.set(xlabel="grid [px]", ylabel="time a frame [ms]", ylim=(0, None), xticks=grids)
    accuracy.plot(grids, [row.arm_mm for row in rows], "o-", label="elbow, wrist, palm")
    accuracy.plot(grids, [row.tips_mm for row in rows], "o--", label="fingertips found")
    accuracy.set(xlabel="grid [px]", ylabel="median distance [mm]", ylim=(0, None), xticks=grids)
    for axes in (time, accuracy):
        axes.legend()
    save_figure(figure, path)


def _off(joints: Float64, states: NDArray[np.uint8], truth: Float64) -> Float64:
    """Return the errors (8,) [m]; infinite for joints that were not measured, NaN without ground truth."""
    distances = np.linalg.norm(joints - truth[list(ARM_JOINTS)], axis=-1)
    return np.where(states == JointState.TRACKED, distances, np.where(np.isnan(distances), np.nan, np.inf))


def _nothing(truth: Float64) -> Float64:
    return np.where(np.isnan(truth[list(ARM_JOINTS)]).any(axis=-1), np.nan, np.inf)


def _row(grid_px: int, seconds: list[float], distances: list[Float64]) -> GridRow:
    off = np.array(distances)
    arm, tips = off[:, :_ARM], off[:, _ARM:]
    known, near = ~np.isnan(tips), tips <= NEAR_M
    return GridRow(
        grid_px, len(off), int(np.isfinite(arm).any(axis=-1).sum()),
        1000 * float(np.median(seconds)), 1000 * float(np.quantile(seconds, 0.95)),
        _median_mm(arm[np.isfinite(arm)]), _median_mm(tips[near]),
        float(near.sum() / known.sum()) if known.any() else float("nan"),
    )  # fmt: skip


def _median_mm(metres: Float64) -> float:
    return 1000 * float(np.median(metres)) if metres.size else float("nan")
