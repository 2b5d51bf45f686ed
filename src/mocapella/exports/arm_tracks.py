"""Export tracked arms as a CSV: a row for each joint of each arm of each scene."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from mocapella.errors import SettingsError
from mocapella.exports.arm_rows import STATES
from mocapella.exports.run_labels import label_texts
from mocapella.model.arms import ARM_JOINTS, ARM_POINTS
from mocapella.model.names import as_cell
from mocapella.model.scene import Scene, TrackedArm
from mocapella.model.trajectories import LABELS

COLUMNS: Final = (
    "step", "time_s", "arm", "person", "handedness", "gesture", "gesture_sure", "grabbing", "cameras", "joint", "state",
    "x_m", "y_m", "z_m", "sd_m", "run", *LABELS,
)  # fmt: skip


class ArmTracksReport(msgspec.Struct, frozen=True):
    """Counts of an export of arms.

    Attributes:
        scenes: number of scenes read, including scenes that ``every`` leaves out.
        with_arms: number of written scenes that have an arm.
        rows: number of rows in the file, without the header.
        arms: number of different arm ids in the file.
    """

    scenes: int
    with_arms: int
    rows: int
    arms: int


def write_arm_tracks(
    scenes: Iterable[tuple[int, Scene]],
    path: Path,
    *,
    every: int = 1,
    all_points: bool = False,
    labels: Mapping[int, Mapping[str, Any]] | None = None,
) -> ArmTracksReport:
    """Write a CSV with `COLUMNS`: joint positions in the world frame [m], and times since the first scene [s].

    Each joint of each arm has a row, also if its position is unknown; unknown values are empty. ``person`` is empty for
    an unassigned arm, and ``cameras`` has names with spaces between. A scene without arms has no row. The file appears
    complete or not at all.

    Args:
        scenes: number of the tracker's run and scene, in their order.
        path: the CSV file; an existing one is replaced.
        every: write each n-th scene, from the first; at least 1.
        all_points: write all 23 `ARM_POINTS` instead of the eight joints `ARM_JOINTS`.
        labels: labels of each run by its number; None for none.

    Raises:
        SettingsError: the file cannot be written.
    """
    chosen = range(len(ARM_POINTS)) if all_points else ARM_JOINTS
    part = path.with_name(f".{path.name}.part")
    counts, with_arms, rows, arms, began_ns = 0, 0, 0, set[int](), None
    try:
        with part.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(COLUMNS)
            for number, (run, scene) in enumerate(scenes):
                began_ns = scene.at_ns if began_ns is None else began_ns
                counts += 1
                if number % every:
                    continue
                with_arms += bool(scene.arms)
                for arm in scene.arms:
                    arms.add(arm.id)
                    of_arm = _of_arm(scene, arm, began_ns)
                    of_run = [run, *map(as_cell, label_texts((labels or {}).get(run, {})).values())]
                    writer.writerows([*of_arm, ARM_POINTS[k], *_of_point(arm, k), *of_run] for k in chosen)
                    rows += len(chosen)
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise SettingsError(f"--out {path}: {error.strerror}; name a file in a folder that exists") from error
    return ArmTracksReport(counts, with_arms, rows, len(arms))


def _of_arm(scene: Scene, arm: TrackedArm, began_ns: int) -> list[Any]:
    person = "" if arm.person < 0 else arm.person
    gesture_sure = round(arm.gesture_sure, 4) if arm.gesture else ""
    side = "left" if arm.left else "right"
    at = [scene.step, round((scene.at_ns - began_ns) / 1e9, 6)]
    return [*at, arm.id, person, side, as_cell(arm.gesture), gesture_sure, int(arm.grabbing), " ".join(arm.cameras)]


def _of_point(arm: TrackedArm, k: int) -> list[Any]:
    known = bool(np.isfinite(arm.points[k]).all())
    place = [f"{value:.5f}" for value in arm.points[k]] if known else [""] * 3
    return [STATES[arm.states[k]], *place, f"{arm.sd[k]:.5f}" if np.isfinite(arm.sd[k]) else ""]
