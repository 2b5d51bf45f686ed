"""Convert arms detected in depth images to JSON rows and to table rows (`docs/arms/recordings.md` describes both)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.lens import project
from mocapella.model.arms import ARM_JOINTS, ARM_POINTS, SeenArm, SeenArms
from mocapella.model.names import as_cell
from mocapella.model.observations import STATE_NAMES

Float64 = NDArray[np.float64]

STATES: Final = STATE_NAMES
COLUMNS: Final = (
    "recording", "file", "time_s", "arm", "handedness", "handedness_sure", "gesture", "gesture_sure", "grabbing",
    "joint", "state", "x_m", "y_m", "z_m", "x_px", "y_px", "sd_m", "reason",
)  # fmt: skip
"""Columns of the table, which has a row for each joint of an arm, and one row for an image without arms."""


def handedness(arm: SeenArm) -> str:
    """Return ``left`` or ``right``, or ``unknown`` if `SeenArm.left_sure` is at most 0.5."""
    return "unknown" if arm.left_sure <= 0.5 else "left" if arm.left else "right"


def frame_row(file: str, at_s: float, found: SeenArms, lens: Float64, *, all_points: bool = False) -> dict[str, Any]:
    """Return the arms of one depth image as a JSON object with the keys ``file``, ``time_s``, ``arms`` and ``reason``.

    An arm has its handedness, its gesture (empty if none is recognised), and for each joint the state, the position in
    the camera frame (x right, y down) [m], its projection x, y [px] and the standard deviation [m]; unknown values are
    None.

    Args:
        file: the image's file.
        at_s: time of the image, written as given [s].
        found: the detected arms, and the reason to write.
        lens: (9,) intrinsics and distortion: fx fy cx cy [px], k1 k2 p1 p2 k3.
        all_points: write all 23 `ARM_POINTS` instead of the eight joints `ARM_JOINTS`.
    """
    points = range(len(ARM_POINTS)) if all_points else ARM_JOINTS
    return {
        "file": file,
        "time_s": round(at_s, 6),
        "arms": [_arm(arm, lens, points) for arm in found.arms],
        "reason": found.reason,
    }


def _arm(arm: SeenArm, lens: Float64, points: Sequence[int]) -> dict[str, Any]:
    chosen = list(points)
    places, pixels = arm.points[chosen], project(arm.points[chosen], lens)
    return {
        "id": int(arm.id),
        "handedness": handedness(arm),
        "handedness_sure": round(float(arm.left_sure), 4),
        "gesture": arm.gesture,
        "gesture_sure": round(float(arm.gesture_sure), 4),
        "grabbing": bool(arm.grabbing),
        "joints": {
            ARM_POINTS[k]: {
                "state": STATES[arm.states[k]],
                "m": _numbers(place, 5),
                "px": _numbers(pixel, 2),
                "sd_m": None if np.isnan(arm.sd[k]) else round(float(arm.sd[k]), 5),
            }
            for k, place, pixel in zip(chosen, places, pixels, strict=True)
        },
    }


def table_rows(recording: str, row: dict[str, Any]) -> Iterator[list[Any]]:
    """Yield the rows of one image for a CSV, as cells in the order of `COLUMNS`; unknown values are empty texts.

    There is a row for each joint of each arm, or a single row with the reason if the image has no arm.

    Args:
        recording: name of the recording, for the first column.
        row: result of `frame_row`.
    """
    begin = [as_cell(recording), as_cell(row["file"]), row["time_s"]]
    for arm in row["arms"]:
        of_arm = [arm[name] for name in ("id", "handedness", "handedness_sure", "gesture", "gesture_sure")]
        for name, joint in arm["joints"].items():
            places = [*(joint["m"] or [""] * 3), *(joint["px"] or [""] * 2)]
            sd = "" if joint["sd_m"] is None else joint["sd_m"]
            yield [*begin, *of_arm, int(arm["grabbing"]), name, joint["state"], *places, sd, row["reason"]]
    if not row["arms"]:
        yield [*begin, *[""] * (len(COLUMNS) - len(begin) - 1), row["reason"]]


def _numbers(values: Float64, digits: int) -> list[float] | None:
    return [round(float(value), digits) for value in values] if np.isfinite(values).all() else None
