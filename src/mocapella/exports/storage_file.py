"""Write MOT and STO, OpenSim's tables over time: joint angles in degrees and the position of the pelvis."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import SettingsError
from mocapella.model.joint_angles import JointAngles
from mocapella.model.trajectories import Trajectories

Float64 = NDArray[np.float64]

PELVIS: Final = ("pelvis_tx", "pelvis_ty", "pelvis_tz")
"""Coordinates of OpenSim's models for the position of the pelvis [m]."""
COORDINATES: Final = (
    "pelvis_tilt", "pelvis_list", "pelvis_rotation", *PELVIS,
    *(f"{name}_{side}" for side in "rl" for name in (
        "hip_flexion", "hip_adduction", "hip_rotation", "knee_angle", "ankle_angle")),
    "lumbar_extension", "lumbar_bending", "lumbar_rotation",
    *(f"{name}_{side}" for side in "rl" for name in ("arm_flex", "arm_add", "arm_rot", "elbow_flex")),
)  # fmt: skip
"""Coordinates of a MOT, in its order: names and signs of OpenSim's model of Rajagopal et al. (2016)."""
_MOST_NAMED: Final = 3
_HEADER: Final = """{name}
version=1
nRows={rows}
nColumns={columns}
inDegrees=yes

Angles are in degrees, positions in metres; docs/joint-angles.md of Mocapella defines them.
endheader
"""


def write_mot(trajectories: Trajectories, path: Path) -> list[str]:
    """Write the coordinates of one person as MOT, which OpenSim shows on a model; unknown values are NaN.

    Columns are the `COORDINATES` that are ever known. The first frame has the time 0, as in a TRC.

    Args:
        trajectories: one individual at a constant rate, with the axes of OpenSim's ground: X forward, Y up.
        path: the file.

    Returns:
        Sentences about coordinates that are left out or partly unknown.

    Raises:
        SettingsError: the keypoints determine no angle, or none is ever known.
        OSError: the file cannot be written.
    """
    angles = JointAngles.of(trajectories, with_sd=False)
    known = _columns(angles)
    return _written({name: known[name] for name in COORDINATES if name in known}, angles, path, "Coordinates")


def write_sto(trajectories: Trajectories, path: Path) -> list[str]:
    """Write all joint angles of one individual as STO; unknown values are NaN. Otherwise as `write_mot`."""
    angles = JointAngles.of(trajectories, with_sd=False)
    return _written(_columns(angles), angles, path, "Joint angles")


def _columns(angles: JointAngles) -> dict[str, Float64]:
    """Return angles [deg] and the position of the pelvis [m] (frames,) by name, with underscores for spaces."""
    names = ["_".join(name.split()) for name in angles.names]
    found = dict(zip(names, np.degrees(angles.angles[:, 0]).T, strict=True))
    return found | dict(zip(PELVIS, angles.pelvis[:, 0].T, strict=True))


def _written(columns: dict[str, Float64], angles: JointAngles, path: Path, title: str) -> list[str]:
    kept = {name: _unwrapped(name, values) for name, values in columns.items() if np.isfinite(values).any()}
    if not kept:
        raise SettingsError(f"{angles.individuals[0]} has no known joint angle in any frame")
    table = np.column_stack([angles.times_s - angles.times_s[0], *kept.values()])
    text = _HEADER.format(name=title, rows=len(table), columns=table.shape[1])
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(text + "\t".join(("time", *kept)) + "\n")
        for row in table:
            cells = ("NaN" if math.isnan(value) else f"{value:.6f}" for value in row.tolist())
            file.write("\t".join(cells) + "\n")
    lost = [name for name in columns if name not in kept and name not in PELVIS]
    notes = [f"never known and left out: {', '.join(lost)}"] if lost else []
    gaps = {name: float(np.isnan(values).mean()) for name, values in kept.items()}
    most = [name for name in sorted(gaps, key=gaps.__getitem__, reverse=True) if gaps[name] > 0]
    if most:
        listed = ", ".join(f"{name} {gaps[name]:.0%}" for name in most[:_MOST_NAMED])
        notes.append(f"{np.mean(list(gaps.values())):.0%} of the values are unknown (NaN), most often: {listed}")
    return notes


def _unwrapped(name: str, values: Float64) -> Float64:
    """Return an angle (frames,) without steps of 360° between known frames; a position unchanged [deg]."""
    out = values.copy()
    known = np.isfinite(out)
    if name not in PELVIS:
        out[known] = np.unwrap(out[known], period=360.0)
    return out
