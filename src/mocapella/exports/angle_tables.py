"""Tables of joint angles, with a row for each known angle of each individual at each time."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mocapella.exports.arm_rows import STATES
from mocapella.exports.trajectory_tables import (
    Texts,
    columns_as_pandas,
    columns_as_polars,
    in_steps,
    labels_of_runs,
    write_table,
)
from mocapella.model.joint_angles import JointAngles
from mocapella.model.trajectories import LABELS, Trajectories

ANGLE_COLUMNS: Final = ("time_s", "run", *LABELS, "individual", "angle", "state", "deg", "sd_deg")
"""Columns of a table of joint angles."""


def angle_columns(angles: JointAngles) -> dict[str, Texts | NDArray[Any]]:
    """Return a table by column, in the order of `ANGLE_COLUMNS`.

    Each angle of each individual with a known angle in a frame has a row, in the order of frames, individuals and
    angles. ``state`` is measured, inferred or unknown; unknown angles and standard deviations [deg] are NaN.
    """
    frames, people = np.nonzero(np.isfinite(angles.angles).any(axis=2))
    count = len(angles.names)
    each = np.repeat(np.arange(len(frames)), count)
    f, i, k = frames[each], people[each], np.tile(np.arange(count), len(frames))
    runs = angles.runs[f]
    return {
        "time_s": angles.times_s[f],
        "run": runs,
        **{label: labels_of_runs(angles.labels, label, runs) for label in LABELS},
        "individual": Texts(i, angles.individuals),
        "angle": Texts(k, angles.names),
        "state": Texts(angles.states[f, i, k].astype(np.int64), STATES),
        "deg": np.degrees(angles.angles[f, i, k]),
        "sd_deg": np.degrees(angles.sd[f, i, k]),
    }


def angles_as_pandas(angles: JointAngles) -> Any:
    """Return the table as a pandas data frame; texts are categories, and unknown numbers are NaN.

    Raises:
        SettingsError: pandas is not installed; names the extra.
    """
    return columns_as_pandas(angle_columns(angles))


def angles_as_polars(angles: JointAngles) -> Any:
    """Return the table as a polars data frame; texts are of the type Enum, and unknown numbers are null.

    Raises:
        SettingsError: polars is not installed; names the extra.
    """
    return columns_as_polars(angle_columns(angles))


def write_angles(trajectories: Trajectories, path: Path) -> None:
    """Write the table of the joint angles of trajectories as CSV; unknown values are empty.

    Raises:
        SettingsError: the keypoints determine no angle.
        OSError: the file cannot be written.
    """
    JointAngles.of(trajectories.at(slice(0, 0)))  # refuses keypoints without an angle, also without a frame
    write_table(path, ANGLE_COLUMNS, (angle_columns(JointAngles.of(some)) for some in in_steps(trajectories)))
